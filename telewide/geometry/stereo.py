"""Disparity and depth of a rectified pair.

``disparity_px = x_ref - x_src``, of any sign, in pixels of the map that holds it. ``depth_m`` is z along ref's optical
axis. ``doffs_px = cx_src - cx_ref`` (Middlebury's definition). Unknown values are NaN, never 0.
Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatMap


@dataclass(frozen=True)
class DisparityMap:
    """Answer of a matcher for the reference view.

    Attributes:
        disparity_px: (H, W) float32, ``x_ref - x_src``; filled everywhere, also where nothing could be matched.
        confidence: (H, W) float32 in [0, 1].
        valid: (H, W) bool, True where the value was measured; False where it was filled in (occluded, inconsistent).
    """

    disparity_px: FloatMap
    confidence: FloatMap
    valid: BoolMap


@dataclass(frozen=True)
class ValidMasks:
    """Where rectified views show what their photos hold; elsewhere the border of a photo is continued.

    Attributes:
        ref: (H, W) bool.
        src: (H, W) bool.
    """

    ref: BoolMap
    src: BoolMap

    def comparable(self, disparity_px: FloatMap) -> BoolMap:
        """(H, W) bool, False for pixels of ref that no photo shows in one of the views, at the disparity each has.

        What falls outside of src altogether is for the matcher to say.
        """
        width = disparity_px.shape[1]
        x_src = np.round(np.arange(width) - np.nan_to_num(disparity_px, nan=np.inf, posinf=np.inf, neginf=-np.inf))
        is_inside = (x_src >= 0) & (x_src <= width - 1)
        partner = np.where(is_inside, x_src, 0).astype(np.intp)
        return np.asarray(self.ref & (~is_inside | np.take_along_axis(self.src, partner, axis=1)))


def without_unphotographed(found: DisparityMap, valid: ValidMasks | None) -> DisparityMap:
    """Take confidence and validity from what was matched where a photo does not reach.

    Args:
        found: disparity of ref.
        valid: of the views; None where the photos fill them.
    """
    if valid is None:
        return found
    comparable = valid.comparable(found.disparity_px)
    confidence = np.where(comparable, found.confidence, np.float32(0))
    return DisparityMap(found.disparity_px, confidence, found.valid & comparable)


def resize_disparity(disparity_px: FloatMap, *, wh: tuple[int, int]) -> FloatMap:
    """Resize a disparity map, scaling its values with its width.

    Nearest neighbour, so that no value lies between two surfaces.

    Args:
        disparity_px: (H, W) float32, px of this map.
        wh: width and height of the result.

    Returns:
        (wh[1], wh[0]) float32, px of the result.
    """
    scale_x = wh[0] / disparity_px.shape[1]
    resized = cv2.resize(disparity_px, wh, interpolation=cv2.INTER_NEAREST_EXACT)
    return np.asarray(resized * np.float32(scale_x), dtype=np.float32)


def depth_from_disparity(disparity_px: FloatMap, *, f_px: float, baseline_m: float, doffs_px: float = 0.0) -> FloatMap:
    """Depth along ref's optical axis: ``z = f B / (d + doffs)``.

    Args:
        disparity_px: (H, W) float32, px.
        f_px: focal length of the rectified views, px.
        baseline_m: distance of the two lenses, m.
        doffs_px: ``cx_src - cx_ref``, px.

    Returns:
        (H, W) float32, m; NaN where ``d + doffs`` is not positive.
    """
    shifted_px = disparity_px.astype(np.float64) + doffs_px
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = np.where(shifted_px > 0, f_px * baseline_m / shifted_px, np.nan)
    return depth_m.astype(np.float32)
