"""Semi-global matching of two comparable views, without training and without torch.

Every pixel and disparity gets a cost: how the pattern of light and dark around the pixel differs (census, on ref
blurred a little towards the coarser src), and how the colours differ. Along eight directions the costs are summed with
a price on every change of disparity, lower where ref has an edge, and the cheapest disparity wins. Values on which ref
and src do not agree are replaced from the background beside them, and edges are moved to those of ref.
``disparity_px = x_ref - x_src``; the window (d_min, d_max) is in px, d_max itself left out, and may be negative.
Source: H. Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 2008.
Letters: D disparity levels, H W image, N M steps of a sweep and pixels beside each other in a step.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.stereo import BoolMap, DisparityMap, FloatMap
from telewide.matching.filling import fill_background, fill_rows, weighted_median

__all__ = ["fill_background", "match_semiglobal"]

CostVolume = NDArray[np.uint16]

_MIN_LEVELS = 4
# Costs are in units of the dearest match, held as whole multiples of 1 / _UNIT.
_UNIT = 100
_CENSUS_SHARE = 0.8  # of a cost; the rest is colour
_CENSUS_STEP_PX = 3
_COLOUR_LIMIT = 20 / 255
_OUTSIDE_COST = 0.35  # where src ends: dearer than most right matches, cheaper than most wrong ones
_COST_BLOCK_PX = 3
_REF_BLUR_PX = 1.0
_SMALL_CHANGE = 0.6  # price of a change by one level along a path
_LARGE_CHANGE = 10.0  # price of a larger one where ref is even ...
_LEAST_LARGE_CHANGE = 1.0  # ... and on its strongest edges
_EDGE_LEVEL = 3 / 255  # the difference between neighbours of ref that halves the price
_BAND_ROWS = 128  # rows swept sideways at once: bounds the memory
_FORBIDDEN = 20_000  # dearer than any path; leaves room for sums in 16 bits
_CONSISTENT_PX = 1.0
_SPECKLE_AREA_PX = 400


def match_semiglobal(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> DisparityMap:
    """Match two rectified views by semi-global matching.

    Takes 4 bytes of memory for every pixel and level.

    Args:
        ref: (H, W, 3) float32, sRGB in [0, 1]: the view the result is for.
        src: (H, W, 3) float32, sRGB in [0, 1]: the other view, of the same size, in ref's colours.
        window: smallest and largest disparity searched, px; the largest is left out.

    Returns:
        The disparity of ref, filled everywhere. Confidence falls by e with every px by which the two views, or a
        value and its surroundings, disagree; it is 0 where nothing was measured.

    Raises:
        ValueError: the views differ in shape, or the window is too small.
    """
    _check_views(ref, src, window=window)
    total_HDW = _summed_over_paths(_matching_cost(ref, src, window=window), ref)
    measured_px = _cheapest(total_HDW) + np.float32(window[0])
    src_disparity_px = _cheapest_of_src(total_HDW, window=window)
    del total_HDW
    difference_px = _cross_difference(measured_px, src_disparity_px)
    is_consistent = (difference_px <= _CONSISTENT_PX) & _outside_speckles(measured_px)
    filled_px = fill_rows(np.where(is_consistent, measured_px, np.float32(np.nan)))
    disparity_px = weighted_median(filled_px, ref)
    moved_px = np.abs(disparity_px - measured_px)
    valid = is_consistent & (moved_px <= _CONSISTENT_PX)
    confidence = np.where(valid, np.exp(-difference_px - moved_px), 0).astype(np.float32)
    return DisparityMap(disparity_px, confidence, valid)


def _check_views(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> None:
    if ref.ndim != 3 or ref.shape[2] != 3 or ref.shape != src.shape:
        raise ValueError(f"two views of one shape (H, W, 3) are expected, found {ref.shape} and {src.shape}")
    if window[1] - window[0] < _MIN_LEVELS:
        raise ValueError(f"disparity window {window}: expected d_max - d_min of at least {_MIN_LEVELS} px")


def _matching_cost(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> CostVolume:
    """Cost of every disparity of every pixel of ref, (H, D, W)."""
    soft_ref: FloatMap = np.asarray(cv2.GaussianBlur(ref, (0, 0), _REF_BLUR_PX), dtype=np.float32)
    ref_census, src_census = _census(soft_ref), _census(src)
    ref_planes, src_planes = np.moveaxis(soft_ref, 2, 0).copy(), np.moveaxis(src, 2, 0).copy()
    height, width = ref.shape[:2]
    cost_HDW = np.empty((height, window[1] - window[0], width), dtype=np.uint16)
    block = (_COST_BLOCK_PX, _COST_BLOCK_PX)
    for level, disparity_px in enumerate(range(*window)):
        x_src = np.arange(width) - disparity_px
        inside = (x_src >= 0) & (x_src < width)
        x_src = np.clip(x_src, 0, width - 1)
        pattern = np.bitwise_count(ref_census ^ src_census[:, x_src]) * np.float32(_CENSUS_SHARE / 8)
        colour = sum(np.abs(r - s[:, x_src]) for r, s in zip(ref_planes, src_planes, strict=True)) / 3
        cost = pattern + np.minimum(colour / _COLOUR_LIMIT, 1) * np.float32(1 - _CENSUS_SHARE)
        cost[:, ~inside] = _OUTSIDE_COST
        cost_HDW[:, level] = cv2.blur(cost, block) * _UNIT
    return cost_HDW


def _census(image: FloatMap) -> NDArray[np.uint8]:
    """Which of eight pixels around each are brighter, a bit for each.

    Source: R. Zabih, J. Woodfill, "Non-parametric Local Transforms for Computing Visual Correspondence", ECCV 1994.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    step = _CENSUS_STEP_PX
    around = cv2.copyMakeBorder(grey, step, step, step, step, cv2.BORDER_REPLICATE)
    height, width = grey.shape
    corners = [(y, x) for y in (0, step, 2 * step) for x in (0, step, 2 * step) if (y, x) != (step, step)]
    brighter = np.stack([around[y : y + height, x : x + width] > grey for y, x in corners])
    return np.asarray(np.packbits(brighter, axis=0)[0])


