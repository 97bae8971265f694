"""The other view as a network matches it: how much finer than its pixels, and how much sharper than it came.

Letters: H W image.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage, FloatMap

_ENLARGED_TO_PIXELS, _MOST_ENLARGED = 1280 * 640, 1.5
"""Smaller views are enlarged up to this before a network with cells of 4 px matches them: cells are too coarse for all
that small pictures show."""
_FINE_SIGMA_PX, _COARSE_SIGMA_PX = 1.0, 4.0
_LEAST_FINE_SHARE = 0.096
"""Of the coarse detail of src, that must be fine: where less is, larger views show no more. All views 4 times as coarse
have more, nearly all that a lens blurred besides, and none 8 times as coarse (``docs/decisions.md``)."""
_SHARPENED_TO = 0.35
"""Of ref's detail, that src gets. Wide photos of phones have as much or nearly so; more would sharpen their noise."""
_SHARPENING_SIGMA_PX, _MOST_SHARPENED = 2.0, 2.0
_TRIALS = 12


def enlarged_size(src: FloatImage) -> tuple[int, int]:
    """The height and width at which a network matches two views, px: larger than their own where they are small.

    Args:
        src: (H, W, 3) other view, as large as the sharp one.
    """
    height, width = src.shape[:2]
    scale = min(_MOST_ENLARGED, math.sqrt(_ENLARGED_TO_PIXELS / (height * width)))
    if scale <= 1 or not _has_fine_detail(_grey(src)):
        return height, width
    return round(scale * height), round(scale * width)


def sharpened(src: FloatImage, *, like: FloatImage) -> FloatImage:
    """Sharpen a soft view by an unsharp mask, so that what lenses and few pixels took counts again at matching.

    The mask is as strong as src needs to get ``_SHARPENED_TO`` of the fine detail of the sharp view, each in deviations
    of its view, but at most ``_MOST_SHARPENED``. A view that has so much is returned as it is.

    Args:
        src: (H, W, 3) other view, [0, 1].
        like: (H, W, 3) sharp view, [0, 1].

    Returns:
        (H, W, 3), [0, 1].
    """
    amount = _amount(_grey(src), _grey(like))
    if amount == 0:
        return src
    lost = src - cv2.GaussianBlur(src, (0, 0), _SHARPENING_SIGMA_PX)
    return np.asarray(np.clip(src + np.float32(amount) * lost, 0, 1), dtype=np.float32)


def _has_fine_detail(src: FloatMap) -> bool:
    return _detail(src, _FINE_SIGMA_PX) >= _LEAST_FINE_SHARE * _detail(src, _COARSE_SIGMA_PX)


def _amount(src: FloatMap, like: FloatMap) -> float:
    """Strength of the mask, by bisection: detail grows with it."""
    wanted = _SHARPENED_TO * _detail(like, _FINE_SIGMA_PX) * _deviation(src) / _deviation(like)
    fine = src - cv2.GaussianBlur(src, (0, 0), _FINE_SIGMA_PX)
    lost = src - cv2.GaussianBlur(src, (0, 0), _SHARPENING_SIGMA_PX)
    fine_lost = lost - cv2.GaussianBlur(lost, (0, 0), _FINE_SIGMA_PX)

    def is_reached(amount: float) -> bool:
        return float(np.abs(fine + np.float32(amount) * fine_lost).mean()) >= wanted

    low, high = 0.0, _MOST_SHARPENED
    if is_reached(low):
        return low
    for _ in range(_TRIALS):
        middle = (low + high) / 2
        low, high = (low, middle) if is_reached(middle) else (middle, high)
    return high


def _detail(grey: FloatMap, sigma_px: float) -> float:
    """Mean distance of a view from its blurred self."""
    return float(np.abs(grey - cv2.GaussianBlur(grey, (0, 0), sigma_px)).mean())


def _deviation(grey: FloatMap) -> float:
    return max(float(grey.std()), 1e-6)


def _grey(view: FloatImage) -> FloatMap:
    return np.asarray(cv2.cvtColor(view, cv2.COLOR_RGB2GRAY), dtype=np.float32)
