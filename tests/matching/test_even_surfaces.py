"""A rippled surface comes nearer to the true one, the oracle; edges, thin things and what is sure stay."""

from __future__ import annotations

import statistics

import numpy as np
import pytest

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.even_surfaces import even_surfaces

HW = (203, 322)


def wall(hw: tuple[int, int] = HW, *, bend_px: float = 0.0) -> FloatMap:
    """A slanted wall, bent by some px from the middle to the sides."""
    rows, columns = np.indices(hw)
    across = 2 * columns / hw[1] - 1
    return (12 + 0.01 * columns - 0.02 * rows + bend_px * across**2).astype(np.float32)


def ripple(hw: tuple[int, int] = HW, *, height_px: float = 0.5) -> FloatMap:
    """Smooth errors, some 40 px from crest to crest, none in the mean."""
    rows, columns = np.indices(hw)
    return (height_px * np.sin(columns / 6.5) * np.sin(rows / 7.5)).astype(np.float32)


def matched(disparity_px: FloatMap, *, confidence: float | FloatMap) -> DisparityMap:
    """The map as a network would give it."""
    sure = np.broadcast_to(np.float32(confidence), disparity_px.shape)
    return DisparityMap(disparity_px, np.ascontiguousarray(sure), np.ones(disparity_px.shape, dtype=np.bool_))


def plain(hw: tuple[int, int] = HW) -> FloatImage:
    """A photo of nothing but an even colour."""
    return np.full((*hw, 3), 0.6, dtype=np.float32)


def rms(error_px: FloatMap) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error_px.astype(np.float64) ** 2)))


@pytest.mark.parametrize("bend_px", [0.0, 2.0])
def test_a_rippled_wall_becomes_even(bend_px: float) -> None:
    truth_px = wall(bend_px=bend_px)
    made = even_surfaces(matched(truth_px + ripple(), confidence=0.7), plain())
    assert rms(made.disparity_px - truth_px) < rms(ripple()) / 4


@pytest.mark.parametrize("hw", [(160, 160), (165, 200), (203, 163), (201, 167)])
def test_pictures_that_end_within_a_cell_are_even_to_their_sides(hw: tuple[int, int]) -> None:
    truth_px = wall(hw)
    made = even_surfaces(matched(truth_px + ripple(hw), confidence=0.7), plain(hw))
    assert made.disparity_px.shape == hw
    assert rms((made.disparity_px - truth_px)[-8:, -8:]) < rms(ripple(hw)[-8:, -8:]) / 2


def test_what_is_even_already_stays_and_so_does_what_is_said_of_it() -> None:
    found = matched(wall(bend_px=3.0), confidence=0.7)
    made = even_surfaces(found, plain())
    np.testing.assert_allclose(made.disparity_px, found.disparity_px, atol=2e-3)
    assert made.confidence is found.confidence
    assert made.valid is found.valid


def test_no_pixel_is_drawn_over_an_edge_of_depth() -> None:
    truth_px = wall()
    truth_px[60:150, 100:220] += 5
    found_px = truth_px + ripple(height_px=0.2)
    made = even_surfaces(matched(found_px, confidence=0.8), plain())
    assert np.abs(made.disparity_px - truth_px).max() < 0.5
    beside = np.zeros(HW, dtype=np.bool_)
    beside[58:152, 98:222] = True
    beside[62:148, 102:218] = False
    np.testing.assert_allclose(made.disparity_px[beside], found_px[beside], atol=0.01)


@pytest.mark.parametrize("step_px", [1.5, 3.0])
def test_a_rod_before_a_wall_stays(step_px: float) -> None:
    truth_px = wall()
    rod: BoolMap = np.zeros(HW, dtype=np.bool_)
    rod[:, 150:155] = True
    truth_px[rod] += step_px
    photo = plain()
    photo[rod] = 0.1
    made = even_surfaces(matched(truth_px, confidence=0.6), photo)
    np.testing.assert_allclose(made.disparity_px[rod], truth_px[rod], atol=1e-3)


def test_what_is_sure_and_textured_stays(rng: np.random.Generator) -> None:
    found = matched(wall() + ripple(), confidence=0.995)
    texture = rng.random((*HW, 3), dtype=np.float32)
    np.testing.assert_array_equal(even_surfaces(found, texture).disparity_px, found.disparity_px)


def test_what_is_sure_and_plain_is_pulled_by_a_little_only() -> None:
    truth_px = wall()
    small, large = ripple(height_px=0.4), ripple(height_px=3.0)
    made_small, made_large = (
        even_surfaces(matched(truth_px + error_px, confidence=0.9995), plain()) for error_px in (small, large)
    )
    assert rms(made_small.disparity_px - truth_px) < rms(small) / 2
    assert rms(made_large.disparity_px - truth_px) > rms(large) * 0.8  # too large for errors that are so unlikely


@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_a_ball_stays_round_to_half_the_error_that_its_confidence_admits(confidence: float) -> None:
    rows, columns = np.indices(HW)
    height = 1 - ((rows - 100) / 80.0) ** 2 - ((columns - 160) / 80.0) ** 2
    truth_px = (wall() + np.where(height > 0, 8 + 6 * np.sqrt(np.maximum(height, 0)), 0)).astype(np.float32)
    made = even_surfaces(matched(truth_px, confidence=confidence), plain())
    admitted_px = 1 / statistics.NormalDist().inv_cdf((1 + confidence) / 2)
    assert rms((made.disparity_px - truth_px)[height > 0.2]) < admitted_px / 2


@pytest.mark.parametrize("hw", [(8, 300), (300, 8), (63, 63), (1, 1)])
def test_small_pictures_stay_as_they_are(hw: tuple[int, int]) -> None:
    found = matched(wall(hw), confidence=0.5)
    assert even_surfaces(found, plain(hw)) is found


def test_noise_has_no_even_piece(rng: np.random.Generator) -> None:
    found = matched(rng.uniform(0, 60, HW).astype(np.float32), confidence=0.9)
    np.testing.assert_array_equal(even_surfaces(found, plain()).disparity_px, found.disparity_px)


def test_equal_maps_are_made_equally() -> None:
    found = matched(wall() + ripple(), confidence=0.7)
    first, second = (even_surfaces(found, plain()).disparity_px for _ in range(2))
    np.testing.assert_array_equal(first, second)
