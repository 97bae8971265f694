"""What may be said of a depth: metres only where focal length and baseline are both known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigs import phone

from telewide.capture.facts import CaptureFacts
from telewide.depth.precision import DepthPrecision
from telewide.depth.result import depth_result, depth_result_of_rig
from telewide.geometry.stereo import DisparityMap


@pytest.fixture
def disparity() -> DisparityMap:
    """A small map with an unknown corner."""
    disparity_px = np.linspace(5, 40, 12 * 18, dtype=np.float32).reshape(12, 18)
    disparity_px[0, 0] = np.nan
    return DisparityMap(disparity_px, np.full((12, 18), 0.7, np.float32), np.isfinite(disparity_px))


def test_nothing_is_invented_without_facts(disparity: DisparityMap) -> None:
    result = depth_result("a", disparity)
    assert (result.K, result.baseline_m, result.depth_m) == (None, None, None)


@pytest.mark.parametrize("facts", [CaptureFacts(f_px=900.0), CaptureFacts(baseline_m=0.01)])
def test_half_of_the_scale_gives_no_metres(disparity: DisparityMap, facts: CaptureFacts) -> None:
    assert depth_result("a", disparity, facts=facts).depth_m is None


def test_depth_is_focal_length_times_baseline_over_shifted_disparity(disparity: DisparityMap) -> None:
    result = depth_result("a", disparity, facts=CaptureFacts(f_px=900.0, baseline_m=0.012, doffs_px=3.0))
    assert result.depth_m is not None
    known = disparity.valid
    expected_m = 900.0 * 0.012 / (disparity.disparity_px[known].astype(np.float64) + 3.0)
    np.testing.assert_allclose(result.depth_m[known], expected_m, rtol=1e-6)
    assert np.isnan(result.depth_m[0, 0])


def test_principal_point_is_the_centre_of_the_pixel_grid(disparity: DisparityMap) -> None:
    result = depth_result("a", disparity, facts=CaptureFacts(f_px=900.0))
    assert result.K is not None
    # The centre of a map whose first pixel centre is (0, 0) maps onto itself when the map is mirrored.
    np.testing.assert_allclose(result.K, [[900, 0, 17 - result.K[0, 2]], [0, 900, 11 - result.K[1, 2]], [0, 0, 1]])


def test_a_rig_gives_metres_and_how_sure_they_are(disparity: DisparityMap) -> None:
    rig = phone("vertical", shrink=250)
    result = depth_result_of_rig("a", disparity, rig=rig, precision=DepthPrecision(lens_shift_std_px=1.0))
    assert result.depth_m is not None
    assert result.depth_std_m is not None
    known = disparity.valid
    expected_m = rig.tele.K[0, 0] * rig.baseline_m / disparity.disparity_px[known]
    np.testing.assert_allclose(result.depth_m[known], expected_m, rtol=1e-5)
    assert (result.depth_std_m[known] > expected_m**2 / (rig.tele.K[0, 0] * rig.baseline_m)).all()
    np.testing.assert_array_equal(np.isnan(result.depth_std_m), ~known)
    exact = depth_result_of_rig("a", disparity, rig=rig)
    assert exact.depth_std_m is not None
    assert (exact.depth_std_m[known] < result.depth_std_m[known]).all()
    np.testing.assert_array_equal(result.distortion, rig.tele.distortion)


@pytest.mark.parametrize("has_rig", [True, False])
def test_what_lies_beyond_infinity_is_not_valid(has_rig: bool) -> None:
    doffs_px = 0.0 if has_rig else 3.0
    disparity_px = np.array([[4.0, 2.0, 0.0, -3.0]], np.float32) - np.float32(doffs_px)
    disparity = DisparityMap(disparity_px, np.ones((1, 4), np.float32), np.ones((1, 4), np.bool_))
    facts = CaptureFacts(f_px=900.0, baseline_m=0.012, doffs_px=doffs_px)
    result = (
        depth_result_of_rig("a", disparity, rig=phone(shrink=250))
        if has_rig
        else depth_result("a", disparity, facts=facts)
    )
    assert result.depth_m is not None
    np.testing.assert_array_equal(result.disparity.valid, [[True, True, False, False]])
    np.testing.assert_array_equal(np.isfinite(result.depth_m), result.disparity.valid)


def test_a_rig_without_scale_gives_no_metres(disparity: DisparityMap) -> None:
    rig = replace(phone(shrink=250), is_scale_known=False)
    result = depth_result_of_rig("a", disparity, rig=rig)
    assert (result.baseline_m, result.depth_m, result.depth_std_m) == (None, None, None)
    np.testing.assert_array_equal(result.K, rig.tele.K)
