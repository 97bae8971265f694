"""Middlebury 2006: bytes to pixels, and capture folders that are read back as written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.benchmark.datasets.middlebury import (
    middlebury_2006_scenes,
    read_middlebury_2006,
    write_middlebury_captures,
)
from telewide.capture.pair import find_captures, read_pair, read_truth
from telewide.errors import InputError, UsageError
from telewide.simulate.degrade import shrink_and_enlarge


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Two scenes of noise in which every disparity is stored as 3 d; a column is unknown."""
    root, rng = tmp_path / "third", np.random.default_rng(0)
    for scene in ("Aloe", "Wood1"):
        (root / scene).mkdir(parents=True)
        for view in ("view1", "view5"):
            cv2.imwrite(str(root / scene / f"{view}.png"), rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
        levels = np.full((48, 64), 61, np.uint8)
        levels[:, 10] = 0
        cv2.imwrite(str(root / scene / "disp1.png"), levels)
    return root


def test_bytes_become_pixels_and_zero_unknown(scenes: Path) -> None:
    truth = read_middlebury_2006(scenes / "Aloe", scale_denominator=3)
    assert np.isnan(truth.disparity_px[:, 10]).all()
    np.testing.assert_array_equal(np.delete(truth.disparity_px, 10, axis=1), np.float32(61 / 3))
    assert truth.left.shape == truth.right.shape == (48, 64, 3)


def test_captures_are_read_back_as_written(scenes: Path, tmp_path: Path) -> None:
    written = write_middlebury_captures(scenes, tmp_path / "out", scenes=["Wood1"], factor=4)
    assert written == (tmp_path / "out" / "Wood1",)
    captures = find_captures(tmp_path / "out")
    (capture,) = captures.captures
    assert capture.name == "Wood1"
    assert captures.facts.asymmetry == 4.0
    assert captures.facts.rectified is True
    truth = read_middlebury_2006(scenes / "Wood1", scale_denominator=3)
    pair = read_pair(capture, facts=captures.facts)
    np.testing.assert_array_equal(pair.tele, truth.left)
    np.testing.assert_allclose(pair.wide, shrink_and_enlarge(truth.right, factor=4), atol=0.5001 / 255)
    np.testing.assert_array_equal(read_truth(capture, hw=(48, 64)), truth.disparity_px)


def test_scenes_are_listed_sorted(scenes: Path) -> None:
    assert middlebury_2006_scenes(scenes) == ("Aloe", "Wood1")


def test_a_scene_that_is_not_there(scenes: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no scene Alloe") as caught:
        write_middlebury_captures(scenes, tmp_path / "out", scenes=["Alloe"], factor=4)
    assert "Aloe" in (caught.value.hint or "")
    assert not (tmp_path / "out").exists()


def test_folders_that_hold_no_scenes(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is no folder"):
        middlebury_2006_scenes(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no scene"):
        middlebury_2006_scenes(tmp_path)


def test_sizes_that_differ(scenes: Path) -> None:
    cv2.imwrite(str(scenes / "Aloe" / "disp1.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(InputError, match="differ in size"):
        read_middlebury_2006(scenes / "Aloe", scale_denominator=3)


def test_a_real_scene_warps_right_onto_left(data_root: Path) -> None:
    scene = read_middlebury_2006(data_root / "middlebury_2006_third" / "Aloe", scale_denominator=3)
    y, x = np.mgrid[: scene.left.shape[0], : scene.left.shape[1]].astype(np.float32)
    known = ~np.isnan(scene.disparity_px) & (x - scene.disparity_px >= 0)
    at_zero = np.abs(scene.right - scene.left)[known].mean()
    warped = cv2.remap(scene.right, x - np.nan_to_num(scene.disparity_px), y, cv2.INTER_LINEAR)
    assert np.abs(warped - scene.left)[known].mean() < 0.4 * at_zero
    assert len(middlebury_2006_scenes(data_root / "middlebury_2006_third")) == 21
