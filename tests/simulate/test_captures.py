"""Written captures are what the reader of captures expects, and their truth explains the two pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from telewide.capture.facts import FACTS_FILE
from telewide.capture.images import read_image
from telewide.capture.pair import find_captures, read_pair, read_truth
from telewide.errors import UsageError
from telewide.simulate.captures import SCENES, write_captures

HW = (96, 144)


def moved_by(image: np.ndarray, disparity_px: np.ndarray) -> np.ndarray:
    """Value of the image at x - d, linear between pixels."""
    x = np.clip(np.arange(image.shape[1]) - disparity_px, 0, image.shape[1] - 1.001)
    whole, share = np.floor(x).astype(int), (x % 1)[..., None]
    rows = np.arange(image.shape[0])[:, None]
    return (image[rows, whole] * (1 - share) + image[rows, whole + 1] * share).astype(np.float32)


@pytest.mark.parametrize("scene", SCENES)
def test_reader_finds_what_was_written(tmp_path: Path, scene: str) -> None:
    folders = write_captures(tmp_path / "out", count=2, seed=5, hw=HW, factor=3.0, scene=scene)
    found = find_captures(tmp_path / "out")
    assert [capture.tele_path.parent for capture in found.captures] == list(folders)
    assert found.problems == ()
    assert found.facts.asymmetry == 3.0
    assert found.facts.rectified is True
    for capture in found.captures:
        assert read_image(capture.wide_path).shape == (32, 48, 3)
        pair = read_pair(capture, facts=found.facts)
        truth_px = read_truth(capture, hw=HW)
        assert truth_px is not None
        assert pair.tele.shape == pair.wide.shape == (*HW, 3)
        assert 0.5 < truth_px.min() < truth_px.max() < 0.13 * HW[1]
        # Tint aside, wide at x - d shows what tele shows at x; elsewhere it does not.
        grey = [image - image.mean(axis=(0, 1)) for image in (pair.tele, moved_by(pair.wide, truth_px), pair.wide)]
        shown = np.s_[:, round(0.12 * HW[1]) :]
        off = [np.square(grey[0][shown] - image[shown]).mean() for image in grey[1:]]
        assert off[0] < 0.8 * off[1]


def test_same_seed_same_files(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_captures(tmp_path / name, count=1, seed=seed, hw=HW)
    a, b, c = ((tmp_path / name / "000" / "tele.png").read_bytes() for name in "abc")
    assert a == b != c


def test_a_capture_does_not_depend_on_how_many_follow(tmp_path: Path) -> None:
    write_captures(tmp_path / "one", count=1, seed=1, hw=HW)
    write_captures(tmp_path / "two", count=2, seed=1, hw=HW)
    one, two = (tmp_path / name / "000" / "wide.png" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()


def test_truth_only_for_the_first(tmp_path: Path) -> None:
    folders = write_captures(tmp_path, count=3, hw=HW, image_format="jpg", truth_count=1)
    assert [(folder / "truth.pfm").exists() for folder in folders] == [True, False, False]
    assert (folders[2] / "wide.jpg").exists()
    assert (tmp_path / FACTS_FILE).exists()


def test_window_and_factor_are_followed(tmp_path: Path) -> None:
    write_captures(tmp_path, count=1, hw=(100, 150), factor=2.5, disparity_window_px=(-4.0, 8.0), scene="random")
    capture = find_captures(tmp_path).captures[0]
    truth_px = read_truth(capture)
    assert truth_px is not None
    assert -4.01 <= truth_px.min() < truth_px.max() <= 8.01
    assert read_image(capture.wide_path).shape == (40, 60, 3)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"count": 0}, "number of captures"),
        ({"factor": 0.5}, "factor"),
        ({"factor": 99.0}, "factor"),
        ({"factor": 4.0}, "128"),
        ({"scene": "portrait"}, "portrait"),
        ({"image_format": "bmp"}, "bmp"),
        ({"disparity_window_px": (9.0, 2.0)}, "window"),
    ],
)
def test_wrong_requests_are_refused(tmp_path: Path, wrong: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        write_captures(tmp_path, **{"count": 1, "hw": HW, **wrong})  # type: ignore[arg-type]


def test_examples_are_complete_and_small(repo: Path) -> None:
    folder = repo / "examples" / "captures"
    found = find_captures(folder)
    assert len(found.captures) == 10
    assert found.problems == ()
    assert sum(capture.truth_path is not None for capture in found.captures) == 5
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 3_000_000
