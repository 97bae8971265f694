"""Each photo of a call is decoded once, hashed once and asked for its EXIF once; points are looked for once a view."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from photographed_boards import write_board_photos

import telewide.capture.exif
import telewide.capture.images
import telewide.files
import telewide.points.matches
from telewide.boards.kept_photos import KeptPhotos
from telewide.boards.photo_detection import read_grey
from telewide.bokeh.picture import BokehOptions
from telewide.capture.pair import find_captures
from telewide.capture.photo_store import PhotoStore
from telewide.pipeline import run_captures
from telewide.recipe import load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.calibrate import CalibrateOptions, calibrate_boards
from telewide.stages.depth import DepthOptions
from telewide.stages.observer import Silent


def counted(monkeypatch: pytest.MonkeyPatch, place: Any, name: str, key: Callable[..., object]) -> Counter[object]:
    """Calls of a function by what they are about; the function itself runs."""
    calls: Counter[object] = Counter()
    real = getattr(place, name)

    def counting(*args: Any, **kwargs: Any) -> Any:
        calls[key(*args)] += 1
        return real(*args, **kwargs)

    monkeypatch.setattr(place, name, counting)
    return calls


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    folder = tmp_path / "captures"
    write_captures(folder, count=2, seed=1, hw=(128, 192), factor=2)
    return folder


def test_a_call_works_on_each_photo_once(captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telewide.files, "_TOO_NEW_NS", 0)  # files written this very second are trusted
    decoded = counted(monkeypatch, telewide.capture.images, "_decoded", lambda path, *_: path)
    asked = counted(monkeypatch, telewide.capture.exif, "_tags_of_photo", lambda path, *_: path)
    hashed = counted(monkeypatch, hashlib, "file_digest", lambda stream, *_: Path(stream.name))
    searched = counted(monkeypatch, telewide.points.matches, "sift_features", lambda image: image.tobytes())
    few = ("train.rehearsal.steps=1", "train.rehearsal.least_steps=1")
    recipe = load_recipe("quick", settings=few)
    options = DepthOptions(method="sgm", bokeh=BokehOptions(strength_px=3.0), device="cpu")
    done = run_captures(captures, run=tmp_path / "run", recipe=recipe, options=options, observer=Silent())
    assert len(done.outcomes) == 2
    assert done.report is not None
    photos = [path for capture in find_captures(captures).captures for path in (capture.tele_path, capture.wide_path)]
    for what, calls in (("decoded", decoded), ("asked for EXIF", asked), ("hashed", hashed)):
        assert {path: calls[path] for path in photos} == dict.fromkeys(photos, 1), what
    assert sorted(searched.values()) == [1] * 4, "points of two captures with two views"


def test_photos_are_kept_within_the_budget(captures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (capture.tele_path for capture in find_captures(captures).captures)
    expected = {path: telewide.capture.images.read_image(path) for path in (first, second)}
    decoded = counted(monkeypatch, telewide.capture.images, "_decoded", lambda path, *_: path)
    store = PhotoStore(max_bytes=expected[first].size)  # a byte a value of 8 bits
    for path in (first, second, first, second):
        np.testing.assert_array_equal(store.read(path), expected[path])
    assert decoded == {first: 1, second: 2}
    assert store.kept_bytes == expected[first].size


@pytest.mark.parametrize("board", [None, pytest.param("chessboard_9x6", marks=pytest.mark.slow)])
def test_a_calibration_decodes_each_board_photo_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, board: str | None
) -> None:
    """Recognition, detection and the page share what one of them has decoded."""
    boards = write_board_photos(tmp_path / "boards", count=4)
    decoded = counted(monkeypatch, telewide.capture.images, "_decoded", lambda path, *_: path)
    options = CalibrateOptions(board=board, out=tmp_path / "rig.yaml", processes=1)
    run = calibrate_boards(boards, options=options, observer=Silent())
    assert "A rectified pair" in run.report.read_text(encoding="utf-8")
    assert decoded == dict.fromkeys(boards.glob("*/*.png"), 1)


def test_board_photos_are_kept_within_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = sorted(write_board_photos(tmp_path, count=1).glob("*/*.png"))
    decoded = counted(monkeypatch, telewide.capture.images, "_decoded", lambda path, *_: path)
    photos = KeptPhotos(max_bytes=4 * read_grey(first).size)
    decoded.clear()
    for path in (first, second, first, second):
        grey = photos.read_grey(path)
    assert photos.paths == {first}
    assert photos.kept_bytes == 4 * photos.read_grey(first).size
    assert decoded == {first: 1, second: 2}
    np.testing.assert_array_equal(grey, read_grey(second))
    np.testing.assert_allclose(photos.read_colour(first), telewide.capture.images.read_image(first), atol=0.5 / 255)
