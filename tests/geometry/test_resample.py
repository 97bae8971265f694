"""Reading a picture between its pixels: against closed forms, and against SciPy's spline."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from telewide.geometry.arrays import FloatMap
from telewide.geometry.resample import has_exact_positions, resample

of_exact_positions = pytest.mark.skipif(not has_exact_positions(), reason="OpenCV before 5 rounds positions to 1/32 px")


def grid(hw: tuple[int, int], *, step: float = 1.0, start: float = 0.0) -> tuple[FloatMap, FloatMap]:
    y, x = (np.mgrid[: hw[0], : hw[1]] * step + start).astype(np.float32)
    return x, y


def waves(x: NDArray[np.floating], y: NDArray[np.floating], *, period_px: float) -> FloatMap:
    phase = 2 * np.pi / period_px
    return (0.5 + 0.2 * np.sin(phase * (0.8 * x + 0.6 * y)) + 0.2 * np.cos(phase * y)).astype(np.float32)


@of_exact_positions
def test_pixels_are_kept_exactly(rng: np.random.Generator) -> None:
    image = rng.random((40, 60, 3)).astype(np.float32)
    np.testing.assert_allclose(resample(image, *grid((40, 60))), image, atol=2e-5)


@of_exact_positions
def test_between_the_pixels_it_is_the_interpolating_spline(rng: np.random.Generator) -> None:
    image = rng.uniform(0.3, 0.7, (50, 70)).astype(np.float32)
    x, y = rng.uniform(0, 69, (30, 41)).astype(np.float32), rng.uniform(0, 49, (30, 41)).astype(np.float32)
    expected = ndimage.map_coordinates(image.astype(np.float64), [y, x], order=3, mode="mirror")
    np.testing.assert_allclose(resample(image, x, y), np.clip(expected, 0, 1), atol=5e-4)


@of_exact_positions
def test_positions_are_not_rounded() -> None:
    # On a ramp the value is the position: OpenCV's own cubic errs by 0.05 px here.
    ramp = np.tile(np.arange(100, dtype=np.float32) / 100, (40, 1))
    x = np.linspace(20, 70, 1001, dtype=np.float32)[None]
    np.testing.assert_allclose(100 * resample(ramp, x, np.full_like(x, 20.3)), x, atol=1e-3)


@pytest.mark.parametrize("shrink", [0.33, 0.5, 1.0])
def test_enlarged_waves_stay_waves(shrink: float) -> None:
    photo = waves(*grid((90, 120))[:2], period_px=6.0)
    x, y = grid((60, 80), step=shrink, start=12.3)
    np.testing.assert_allclose(resample(photo, x, y, shrink=shrink), waves(x, y, period_px=6.0), atol=0.01)


def test_what_the_coarser_grid_cannot_carry_is_taken_out_and_the_rest_kept() -> None:
    x, y = grid((60, 80), step=3.2, start=15.7)
    photo_x, photo_y = grid((260, 330))
    fine = waves(photo_x, photo_y, period_px=3.9)  # 1.2 px of the new grid
    assert np.std(resample(fine, x, y)) > 0.15
    assert np.std(resample(fine, x, y, shrink=3.2)) < 0.02
    coarse = waves(photo_x, photo_y, period_px=32.0)
    np.testing.assert_allclose(resample(coarse, x, y, shrink=3.2), waves(x, y, period_px=32.0), atol=0.02)
    np.testing.assert_allclose(resample(np.full_like(fine, 0.37), x, y, shrink=3.2), 0.37, atol=1e-5)


def test_outside_the_border_is_continued() -> None:
    image = waves(*grid((40, 50)), period_px=11.0)
    x, y = np.full((1, 3), -30, np.float32), np.array([[-5, 20, 90]], np.float32)  # all left of it
    np.testing.assert_allclose(resample(image, x, y), [[image[0, 0], image[20, 0], image[-1, 0]]], atol=1e-4)


def test_values_stay_in_range_beside_edges() -> None:
    step = np.zeros((40, 40, 3), np.float32)
    step[:, 20:] = 1.0
    values = resample(step, *grid((60, 60), step=0.3, start=10.1))
    assert values.min() >= 0
    assert values.max() <= 1
    assert np.isfinite(values).all()
