from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.correction.colour import apply_colour, colour_delta, colour_ratio, fit_colour, sample_colours
from telewide.correction.matches import Matches, find_matches
from telewide.simulate.layers import RenderedPair

FloatImage = NDArray[np.float32]


@pytest.fixture(scope="module")
def matches(world: RenderedPair) -> Matches:
    return find_matches(world.ref, world.src)


@pytest.mark.parametrize(
    ("gain", "offset"),
    [((0.8, 1.0, 1.15), (0.05, 0.0, -0.04)), ((1.2, 1.2, 1.2), (0.0, 0.0, 0.0)), ((0.6, 0.7, 0.75), (0.1, 0.12, 0.2))],
)
def test_a_known_tint_is_undone(
    world: RenderedPair, matches: Matches, gain: tuple[float, ...], offset: tuple[float, ...]
) -> None:
    tinted = ((world.src - np.float32(offset)) / np.float32(gain)).astype(np.float32)
    fit = fit_colour(world.ref, tinted, matches)
    np.testing.assert_allclose(fit.gain, gain, atol=0.03)
    np.testing.assert_allclose(fit.offset, offset, atol=0.02)
    assert fit.delta_after < 0.25 * fit.delta_before
    before, after = sample_colours(world.ref, apply_colour(tinted, fit), matches)
    assert colour_ratio(before, after) == pytest.approx((1, 1, 1), abs=0.01)


def test_an_equal_pair_is_left_alone(world: RenderedPair, matches: Matches) -> None:
    fit = fit_colour(world.ref, world.src, matches)
    assert fit.is_identity
    assert apply_colour(world.src, fit) is world.src


def test_a_tenth_of_wrong_matches_does_not_bend_the_fit(
    rng: np.random.Generator, world: RenderedPair, matches: Matches
) -> None:
    src_px = matches.src_px.copy()
    n_wrong = len(matches) // 10
    src_px[:n_wrong] = rng.uniform((0, 0), world.src.shape[1::-1], (n_wrong, 2))
    fit = fit_colour(world.ref, (world.src * 0.8).astype(np.float32), Matches(matches.ref_px, src_px))
    np.testing.assert_allclose(0.8 * fit.gain + 2 * fit.offset, 1.0, atol=0.05)


def test_few_shades_fit_a_gain_not_a_slope(rng: np.random.Generator) -> None:
    ref = np.clip(0.5 + rng.normal(0, 0.004, (60, 80, 3)), 0, 1).astype(np.float32)
    src = np.clip(0.4 + rng.normal(0, 0.004, (60, 80, 3)), 0, 1).astype(np.float32)
    points = rng.uniform(5, 55, (100, 2))
    fit = fit_colour(ref, src, Matches(points, points))
    np.testing.assert_allclose(fit.gain, 1.25, atol=0.05)
    np.testing.assert_allclose(fit.offset, 0.0, atol=0.03)


def test_too_few_matches_leave_the_colours_alone(world: RenderedPair, matches: Matches) -> None:
    fit = fit_colour(world.ref, 0.5 * world.src, matches.select(np.arange(11)))
    assert fit.is_identity


def test_no_match_at_all_is_said(world: RenderedPair) -> None:
    none = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    fit = fit_colour(world.ref, world.src, none)
    assert fit.is_identity
    assert np.isnan(fit.delta_before)
    assert np.isnan(colour_ratio(*sample_colours(world.ref, world.src, none))).all()
    assert np.isnan(colour_delta(*sample_colours(world.ref, world.src, none)))
