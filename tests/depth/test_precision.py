"""The stated standard deviations against drawn errors, and against what is put in."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.depth.precision import (
    DepthPrecision,
    depth_std_m,
    disparity_std_px,
    lens_shift_std_share,
)
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.matcher import ConfidenceStd

F_PX, BASELINE_M = 9000.0, 0.012


def maps(disparity_px: FloatMap, *, confidence: float = 0.9) -> DisparityMap:
    known = np.isfinite(disparity_px)
    return DisparityMap(disparity_px, np.full(disparity_px.shape, confidence, np.float32), known)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize(
    ("match_px", "precision"),
    [
        (0.5, DepthPrecision()),
        (0.0, DepthPrecision(baseline_std_m=0.0004)),
        (0.0, DepthPrecision(f_std_px=150.0)),
        (0.0, DepthPrecision(lens_shift_std_px=1.2)),
        (0.7, DepthPrecision(baseline_std_m=0.0002, f_std_px=40.0, lens_shift_std_px=0.9)),
    ],
)
def test_std_is_that_of_drawn_errors(
    depth_m: float, match_px: float, precision: DepthPrecision, rng: np.random.Generator
) -> None:
    n = 60_000
    disparity_px = (
        F_PX * BASELINE_M / depth_m + rng.normal(0, match_px, n) + rng.normal(0, precision.lens_shift_std_px, n)
    )
    baseline_m = BASELINE_M + rng.normal(0, precision.baseline_std_m, n)
    f_px = F_PX + rng.normal(0, precision.f_std_px, n)
    drawn_m = f_px * baseline_m / disparity_px
    stated_m = depth_std_m(
        np.full((1, 1), depth_m, np.float32),
        np.full((1, 1), match_px, np.float32),
        f_px=F_PX,
        baseline_m=BASELINE_M,
        precision=precision,
    )
    assert stated_m[0, 0] == pytest.approx(np.std(drawn_m), rel=0.05)


def test_what_is_stated_holds_the_truth_as_often_as_it_says(rng: np.random.Generator) -> None:
    # Shots of which each has its own shift of the lens, and each pixel its own error; the depth is the estimated one.
    precision = DepthPrecision(baseline_std_m=0.00006, f_std_px=9.0, lens_shift_std_px=0.8)
    truth_m = rng.uniform(0.4, 4.0, (400, 50))
    match_px = rng.choice([0.2, 0.6, 1.5], truth_m.shape)
    moved_px = rng.normal(0, 0.8, (400, 1))
    disparity_px = F_PX * BASELINE_M / truth_m + moved_px + rng.normal(0, match_px)
    stated_f_px = F_PX + rng.normal(0, 9.0, (400, 1))
    stated_baseline_m = BASELINE_M + rng.normal(0, 0.00006, (400, 1))
    found_m = (stated_f_px * stated_baseline_m / disparity_px).astype(np.float32)
    std_m = depth_std_m(found_m, match_px.astype(np.float32), f_px=F_PX, baseline_m=BASELINE_M, precision=precision)
    inside = np.abs(found_m - truth_m) < 1.96 * std_m
    assert 0.93 < inside.mean() < 0.97


def test_unknown_depth_has_no_std() -> None:
    depth_m = np.array([[np.nan, 1.0]], np.float32)
    std_m = depth_std_m(
        depth_m, np.ones((1, 2), np.float32), f_px=F_PX, baseline_m=BASELINE_M, precision=DepthPrecision()
    )
    np.testing.assert_array_equal(np.isnan(std_m), [[True, False]])


def test_confident_disparities_are_surer_and_filled_ones_least() -> None:
    disparity = DisparityMap(
        np.full((1, 4), 9, np.float32),
        np.array([[1.0, 0.5, 0.0, 0.9]], np.float32),
        np.array([[True, True, True, False]]),
    )
    of = ConfidenceStd(0.2, 8.0)
    std_px = disparity_std_px(disparity, of=of)[0]
    np.testing.assert_allclose(std_px[:3], [0.2, np.sqrt(0.2 * 8.0), 8.0], rtol=1e-6)
    assert std_px[2] <= std_px[3]
    # Matched at a third of the size, a pixel there is three here.
    np.testing.assert_allclose(disparity_std_px(disparity, of=of, scale=1 / 3)[0], 3 * std_px, rtol=1e-6)


def test_spread_of_the_shots_is_found_and_a_bad_shot_does_not_draw_it_out(rng: np.random.Generator) -> None:
    offsets = rng.normal(0, 5.0, 60) / 4032
    assert lens_shift_std_share(offsets) == pytest.approx(5.0 / 4032, rel=0.25)
    assert lens_shift_std_share([*offsets, 900.0 / 4032, np.nan]) == pytest.approx(5.0 / 4032, rel=0.25)
    # A rig that is off for all shots alike is off along the baseline too.
    assert lens_shift_std_share(np.full(60, 1e-3)) > 1e-3


def test_without_shots_the_spread_is_the_usual_one() -> None:
    usual = lens_shift_std_share([])
    assert usual == pytest.approx(0.58 / 1280)
    assert lens_shift_std_share([np.nan]) == pytest.approx(usual)
    assert usual < lens_shift_std_share([3.0 / 1280]) < 3.0 * 1.5 / 1280
