"""Matches kept for judging: where tele's points truly lie in wide, known to no fit and no training.

A match found in both directions says where a point of tele lies in wide. How far a disparity map misses them
compares matchers, losses and stages, and needs no ground truth.
Letters: N matches, H W image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.layout import Capture
from telewide.geometry.arrays import FloatArray, FloatMap

CLIP_PX = 3.0
"""A match missed by more counts as missed by this much, so that a few wild ones do not decide."""
_REMAP_LIMIT = 32000
"""cv2.remap refuses longer columns."""


@dataclass(frozen=True)
class HeldOut:
    """One capture with the matches kept for judging.

    Attributes:
        capture: corrected pair.
        ref_px: (N, 2) points (x, y) of tele.
        disparity_px: (N,) ``x_tele - x_wide`` of the matches.
    """

    capture: Capture
    ref_px: FloatArray
    disparity_px: NDArray[np.float64]

    def beyond(self, x_px: float) -> HeldOut:
        """The matches right of a column of tele."""
        kept = self.ref_px[:, 0] >= x_px
        return HeldOut(self.capture, self.ref_px[kept], self.disparity_px[kept])


def match_errors_px(disparity_px: FloatMap, held_out: HeldOut) -> NDArray[np.float64]:
    """Absolute error of a disparity map at the matches, bilinear in between.

    Args:
        disparity_px: (H, W) of tele, filled everywhere.
        held_out: N matches of the same pair.

    Returns:
        (N,) px.
    """
    return np.abs(sampled_at(disparity_px, held_out) - held_out.disparity_px[:_REMAP_LIMIT])


def sampled_at(map_HW: FloatMap, held_out: HeldOut) -> NDArray[np.float64]:
    """Values of a map (H, W) of tele at the matches, bilinear in between; (N,)."""
    xy = held_out.ref_px.astype(np.float32)[:_REMAP_LIMIT]
    if not len(xy):
        return np.empty(0)
    sampled = cv2.remap(map_HW, xy[:, :1], xy[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled[:, 0].astype(np.float64)


def summarise_errors(errors_px: NDArray[np.float64]) -> dict[str, float]:
    """Shares of matches off by more than 1 and 3 px, mean error, mean of it clipped at 3 px; NaN without matches."""
    if not errors_px.size:
        return {"off_1px": math.nan, "off_3px": math.nan, "mean_px": math.nan, "clipped_px": math.nan, "matches": 0.0}
    return {
        "off_1px": float((errors_px > 1).mean()),
        "off_3px": float((errors_px > 3).mean()),
        "mean_px": float(errors_px.mean()),
        "clipped_px": float(np.minimum(errors_px, CLIP_PX).mean()),
        "matches": float(errors_px.size),
    }
