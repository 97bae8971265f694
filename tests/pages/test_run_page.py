"""What the report page of a run advises to do next: commands that can be pasted into a shell."""

from __future__ import annotations

import base64
import logging
import shlex
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.capture.images import write_image
from telewide.cli import main
from telewide.cli.bokeh import BokehWords
from telewide.depth.export import write_depth
from telewide.depth.result import DepthResult
from telewide.drawing import upright
from telewide.geometry.stereo import DisparityMap
from telewide.pages.run_page import next_steps, report_row, training_curves
from telewide.pages.viewed import DEFAULT_LIGHTS
from telewide.recipe import Recipe, load_recipe
from telewide.text import Invocation

RIG = Path("my rigs/phone.yaml")


def commands(recipe: Recipe, *, rig: Path | None) -> dict[str, list[str]]:
    """The words of each command, by its subcommand and captures."""
    typed = Invocation("run", ("my captures",), {"out": "my run", "rig": rig, "recipe": "quick", "seed": 5})
    steps = next_steps(Path("my run"), recipe=recipe, invocation=typed, calls={})
    words = [shlex.split(step.command) for step in steps]
    assert all(word[0] == "telewide" for word in words)
    return {" ".join(word[1:3]): word[1:] for word in words}


@pytest.mark.parametrize("rig", [None, RIG])
def test_the_same_captures_keep_their_rig(rig: Path | None) -> None:
    asked = commands(load_recipe("quick"), rig=rig)
    for words in (asked["run my captures"], asked["depth my captures"]):
        assert (words[words.index("--rig") + 1] == str(RIG)) if rig else ("--rig" not in words)
    assert "--rig" not in asked["run my-captures/"], "own photos have lenses of their own"
    assert asked["depth my captures"][2:4] == ["--run", "my run"]
    longer = asked["run my captures"]
    assert longer[2:4] == ["--out", "my run-default"]
    assert longer[-2:] == ["--seed", "5"]
    assert "--recipe" not in longer


def test_every_command_is_one_the_program_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for words in commands(load_recipe("quick"), rig=RIG).values():
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code == 2
        assert f"{Path(words[1])} does not exist" in capsys.readouterr().err


def test_a_longer_training_is_advised_where_there_is_one() -> None:
    assert "run my captures" in commands(load_recipe("quick"), rig=None)
    assert "run my captures" not in commands(load_recipe("default", seed=5), rig=None)


@pytest.mark.parametrize(("rotated_deg", "wh"), [(0, (80, 60)), (90, (60, 80))])
def test_all_pictures_of_a_capture_stand_alike(
    tmp_path: Path, rng: np.random.Generator, rotated_deg: int, wh: tuple[int, int]
) -> None:
    photo = rng.random((60, 80, 3)).astype(np.float32)
    one = np.ones(photo.shape[:2], np.float32)
    result = DepthResult("one", DisparityMap(one, one, one > 0), rotated_deg=rotated_deg)
    write_depth(tmp_path / "one", result, image=photo)
    write_image(tmp_path / "one" / "bokeh.jpg", upright(photo, rotated_deg=rotated_deg))
    row = report_row("one", lambda _: photo, tmp_path / "one", root=tmp_path, numbers={}, rotated_deg=rotated_deg)
    assert [picture.wh for picture in row.pictures] == [wh] * 4


def test_a_depth_that_cannot_be_read_leaves_its_picture_out_and_is_said(
    tmp_path: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    photo = rng.uniform(size=(60, 80, 3)).astype(np.float32)
    (tmp_path / "depth.npz").write_bytes(b"garbage")
    with caplog.at_level(logging.WARNING):
        row = report_row("one", lambda _: photo, tmp_path, root=tmp_path, numbers={})
    assert [picture.label for picture in row.pictures] == ["wide", "tele"]
    assert "depth.npz is corrupt" in caplog.text


def test_curves_are_drawn_of_what_can_be_read(tmp_path: Path) -> None:
    lines = [f'{{"stage": "a", "stage_index": 0, "step": {step}, "losses": {{"x": {0.1 * step}}}}}' for step in (1, 2)]
    lines.append('{"stage": "b", "stage_index": 1, "step": 1, "judgement": {"off_1px": 0.5}}')
    (tmp_path / "log.jsonl").write_text("\n".join([*lines, "[]", '{"stage": "b", "ste']))
    losses, judged = training_curves(tmp_path / "log.jsonl")
    np.testing.assert_allclose(losses.values, [0.1, 0.2])
    np.testing.assert_allclose([*judged.steps, *judged.values], [3.0, 50.0])
    assert training_curves(tmp_path / "none") == ()


def test_pixels_of_two_sizes_are_told_apart(tmp_path: Path, rng: np.random.Generator) -> None:
    """Matches are missed by px of the size that was matched, errors are px of the photo: each heading says which."""
    photo = rng.random((60, 80, 3)).astype(np.float32)
    one = np.ones(photo.shape[:2], np.float32)
    write_depth(tmp_path / "one", DepthResult("one", DisparityMap(one, one, one > 0)), image=photo)
    numbers = {"off_1px": 0.5, "EPE_px": 0.5}
    row = report_row("one", lambda _: photo, tmp_path / "one", root=tmp_path, numbers=numbers)
    matched, photos = row.numbers
    assert "px of the matched size" in matched
    assert "px of the photo" in photos


@pytest.mark.parametrize(("stated", "shown"), [(None, DEFAULT_LIGHTS), (1.0, 1.0), (8.0, 8.0)])
def test_lights_shine_on_the_page_unless_somebody_said_how_bright(
    tmp_path: Path, rng: np.random.Generator, stated: float | None, shown: float
) -> None:
    """A value that was stated counts, though it be the one that files are made with by default."""
    photo = rng.random((60, 80, 3)).astype(np.float32)
    disparity_px = np.tile(np.linspace(2, 9, 80, dtype=np.float32), (60, 1))
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), disparity_px > 0)
    write_depth(tmp_path / "one", DepthResult("one", maps), image=photo)
    numbers = {"focus_px": 9.0, "focus_x_px": 79.0, "focus_y_px": 30.0, "blur_per_px": 1.0}
    words = {} if stated is None else {"highlights": stated}
    asked = BokehWords(**words).options()
    row = report_row("one", lambda _: photo, tmp_path / "one", root=tmp_path, numbers=numbers, bokeh_asked=asked)
    assert row.viewed is not None
    assert (row.viewed["focus"], row.viewed["lights"]) == ([79, 30], shown)


