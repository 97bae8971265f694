"""Slopes made steps: hand-made edges, leaning surfaces and thin things."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.depth.slopes import steepened, with_smooth_outlines

HW = (60, 80)


def step_px(*, rise_px: float = 12.0) -> np.ndarray:
    return np.where(np.arange(HW[1]) < 40, 3.0, 3.0 + rise_px)[None].repeat(HW[0], axis=0).astype(np.float32)


@pytest.mark.parametrize("width_px", [3, 5, 7])
def test_an_edge_that_was_drawn_as_a_slope_is_a_step_in_its_middle(width_px: int) -> None:
    slope_px = cv2.blur(step_px(), (width_px, 1))
    np.testing.assert_array_equal(steepened(slope_px), step_px())


def test_surfaces_lean_as_before() -> None:
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    for leaning_px in (0.1 * y, 0.6 * x, 0.8 * x - 0.3 * y):
        inner = np.s_[8:-8, 8:-8]
        np.testing.assert_array_equal(steepened(leaning_px)[inner], leaning_px[inner])


def test_a_step_between_leaning_surfaces_stays() -> None:
    _, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    leaning_px = step_px() + 0.05 * x
    assert np.abs(steepened(leaning_px) - leaning_px).max() < 0.5


def test_thin_things_stay() -> None:
    thin_px = np.full(HW, 3.0, np.float32)
    thin_px[:30, 30] = 15.0
    thin_px[45:47] = 12.0
    np.testing.assert_array_equal(steepened(thin_px), thin_px)


def test_single_pixels_do_not_stand_out_of_an_outline_and_no_value_is_new() -> None:
    ragged_px = step_px()
    ragged_px[10, 39], ragged_px[30, 40] = 15.0, 3.0
    np.testing.assert_array_equal(with_smooth_outlines(ragged_px, jump_px=1.0), step_px())
    bar_px = np.full(HW, 3.0, np.float32)
    bar_px[:, 20:22] = 12.0  # two pixels wide
    np.testing.assert_array_equal(with_smooth_outlines(bar_px, jump_px=1.0), bar_px)
    away_px = step_px()
    away_px[10, 10] += 0.9  # no edge of depth
    np.testing.assert_array_equal(with_smooth_outlines(away_px, jump_px=1.0), away_px)


def test_fewer_pixels_stand_alone_on_a_ragged_outline_than_after_one_median(rng: np.random.Generator) -> None:
    ragged_px = np.where(np.arange(HW[1]) < 40 + rng.integers(-3, 4, (1000, 1)), 3.0, 15.0).astype(np.float32)
    smooth_px = with_smooth_outlines(ragged_px, jump_px=1.0)
    assert set(np.unique(smooth_px)) == {3.0, 15.0}

    def alone(map_px: np.ndarray) -> int:
        return int((np.abs(cv2.medianBlur(map_px, 3) - map_px) > 1).sum())

    assert alone(smooth_px) < 0.6 * alone(cv2.medianBlur(ragged_px, 3))
