"""Results back on the tele photo: against depths ray-traced from the photo's own pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rigs import PLACES_OF_WIDE_M, phone

from telewide.depth.unrectify import disparity_on_tele
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.geometry.rectification import RectifiedGeometry, rectified_geometry
from telewide.geometry.stereo import DisparityMap

SHRINK = 16.0
NEAR_M, FAR_M = 0.8, 2.5


def pixels(hw: tuple[int, int]) -> FloatArray:
    columns, rows = np.meshgrid(np.arange(hw[1]), np.arange(hw[0]))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)


def plane_depths(rays: FloatArray, *, normal: FloatArray, distance_m: float) -> FloatArray:
    """Depth at which rays of tele's frame with z = 1 meet a plane."""
    return distance_m / (rays @ normal)


def tele_rays(geometry: RectifiedGeometry) -> FloatArray:
    hw = geometry.rig.tele.hw
    return np.column_stack([geometry.rig.tele.normalised(pixels(hw)), np.ones(hw[0] * hw[1])])


def rectified_truth(geometry: RectifiedGeometry, *, normal: FloatArray, distance_m: float) -> FloatMap:
    """Disparity of a plane in the rectified ref, px."""
    rays = np.column_stack(
        [(pixels(geometry.hw) - geometry.ref_centre_px) / geometry.f_px, np.ones(geometry.hw[0] * geometry.hw[1])]
    )
    z_m = plane_depths(rays @ geometry.rect_from_tele, normal=normal, distance_m=distance_m)
    disparity_px = geometry.f_px * geometry.rig.baseline_m / z_m - geometry.doffs_px
    return disparity_px.reshape(geometry.hw).astype(np.float32)


def sure(disparity_px: FloatMap) -> DisparityMap:
    return DisparityMap(disparity_px, np.ones(disparity_px.shape, np.float32), np.isfinite(disparity_px))


@pytest.mark.parametrize("doffs_px", [0.0, 4.0])
@pytest.mark.parametrize("working_width_px", [None, 120])
@pytest.mark.parametrize("place", sorted(PLACES_OF_WIDE_M))
def test_depth_is_z_along_teles_own_axis(place: str, working_width_px: int | None, doffs_px: float) -> None:
    rig = phone(place, shrink=SHRINK)
    geometry = rectified_geometry(rig, working_width_px=working_width_px, doffs_px=doffs_px)
    normal = np.array([0.3, -0.2, 1.0])
    on_tele = disparity_on_tele(sure(rectified_truth(geometry, normal=normal, distance_m=1.1)), geometry=geometry)
    assert on_tele.disparity_px.shape == rig.tele.hw
    depth_m = rig.tele.K[0, 0] * rig.baseline_m / on_tele.disparity_px
    expected_m = plane_depths(tele_rays(geometry), normal=normal, distance_m=1.1).reshape(rig.tele.hw)
    np.testing.assert_allclose(depth_m[2:-2, 2:-2], expected_m[2:-2, 2:-2], rtol=2e-4)
    np.testing.assert_allclose(depth_m, expected_m, rtol=5e-3)  # at the border half a pixel is continued
    assert on_tele.valid.all()


@pytest.mark.parametrize("place", ["vertical", "reversed", "oblique"])
def test_between_two_surfaces_nothing_is_averaged(place: str) -> None:
    rig = phone(place, shrink=SHRINK)
    geometry = rectified_geometry(rig, working_width_px=120)
    disparity_px = np.full(geometry.hw, geometry.f_px * rig.baseline_m / FAR_M, np.float32)
    disparity_px[20:50, 30:80] = geometry.f_px * rig.baseline_m / NEAR_M
    on_tele = disparity_on_tele(sure(disparity_px), geometry=geometry)
    ratio = geometry.tele_depth_per_rectified_depth(geometry.ref_from_tele(pixels(rig.tele.hw))).reshape(rig.tele.hw)
    z_rect_m = rig.tele.K[0, 0] * rig.baseline_m / on_tele.disparity_px / ratio
    assert np.minimum(np.abs(z_rect_m - NEAR_M), np.abs(z_rect_m - FAR_M)).max() < 1e-3
    assert 0.05 < np.mean(z_rect_m < 1) < 0.9


def test_a_map_lands_on_its_pixel() -> None:
    # One marked pixel of the rectified view comes back to where its point of the photo is, mirrored and turned.
    rig = phone("vertical, reversed", shrink=SHRINK)
    geometry = rectified_geometry(rig)
    tele_px = np.array([[61.0, 130.0]])
    column, row = np.round(geometry.ref_from_tele(tele_px)[0]).astype(int)
    mask = np.zeros(geometry.hw, np.bool_)
    mask[row - 1 : row + 2, column - 1 : column + 2] = True
    confidence = mask.astype(np.float32)
    disparity = DisparityMap(np.full(geometry.hw, 9, np.float32), confidence, ~mask)
    on_tele = disparity_on_tele(disparity, geometry=geometry)
    rows, columns = np.nonzero(on_tele.confidence)
    np.testing.assert_allclose([columns.mean(), rows.mean()], tele_px[0], atol=1.0)
    assert on_tele.confidence[130, 61] == 1
    assert not on_tele.valid[130, 61]
    assert on_tele.valid.mean() > 0.99


def test_unknown_stays_unknown_and_does_not_spread() -> None:
    rig = phone("horizontal", shrink=SHRINK)
    geometry = rectified_geometry(rig)
    disparity_px = np.full(geometry.hw, 9, np.float32)
    disparity_px[40:60, 70:100] = np.nan
    on_tele = disparity_on_tele(sure(disparity_px), geometry=geometry)
    unknown = np.isnan(on_tele.disparity_px)
    assert unknown.sum() == pytest.approx(20 * 30, rel=0.05)
    np.testing.assert_array_equal(unknown, ~on_tele.valid)


def test_without_a_scale_the_map_is_the_same() -> None:
    rig = phone("horizontal", shrink=SHRINK)
    transform = rig.wide_from_tele.copy()
    transform[:3, 3] *= 1 / rig.baseline_m
    relative = replace(rig, wide_from_tele=transform, is_scale_known=False)
    one, other = (
        disparity_on_tele(sure(np.full(rectified_geometry(each).hw, 7, np.float32)), geometry=rectified_geometry(each))
        for each in (rig, relative)
    )
    np.testing.assert_allclose(one.disparity_px, other.disparity_px, rtol=1e-5)


def test_a_map_of_another_size_is_refused() -> None:
    geometry = rectified_geometry(phone("horizontal", shrink=SHRINK))
    with pytest.raises(ValueError, match="was expected"):
        disparity_on_tele(sure(np.zeros((10, 10), np.float32)), geometry=geometry)
