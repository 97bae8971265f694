"""Drawn surfaces, the oracle: what strays beside their outlines returns to them, and what is sure or differs stays."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.lookalikes import follow_lookalikes

HW = (200, 320)
WALL, BOARD = 0.6, 0.15


def board() -> BoolMap:
    """Where a board stands before a wall."""
    inside = np.zeros(HW, dtype=np.bool_)
    inside[40:160, 90:230] = True
    return inside


def photo_of(inside: BoolMap) -> FloatImage:
    """A dark board before a bright wall."""
    return np.where(inside[..., None], np.float32(BOARD), np.float32(WALL)) * np.ones(3, dtype=np.float32)


def depth_of(inside: BoolMap, *, slant: float = 0.0) -> FloatMap:
    """A wall at 12 px, a board 3 px before it; both slanted by some px a column."""
    columns = np.indices(HW)[1]
    return (12 + 3.0 * inside + slant * columns).astype(np.float32)


def rim(inside: BoolMap, *, width: int = 4) -> BoolMap:
    """A patch on the left rim of the board."""
    beside = np.zeros(HW, dtype=np.bool_)
    beside[90:114, 90 : 90 + width] = True
    return beside & inside


def matched(disparity_px: FloatMap, *, confidence: float | FloatMap) -> DisparityMap:
    """The map as a network would give it."""
    sure = np.broadcast_to(np.float32(confidence), disparity_px.shape)
    return DisparityMap(disparity_px, np.ascontiguousarray(sure), np.ones(disparity_px.shape, dtype=np.bool_))


@pytest.mark.parametrize("slant", [0.0, 0.05])
@pytest.mark.parametrize("stray_px", [-2.0, 1.5])
def test_the_rim_of_a_board_returns_to_the_board(stray_px: float, slant: float) -> None:
    inside = board()
    truth_px = depth_of(inside, slant=slant)
    strayed = rim(inside)
    found = matched(truth_px + stray_px * strayed, confidence=0.6)
    made = follow_lookalikes(found, photo_of(inside))
    assert np.abs(made.disparity_px - truth_px)[strayed].mean() < 0.25 * abs(stray_px)
    assert np.abs(made.disparity_px - truth_px).mean() < 0.02
    assert made.confidence is found.confidence
    assert made.valid is found.valid


def test_a_pixel_that_follows_does_not_stop_between_two_surfaces() -> None:
    """Half unsure, it would go half the way."""
    inside = board()
    strayed = rim(inside)
    made = follow_lookalikes(matched(depth_of(inside) - 1.2 * strayed, confidence=0.8), photo_of(inside))
    np.testing.assert_allclose(made.disparity_px[strayed], 15, atol=0.2)


def test_the_rim_stays_where_nothing_tells_board_from_wall() -> None:
    """Half of what looks alike lies at either depth: it does not agree."""
    inside = np.zeros(HW, dtype=np.bool_)
    inside[:, 160:] = True
    found = matched(depth_of(inside), confidence=0.6)
    made = follow_lookalikes(found, np.full((*HW, 3), WALL, dtype=np.float32))
    np.testing.assert_allclose(made.disparity_px[:, 140:180], found.disparity_px[:, 140:180], atol=0.05)


def test_sure_pixels_stay_exactly() -> None:
    inside = board()
    strayed = rim(inside)
    confidence = np.where(np.arange(HW[0])[:, None] < 102, 0.95, 0.6) * np.ones(HW)
    found = matched(depth_of(inside) - 2.0 * strayed, confidence=confidence.astype(np.float32))
    made = follow_lookalikes(found, photo_of(inside)).disparity_px
    np.testing.assert_array_equal(made[:102], found.disparity_px[:102])
    assert (made - found.disparity_px)[102:][strayed[102:]].mean() > 1.5


def test_what_is_all_sure_is_the_same_map() -> None:
    found = matched(depth_of(board()), confidence=0.95)
    assert follow_lookalikes(found, photo_of(board())) is found


@pytest.mark.parametrize(("confidence", "moves"), [(0.85, False), (0.3, True)])
def test_nothing_moves_farther_than_its_confidence_leaves_open(confidence: float, moves: bool) -> None:
    """An error of 2.5 px is 3.6 standard deviations at a confidence of .85, and one at .3."""
    inside = board()
    strayed = rim(inside)
    found = matched(depth_of(inside) - 2.5 * strayed, confidence=confidence)
    change_px = (follow_lookalikes(found, photo_of(inside)).disparity_px - found.disparity_px)[strayed]
    assert (change_px.mean() > 2) == moves
    assert (np.abs(change_px).max() < 0.01) != moves


@pytest.mark.parametrize("width", [1, 2, 5])
def test_a_rod_of_its_own_colour_stays_before_the_wall(width: int) -> None:
    rod = np.zeros(HW, dtype=np.bool_)
    rod[:, 150 : 150 + width] = True
    found = matched(depth_of(rod), confidence=0.6)
    made = follow_lookalikes(found, photo_of(rod))
    np.testing.assert_allclose(made.disparity_px[rod], found.disparity_px[rod], atol=0.1)


def test_a_slope_keeps_its_ends() -> None:
    """The median of a window that is cut off by the sides would pull them inwards by half a window's rise."""
    truth_px = depth_of(np.zeros(HW, dtype=np.bool_), slant=0.15)
    made = follow_lookalikes(matched(truth_px, confidence=0.6), photo_of(np.zeros(HW, dtype=np.bool_)))
    assert np.abs(made.disparity_px - truth_px).max() < 0.1


def test_noise_agrees_on_nothing(rng: np.random.Generator) -> None:
    found = matched(rng.uniform(0, 60, HW).astype(np.float32), confidence=0.6)
    np.testing.assert_array_equal(follow_lookalikes(found, photo_of(board())).disparity_px, found.disparity_px)


@pytest.mark.parametrize("scale", [2, 4])
def test_a_larger_picture_is_brought_back_over_as_many_cells(scale: int) -> None:
    """Cells grow with the picture; edges stay where its own pixels have them."""
    inside, strayed = (np.kron(mask, np.ones((scale, scale), dtype=np.bool_)) for mask in (board(), rim(board())))
    truth_px = np.where(inside, 15, 12).astype(np.float32)
    made = follow_lookalikes(matched(truth_px - 2.0 * strayed, confidence=0.6), photo_of(inside))
    assert np.abs(made.disparity_px - truth_px)[strayed].mean() < 0.2
    assert np.abs(made.disparity_px - truth_px)[~inside].max() < 0.05


@pytest.mark.parametrize("hw", [(1, 1), (3, 50), (16, 16)])
def test_small_pictures_pass(hw: tuple[int, int]) -> None:
    found = matched(np.full(hw, 5.0, dtype=np.float32), confidence=0.5)
    made = follow_lookalikes(found, np.full((*hw, 3), WALL, dtype=np.float32))
    np.testing.assert_allclose(made.disparity_px, 5.0, atol=1e-4)


def test_equal_maps_are_made_equally(rng: np.random.Generator) -> None:
    found = matched(depth_of(board()) + rng.normal(0, 0.3, HW).astype(np.float32), confidence=0.6)
    first, second = (follow_lookalikes(found, photo_of(board())).disparity_px for _ in range(2))
    np.testing.assert_array_equal(first, second)
