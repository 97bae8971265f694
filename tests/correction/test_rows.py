"""The law of the rows, against laws that were put in, and wrong matches among right ones."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.correction.rows import apply_vertical, corrected_matches, fit_vertical
from telewide.geometry.arrays import FloatImage
from telewide.points.matches import Matches, find_matches, split_matches
from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.layers import RenderedPair

HW = (480, 640)


def matches_of_law(
    rng: np.random.Generator, *, offset_px: float, slope_x: float, slope_y: float, n: int = 200, noise_px: float = 0.0
) -> Matches:
    """Matches whose vertical misfit follows the law exactly, but for the noise."""
    src_x = rng.uniform(0, HW[1], n)
    ref_y = rng.uniform(0, HW[0], n)
    misfit_px = offset_px + slope_x * (src_x - (HW[1] - 1) / 2) + slope_y * (ref_y - (HW[0] - 1) / 2)
    misfit_px = misfit_px + rng.normal(0, noise_px, n)
    return Matches(
        np.column_stack([src_x + rng.uniform(10, 30, n), ref_y]), np.column_stack([src_x, ref_y - misfit_px])
    )


def test_a_known_law_is_found(rng: np.random.Generator) -> None:
    fit = fit_vertical(matches_of_law(rng, offset_px=-1.4, slope_x=0.001, slope_y=-0.004), hw=HW)
    assert (fit.offset_px, fit.slope_x, fit.slope_y) == pytest.approx((-1.4, 0.001, -0.004), abs=1e-6)
    assert fit.residual_after_px < 1e-6
    assert fit.residual_before_px > 0.5
    assert fit.is_fitted


def test_a_fifth_of_wrong_matches_does_not_bend_the_law(rng: np.random.Generator) -> None:
    matches = matches_of_law(rng, offset_px=0.7, slope_x=0.0, slope_y=0.003, noise_px=0.2)
    wrong = matches.src_px.copy()
    wrong[:40, 1] += rng.uniform(-20, 20, 40)
    fit = fit_vertical(Matches(matches.ref_px, wrong), hw=HW)
    assert fit.offset_px == pytest.approx(0.7, abs=0.1)
    assert fit.slope_y == pytest.approx(0.003, abs=0.0006)


def test_too_few_matches_leave_the_pair_alone(rng: np.random.Generator, world: RenderedPair) -> None:
    fit = fit_vertical(matches_of_law(rng, offset_px=2.0, slope_x=0, slope_y=0, n=19), hw=HW)
    assert not fit.is_fitted
    assert fit.largest_misfit_px == 0
    assert apply_vertical(world.src, fit) is world.src


def test_no_match_at_all_is_said(world: RenderedPair) -> None:
    fit = fit_vertical(Matches(np.zeros((0, 2)), np.zeros((0, 2))), hw=HW)
    assert not fit.is_fitted
    assert np.isnan(fit.residual_before_px)


def test_matches_in_one_corner_fit_no_slope(rng: np.random.Generator) -> None:
    matches = matches_of_law(rng, offset_px=1.0, slope_x=0, slope_y=0, noise_px=0.3)
    corner = Matches(matches.ref_px * 0.1, matches.src_px * 0.1 - np.array([0.0, 0.9]))
    fit = fit_vertical(corner, hw=HW)
    assert (fit.slope_x, fit.slope_y) == (0, 0)


def test_a_negligible_misfit_is_not_worth_a_resampling(rng: np.random.Generator, world: RenderedPair) -> None:
    fit = fit_vertical(matches_of_law(rng, offset_px=0.04, slope_x=0, slope_y=0), hw=HW)
    assert fit.is_fitted
    assert apply_vertical(world.src, fit) is world.src


def test_corrected_matches_lie_on_one_row(rng: np.random.Generator) -> None:
    matches = matches_of_law(rng, offset_px=-1.4, slope_x=0.001, slope_y=-0.004)
    corrected = corrected_matches(matches, fit_vertical(matches, hw=HW))
    assert np.abs(corrected.vertical_px).max() < 1e-5
    np.testing.assert_array_equal(corrected.disparity_px, matches.disparity_px)


def test_a_planted_misfit_is_found_and_taken_out(world: RenderedPair, wide_src: FloatImage) -> None:
    fit_half, held_out = split_matches(find_matches(world.ref, wide_src))
    fit = fit_vertical(fit_half, hw=world.ref.shape[:2])
    assert fit.offset_px == pytest.approx(-1.2, abs=0.2)
    assert fit.slope_y == pytest.approx(-0.006, abs=0.0015)
    after = corrected_matches(held_out, fit)
    assert np.median(np.abs(after.vertical_px)) < 0.35 * np.median(np.abs(held_out.vertical_px))
    # an independent look: matched anew, the resampled view has no law left
    again = fit_vertical(find_matches(world.ref, apply_vertical(wide_src, fit)), hw=world.ref.shape[:2])
    assert again.largest_misfit_px < 0.25


def test_resampling_gives_back_the_view_before_the_misfit(world: RenderedPair) -> None:
    moved = degrade(world.src, Degradation(vertical_offset_px=2.0), rng=np.random.default_rng(0))
    law = Matches(np.tile(np.linspace(0, 200, 30)[:, None], (1, 2)), np.tile(np.linspace(0, 200, 30)[:, None], (1, 2)))
    law = Matches(law.ref_px, law.src_px + np.array([0.0, 2.0]))
    restored = apply_vertical(moved, fit_vertical(law, hw=world.src.shape[:2]))
    inner = slice(12, -12)
    assert np.abs(restored[inner] - world.src[inner]).max() < 0.01
