"""Confidence after refinement, by laws: what is not moved keeps it, a surface bears out, a long way speaks against."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.refinement import _confidence_of_moved, refine

CONFIDENCE = np.linspace(0, 1, 21, dtype=np.float32)


def moved_by(distance_px: float) -> FloatMap:
    return _confidence_of_moved(CONFIDENCE, np.full_like(CONFIDENCE, distance_px))


def test_a_surface_close_by_bears_out_what_is_unsure_and_takes_nothing_from_what_is_sure() -> None:
    confidence = moved_by(0.1)
    assert (confidence >= CONFIDENCE).all()
    assert confidence[0] == pytest.approx(0.28)
    assert (np.diff(confidence) >= 0).all()
    np.testing.assert_array_equal(confidence[CONFIDENCE > 0.75], CONFIDENCE[CONFIDENCE > 0.75])


def test_the_farther_a_pixel_is_moved_the_less_it_can_be_sure() -> None:
    by_distance = [moved_by(px) for px in (0.1, 0.6, 0.9, 1.4, 3.0, 30.0)]
    for near, far in pairwise(by_distance):
        assert (far <= near).all()
    assert by_distance[-1].max() < 0.5
    assert all(each.min() >= 0 and each.max() <= 1 and each.dtype == np.float32 for each in by_distance)


def test_pixels_that_stay_are_as_sure_as_they_were(rng: np.random.Generator) -> None:
    """A wall that ripples where it is unsure, beside a strip that is matched surely."""
    hw = (96, 128)
    disparity_px = np.full(hw, 12, np.float32)
    disparity_px[:, 40:] += rng.normal(0, 0.5, (96, 88)).astype(np.float32)
    confidence = np.where(np.arange(128) < 40, 1, 0.4).astype(np.float32) * np.ones(hw, np.float32)
    view = np.full((*hw, 3), 0.5, np.float32)
    refined = refine(DisparityMap(disparity_px, confidence, np.ones(hw, bool)), view, view)
    stays = np.abs(refined.disparity_px - disparity_px) < 0.01
    assert 0.2 < stays.mean() < 0.8
    np.testing.assert_array_equal(refined.confidence[stays], confidence[stays])
    assert (refined.confidence[~stays] > confidence[~stays]).mean() > 0.6, "the wall bears them out"
