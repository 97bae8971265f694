"""Cost of an error of depth in the picture: bokeh of the estimated depth against that of the true one.

Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from telewide.bokeh.render import radius_per_px_from_strength, render_bokeh
from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.metrics import psnr_db

FOCUS_PERCENTILES = (10, 50, 90)
"""Of the true disparities: far, in the middle, near."""
STRENGTH_SHARE = 1 / 40
"""Radius of the largest circle of confusion, in sides of the shorter kind."""


@dataclass(frozen=True)
class BokehQuality:
    """PSNR of the rendered pictures, dB; infinite where both are equal.

    Attributes:
        far_db: focused on what is far.
        middle_db: in the middle.
        near_db: on what is near.
    """

    far_db: float
    middle_db: float
    near_db: float

    @property
    def mean_db(self) -> float:
        """Mean of the three."""
        return (self.far_db + self.middle_db + self.near_db) / 3


def bokeh_quality(picture: FloatImage, estimate_px: FloatMap, truth_px: FloatMap) -> BokehQuality:
    """Render bokeh at three focus planes with estimated and with true depth, and compare.

    Both are focused on the same disparity and blurred by the same lens. Where the truth is unknown, both take it from
    the nearest pixel that is known, and what is rendered there does not count.

    Args:
        picture: (H, W, 3) RGB float32 in [0, 1], sharp.
        estimate_px: (H, W) disparity on it, px; NaN is filled from the nearest neighbour.
        truth_px: (H, W) disparity on it, px; NaN where unknown.

    Raises:
        ValueError: the shapes differ, or nothing of the truth is known.
    """
    known = np.isfinite(truth_px)
    if not picture.shape[:2] == estimate_px.shape == truth_px.shape:
        raise ValueError(f"picture {picture.shape}, estimate {estimate_px.shape}, truth {truth_px.shape}: sizes differ")
    if not known.any():
        raise ValueError("nothing of the truth is known")
    filled_truth_px = fill_unknown(truth_px)
    if not np.isfinite(estimate_px).any():
        estimate_px = np.full_like(estimate_px, np.median(truth_px[known]))
    filled_px = np.where(known, fill_unknown(estimate_px), filled_truth_px)
    strength_px = STRENGTH_SHARE * min(truth_px.shape)
    values_db = []
    for focus_px in np.percentile(truth_px[known], FOCUS_PERCENTILES):
        lens = radius_per_px_from_strength(truth_px, float(focus_px), strength_px=strength_px)
        rendered, expected = (
            render_bokeh(picture, map_px, focus_disparity_px=float(focus_px), radius_per_px=lens)
            for map_px in (filled_px, filled_truth_px)
        )
        values_db.append(psnr_db(np.clip(rendered, 0, 1), np.clip(expected, 0, 1), mask=known))
    return BokehQuality(*values_db)
