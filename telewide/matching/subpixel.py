"""The fraction of a pixel, where the two views agree on it: a step of Lucas and Kanade at the end of a match.

Costs that are summed along paths hardly tell 8.2 from 8: every neighbour pulls to the same whole level. So src is
looked up at the disparity found, and what it still lacks of ref is explained by a small shift,
``ref - src(x - d) = s d/dd src(x - d)``, least squares over the surroundings that look alike. Where contrast is low or
the rest is large, as with views of unequal sharpness, the shift is known badly and the disparity stays.
Source: B. Lucas, T. Kanade, "An Iterative Image Registration Technique with an Application to Stereo Vision", 1981.
Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.geometry.arrays import FloatMap
from telewide.matching.filling import guided_filter

_BLUR_PX = 2.0  # of both views: wide knows no finer detail, which would pass for noise
_ROUNDS = 2
_RADIUS_PX = 9  # of the surroundings that are summed over
_DETAIL_PX = 19  # side of the square whose mean is left out: brightness may differ between the lenses
_EDGE_VARIANCE = 120.0  # as of `telewide.matching.filling.weighted_median`; surfaces are larger than their texture
_WORST = 0.1  # difference of a channel above which the views do not show the same thing
_LARGEST_PX = 0.6
_USUAL_PX = 0.2  # standard deviation of what is missing from a disparity found in whole levels
_NEIGHBOURS_ALIKE = 25.0  # how many pixels of the blurred views carry the news of one
_FLOOR = 1e-7  # squared difference that rounding to 8 bits leaves


def refine_subpixel(ref: FloatMap, src: FloatMap, disparity_px: FloatMap, *, confidence: FloatMap) -> FloatMap:
    """Move disparities by less than a pixel, to where src looks most like ref.

    Args:
        ref: (H, W, 3) float32, sRGB in [0, 1]: the view the map is for.
        src: (H, W, 3) float32, sRGB in [0, 1]: the other view, in ref's colours.
        disparity_px: (H, W) float32, px, right to a pixel.
        confidence: (H, W) float32 in [0, 1]; what has none takes no part.

    Returns:
        (H, W) float32, px, within 0.6 px of what was given.
    """
    soft_ref, soft_src = (cv2.GaussianBlur(view, (0, 0), _BLUR_PX).astype(np.float32) for view in (ref, src))
    detail_ref = _detail(soft_ref)
    slope_src = cv2.sepFilter2D(soft_src, -1, np.array([-0.5, 0.0, 0.5]), np.array([1.0])).astype(np.float32)
    surroundings = guided_filter(ref, radius_px=_RADIUS_PX, edge_variance=_EDGE_VARIANCE)
    refined_px = disparity_px.astype(np.float32)
    for _ in range(_ROUNDS):
        seen = _detail(_seen_from_ref(soft_src, refined_px))
        slope = -_detail(_seen_from_ref(slope_src, refined_px))
        missing = detail_ref - seen
        counts = confidence * (np.abs(missing).max(axis=2) < _WORST)
        slope_missing, slope_slope, missing_missing, seen_seen, seen_slope, seen_missing = (
            surroundings.filter((counts * (a * b).sum(axis=2)).astype(np.float32))
            for a, b in (
                *((slope, missing), (slope, slope), (missing, missing)),
                *((seen, seen), (seen, slope), (seen, missing)),
            )
        )
        # What a difference in contrast explains is no shift.
        seen_seen = np.maximum(seen_seen, 0) + 1e-9
        product = slope_missing - seen_slope * seen_missing / seen_seen
        square = np.maximum(slope_slope - seen_slope**2 / seen_seen, 0) + 1e-9
        rest = missing_missing - seen_missing**2 / seen_seen
        shift_px = np.clip(product / square, -_LARGEST_PX, _LARGEST_PX)
        variance_px2 = _variance_px2(product, square, rest)
        # The mean of what was found before and what is found now, each as sure as it is.
        told_px = refined_px + shift_px
        mixed_px = (disparity_px * variance_px2 + told_px * _USUAL_PX**2) / (variance_px2 + _USUAL_PX**2)
        refined_px = np.clip(mixed_px, disparity_px - _LARGEST_PX, disparity_px + _LARGEST_PX).astype(np.float32)
    return np.asarray(refined_px, dtype=np.float32)


def _variance_px2(product: FloatMap, square: FloatMap, rest: FloatMap) -> FloatMap:
    """Variance of the shift, from what it leaves unexplained."""
    left = np.maximum(rest - product**2 / square, 0) + _FLOOR
    n_pixels = (2 * _RADIUS_PX + 1) ** 2 / 2  # about half of the surroundings look alike
    return np.asarray(_NEIGHBOURS_ALIKE * left / square / n_pixels)


def _detail(view: FloatMap) -> FloatMap:
    return np.asarray(view - cv2.blur(view, (_DETAIL_PX, _DETAIL_PX)))


def _seen_from_ref(view: FloatMap, disparity_px: FloatMap) -> FloatMap:
    """The view at ``x - d``. Lanczos: bilinear and OpenCV's cubic look-ups are themselves drawn to whole pixels."""
    height, width = disparity_px.shape
    x_px = np.arange(width, dtype=np.float32) - disparity_px
    y_px = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], x_px.shape)
    seen = cv2.remap(view, x_px, np.ascontiguousarray(y_px), cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen)
