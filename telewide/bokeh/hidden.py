"""A photo in levels of disparity, with what lies hidden behind its edges: for renderers that look past them.

The page renders bokeh from these. What a nearer surface hides is continued from the nearest pixel of the surfaces
behind it, as the layers of `telewide.bokeh.layers` are; here once, whatever the focus. Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.bokeh.layers import FILL_PX
from telewide.bokeh.subject import OUTLIER_PERCENT
from telewide.depth.nearest import fill_unknown, nearest_known
from telewide.geometry.arrays import FloatImage, FloatMap

COUNT = 64
"""Levels; with the strongest blur that is used, neighbours differ by less than a pixel of radius."""
JUMP = 3
"""Neighbouring pixels whose levels differ by more lie on two surfaces."""
REACH_SHARE = 0.08
"""Of the longer side: how far behind an edge something is looked for."""


@dataclass(frozen=True)
class Levels:
    """A photo sorted by disparity.

    Attributes:
        level: (H, W) uint8, 0 the farthest, `COUNT` - 1 the nearest.
        hidden_level: (H, W) uint8, of what lies behind; that of the pixel itself where nothing is hidden.
        hidden: (H, W, 3) float32, its colour, sRGB in [0, 1]; the photo's where nothing is hidden.
        ends_px: disparities of the farthest and of the nearest level.
    """

    level: NDArray[np.uint8]
    hidden_level: NDArray[np.uint8]
    hidden: FloatImage
    ends_px: tuple[float, float]


def sort_by_level(photo: FloatImage, disparity_px: FloatMap) -> Levels:
    """Sort a photo into levels, evenly spaced in disparity, and continue each behind what is nearer.

    Args:
        photo: (H, W, 3) float32, sRGB in [0, 1].
        disparity_px: (H, W) float32, px; NaN where unknown, which takes its nearest neighbour's.

    Raises:
        InputError: no disparity is known.
    """
    filled_px = fill_unknown(disparity_px)
    far_px, near_px = (float(p) for p in np.percentile(filled_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT)))
    near_px = max(near_px, far_px + 1e-3)
    share = (np.clip(filled_px, far_px, near_px) - far_px) / (near_px - far_px)
    level = np.round(share * (COUNT - 1)).astype(np.uint8)
    hidden_level, hidden = level.copy(), photo.copy()
    reach_px = REACH_SHARE * max(level.shape)
    for own in np.unique(level):
        here, behind = level == own, level < int(own) - JUMP
        if not behind.any():
            continue
        distance_px, source = nearest_known(behind)
        here &= distance_px <= reach_px
        if here.any():
            hidden_level[here] = level.ravel()[source[here]]
            hidden[here] = _mean_of(photo, behind).reshape(-1, 3)[source[here]]
    return Levels(level, hidden_level, hidden, (far_px, near_px))


def _mean_of(photo: FloatImage, known: NDArray[np.bool_]) -> FloatImage:
    """Colours averaged over a small square, of the known pixels alone: what nobody saw is better guessed smooth."""
    weight = known.astype(np.float32)
    square = (FILL_PX, FILL_PX)
    total = cv2.blur(photo * weight[..., None], square, borderType=cv2.BORDER_REPLICATE)
    share = cv2.blur(weight, square, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(total / np.maximum(share, 1e-3)[..., None], dtype=np.float32)
