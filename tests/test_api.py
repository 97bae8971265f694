"""The public interface: one way with the command line, examples that run, and nothing heavy on import."""

from __future__ import annotations

import doctest
import os
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from source import modules_loaded_by

import telewide
from telewide import api
from telewide.assets import BOX_WEIGHTS
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm
from telewide.cli import main
from telewide.depth.result import DepthResult
from telewide.errors import InputError, TelewideError, UsageError
from telewide.geometry.stereo import DisparityMap
from telewide.matching.methods import Method
from telewide.matching.window import Window
from telewide.recipe import load_recipe
from telewide.stages.match import read_matcher

FUNCTIONS = [name for name in telewide.__all__ if not name.startswith("_")]
SLOW = {"calibrate", "train"}


def test_import_loads_nothing_heavy_and_offers_all() -> None:
    loaded = modules_loaded_by("import telewide; assert 'train' in dir(telewide)")
    assert not loaded & {"numpy", "cv2", "torch", "telewide.api"}
    assert [name for name in FUNCTIONS if getattr(telewide, name) is not getattr(api, name)] == []
    with pytest.raises(AttributeError, match="resolve"):
        telewide.resolve  # noqa: B018


def run_example(name: str, repo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(repo)
    found = doctest.DocTestFinder(recurse=False).find(getattr(api, name), name)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    assert found
    assert all(test.examples for test in found)
    assert [runner.run(test).failed for test in found] == [0] * len(found)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name not in SLOW])
def test_the_example_of_each_function_runs(name: str, repo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_example(name, repo, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SLOW))
def test_the_longer_examples_run(name: str, repo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_example(name, repo, monkeypatch)


def test_the_example_script_runs(
    repo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["first_steps.py", str(tmp_path)])
    runpy.run_path(str(repo / "examples" / "first_steps.py"))
    said = capsys.readouterr().out
    assert "median depth" in said
    assert read_image(tmp_path / "bokeh.png").shape[2] == 3


@pytest.mark.parametrize(("words", "method"), [(("--method", "sgm"), "sgm"), ((), "network")])
def test_depth_is_that_of_the_command_line(words: tuple[str, ...], method: Method, repo: Path, tmp_path: Path) -> None:
    """By the network that comes with telewide, unless another way is named."""
    capture = repo / "examples" / "captures" / "001"
    with pytest.raises(SystemExit) as left:
        main(["depth", str(capture), *words, "--out", str(tmp_path), "--run", str(tmp_path / "run"), "-q"])
    assert not left.value.code
    depth = telewide.estimate_depth(telewide.read_pair(capture), method=method)
    apart_px = np.abs(depth.disparity.disparity_px - read_pfm(tmp_path / "001" / "disparity.pfm"))
    # The command keeps the corrected pair as pictures of 8 bits; what they round moves some pixels.
    assert np.median(apart_px) < 0.03
    assert np.mean(apart_px < 0.25) > 0.95


def test_a_folder_of_many_captures_is_refused(repo: Path) -> None:
    with pytest.raises(UsageError, match="holds 10 captures"):
        telewide.read_pair(os.fspath(repo / "examples" / "captures"))


def test_weights_that_do_not_exist_are_told(repo: Path, tmp_path: Path) -> None:
    photos = telewide.read_pair(repo / "examples" / "captures" / "000")
    with pytest.raises(TelewideError, match=r"nowhere\.safetensors"):
        telewide.estimate_depth(photos, weights=tmp_path / "nowhere.safetensors")


def test_a_point_may_be_numbers(repo: Path) -> None:
    photo = np.random.default_rng(1).random((60, 90, 3), dtype=np.float32)
    disparity_px = np.where(np.arange(90) < 40, 4.0, 12.0).astype(np.float32) * np.ones((60, 1), np.float32)
    maps = DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))
    depth = DepthResult("beach", maps)
    pictures = [telewide.render_bokeh(photo, depth, focus=focus, strength_px=4.0) for focus in ((70, 30), "70,30")]
    np.testing.assert_array_equal(*pictures)
    np.testing.assert_allclose(pictures[0][:, 60:], photo[:, 60:], atol=1e-4)


@pytest.mark.parametrize(
    ("trained_for", "stated", "expected"),
    [((0, 64), None, (0, 64)), ((-64, 900), None, (-64, 384)), (None, (0, 1000), (0, 384)), (None, None, None)],
)
def test_photos_that_do_not_tell_what_to_search_leave_it_to_the_weights(
    trained_for: Window | None, stated: Window | None, expected: Window | None, repo: Path
) -> None:
    """Within the width of the pictures, as on the command line."""
    shot = telewide.rectify(telewide.read_pair(repo / "examples" / "captures" / "000"))
    assert shot.corrected.pair.tele.shape[1] == 384
    shot = replace(shot, report=replace(shot.report, n_matches=0))
    recipe = load_recipe("default", settings=[] if stated is None else [f"window_px={list(stated)}"])
    matcher = replace(read_matcher(BOX_WEIGHTS, method="sgm", device="cpu"), window=trained_for)
    if expected is None:
        with pytest.raises(InputError, match="no pair"):
            api._window(shot, recipe, matcher)
    else:
        assert api._window(shot, recipe, matcher) == expected
