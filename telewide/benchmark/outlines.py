"""Specks along outlines: pixels that stand out from their surroundings in a bokeh picture and not in its photo.

Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage, FloatMap

JUMP_PX = 1.0
"""Difference between neighbours that is an edge of depth, px of disparity."""
WITHIN_PX = 2
OUTLIER_LEVELS = 20
"""Difference from the median of 3 x 3 pixels, of 255 levels, in any channel."""


def speck_share(picture_srgb: FloatImage, disparity_px: FloatMap) -> float:
    """Share of the pixels within 2 px of depth edges that stand out; NaN where the map has no edge.

    Args:
        picture_srgb: (H, W, 3) in [0, 1], judged in 8 bits.
        disparity_px: (H, W) px, filled.
    """
    square = np.ones((3, 3), np.uint8)
    edges = cv2.dilate(disparity_px, square) - cv2.erode(disparity_px, square) > JUMP_PX
    near = cv2.dilate(edges.astype(np.uint8), np.ones((2 * WITHIN_PX + 1, 2 * WITHIN_PX + 1), np.uint8)) > 0
    if not near.any():
        return float("nan")
    levels = (np.clip(picture_srgb, 0, 1) * 255 + 0.5).astype(np.uint8)
    return float((cv2.absdiff(levels, cv2.medianBlur(levels, 3)).max(axis=2) > OUTLIER_LEVELS)[near].mean())
