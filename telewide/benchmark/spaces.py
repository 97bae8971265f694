"""Worth of a space of features for matching unequal views: it should forget the damage and still tell points apart.

Both measures are those of the publication's table of spaces. Letters: C channels, H W image.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.geometry.arrays import FloatMap
from telewide.matching.window import Window
from telewide.metrics import psnr_db


def space_psnr_db(sharp_HWC: FloatMap, damaged_HWC: FloatMap) -> float:
    """PSNR between features of a sharp view and of its damaged copy, scaled so that the sharp ones fill [0, 1].

    Args:
        sharp_HWC: (H, W, C) float32, features of the sharp view.
        damaged_HWC: likewise of the damaged one.

    Returns:
        dB; infinite where both are equal, NaN where the sharp features are constant.

    Raises:
        ValueError: the shapes differ.
    """
    low, high = float(sharp_HWC.min()), float(sharp_HWC.max())
    if high <= low:
        return float("nan")
    scaled = ((features - low) / np.float32(high - low) for features in (damaged_HWC, sharp_HWC))
    return psnr_db(*scaled)


def match_features(ref_HWC: FloatMap, src_HWC: FloatMap, *, window: Window, patch_px: int = 1) -> FloatMap:
    """Match features by the smallest Euclidean distance, the winner takes all.

    Args:
        ref_HWC: (H, W, C) float32, features of the view that gets the disparity.
        src_HWC: likewise of the other view.
        window: disparities to search, px, whole numbers.
        patch_px: side of the square over which squared distances are added up; 1 for each pixel by itself, 5 in the
            publication where the space is the picture itself.

    Returns:
        (H, W) float32, whole px; 0 where every disparity of the window leaves the other view.

    Raises:
        ValueError: the shapes differ, or the window is empty.
    """
    if ref_HWC.shape != src_HWC.shape:
        raise ValueError(f"features {ref_HWC.shape} and {src_HWC.shape} must have one shape")
    if window[0] >= window[1]:
        raise ValueError(f"disparity window {window}: expected d_min < d_max")
    height, width = ref_HWC.shape[:2]
    least = np.full((height, width), np.inf, np.float32)
    found_px = np.zeros((height, width), np.float32)
    for disparity_px in range(*window):
        to, begin = min(width, width + disparity_px), max(0, disparity_px)
        if begin >= to:
            continue
        apart = ref_HWC[:, begin:to] - src_HWC[:, begin - disparity_px : to - disparity_px]
        cost = np.einsum("hwc,hwc->hw", apart, apart)
        if patch_px > 1:
            cost = np.asarray(cv2.blur(cost, (patch_px, patch_px), borderType=cv2.BORDER_REFLECT_101), np.float32)
        is_better = cost < least[:, begin:to]
        least[:, begin:to][is_better] = cost[is_better]
        found_px[:, begin:to][is_better] = disparity_px
    return found_px