def test_guesses_look_hatched_on_the_page_whatever_the_size_of_the_photo(tmp_path: Path) -> None:
    """The hatch is drawn at the size it is seen at; drawn at the photo's size it would be made invisible."""
    hw = (540, 4320)  # nine times the size it is seen at, which is the period of the hatch
    disparity_px = np.tile(np.linspace(5, 40, hw[1], dtype=np.float32), (hw[0], 1))
    valid = np.arange(hw[1])[None].repeat(hw[0], axis=0) < hw[1] // 2
    write_depth(tmp_path / "one", DepthResult("one", DisparityMap(disparity_px, np.ones(hw, np.float32), valid)))
    photo = np.zeros((150, 200, 3), np.float32)
    picture = report_row("one", lambda _: photo, tmp_path / "one", root=tmp_path, numbers={}).pictures[2]
    shown = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE).astype(np.float64)
    ripple = np.abs(np.diff(shown, axis=0)).mean(axis=0)  # along columns the colour does not change
    half = shown.shape[1] // 2
    assert ripple[half + 8 :].mean() > 5 > 2 * ripple[: half - 8].mean()


def test_corrected_views_are_grey_where_their_photos_do_not_reach(tmp_path: Path, rng: np.random.Generator) -> None:
    photo = np.full((60, 80, 3), 0.9, np.float32)
    disparity_px = rng.uniform(2, 6, photo.shape[:2]).astype(np.float32)
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), disparity_px > 0)
    write_depth(tmp_path / "one", DepthResult("one", maps), image=photo)
    valid = np.zeros((60, 80), np.float32)
    valid[:, 40:] = 1
    write_image(tmp_path / "pair" / "wide.png", photo)
    write_image(tmp_path / "pair" / "wide_valid.png", valid)
    row = report_row("one", lambda _: photo, tmp_path / "one", root=tmp_path, numbers={}, corrected=tmp_path / "pair")
    assert row.viewed is not None
    pictures = row.viewed["pictures"]
    assert list(pictures) == ["tele", "wide", "wide, corrected", "disparity"]  # type: ignore[call-overload]
    encoded = base64.b64decode(pictures["wide, corrected"].partition(",")[2])  # type: ignore[index]
    shown = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_GRAYSCALE) / 255
    np.testing.assert_allclose(shown[:, :32], 0.5, atol=0.02)
    np.testing.assert_allclose(shown[:, 48:], 0.9, atol=0.02)


def test_photos_are_shown_one_at_a_time(tmp_path: Path, rng: np.random.Generator) -> None:
    """A photo and its turned copy take 24 bytes a pixel, its depth 9; two photos so would take 48."""
    hw = (2000, 3000)
    levels = np.tile(rng.integers(0, 256, (20, 30, 3), dtype=np.uint8), (100, 100, 1))
    disparity_px = np.tile(np.linspace(2, 9, hw[0], dtype=np.float32), (hw[1], 1))
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), disparity_px > 0)
    write_depth(tmp_path / "one", DepthResult("one", maps), formats=("npz",))
    write_image(tmp_path / "one" / "bokeh.jpg", np.rot90(levels) / np.float32(255))
    tracemalloc.start()
    row = report_row(
        "one", lambda _: levels * np.float32(1 / 255), tmp_path / "one", root=tmp_path, numbers={}, rotated_deg=90
    )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert row.viewed is not None
    assert peak < 48 * levels[..., 0].size
