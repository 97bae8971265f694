"""Figures of a rig against closed forms: pinholes that differ by a known amount, depth from disparity twice."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pages.made_calibration import made_rig

from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.pages.rig_figures import (
    camera_difference_px,
    cell_counts,
    depth_error_m,
    tele_outline_px,
    transfer_difference_px,
)

HW = (600, 800)


def pinhole(f_px: float, *, cx_px: float = 399.5, cy_px: float = 299.5) -> Camera:
    return Camera(HW, np.array([[f_px, 0, cx_px], [0, f_px, cy_px], [0, 0, 1]]), np.zeros(0))


def pinhole_rig(*, wide_f_px: float = 500.0, x_m: float = 0.01) -> StereoRig:
    transform = rigid_transform(rotation=np.zeros(3), translation=np.array([x_m, 0, 0]))
    return StereoRig(pinhole(1500.0), pinhole(wide_f_px), transform)


def test_a_camera_does_not_differ_from_itself() -> None:
    camera = made_rig().tele
    assert camera_difference_px(camera, camera).max() < 1e-6


def test_a_longer_lens_differs_in_proportion_to_the_distance_from_the_centre() -> None:
    difference_px = camera_difference_px(pinhole(1000.0), pinhole(1010.0))
    rows, columns = difference_px.shape
    y, x = np.mgrid[:rows, :columns] + 0.5
    radius_px = np.hypot(x * HW[1] / columns - 400, y * HW[0] / rows - 300)
    # Rays of the first at radius r lie at 1.01 r in the second; no turn makes that smaller on average.
    np.testing.assert_allclose(difference_px, 0.01 * radius_px, atol=1e-3)


def test_a_moved_principal_point_is_mostly_a_turn_of_a_long_lens() -> None:
    moved = camera_difference_px(pinhole(20_000.0), pinhole(20_000.0, cx_px=409.5))
    assert moved.max() < 0.02  # 10 px of shift are 10 px / f of turn, but for the perspective of a narrow view


def test_transfer_sees_a_change_of_baseline_as_a_change_of_disparity() -> None:
    first, second = pinhole_rig(x_m=0.01), pinhole_rig(x_m=0.011)
    difference_px = transfer_difference_px(first, second, distance_m=2.0)
    np.testing.assert_allclose(difference_px, 1500.0 * 0.001 / 2.0, rtol=1e-9)
    assert transfer_difference_px(first, first, distance_m=2.0).max() == 0


def test_transfer_is_counted_in_tele_pixels() -> None:
    first = pinhole_rig()
    turned = rigid_transform(rotation=np.array([0, 1e-4, 0]), translation=np.array([0.01, 0, 0]))
    difference_px = transfer_difference_px(first, dataclasses.replace(first, wide_from_tele=turned), distance_m=1e6)
    centre_px = difference_px[difference_px.shape[0] // 2, difference_px.shape[1] // 2]
    assert centre_px == pytest.approx(1500.0 * 1e-4, rel=1e-3)  # small angle times f_tele


def test_depth_error_is_the_slope_of_depth_over_disparity() -> None:
    rig = pinhole_rig()
    depth_m = np.array([0.5, 1.0, 4.0])
    disparity_px = 1500.0 * 0.01 / depth_m
    step_px = 1e-5
    numeric_m = (15.0 / (disparity_px - step_px) - 15.0 / (disparity_px + step_px)) / (2 * step_px)
    np.testing.assert_allclose(depth_error_m(depth_m, rig, disparity_std_px=1.0), numeric_m, rtol=1e-6)
    np.testing.assert_allclose(depth_error_m(depth_m, rig, disparity_std_px=0.3), 0.3 * numeric_m, rtol=1e-6)


def test_the_outline_of_tele_is_its_frame_shrunk_by_the_focal_ratio() -> None:
    outline_px = tele_outline_px(pinhole_rig())
    low_px, high_px = outline_px.min(axis=0), outline_px.max(axis=0)
    np.testing.assert_allclose(high_px - low_px, np.array([800, 600]) / 3, atol=1e-6)
    np.testing.assert_allclose((low_px + high_px) / 2, [399.5, 299.5], atol=1e-6)


def test_cells_count_every_point_inside_once() -> None:
    corners_px = np.array([[-0.5, -0.5], [799.49, 599.49], [0.0, 599.0], [399.4, 10.0], [399.6, 10.0]])
    counts = cell_counts(np.vstack([corners_px, [[900.0, 10.0], [-3.0, 5.0]]]), hw=HW, cells=(2, 2))
    assert counts.tolist() == [[2, 1], [1, 1]]


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_corners_that_a_distortion_folds_over_are_left_out() -> None:
    """As in a solve of boards that filled the middle of the wide photo only."""
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    sound, folded = (Camera((480, 640), K, np.array([-0.05, k2, 0.0, 0.0, 0.0])) for k2 in (0.25, -0.9))
    difference_px = camera_difference_px(sound, folded)
    rows, columns = difference_px.shape
    assert np.isnan(difference_px[0, 0])
    assert np.isfinite(difference_px[rows // 3 : 2 * rows // 3, columns // 3 : 2 * columns // 3]).all()
