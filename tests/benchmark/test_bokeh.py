"""Measures of bokeh against hand-made cases, and the command on simulated captures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from bokeh.layered_world import random_world
from typer.testing import CliRunner

from telewide.benchmark.bokeh import _Lens
from telewide.benchmark.lens_truth import LensTruth, edge_band, read_lens_truths
from telewide.benchmark.outlines import speck_share
from telewide.benchmark.plain_blurs import BLURS, gaussian_blur, laid_over, scattered
from telewide.capture.images import write_image
from telewide.cli.app import app
from telewide.cli.benchmark import benchmark_app
from telewide.errors import InputError
from telewide.simulate.captures import write_captures
from telewide.srgb import srgb_from_linear

HW = (60, 80)


def step_px() -> np.ndarray:
    return np.where(np.arange(HW[1]) < 40, 2.0, 9.0)[None].repeat(HW[0], axis=0).astype(np.float32)


def test_specks_are_counted_within_two_px_of_an_edge() -> None:
    photo = np.full((*HW, 3), 0.5, np.float32)
    photo[:, 40:] = 0.8  # an edge is no speck
    assert speck_share(photo, step_px()) == 0
    photo[10, 38], photo[20, 41], photo[30, 44, 1], photo[40, 39] = 0, 1, 0, 0.5 + 15 / 255
    # The step lies between columns 39 and 40: of columns 37 to 42 two pixels stand out, the others are far or faint.
    assert speck_share(photo, step_px()) == pytest.approx(2 / (6 * HW[0]))
    assert np.isnan(speck_share(photo, np.zeros(HW, np.float32)))


def test_a_gaussian_by_depth_has_the_spread_of_the_disk() -> None:
    image = np.full((81, 81, 3), 0.2, np.float32)
    image[40, 40] = 1
    blurred = gaussian_blur(image, np.full((81, 81), 3.0, np.float32), focus_px=1.0, k=3.0)
    light = np.maximum(blurred[..., 0] ** 2.2 - blurred[0, 0, 0] ** 2.2, 0)
    y = np.arange(81)[:, None] - 40
    assert np.sqrt((light * y**2).sum() / light.sum()) == pytest.approx(3.0, rel=0.1)  # half of the radius, 6 px
    np.testing.assert_allclose(gaussian_blur(image, step_px_of(81), focus_px=0.0, k=0.0), image, atol=1e-6)


def step_px_of(size: int) -> np.ndarray:
    return np.where(np.arange(size) < size // 2, 0.0, 5.0)[None].repeat(size, axis=0).astype(np.float32)


def test_the_band_lies_along_jumps_of_the_blur() -> None:
    band = edge_band(step_px(), k=1.0)
    assert band[:, 31:49].all()
    assert not band[:, :30].any()
    assert not edge_band(step_px(), k=0.2).any()  # 1.4 px of blur is no jump


def test_true_depth_scores_better_than_a_wrong_one_and_than_a_gaussian() -> None:
    world, f_px, z_m = random_world(2, 160), 1000.0, 1.0
    disparity_px = 20 + 8 * world.disparity_px()
    focus_px = float(disparity_px.max())
    baseline_m = focus_px * z_m / f_px
    k = 1.0  # the aperture's radius is the baseline
    picture = srgb_from_linear(world.through_lens_linear(focus=(focus_px - 20) / 8, k=8 * k, samples=64))
    truth = LensTruth("bokeh", np.clip(picture, 0, 1), focus_px, focus_distance_m=z_m, aperture_radius_m=k * baseline_m)
    lens = _Lens(srgb_from_linear(world.photo_linear()), truth, disparity_px, f_px=f_px)
    exact, shifted = (lens.scores(d) for d in (disparity_px, np.roll(disparity_px, 4, axis=1)))
    assert exact["ours_edges_db"] > exact["gaussian_edges_db"] + 3
    assert exact["ours_db"] > shifted["ours_db"] + 1
    # The same depth by a baseline twice as long: its disparities are twice as large.
    again = lens.scores(2 * disparity_px, baseline_m=2 * baseline_m)
    assert again["ours_db"] == pytest.approx(exact["ours_db"], abs=0.3)


@pytest.mark.parametrize("blur", BLURS.values())
def test_every_blur_spreads_one_distance_alike(blur: Callable[..., np.ndarray], rng: np.random.Generator) -> None:
    photo = cv2.GaussianBlur(rng.random((80, 80, 3)).astype(np.float32), (0, 0), 1)
    flat_px = np.full((80, 80), 3.0, np.float32)
    blurred = blur(photo, flat_px, focus_px=1.0, k=2.0)  # a disk of 4 px
    np.testing.assert_allclose(blurred.mean(axis=(0, 1)), photo.mean(axis=(0, 1)), atol=0.02)
    assert blurred[20:60, 20:60].std() < photo[20:60, 20:60].std() / 2
    np.testing.assert_allclose(blur(photo, flat_px, focus_px=3.0, k=2.0), photo, atol=1e-5)


def test_what_lies_behind_is_hidden_by_layers_and_mixed_by_scatter() -> None:
    photo = np.zeros((80, 80, 3), np.float32)
    photo[:, 40:] = 1  # a black far wall, and before it, in focus, a white one
    far_left = step_px_of(80)
    near_edge = np.s_[20:60, 41:44]
    hidden = laid_over(photo, far_left, focus_px=5.0, k=1.0)
    np.testing.assert_allclose(hidden[near_edge], 1, atol=1e-3)
    mixed = scattered(photo, far_left, focus_px=5.0, k=1.0)
    assert mixed[near_edge].max() < 0.97


@pytest.mark.slow
def test_pictures_of_every_focus_and_aperture_are_scored_by_own_and_by_true_depth(tmp_path: Path) -> None:
    command = ["simulate", str(tmp_path / "set"), "--captures", "1", "--width", "128", "--height", "96", "--thin-lens"]
    assert CliRunner().invoke(app, [*command, "--seed", "4"]).exit_code == 0
    captures, out = tmp_path / "set" / "captures", tmp_path / "bokeh.json"
    assert len(read_lens_truths(captures, "000")) == 9
    done = CliRunner().invoke(benchmark_app, ["bokeh", str(captures), "--json", str(out)])
    assert done.exit_code == 0, done.output
    rows = [row for row in json.loads(out.read_text())["rows"] if "picture" in row]
    assert {row["matcher"] for row in rows} == {"sgm", "box", "true depth"}
    assert len(rows) == 27
    exact = [row for row in rows if row["matcher"] == "true depth"]
    mean_db = {name: np.mean([row[f"{name}_edges_db"] for row in exact]) for name in BLURS}
    assert max(mean_db, key=lambda name: mean_db[name]) == "ours"
    assert mean_db["ours"] > mean_db["gaussian"] + 1
    lines = done.stdout.splitlines()
    line = next(line for line in lines if line.startswith("| true depth"))
    assert line.split("|")[-2].strip() == "0"  # nothing is lost by it
    assert sum(line.startswith("| bokeh-") for line in lines) == 27
    costs = [line.split("|")[1:-1] for line in lines if line.startswith("| ours ")]
    assert all(float(cost) > 0 for cost in costs[-1][1:])


def test_a_corrupt_truth_is_named(tmp_path: Path) -> None:
    captures, truth = tmp_path / "captures", tmp_path / "truth" / "000"
    assert read_lens_truths(captures, "000") == ()
    truth.mkdir(parents=True)
    write_image(truth / "bokeh.png", np.zeros((*HW, 3), np.float32))
    (truth / "bokeh.json").write_text(json.dumps({"focus_distance_m": 1, "focus_disparity_px": 0}))
    with pytest.raises(InputError, match=r"bokeh\.json"):
        read_lens_truths(captures, "000")


def test_the_command_prints_a_line_and_writes_a_row_for_each_capture(tmp_path: Path) -> None:
    write_captures(tmp_path / "captures", count=2, seed=1, hw=(96, 128))
    out = tmp_path / "bokeh.json"
    done = CliRunner().invoke(benchmark_app, ["bokeh", str(tmp_path / "captures"), "--json", str(out)])
    assert done.exit_code == 0, done.output
    assert "| sgm " in done.stdout
    rows = json.loads(out.read_text())["rows"]
    judged = [(row["capture"], row["matcher"]) for row in rows]
    assert sorted(judged) == [(name, matcher) for name in ("000", "001") for matcher in ("box", "sgm")]
    assert all(0 <= row[key] <= 1 for row in rows for key in ("specks", "photo_specks"))
