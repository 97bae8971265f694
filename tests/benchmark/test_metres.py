"""Metres judged by closed forms; the simulated phone's switches; and a small run from photos to the table."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.benchmark.metres import (
    BAND_SHARE,
    DEPTHS_M,
    DISTANCES_M,
    MATCHING_ERROR_PX,
    MeasuredDepths,
    depth_makers,
    judge_distance,
    metres_table,
    read_depths,
)
from telewide.benchmark.report import BenchmarkReport
from telewide.capture.images import read_image, write_image
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.cli import app
from telewide.errors import UsageError
from telewide.geometry.rig import StereoRig
from telewide.simulate.phone import phone_rig, write_phone
from telewide.stages.capture_depth import DepthOutcome
from telewide.stages.depth import DepthRun

GAIN = 20.0
SHARES = ("known", "error_p50", "error_p90", "allowed", "inside_95")


def measured(truth_m: NDArray[np.float64], share_off: NDArray[np.float64] | float, std_m: float) -> MeasuredDepths:
    return MeasuredDepths(truth_m, truth_m * (1 + share_off), np.full(len(truth_m), std_m))


def test_a_true_depth_has_no_error() -> None:
    row = judge_distance(measured(np.full(50, 2.0), 0.0, 0.01), 2.0, gain=GAIN)
    assert [row[key] for key in SHARES] == pytest.approx([1, 0, 0, 2 * MATCHING_ERROR_PX / GAIN, 1])
    assert row["pixels"] == 50


def test_errors_are_relative_and_told_by_their_percentiles() -> None:
    """Errors of 0 to 10 %, evenly and of both signs, at 4 m with a stated deviation of 0.1 m."""
    share_off = np.linspace(0, 0.1, 10_001) * np.where(np.arange(10_001) % 2, 1, -1)
    row = judge_distance(measured(np.full(10_001, 4.0), share_off, 0.1), 4.0, gain=GAIN)
    assert row["error_p50"] == pytest.approx(0.05)
    assert row["error_p90"] == pytest.approx(0.09)
    assert row["inside_95"] == pytest.approx(1.96 * 0.1 / 0.4, abs=1e-3)


def test_normal_errors_of_the_stated_deviation_lie_inside_in_95_percent(rng: np.random.Generator) -> None:
    """And matching that is off by 0.25 px has the percentiles of a normal distribution about what geometry allows."""
    truth_m = np.full(200_000, 1.0)
    disparity_px = GAIN / truth_m + rng.normal(0, MATCHING_ERROR_PX, truth_m.shape)
    depths = MeasuredDepths(truth_m, GAIN / disparity_px, np.full(truth_m.shape, MATCHING_ERROR_PX / GAIN))
    row = judge_distance(depths, 1.0, gain=GAIN)
    assert row["inside_95"] == pytest.approx(0.95, abs=0.003)
    assert row["error_p50"] == pytest.approx(0.6745 * float(str(row["allowed"])), rel=0.02)
    assert row["error_p90"] == pytest.approx(1.6449 * float(str(row["allowed"])), rel=0.02)


def test_only_the_band_counts_and_what_is_unknown_does_not() -> None:
    edge = BAND_SHARE * 2.0
    truth_m = np.array([2 - edge * 0.99, 2 + edge * 0.99, 2 - edge * 1.01, 2 + edge * 1.01, 2.0, 2.0])
    depth_m = np.array([*truth_m[:2], 9.0, 9.0, np.nan, 2.2])
    row = judge_distance(MeasuredDepths(truth_m, depth_m, np.full(6, 0.01)), 2.0, gain=GAIN)
    assert row["pixels"] == 3
    assert row["known"] == pytest.approx(3 / 4)
    assert row["inside_95"] == pytest.approx(2 / 3)


def test_where_nothing_lies_there_is_no_number() -> None:
    row = judge_distance(measured(np.full(5, 2.0), 0.0, 0.1), 0.5, gain=GAIN)
    assert row["pixels"] == 0
    assert all(np.isnan(float(str(row[key]))) for key in SHARES)
    kind = {"matcher": "sgm", "moves": True, "cast": False}
    line = metres_table(BenchmarkReport("metres", {}, ({**kind, **row},))).splitlines()[-1]
    assert [cell.strip() for cell in line.split("|")[1:-1]] == ["sgm", "yes", "no", "0.5", "0", *["-"] * 5]


def test_hidden_and_filled_pixels_do_not_count(tmp_path: Path, rng: np.random.Generator) -> None:
    rig = phone_rig(rng, hw=(4, 6))
    truth_m = rng.uniform(1, 2, (4, 6)).astype(np.float32)
    hidden, valid = np.zeros((4, 6), np.float32), np.ones((4, 6), np.bool_)
    hidden[0], valid[1] = 1, False
    write_pfm(tmp_path / "captures" / "000" / "truth.pfm", (rig.tele.K[0, 0] * rig.baseline_m / truth_m))
    write_image(tmp_path / "truth" / "hidden" / "000.png", hidden)
    folder = tmp_path / "depth"
    (folder / "000").mkdir(parents=True)
    np.savez(folder / "000" / "depth.npz", depth_m=truth_m, depth_std_m=0.1 * truth_m, valid=valid)
    depths = read_depths(tmp_path, DepthRun(folder, (DepthOutcome("000", (), (), {}),), ()), rig=rig)
    np.testing.assert_allclose(depths.truth_m, truth_m[1:].ravel(), rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(depths.depth_m), np.repeat([True, False, False], 6))
    np.testing.assert_allclose(depths.depth_std_m, 0.1 * depths.truth_m, rtol=1e-6)


def test_a_capture_without_depth_counts_as_not_known(tmp_path: Path, rng: np.random.Generator) -> None:
    """Two captures, one of which was skipped: half of what both lenses see is known."""
    rig = phone_rig(rng, hw=(4, 6))
    truth_m = np.ones((4, 6), np.float32)
    for name in ("000", "001"):
        write_pfm(tmp_path / "captures" / name / "truth.pfm", rig.tele.K[0, 0] * rig.baseline_m / truth_m)
        write_image(tmp_path / "truth" / "hidden" / f"{name}.png", np.zeros((4, 6), np.float32))
    folder = tmp_path / "depth"
    (folder / "000").mkdir(parents=True)
    np.savez(folder / "000" / "depth.npz", depth_m=truth_m, depth_std_m=truth_m, valid=np.ones((4, 6), np.bool_))
    depths = read_depths(tmp_path, DepthRun(folder, (DepthOutcome("000", (), (), {}),), ()), rig=rig)
    assert judge_distance(depths, 1.0, gain=100.0)["known"] == 0.5


def test_a_run_without_weights_is_refused(tmp_path: Path) -> None:
    assert [maker.name for maker in depth_makers(())] == ["sgm"]
    with pytest.raises(UsageError, match="no trained network"):
        depth_makers([tmp_path])


def test_the_still_lifes_hold_every_distance() -> None:
    for distance_m in DISTANCES_M:
        assert any(near_m < distance_m < far_m for near_m, far_m in DEPTHS_M), distance_m


def misses(place: Path, rig: StereoRig) -> tuple[float, float]:
    """How far wide's colours are from tele's by the true depth: median where both see, and where wide does not."""
    folder = place / "captures" / "000"
    tele, wide = read_image(folder / "tele.jpg"), read_image(folder / "wide.jpg")
    depth_m = rig.tele.K[0, 0] * rig.baseline_m / read_pfm(folder / "truth.pfm")
    rows, columns = np.indices(depth_m.shape)
    rays = rig.tele.normalised(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))
    points_m = np.column_stack([rays, np.ones(len(rays))]) * depth_m.reshape(-1, 1)
    in_wide = rig.wide.project(points_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3])
    x, y = in_wide.reshape(*depth_m.shape, 2).astype(np.float32).transpose(2, 0, 1)
    seen = cv2.remap(wide, np.ascontiguousarray(x), np.ascontiguousarray(y), cv2.INTER_LINEAR)
    # Wide has a third of the detail.
    difference = np.abs(cv2.GaussianBlur(tele, (0, 0), 1.5) - seen).mean(axis=2)
    hidden = read_image(place / "truth" / "hidden" / "000.png")[..., 0] > 0.5
    return float(np.median(difference[~hidden])), float(np.median(difference[hidden]))


def test_what_is_switched_off_is_off_and_all_else_the_same(tmp_path: Path) -> None:
    kinds = {"plain": (False, False), "moves": (True, False), "cast": (False, True)}
    missed = {}
    for name, (moves, cast) in kinds.items():
        place = tmp_path / name
        rig = write_phone(place, captures=1, boards=0, width=320, seed=1, moves=moves, cast=cast, depths_m=((0.6, 2),))
        missed[name] = misses(place, rig)
    assert missed["plain"][0] < 0.02
    assert missed["plain"][1] > 3 * missed["plain"][0]
    assert missed["moves"][0] > 1.05 * missed["plain"][0]
    assert missed["cast"][0] > 1.5 * missed["plain"][0]
    truths = [read_pfm(tmp_path / name / "captures" / "000" / "truth.pfm") for name in kinds]
    np.testing.assert_array_equal(truths[0], truths[1])
    np.testing.assert_array_equal(truths[0], truths[2])
    depth_m = rig.tele.K[0, 0] * rig.baseline_m / truths[0]
    assert 0.45 < depth_m.min() < 0.75
    assert 1.2 < depth_m.max() < 2.1


def test_depths_of_a_phone_need_a_nearer_and_a_farther_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="metres"):
        write_phone(tmp_path, captures=1, depths_m=((2.0, 1.0),))


@pytest.mark.slow
def test_from_photos_to_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["benchmark", "metres", "--width", "480", "--boards", "10", "--json", str(tmp_path / "metres.json")]
    assert app._exit_code([*words, "--keep", str(tmp_path / "kept")]) == 0
    assert len(capsys.readouterr().out.strip().splitlines()) == 2 + 4 * len(DISTANCES_M)
    rows = json.loads((tmp_path / "metres.json").read_text())["rows"]
    for row in rows:
        assert row["pixels"] > 1000
        assert row["inside_95"] > 0.9
        if not row["moves"]:
            assert row["error_p50"] < 1.5 * row["allowed"]
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == [
        "moving",
        "moving-cast",
        "still",
        "still-cast",
    ]
