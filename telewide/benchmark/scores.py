"""Scores of a disparity map: shares of wrong pixels and mean error, by what the other view sees.

Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.geometry.arrays import BoolMap, FloatMap
from telewide.metrics import bad_pixel_share, density, end_point_error_px, three_pixel_error

Region = Literal["all", "visible", "occluded"]


@dataclass(frozen=True)
class Score:
    """Errors over one region.

    Attributes:
        off_3px_5percent: 3PE, share in [0, 1].
        end_point_error_px: EPE; NaN where an estimate is missing.
        bad_1px: share in [0, 1] off by more than 1 px.
        bad_2px: likewise 2 px.
        density: share in [0, 1] that has an estimate.
        pixels: how many count.
    """

    off_3px_5percent: float
    end_point_error_px: float
    bad_1px: float
    bad_2px: float
    density: float
    pixels: int


def score_regions(estimate_px: FloatMap, truth: StereoTruth) -> dict[Region, Score]:
    """Judge a disparity map.

    Args:
        estimate_px: (H, W) disparity of the left view, px; NaN where there is none.
        truth: of the scene.

    Returns:
        Scores over all pixels with known truth and, where the set tells them apart, over those that the right view
        sees and those that it does not. A region without a pixel is left out.

    Raises:
        ValueError: the shapes differ.
    """
    known = np.isfinite(truth.disparity_px)
    regions: dict[Region, BoolMap] = {"all": known}
    if truth.occluded is not None:
        regions |= {"visible": known & ~truth.occluded, "occluded": known & truth.occluded}
    return {
        name: score_pixels(estimate_px, truth.disparity_px, pixels) for name, pixels in regions.items() if pixels.any()
    }


def score_pixels(estimate_px: FloatMap, truth_px: FloatMap, pixels: BoolMap) -> Score:
    """Judge a disparity map over some pixels.

    Args:
        estimate_px: (H, W) disparity, px; NaN where there is none.
        truth_px: (H, W) disparity, px; NaN where unknown.
        pixels: (H, W) bool, those that count.

    Raises:
        ValueError: the shapes differ, or no pixel that counts has a known truth.
    """
    return Score(
        off_3px_5percent=three_pixel_error(estimate_px, truth_px, mask=pixels),
        end_point_error_px=end_point_error_px(estimate_px, truth_px, mask=pixels),
        bad_1px=bad_pixel_share(estimate_px, truth_px, threshold_px=1.0, mask=pixels),
        bad_2px=bad_pixel_share(estimate_px, truth_px, threshold_px=2.0, mask=pixels),
        density=density(estimate_px, truth_px, mask=pixels),
        pixels=int(pixels.sum()),
    )
