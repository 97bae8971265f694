"""Disparity where none was measured, and maps whose edges follow the picture.

Holes of a disparity map are mostly what src does not see: the background beside a nearer object. So a hole takes the
lower of the two surfaces that end at it, never a mean of both. A weighted median then moves edges to where the picture
has them, and takes no value from between two surfaces either. NaN means unknown.
Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from telewide.geometry.arrays import FloatMap

_RADIUS_PX = 13
_EDGE_VARIANCE = 20.0  # colour variance, of 255 levels squared, above which the picture counts as having an edge


def fill_rows(disparity_px: FloatMap) -> FloatMap:
    """Fill each hole with the smaller of the known values to its left and right.

    Args:
        disparity_px: (H, W) float32, px; NaN where unknown.

    Returns:
        (H, W) float32, px, without NaN: an empty row takes the nearest one's values, an empty map is zero.
    """
    beside_px = np.fmin(_last_known(disparity_px), _last_known(disparity_px[:, ::-1])[:, ::-1])
    is_empty = np.isnan(beside_px[:, 0])  # what is known anywhere in a row has been carried to both of its ends
    if is_empty.all():
        return np.zeros_like(beside_px)
    (nearest,) = distance_transform_edt(is_empty, return_distances=False, return_indices=True)
    return np.asarray(beside_px[nearest], dtype=np.float32)


def weighted_median(
    disparity_px: FloatMap, guide_rgb: FloatMap, *, radius_px: int = _RADIUS_PX, edge_variance: float = _EDGE_VARIANCE
) -> FloatMap:
    """Take the median over each pixel's surroundings, weighted by likeness in the guide.

    The weights are those of the guided filter: the share of values below each whole level is filtered, and the median
    is where it passes one half; the mean of the values within 1 px of it then gives the fraction. Where two surfaces
    meet the result is a value of one of them.
    Source: Z. Ma, K. He, Y. Wei, J. Sun, E. Wu, "Constant Time Weighted Median Filtering for Stereo Matching and
    Beyond", ICCV 2013.

    Args:
        disparity_px: (H, W) float32, px, without NaN.
        guide_rgb: (H, W, 3) float32, sRGB in [0, 1]: the view the map is for.
        radius_px: radius of the surroundings, px.
        edge_variance: variance of the guide, of 255 levels squared, above which an edge is kept.

    Returns:
        (H, W) float32, px.
    """
    smooth = guided_filter(guide_rgb, radius_px=radius_px, edge_variance=edge_variance)
    median_px = np.full(disparity_px.shape, np.nan, dtype=np.float32)
    share_before: NDArray[np.float32] = np.zeros(disparity_px.shape, dtype=np.float32)
    for level in range(int(np.floor(disparity_px.min())), int(np.ceil(disparity_px.max())) + 1):
        is_below = (disparity_px <= level + 0.5).astype(np.float32)
        share = np.maximum(smooth.filter(is_below), share_before)
        crossing = np.isnan(median_px) & (share >= 0.5)
        rise = share[crossing] - share_before[crossing]
        median_px[crossing] = level - 0.5 + (0.5 - share_before[crossing]) / rise
        share_before = share
    median_px = np.where(np.isnan(median_px), disparity_px, median_px)
    # An even surface falls into one level, and its fraction is lost: the values near the median bring it back.
    is_near = (np.abs(disparity_px - median_px) < 1).astype(np.float32)
    fraction_px = smooth.filter(is_near * (disparity_px - median_px)) / np.maximum(smooth.filter(is_near), 0.5)
    return np.asarray(median_px + np.clip(fraction_px, -0.5, 0.5), dtype=np.float32)


def guided_filter(guide_rgb: FloatMap, *, radius_px: int, edge_variance: float) -> cv2.ximgproc.GuidedFilter:
    """Make a filter that takes means over each pixel's surroundings, weighted by likeness in the guide.

    Args:
        guide_rgb: (H, W, 3) float32, sRGB in [0, 1].
        radius_px: radius of the surroundings, px.
        edge_variance: variance of the guide, of 255 levels squared, above which an edge is kept.

    Returns:
        A filter of (H, W) float32 maps.
    """
    guide = np.ascontiguousarray(np.clip(guide_rgb * 255 + 0.5, 0, 255).astype(np.uint8))
    return cv2.ximgproc.createGuidedFilter(guide, radius_px, edge_variance)


def _last_known(values: FloatMap) -> FloatMap:
    """Each pixel's nearest known value at it or to its left in the row; NaN where there is none."""
    index = np.where(np.isfinite(values), np.arange(values.shape[1]), 0)
    return np.asarray(np.take_along_axis(values, np.maximum.accumulate(index, axis=1), axis=1))
