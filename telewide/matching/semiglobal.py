"""Semi-global matching of two comparable views, without training and without torch.

Every pixel and disparity gets a cost: how the patterns of light and dark around the two pixels differ (census), and how
their colours differ. Along eight directions the costs are summed with a price on every change of disparity, lower where
ref has an edge, and the cheapest disparity wins. Values on which ref and src do not agree are replaced from the
background beside them, and edges are moved to those of ref.
``disparity_px = x_ref - x_src``; the window (d_min, d_max) is in px, d_max itself left out, and may be negative.
Source: H. Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 2008.
Letters: D disparity levels, H W image, N M steps of a sweep and pixels beside each other in a step.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, ByteImage, FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks, without_unphotographed
from telewide.matching.filling import fill_rows, weighted_median
from telewide.matching.subpixel import refine_subpixel

CostVolume = NDArray[np.uint16]

_MIN_LEVELS = 4
# Costs are in levels of colour, of 255, added up over the three channels.
_BIT_COST = 30  # of a census bit that differs
_CENSUS_STEP_PX = 3
_COLOUR_LIMIT = 60
_OUTSIDE_COST = 105  # where src ends: dearer than most right matches, cheaper than most wrong ones
_BLUR_PX = 1.0  # of both views: takes noise, steps of 8 bits and part of the difference in sharpness
_SMALL_CHANGE = 180  # price of a change by one level of disparity along a path
_LARGE_CHANGE = 3000  # price of a larger one where ref is even ...
_LEAST_LARGE_CHANGE = 300  # ... and on its strongest edges
_EDGE = 6  # the difference between neighbours of ref that halves the price
_BAND_ROWS = 128  # rows swept sideways at once: bounds the memory
_FORBIDDEN = 20_000  # dearer than any path; leaves room for sums in 16 bits
_CONSISTENT_PX = 1.5
_SPECKLE_SHARE = 0.0025  # of the image, the largest island of disparity that is dropped
_AGREEMENT_BLOCK_PX = 9
_MEASURED_CONFIDENCE = 0.25


def match_semiglobal(
    ref: FloatMap, src: FloatMap, *, window: tuple[int, int], valid: ValidMasks | None = None
) -> DisparityMap:
    """Match two rectified views by semi-global matching, to a fraction of a pixel.

    Takes 4 bytes of memory for every pixel and level.

    Args:
        ref: (H, W, 3) float32, sRGB in [0, 1]: the view the result is for.
        src: (H, W, 3) float32, sRGB in [0, 1]: the other view, of the same size, in ref's colours.
        window: smallest and largest disparity searched, px; the largest is left out.
        valid: where the photos reach, of (H, W); beyond, src ends and ref is filled; None where they fill the views.

    Returns:
        The disparity of ref, filled everywhere. Confidence is a mean over the pixel's surroundings of
        exp(-(disagreement of the two views in px, beyond src's rounding) - (px by which the median moved the value)),
        where a value that was replaced counts 0.

    Raises:
        ValueError: the views differ in shape, or the window is too small.
    """
    _check_views(ref, src, window=window)
    found = _match_to_levels(ref, src, window=window, valid=valid)
    disparity_px = refine_subpixel(ref, src, found.disparity_px, confidence=found.confidence)
    return DisparityMap(disparity_px, found.confidence, found.valid)


def _match_to_levels(
    ref: FloatMap, src: FloatMap, *, window: tuple[int, int], valid: ValidMasks | None
) -> DisparityMap:
    """Match to whole pixels."""
    cost_HDW = _matching_cost(ref, src, window=window)
    if valid is not None:
        _forget_unphotographed(cost_HDW, valid, window=window)
    total_HDW = _summed_over_paths(cost_HDW, ref * 255)
    del cost_HDW
    measured_px = _cheapest(total_HDW) + np.float32(window[0])
    src_disparity_px = _cheapest_of_src(total_HDW, window=window)
    del total_HDW
    difference_px = _cross_difference(measured_px, src_disparity_px)
    is_consistent = (difference_px <= _CONSISTENT_PX) & _outside_speckles(measured_px)
    if valid is not None:
        is_consistent &= valid.comparable(measured_px)
    filled_px = fill_rows(np.where(is_consistent, measured_px, np.float32(np.nan)))
    disparity_px = weighted_median(filled_px, ref)
    agreement = np.exp(-np.maximum(difference_px - 0.5, 0) - np.abs(disparity_px - measured_px)) * is_consistent
    confidence = cv2.blur(agreement, (_AGREEMENT_BLOCK_PX, _AGREEMENT_BLOCK_PX)).clip(0, 1).astype(np.float32)
    return without_unphotographed(DisparityMap(disparity_px, confidence, confidence >= _MEASURED_CONFIDENCE), valid)


def _check_views(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> None:
    if ref.ndim != 3 or ref.shape[2] != 3 or ref.shape != src.shape:
        raise ValueError(f"two views of one shape (H, W, 3) are expected, found {ref.shape} and {src.shape}")
    if window[1] - window[0] < _MIN_LEVELS:
        raise ValueError(f"disparity window {window}: expected d_max - d_min of at least {_MIN_LEVELS} px")


def _matching_cost(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> CostVolume:
    """Cost of every disparity of every pixel of ref, (H, D, W)."""
    soft_ref, soft_src = (cv2.GaussianBlur(view, (0, 0), _BLUR_PX).astype(np.float32) for view in (ref, src))
    ref_census, src_census = _census(soft_ref), _census(soft_src)
    ref_planes, src_planes = _byte_planes(soft_ref), _byte_planes(soft_src)
    height, width = ref.shape[:2]
    cost_HDW = np.full((height, window[1] - window[0], width), _OUTSIDE_COST, dtype=np.uint16)
    for level, disparity_px in enumerate(range(*window)):
        at_ref, at_src = _overlap(disparity_px, width=width)
        bits = np.bitwise_count(ref_census[:, at_ref] ^ src_census[:, at_src])
        planes = zip(ref_planes, src_planes, strict=True)
        colour = _sum_of_three(*(_absolute_difference(r[:, at_ref], s[:, at_src]) for r, s in planes))
        cost_HDW[:, level, at_ref] = np.minimum(colour, _COLOUR_LIMIT) + bits * np.uint16(_BIT_COST)
    return cost_HDW


def _forget_unphotographed(cost_HDW: CostVolume, valid: ValidMasks, *, window: tuple[int, int]) -> None:
    """Let all that is compared with the continued border of a photo cost what lies outside of src does."""
    for level, disparity_px in enumerate(range(*window)):
        at_ref, at_src = _overlap(disparity_px, width=valid.ref.shape[1])
        is_unknown = ~(valid.ref[:, at_ref] & valid.src[:, at_src])
        np.copyto(cost_HDW[:, level, at_ref], np.uint16(_OUTSIDE_COST), where=is_unknown)


def _byte_planes(image: FloatMap) -> list[ByteImage]:
    levels = np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)
    return [levels[..., channel].copy() for channel in range(3)]


def _absolute_difference(a: ByteImage, b: ByteImage) -> ByteImage:
    return np.maximum(a, b) - np.minimum(a, b)


def _sum_of_three(a: ByteImage, b: ByteImage, c: ByteImage) -> NDArray[np.uint16]:
    return np.asarray(np.add(a, b, dtype=np.uint16) + c)


def _overlap(disparity_px: int, *, width: int) -> tuple[slice, slice]:
    """Columns of ref whose partner lies in src, and the columns of those partners."""
    first, last = max(0, disparity_px), max(0, disparity_px, min(width, width + disparity_px))
    return slice(first, last), slice(first - disparity_px, last - disparity_px)


def _census(image: FloatMap) -> ByteImage:
    """Census of eight pixels around each: a bit for each that is brighter.

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
    before = np.full((levels + 2, width), _FORBIDDEN, dtype=np.uint16)  # a level more at either end
    path = cost_NDM[0].copy()
    total_NDM[0] += path
    for step in range(1, len(cost_NDM)):
        _shift_columns(path, before[1:-1], by=drift)
        least = before.min(axis=0)
        difference = np.abs(guide[step] - guide[step - 1, before_x]).sum(axis=1)
        large_change = np.maximum(_LARGE_CHANGE / (1 + difference / _EDGE), _LEAST_LARGE_CHANGE).astype(np.uint16)
        np.minimum(before[:-2], before[2:], out=path)
        path += np.uint16(_SMALL_CHANGE)
        np.minimum(path, before[1:-1], out=path)
        np.minimum(path, least + large_change, out=path)
        path -= least
        path += cost_NDM[step]
        total_NDM[step] += path


def _shift_columns(values: CostVolume, out: CostVolume, *, by: int) -> None:
    """Move columns by -1, 0 or 1; the column left empty repeats its neighbour."""
    if by == 0:
        out[:] = values
    elif by > 0:
        out[:, 1:], out[:, 0] = values[:, :-1], values[:, 0]
    else:
        out[:, :-1], out[:, -1] = values[:, 1:], values[:, -1]


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
        at_ref, at_src = _overlap(candidate_px, width=width)
        total = total_HDW[:, level, at_ref]
        is_better = total < best[:, at_src]
        np.copyto(best[:, at_src], total, where=is_better)
        np.copyto(disparity_px[:, at_src], np.float32(candidate_px), where=is_better)
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
    cv2.filterSpeckles(sixteenths, -32768, round(_SPECKLE_SHARE * sixteenths.size), 16)
    return np.asarray(sixteenths != -32768)