def _summed_over_paths(cost_HDW: CostVolume, ref: FloatMap) -> CostVolume:
    """Sum of the path costs that reach each pixel from eight directions, (H, D, W)."""
    total_HDW = np.zeros_like(cost_HDW)
    for direction in (1, -1):
        for drift in (-1, 0, 1):
            _sweep(cost_HDW[::direction], total_HDW[::direction], ref[::direction], drift=drift)
    for top in range(0, ref.shape[0], _BAND_ROWS):
        band = slice(top, top + _BAND_ROWS)
        cost_WDH = cost_HDW[band].transpose(2, 1, 0).copy()
        total_WDH = np.zeros_like(cost_WDH)
        for direction in (1, -1):
            sideways = ref[band].transpose(1, 0, 2)[::direction]
            _sweep(cost_WDH[::direction], total_WDH[::direction], sideways, drift=0)
        total_HDW[band] += total_WDH.transpose(2, 1, 0)
    return total_HDW


def _sweep(cost_NDM: CostVolume, total_NDM: CostVolume, guide: FloatMap, *, drift: int) -> None:
    """Add the costs of the paths that run from the first step to the last, ``drift`` pixels aside in each.

    ``L(d) = C(d) + min(L'(d), L'(d - 1) + P1, L'(d + 1) + P1, min L' + P2) - min L'`` with L' of the pixel before on
    the path, P1 the small change and P2 the large one.
    """
    _, levels, width = cost_NDM.shape
    before_x = np.clip(np.arange(width) - drift, 0, width - 1)
    small_change = np.uint16(_SMALL_CHANGE * _UNIT)
    path = np.full((levels + 2, width), _FORBIDDEN, dtype=np.uint16)  # with a level below the first and above the last
    path[1:-1] = cost_NDM[0]
    total_NDM[0] += cost_NDM[0]
    for step in range(1, len(cost_NDM)):
        if drift:
            path = path[:, before_x]
        least = path[1:-1].min(axis=0)
        difference = np.abs(guide[step] - guide[step - 1, before_x]).mean(axis=1)
        large_change = np.maximum(_LARGE_CHANGE / (1 + difference / _EDGE_LEVEL), _LEAST_LARGE_CHANGE) * _UNIT
        best = np.minimum(path[:-2], path[2:])
        best += small_change
        np.minimum(best, path[1:-1], out=best)
        np.minimum(best, least + large_change.astype(np.uint16), out=best)
        best -= least
        np.add(best, cost_NDM[step], out=path[1:-1])
        total_NDM[step] += path[1:-1]


def _cheapest(total_HDW: CostVolume) -> FloatMap:
    """The cheapest level, moved by up to half a level to the tip of a V through it and its two neighbours."""
    winner = total_HDW.argmin(axis=1)
    centre = np.clip(winner, 1, total_HDW.shape[1] - 2)
    below, at, above = (
        np.take_along_axis(total_HDW, (centre + aside)[:, None], axis=1)[:, 0].astype(np.float32)
        for aside in (-1, 0, 1)
    )
    rise = np.maximum(np.maximum(below, above) - at, 1)
    offset = np.clip((below - above) / (2 * rise), -0.5, 0.5)
    return np.asarray(winner + np.where(winner == centre, offset, 0), dtype=np.float32)


def _cheapest_of_src(total_HDW: CostVolume, *, window: tuple[int, int]) -> FloatMap:
    """The cheapest disparity of each pixel of src, from the same sums, px."""
    height, _, width = total_HDW.shape
    best = np.full((height, width), np.iinfo(np.uint16).max, dtype=np.uint16)
    disparity_px = np.full((height, width), np.nan, dtype=np.float32)
    for level, candidate_px in enumerate(range(*window)):
        first, last = max(0, -candidate_px), min(width, width - candidate_px)  # of src, where ref has a pixel
        if first < last:
            total = total_HDW[:, level, first + candidate_px : last + candidate_px]
            is_better = total < best[:, first:last]
            best[:, first:last][is_better] = total[is_better]
            disparity_px[:, first:last][is_better] = candidate_px
    return disparity_px


def _cross_difference(ref_disparity_px: FloatMap, src_disparity_px: FloatMap) -> FloatMap:
    """Absolute difference of ref's disparity and the one src has at the matched pixel; inf where there is none."""
    width = ref_disparity_px.shape[1]
    x_src = np.round(np.arange(width) - ref_disparity_px).astype(np.int64)
    there_px = np.take_along_axis(src_disparity_px, np.clip(x_src, 0, width - 1), axis=1)
    difference_px = np.abs(ref_disparity_px - there_px)
    has_partner = (x_src >= 0) & (x_src < width) & np.isfinite(there_px)
    return np.where(has_partner, difference_px, np.float32(np.inf)).astype(np.float32)


def _outside_speckles(disparity_px: FloatMap) -> BoolMap:
    """True outside small islands of disparity."""
    sixteenths = np.clip(np.round(disparity_px * 16), -32000, 32000).astype(np.int16)
    cv2.filterSpeckles(sixteenths, -32768, _SPECKLE_AREA_PX, 16)
    return np.asarray(sixteenths != -32768)
