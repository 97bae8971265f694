"""Filling takes values from the surface behind; the weighted median takes none from between two surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.geometry.arrays import FloatMap
from telewide.matching.filling import fill_rows, weighted_median


def two_surfaces(*, hw: tuple[int, int] = (60, 80), near_px: float = 30.0, far_px: float = 10.0) -> FloatMap:
    """A near object in the right half before a far wall."""
    disparity_px = np.full(hw, far_px, dtype=np.float32)
    disparity_px[:, hw[1] // 2 :] = near_px
    return disparity_px


def guide_of(disparity_px: FloatMap, rng: np.random.Generator) -> FloatMap:
    """A picture whose colour changes where the disparity does."""
    shade = np.where(disparity_px > disparity_px.mean(), 0.8, 0.2).astype(np.float32)
    noise = rng.normal(0, 0.01, (*disparity_px.shape, 3))
    return np.clip(shade[..., None] + noise, 0, 1).astype(np.float32)


def test_occlusion_takes_the_far_surface() -> None:
    truth_px = two_surfaces()
    holed_px = truth_px.copy()
    holed_px[:, 30:40] = np.nan  # what src does not see, left of the near object
    np.testing.assert_allclose(fill_rows(holed_px), truth_px)


@pytest.mark.parametrize("far_px", [-20.0, 0.0, 12.5])
def test_filling_keeps_what_is_known_and_leaves_no_hole(far_px: float, rng: np.random.Generator) -> None:
    truth_px = two_surfaces(far_px=far_px)
    holed_px = np.where(rng.random(truth_px.shape) < 0.5, truth_px, np.nan).astype(np.float32)
    holed_px[20:25] = np.nan  # whole rows, and a border
    holed_px[:, -6:] = np.nan
    filled_px = fill_rows(holed_px)
    assert filled_px.dtype == np.float32
    assert np.isfinite(filled_px).all()
    known = np.isfinite(holed_px)
    np.testing.assert_array_equal(filled_px[known], holed_px[known])
    assert (np.abs(filled_px - truth_px) > 1).mean() < 0.05


def test_nothing_known_is_zero() -> None:
    unknown_px = np.full((20, 30), np.nan, dtype=np.float32)
    np.testing.assert_array_equal(fill_rows(unknown_px), 0)


def test_median_takes_no_value_between_surfaces(rng: np.random.Generator) -> None:
    truth_px = two_surfaces()
    wrong = rng.random(truth_px.shape) < 0.2
    noisy_px = np.where(wrong, rng.uniform(0, 60, truth_px.shape), truth_px).astype(np.float32)
    median_px = weighted_median(noisy_px, guide_of(truth_px, rng))
    assert np.abs(median_px - truth_px).max() < 2


def test_median_moves_an_edge_to_the_guide(rng: np.random.Generator) -> None:
    truth_px = two_surfaces()
    fat_px = np.roll(truth_px, -4, axis=1)
    fat_px[:, -4:] = truth_px[:, -4:]
    median_px = weighted_median(fat_px, guide_of(truth_px, rng))
    assert (np.abs(median_px - truth_px) > 1).mean() < 0.2 * (np.abs(fat_px - truth_px) > 1).mean()


@pytest.mark.parametrize("even", [-7.0, 12.4, 0.5])
def test_median_of_an_even_map_is_that_map(even: float, rng: np.random.Generator) -> None:
    even_px = np.full((24, 32), even, dtype=np.float32)
    guide = rng.random((24, 32, 3), dtype=np.float32)
    np.testing.assert_allclose(weighted_median(even_px, guide), even_px, atol=0.01)


def test_median_of_a_slope_is_that_slope(rng: np.random.Generator) -> None:
    slope_px = np.tile(np.linspace(3, 9, 80, dtype=np.float32), (60, 1))
    noisy_px = slope_px + rng.normal(0, 0.3, slope_px.shape).astype(np.float32)
    median_px = weighted_median(noisy_px, np.full((60, 80, 3), 0.5, dtype=np.float32), radius_px=5)
    assert np.abs(median_px - slope_px)[8:-8, 8:-8].max() < 0.2


def test_an_empty_row_takes_the_nearest_known_one() -> None:
    """Known rows 2 and 7 of ten: the others go by distance, above or below."""
    disparity_px = np.full((10, 4), np.nan, np.float32)
    disparity_px[2, 1], disparity_px[7, 3] = 2, 7
    np.testing.assert_array_equal(fill_rows(disparity_px)[:, 0], [2, 2, 2, 2, 2, 7, 7, 7, 7, 7])
    np.testing.assert_array_equal(fill_rows(np.full((3, 4), np.nan, np.float32)), np.zeros((3, 4)))
