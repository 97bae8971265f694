"""Errors of an estimate against the truth: disparity and image quality.

Truth that is unknown is NaN and is left out. A mask says which pixels count; without one, all with known truth do.
Shares are in [0, 1]. Letters: H W image.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap

_BAD_PX = 3.0
_BAD_SHARE_OF_TRUTH = 0.05


def end_point_error_px(estimate_px: FloatMap, truth_px: FloatMap, *, mask: BoolMap | None = None) -> float:
    """Mean absolute disparity error.

    Args:
        estimate_px: (H, W) disparity, px.
        truth_px: (H, W) disparity, px; NaN where unknown.
        mask: (H, W) bool, the pixels that count; None for all.

    Returns:
        px; NaN where a pixel that counts has no estimate, because an answer left out has no size: fill it first.

    Raises:
        ValueError: the shapes differ, or no pixel that counts has a known truth.
    """
    return float(np.mean(_counted_errors_px(estimate_px, truth_px, mask)[0]))


def three_pixel_error(estimate_px: FloatMap, truth_px: FloatMap, *, mask: BoolMap | None = None) -> float:
    """Share of pixels that are wrong: by more than 3 px and by more than 5 % of the true disparity.

    The outlier rule of Menze and Geiger, "Object scene flow for autonomous vehicles" (2015). A pixel without an
    estimate is wrong.

    Args:
        estimate_px: (H, W) disparity, px; NaN where there is none.
        truth_px: (H, W) disparity, px; NaN where unknown.
        mask: (H, W) bool, the pixels that count; None for all.

    Returns:
        Share in [0, 1].

    Raises:
        ValueError: the shapes differ, or no pixel that counts has a known truth.
    """
    error_px, counted_truth_px = _counted_errors_px(estimate_px, truth_px, mask)
    is_fine = (error_px <= _BAD_PX) | (error_px <= _BAD_SHARE_OF_TRUTH * np.abs(counted_truth_px))
    return float(1.0 - np.mean(is_fine))


def bad_pixel_share(
    estimate_px: FloatMap, truth_px: FloatMap, *, threshold_px: float, mask: BoolMap | None = None
) -> float:
    """Share of pixels off by more than a threshold: bad-1, bad-2 of Scharstein and Szeliski's evaluation (IJCV 2002).

    A pixel without an estimate is wrong.

    Args:
        estimate_px: (H, W) disparity, px; NaN where there is none.
        truth_px: (H, W) disparity, px; NaN where unknown.
        threshold_px: the largest error that is fine, px.
        mask: (H, W) bool, the pixels that count; None for all.

    Returns:
        Share in [0, 1].

    Raises:
        ValueError: the shapes differ, or no pixel that counts has a known truth.
    """
    error_px, _ = _counted_errors_px(estimate_px, truth_px, mask)
    return float(1.0 - np.mean(error_px <= threshold_px))


def density(estimate_px: FloatMap, truth_px: FloatMap, *, mask: BoolMap | None = None) -> float:
    """Share of pixels with known truth that have an estimate.

    Args:
        estimate_px: (H, W) disparity, px; NaN where there is none.
        truth_px: (H, W) disparity, px; NaN where unknown.
        mask: (H, W) bool, the pixels that count; None for all.

    Returns:
        Share in [0, 1].

    Raises:
        ValueError: the shapes differ, or no pixel that counts has a known truth.
    """
    return float(np.mean(np.isfinite(_counted_errors_px(estimate_px, truth_px, mask)[0])))


def psnr_db(picture: FloatImage, reference: FloatImage, *, mask: BoolMap | None = None) -> float:
    """Peak signal to noise ratio of a picture whose white is 1.

    Args:
        picture: (H, W, 3) or (H, W) float32.
        reference: likewise.
        mask: (H, W) bool, the pixels that count; None for all.

    Returns:
        dB; infinite where both are equal.

    Raises:
        ValueError: the shapes differ, or no pixel counts.
    """
    if picture.shape != reference.shape:
        raise ValueError(f"picture {picture.shape} and reference {reference.shape} must have one shape")
    square = np.square(picture.astype(np.float64) - reference)
    counted = square if mask is None else square[_checked_mask(mask, picture.shape[:2])]
    if counted.size == 0:
        raise ValueError("no pixel counts")
    mean = float(np.mean(counted))
    return -10 * math.log10(mean) if mean > 0 else math.inf


def _counted_errors_px(
    estimate_px: FloatMap, truth_px: FloatMap, mask: BoolMap | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if estimate_px.shape != truth_px.shape:
        raise ValueError(f"estimate {estimate_px.shape} and truth {truth_px.shape} must have one shape")
    counts = ~np.isnan(truth_px)
    if mask is not None:
        counts &= _checked_mask(mask, truth_px.shape)
    if not counts.any():
        raise ValueError("no pixel that counts has a known truth")
    counted_truth_px = truth_px[counts].astype(np.float64)
    return np.abs(estimate_px[counts] - counted_truth_px), counted_truth_px


def _checked_mask(mask: BoolMap, hw: tuple[int, ...]) -> BoolMap:
    if mask.shape != hw or mask.dtype != np.bool_:
        raise ValueError(f"mask must be bool of shape {hw}, found {mask.dtype} of shape {mask.shape}")
    return mask
