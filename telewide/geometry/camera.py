"""Resizing and cropping of pixel positions and of the camera matrix.

Pixel (0, 0) is the centre of the top-left pixel, so resizing by s maps ``x' = (x + 0.5) s - 0.5``: the principal point
moves like any other point, the focal length scales by s, and the skew entry scales with x.
Points are (x, y). Letters: N points; K the 3x3 camera matrix, px.
"""

from __future__ import annotations

import math

import numpy as np

from telewide.geometry.arrays import FloatArray

_FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)


def focal_px_from_f35(f35_mm: float, *, hw: tuple[int, int]) -> float:
    """Focal length from its 35 mm equivalent: ``f_px = f35 d_px / d_35``, d the diagonal (CIPA DCG-001).

    By the longer side instead, photos of 4:3 and 16:9 would differ by 9 %.

    Args:
        f35_mm: focal length of equal field of view on 36 x 24 mm.
        hw: size of the photo, px.

    Returns:
        px.
    """
    return f35_mm / _FULL_FRAME_DIAGONAL_MM * math.hypot(*hw)


def scaled_points(points_px: FloatArray, *, scale_xy: tuple[float, float]) -> FloatArray:
    """Where points lie after the image was resized: ``x' = (x + 0.5) s - 0.5``.

    Args:
        points_px: (..., 2) x and y, px of the image before.
        scale_xy: new size / old size along x and along y.

    Returns:
        (..., 2) float64, px of the resized image.

    Raises:
        ValueError: the last axis does not hold x and y, or a scale is not positive.
    """
    points = np.asarray(points_px, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 2:
        raise ValueError(f"points must have shape (..., 2), found {points.shape}")
    scale = _checked_scale(scale_xy)
    return (points + 0.5) * scale - 0.5


def scaled_intrinsics(K: FloatArray, *, scale_xy: tuple[float, float]) -> FloatArray:
    """Camera matrix of the resized image.

    Projecting with the result equals projecting with ``K`` and moving the points by :func:`scaled_points`.

    Args:
        K: (3, 3) camera matrix, px of the image before.
        scale_xy: new size / old size along x and along y.

    Returns:
        (3, 3) float64, px of the resized image.

    Raises:
        ValueError: ``K`` is not 3x3 or a scale is not positive.
    """
    scale_x, scale_y = _checked_scale(scale_xy)
    resized_from_image = np.array(
        [[scale_x, 0.0, 0.5 * scale_x - 0.5], [0.0, scale_y, 0.5 * scale_y - 0.5], [0.0, 0.0, 1.0]]
    )
    return resized_from_image @ _checked_intrinsics(K)


def _checked_scale(scale_xy: tuple[float, float]) -> FloatArray:
    scale = np.asarray(scale_xy, dtype=np.float64)
    if scale.shape != (2,) or not np.all(np.isfinite(scale) & (scale > 0)):
        raise ValueError(f"scale_xy must be two positive numbers, found {scale_xy}")
    return scale


def _checked_intrinsics(K: FloatArray) -> FloatArray:
    matrix = np.asarray(K, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise ValueError(f"K must be a 3x3 camera matrix, found shape {matrix.shape}")
    return matrix
