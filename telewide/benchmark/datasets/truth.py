"""A pair with its true disparity, as every data set is read.

Published sets call their views left and right; left is the one the truth is for. Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap

_CROSS_CHECK_PX = 1.0


@dataclass(frozen=True)
class StereoTruth:
    """A rectified pair of equal cameras with the true disparity of its left view.

    Attributes:
        left: (H, W, 3) RGB float32 in [0, 1].
        right: (H, W, 3) RGB float32 in [0, 1].
        disparity_px: (H, W) float32, ``x_left - x_right``, of any sign; NaN where unknown.
        occluded: (H, W) bool, what only the left view sees; None where the set does not tell.
    """

    left: FloatImage
    right: FloatImage
    disparity_px: FloatMap
    occluded: BoolMap | None = None


def checked_truth(source: Path, truth: StereoTruth) -> StereoTruth:
    """Return what was read if its parts have one size.

    Args:
        source: where it was read from, for the message.
        truth: what was read.

    Raises:
        InputError: the views, the disparity or the mask differ in size.
    """
    shapes = [truth.left.shape[:2], truth.right.shape[:2], truth.disparity_px.shape]
    if truth.occluded is not None:
        shapes.append(truth.occluded.shape)
    if len(set(shapes)) > 1:
        found = ", ".join(f"{height} x {width}" for height, width in shapes)
        raise InputError(f"{source}: the views and their truth differ in size (height x width): {found}")
    return truth


def occluded_by_cross_check(left_px: FloatMap, right_px: FloatMap) -> BoolMap:
    """Find what the right view does not see: points whose place there has another disparity, none, or lies outside.

    Disparities that differ by 1 px at most are taken for one point, as usual for hand-made truth.

    Args:
        left_px: (H, W) disparity of the left view, px; NaN where unknown.
        right_px: (H, W) disparity of the right view with the same sign, px; NaN where unknown.

    Returns:
        (H, W) bool; True as well where the left view's own disparity is unknown.
    """
    height, width = left_px.shape
    rows, columns = np.mgrid[:height, :width]
    target = columns - np.where(np.isnan(left_px), np.inf, left_px)
    seen = np.zeros(left_px.shape, dtype=np.bool_)
    is_inside = (target >= -0.5) & (target <= width - 0.5)
    inside = np.where(is_inside, target, 0)
    for neighbour in (np.floor(inside), np.ceil(inside)):
        found_px = right_px[rows, np.clip(neighbour, 0, width - 1).astype(np.int64)]
        seen |= np.abs(found_px - left_px) <= _CROSS_CHECK_PX  # comparing with NaN is False
    return np.asarray(~(seen & is_inside), dtype=np.bool_)
