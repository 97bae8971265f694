"""What the right view of a light field does not see: closed forms of planes, and the photographed views themselves."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.benchmark.datasets.light_fields import read_hci, read_inria
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.scores import score_regions
from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatMap

HW = (24, 96)
X = np.arange(HW[1])
ROWS, COLUMNS = slice(6, 18), slice(40, 60)
"""Of the near square."""


def square(near: float, *, before: float) -> FloatMap:
    """A near square before a far plane."""
    disparity = np.full(HW, before, np.float32)
    disparity[ROWS, COLUMNS] = near
    return disparity


def hidden(folder: Path, per_step_px: FloatMap, *, right: int = 44, of_right_px: FloatMap | None = None) -> BoolMap:
    """What is occluded as read from a scene of HCI; colours do not matter."""
    for view in (40, right):
        write_image(folder / "scene" / f"input_Cam{view:03d}.png", np.full((*HW, 3), 0.5, np.float32))
    write_pfm(folder / "scene" / "gt_disp_lowres.pfm", per_step_px)
    if of_right_px is not None:
        write_pfm(folder / "scene" / f"gt_disp_lowres_Cam{right:03d}.pfm", of_right_px)
    occluded = read_hci(folder, "scene", views=(40, right)).occluded
    assert occluded is not None
    return occluded


@pytest.mark.parametrize(("near", "far"), [(3, 1), (2, 0), (1, -1), (-1, -3)])
@pytest.mark.parametrize("right", [41, 42, 44])
def test_a_square_hides_a_strip_as_wide_as_disparities_differ(tmp_path: Path, near: int, far: int, right: int) -> None:
    """Left of it, since the right view shows x at x - d: what is near moves left over what is far."""
    steps = right - 40
    there = X - far * steps
    expected = np.broadcast_to((there < 0) | (there >= HW[1]), HW).copy()
    expected[ROWS, COLUMNS] = False
    expected[ROWS, COLUMNS.start - (near - far) * steps : COLUMNS.start] = True
    np.testing.assert_array_equal(hidden(tmp_path, square(near, before=far), right=right), expected)


def test_a_step_within_the_tolerance_hides_nothing(tmp_path: Path) -> None:
    assert not hidden(tmp_path, square(0.2, before=0)).any()  # 0.8 px between the views


@pytest.mark.parametrize("slope", [-0.6, -0.25, 0.1, 0.25, 0.6])
@pytest.mark.parametrize("down", [0, 0.3])
def test_a_slanted_plane_hides_nothing(tmp_path: Path, slope: float, down: float) -> None:
    disparity_px = (slope * (X - 50.3) + down * np.arange(HW[0])[:, None]).astype(np.float32)
    there = X - disparity_px
    is_inside = (there >= 0.01) & (there <= HW[1] - 1.01)
    is_outside = (there < -0.01) | (there > HW[1] - 0.99)
    occluded = hidden(tmp_path, disparity_px / 4)
    assert not occluded[is_inside].any()
    assert occluded[is_outside].all()


def test_a_slanted_square_before_a_plane_has_no_holes(tmp_path: Path) -> None:
    """In the right view a slope of -0.5 is half as wide again as in the left one; the plane does not shine through."""
    disparity = square(0, before=0)
    disparity[ROWS, COLUMNS] = (20 - 0.5 * np.arange(20)) / 4
    expected = np.zeros(HW, np.bool_)
    expected[ROWS, 40 - 20 : 40] = True  # the square begins at 40 - 20 and ends beyond 40
    np.testing.assert_array_equal(hidden(tmp_path, disparity), expected)


def test_with_the_right_disparity_both_ways_agree_on_what_the_left_view_shows(tmp_path: Path) -> None:
    left = square(3, before=1)
    right = np.full(HW, 1, np.float32)
    right[ROWS, 40 - 12 : 60 - 12] = 3
    by_right = hidden(tmp_path / "with", left, of_right_px=right)
    np.testing.assert_array_equal(by_right, hidden(tmp_path / "without", left))


def test_the_right_disparity_tells_of_things_that_the_left_view_does_not_show(tmp_path: Path) -> None:
    left, right = np.zeros(HW, np.float32), np.zeros(HW, np.float32)
    right[:, 90:] = 5  # it would lie at 90 + 20 of the left view, outside
    assert not hidden(tmp_path / "without", left).any()
    np.testing.assert_array_equal(hidden(tmp_path / "with", left, of_right_px=right), np.broadcast_to(X >= 90, HW))


def test_unknown_disparities_hide_nothing_and_are_not_seen(tmp_path: Path) -> None:
    unknown = np.zeros(HW, np.bool_)
    unknown[ROWS, COLUMNS] = True
    np.testing.assert_array_equal(hidden(tmp_path, square(np.nan, before=0)), unknown)
    assert hidden(tmp_path, np.full(HW, np.nan, np.float32)).all()


def test_a_scene_of_inria_without_the_right_disparity(tmp_path: Path) -> None:
    folder = tmp_path / "Lion"
    for place in ("5_5", "5_7"):
        write_image(folder / f"lf_{place}.png", np.full((*HW, 3), 0.5, np.float32))
    np.save(folder / "disparity_5_5.npy", square(4, before=0))
    occluded = read_inria(tmp_path, "Lion", views=(40, 42)).occluded
    expected = np.zeros(HW, np.bool_)
    expected[ROWS, 40 - 8 : 40] = True
    assert occluded is not None
    np.testing.assert_array_equal(occluded, expected)


def test_a_disparity_of_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="differ in size"):
        hidden(tmp_path, np.zeros((HW[0], HW[1] - 1), np.float32))


@pytest.fixture
def antinous(data_root: Path) -> StereoTruth:
    root = data_root / "hci_antinous"
    if not root.is_dir():
        pytest.skip(f"no light field at {root}")
    return read_hci(root, "antinous", views=(40, 44))


def test_the_real_right_view_shows_what_counts_as_visible(antinous: StereoTruth) -> None:
    assert antinous.occluded is not None
    assert 0.005 < antinous.occluded.mean() < 0.15
    x, y = np.meshgrid(*map(np.arange, antinous.occluded.shape[::-1]))
    there = (x - antinous.disparity_px).astype(np.float32)
    warped = cv2.remap(antinous.right, there, y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    off = np.abs(warped - antinous.left).mean(axis=2)
    is_inside = (there >= 0) & (there <= there.shape[1] - 1)
    seen, covered = off[~antinous.occluded].mean(), off[antinous.occluded & is_inside].mean()
    assert seen < 0.005  # a level and a quarter of 255
    assert covered > 20 * seen


def test_the_real_scene_is_scored_by_what_is_visible(antinous: StereoTruth) -> None:
    scores = score_regions(antinous.disparity_px, antinous)
    assert set(scores) == {"all", "visible", "occluded"}
    assert scores["visible"].pixels + scores["occluded"].pixels == scores["all"].pixels == antinous.disparity_px.size
