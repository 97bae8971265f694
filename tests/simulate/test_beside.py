"""The second view of a photo against closed forms: planes, steps, and the photo warped back by its disparity."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.simulate.beside import seen_from_beside

HW = (40, 160)


def photo(seed: int = 0) -> FloatImage:
    noise = np.random.default_rng(seed).random((*HW, 3), dtype=np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 2.0)


def warped_back(src: FloatImage, disparity_px: FloatMap) -> FloatImage:
    x = np.arange(HW[1], dtype=np.float32) - disparity_px
    rows = np.broadcast_to(np.arange(HW[0], dtype=np.float32)[:, None], HW)
    return cv2.remap(src, x.astype(np.float32), np.ascontiguousarray(rows), cv2.INTER_CUBIC)


@pytest.mark.parametrize("disparity_px", [7, 0, -5])
def test_a_plane_of_whole_pixels_is_the_photo_moved(disparity_px: int) -> None:
    ref = photo()
    seen = seen_from_beside(ref, np.full(HW, disparity_px, np.float32))
    columns = np.arange(HW[1])
    inside = (columns - disparity_px >= 0) & (columns - disparity_px < HW[1])
    np.testing.assert_allclose(seen.src[:, (columns - disparity_px)[inside]], ref[:, inside], atol=1e-6)
    np.testing.assert_array_equal(seen.occluded, np.broadcast_to(~inside, HW))


def test_what_is_seen_warps_back_onto_the_photo() -> None:
    """A slanted ground, a box before it and a rod before both; what is hidden does not."""
    ref = photo()
    disparity_px = np.broadcast_to(np.linspace(4, 12, HW[1], dtype=np.float32), HW).copy()
    disparity_px[8:30, 60:100] = 25
    disparity_px[:, 120:123] = 33
    seen = seen_from_beside(ref, disparity_px)
    error = np.abs(warped_back(seen.src, disparity_px) - ref).max(axis=2)
    assert np.percentile(error[~seen.occluded], 98) < 0.02
    assert np.median(error[seen.occluded]) > 0.05


def test_a_step_hides_as_many_pixels_as_it_is_high_on_its_left() -> None:
    """Ref's pixel x lies at x - d in src: a near thing moves left, over the ground to its left."""
    disparity_px = np.full(HW, 5, np.float32)
    disparity_px[:, 80:110] = 17
    hidden = seen_from_beside(photo(), disparity_px).occluded
    assert set(np.flatnonzero(hidden[0])) == {*range(5), *range(68, 80)}
    assert (hidden == hidden[0]).all()


def test_a_gap_is_continued_from_the_ground_and_not_from_the_thing() -> None:
    ref = np.full((*HW, 3), 0.2, np.float32)
    ref[:, 80:110] = 0.9
    disparity_px = np.full(HW, 5, np.float32)
    disparity_px[:, 80:110] = 17
    src = seen_from_beside(ref, disparity_px).src
    # The thing covers columns 63 to 92 of src; right of it lies what ref did not see.
    np.testing.assert_allclose(src[:, 64:92], 0.9, atol=1e-6)
    np.testing.assert_allclose(src[:, 95:], 0.2, atol=1e-6)
