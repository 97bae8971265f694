"""Resizing and cropping of cameras: laws, and OpenCV's resize as the oracle."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.geometry.camera import scaled_intrinsics, scaled_points

K = np.array([[800.0, 1.5, 319.5], [0.0, 810.0, 200.0], [0.0, 0.0, 1.0]])


def project(K: NDArray[np.float64], points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    homogeneous = points_m @ K.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


@pytest.mark.parametrize("scale_xy", [(1.0, 1.0), (0.5, 0.25), (3.0, 1.7)])
def test_project_then_scale_equals_scale_then_project(scale_xy: tuple[float, float], rng: np.random.Generator) -> None:
    points_m = rng.uniform([-1, -1, 2], [1, 1, 9], (50, 3))
    scaled = scaled_points(project(K, points_m), scale_xy=scale_xy)
    np.testing.assert_allclose(project(scaled_intrinsics(K, scale_xy=scale_xy), points_m), scaled, atol=1e-9)


def test_scaling_back_undoes_it(rng: np.random.Generator) -> None:
    points_px = rng.uniform(0, 500, (3, 4, 2))
    there = scaled_points(points_px, scale_xy=(0.3, 4.0))
    np.testing.assert_allclose(scaled_points(there, scale_xy=(1 / 0.3, 0.25)), points_px, atol=1e-9)
    there_K = scaled_intrinsics(K, scale_xy=(0.3, 4.0))
    np.testing.assert_allclose(scaled_intrinsics(there_K, scale_xy=(1 / 0.3, 0.25)), K, atol=1e-9)


def test_corners_of_the_image_stay_corners() -> None:
    corners_px = np.array([[-0.5, -0.5], [639.5, 479.5]])
    np.testing.assert_allclose(scaled_points(corners_px, scale_xy=(0.25, 0.5)), [[-0.5, -0.5], [159.5, 239.5]])


@pytest.mark.parametrize("scale", [0.25, 0.5, 2.0, 3.0])
def test_opencv_resize_moves_a_blob_there(scale: float) -> None:
    y, x = np.mgrid[:96, :128].astype(np.float64)
    blob = np.exp(-((x - 60.3) ** 2 + (y - 41.8) ** 2) / (2 * 9.0**2))
    wh = (round(128 * scale), round(96 * scale))
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    resized = cv2.resize(blob, wh, interpolation=interpolation)
    rows, columns = np.mgrid[: wh[1], : wh[0]]
    centroid = np.array([(columns * resized).sum(), (rows * resized).sum()]) / resized.sum()
    expected = scaled_points(np.array([60.3, 41.8]), scale_xy=(scale, scale))
    np.testing.assert_allclose(centroid, expected, atol=0.01)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match=r"\(\.\.\., 2\)"):
        scaled_points(np.zeros((4, 3)), scale_xy=(1, 1))
    with pytest.raises(ValueError, match="positive"):
        scaled_points(np.zeros((4, 2)), scale_xy=(0, 1))
    with pytest.raises(ValueError, match="3x3"):
        scaled_intrinsics(np.eye(4), scale_xy=(1, 1))
