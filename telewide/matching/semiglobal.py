"""Semi-global matching of two comparable views, without training and without torch.

``disparity_px = x_ref - x_src``; the search window (d_min, d_max) is in px, d_max itself left out, and may be negative.
Each view is matched against the other with OpenCV's eight-path semi-global matcher; what the two results do not agree
on is unmeasured, and is filled from the background beside it.
Source: H. Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 2008.
Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.stereo import BoolMap, DisparityMap, FloatMap

_LEVELS_STEP = 16  # OpenCV: the number of levels must divide by 16, and disparities come in 1/16 px
_CONSISTENT_PX = 1.5
_BLOCK_PX = 5
_SPECKLE_AREA_PX = 60


def match_semiglobal(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> DisparityMap:
    """Match two rectified views by semi-global matching.

    Args:
        ref: (H, W, 3) float32, sRGB in [0, 1]: the view the result is for.
        src: (H, W, 3) float32, sRGB in [0, 1]: the other view, of the same size.
        window: smallest and largest disparity searched, px; the largest is left out.

    Returns:
        The disparity of ref, filled everywhere.

    Raises:
        ValueError: the views differ in shape or the window is empty.
    """
    _check_views(ref, src, window=window)
    ref_disparity_px = _match_one_way(_bytes_from_srgb(ref), _bytes_from_srgb(src), window=window)
    flipped_px = _match_one_way(_bytes_from_srgb(src[:, ::-1]), _bytes_from_srgb(ref[:, ::-1]), window=window)
    difference_px = _cross_difference(ref_disparity_px, flipped_px[:, ::-1])
    valid = (difference_px <= _CONSISTENT_PX) & _outside_speckles(ref_disparity_px)
    measured_px = np.where(valid, ref_disparity_px, np.float32(np.nan))
    confidence = np.where(valid, np.exp(-difference_px), 0).astype(np.float32)
    return DisparityMap(fill_background(measured_px, ref), confidence, valid)


def fill_background(disparity_px: FloatMap, guide_rgb: FloatMap) -> FloatMap:
    """Fill holes from the surface behind: the smaller of the nearest known values to both sides in the row.

    Args:
        disparity_px: (H, W) float32, px; NaN where unknown.
        guide_rgb: (H, W, 3) float32 in [0, 1]: the view the map is for.

    Returns:
        (H, W) float32, px, without NaN; zero everywhere if nothing was known.
    """
    rows = np.minimum(_last_known(disparity_px), _last_known(disparity_px[:, ::-1])[:, ::-1])
    rows = np.where(np.isfinite(rows), rows, np.float32(np.nan))
    columns = np.fmin(_first_filled(rows.T).T, np.inf)
    return np.where(np.isfinite(columns), columns, 0).astype(np.float32)


def _check_views(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> None:
    if ref.ndim != 3 or ref.shape[2] != 3 or ref.shape != src.shape:
        raise ValueError(f"two views of one shape (H, W, 3) are expected, found {ref.shape} and {src.shape}")
    if window[1] <= window[0]:
        raise ValueError(f"the disparity window {window} is empty: its end must exceed its start")


def _bytes_from_srgb(image: FloatMap) -> NDArray[np.uint8]:
    return np.ascontiguousarray(np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8))


def _match_one_way(ref: NDArray[np.uint8], src: NDArray[np.uint8], *, window: tuple[int, int]) -> FloatMap:
    """Disparity of ref in px, NaN where OpenCV gives none."""
    d_min, d_max = window
    levels = -(-(d_max - d_min) // _LEVELS_STEP) * _LEVELS_STEP
    # OpenCV gives nothing where part of the window falls outside src: borders repeated on both sides avoid that.
    left_px, right_px = max(d_min + levels, 0), max(-d_min, 0)
    padded = [cv2.copyMakeBorder(v, 0, 0, left_px, right_px, cv2.BORDER_REPLICATE) for v in (ref, src)]
    matcher = cv2.StereoSGBM.create(
        minDisparity=d_min,
        numDisparities=levels,
        blockSize=_BLOCK_PX,
        P1=8 * 3 * _BLOCK_PX**2,
        P2=32 * 3 * _BLOCK_PX**2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    sixteenths = matcher.compute(*padded)[:, left_px : left_px + ref.shape[1]]
    return np.where(sixteenths >= d_min * 16, sixteenths / np.float32(16), np.float32(np.nan)).astype(np.float32)


def _cross_difference(ref_disparity_px: FloatMap, src_disparity_px: FloatMap) -> FloatMap:
    """Absolute difference of ref's disparity and the one src has at the matched pixel; inf where there is none."""
    width = ref_disparity_px.shape[1]
    x_src = np.round(np.arange(width, dtype=np.float32) - np.nan_to_num(ref_disparity_px)).astype(np.int64)
    there_px = np.take_along_axis(src_disparity_px, np.clip(x_src, 0, width - 1), axis=1)
    difference_px = np.abs(ref_disparity_px - there_px)
    inside = (x_src >= 0) & (x_src < width) & np.isfinite(difference_px)
    return np.where(inside, difference_px, np.float32(np.inf)).astype(np.float32)


def _outside_speckles(disparity_px: FloatMap) -> BoolMap:
    """True outside small islands of disparity."""
    sixteenths = np.nan_to_num(disparity_px * 16, nan=-32768).astype(np.int16)
    cv2.filterSpeckles(sixteenths, -32768, _SPECKLE_AREA_PX, 16)
    return np.asarray(sixteenths > -32768)


def _last_known(values: FloatMap) -> FloatMap:
    """Each pixel's nearest known value at it or to its left; inf where there is none."""
    known = np.isfinite(values)
    index = np.maximum.accumulate(np.where(known, np.arange(values.shape[1]), -1), axis=1)
    taken = np.take_along_axis(values, np.maximum(index, 0), axis=1)
    return np.where(index >= 0, taken, np.float32(np.inf)).astype(np.float32)


def _first_filled(values: FloatMap) -> FloatMap:
    """The nearest known value before each pixel of a row, else the one after it."""
    before, after = _last_known(values), _last_known(values[:, ::-1])[:, ::-1]
    return np.where(np.isfinite(before), before, after)
