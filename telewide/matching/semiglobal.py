"""Semi-global matching of two comparable views, without training and without torch.

Every pixel and disparity gets a cost: how the patterns of light and dark around the two pixels differ (census), and how
their colours differ. Along eight directions the costs are summed with a price on every change of disparity, lower where
ref has an edge, and the cheapest disparity wins. Values on which ref and src do not agree are replaced from the
background beside them, and edges are moved to those of ref.
``disparity_px = x_ref - x_src``; the window (d_min, d_max) is in px, d_max itself left out, and may be negative.
Source: H. Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 2008.
Letters: D disparity levels, H W image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, ByteImage, FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks, without_unphotographed
from telewide.matching.filling import fill_rows, weighted_median
from telewide.matching.path_costs import CostVolume, summed_over_paths
from telewide.matching.subpixel import refine_subpixel

_MIN_LEVELS = 4
# Costs are in levels of colour, of 255, added up over the three channels.
_BIT_COST = 30  # of a census bit that differs
_CENSUS_STEP_PX = 3
_COLOUR_LIMIT = 60
_OUTSIDE_COST = 105  # where src ends: dearer than most right matches, cheaper than most wrong ones
_BLUR_PX = 1.0  # of both views: takes noise, steps of 8 bits and part of the difference in sharpness
_CONSISTENT_PX = 1.5
_SPECKLE_SHARE = 0.0025  # of the image, the largest island of disparity that is dropped
_AGREEMENT_BLOCK_PX = 9
_MEASURED_CONFIDENCE = 0.25


@dataclass(frozen=True)
class _Compared:
    """Descriptions of ref and of src that are compared.

    Attributes:
        census: (H, W), patterns of light and dark.
        planes: three colours of (H, W).
        valid: where the photos reach; None where they fill the views.
    """

    census: tuple[ByteImage, ByteImage]
    planes: tuple[list[ByteImage], list[ByteImage]]
    valid: ValidMasks | None


def match_semiglobal(
    ref: FloatMap, src: FloatMap, *, window: tuple[int, int], valid: ValidMasks | None = None
) -> DisparityMap:
    """Match two rectified views by semi-global matching, to a fraction of a pixel.

    Takes 4 bytes of memory for every pixel and level, up to 1 GiB; more would take about 14 bytes times D W and the
    square root of H instead, a third more time, and give the same result.

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
    measured_px, src_disparity_px = _measured(ref, src, window=window, valid=valid)
    difference_px = _cross_difference(measured_px, src_disparity_px)
    is_consistent = (difference_px <= _CONSISTENT_PX) & _outside_speckles(measured_px)
    if valid is not None:
        is_consistent &= valid.comparable(measured_px)
    filled_px = fill_rows(np.where(is_consistent, measured_px, np.float32(np.nan)))
    disparity_px = weighted_median(filled_px, ref)
    agreement = np.exp(-np.maximum(difference_px - 0.5, 0) - np.abs(disparity_px - measured_px)) * is_consistent
    confidence = cv2.blur(agreement, (_AGREEMENT_BLOCK_PX, _AGREEMENT_BLOCK_PX)).clip(0, 1).astype(np.float32)
    return without_unphotographed(DisparityMap(disparity_px, confidence, confidence >= _MEASURED_CONFIDENCE), valid)


def _measured(
    ref: FloatMap, src: FloatMap, *, window: tuple[int, int], valid: ValidMasks | None
) -> tuple[FloatMap, FloatMap]:
    """The cheapest disparity of each pixel of ref, and of src, px."""
    compared = _compared(ref, src, valid)
    measured_px, src_disparity_px = (np.empty(ref.shape[:2], dtype=np.float32) for _ in range(2))
    totals = summed_over_paths(
        partial(_matching_cost, compared, window=window), ref * 255, levels=window[1] - window[0]
    )
    for rows, total_HDW in totals:
        measured_px[rows] = _cheapest(total_HDW) + np.float32(window[0])
        src_disparity_px[rows] = _cheapest_of_src(total_HDW, window=window)
        del total_HDW
    return measured_px, src_disparity_px


def _check_views(ref: FloatMap, src: FloatMap, *, window: tuple[int, int]) -> None:
    if ref.ndim != 3 or ref.shape[2] != 3 or ref.shape != src.shape:
        raise ValueError(f"two views of one shape (H, W, 3) are expected, found {ref.shape} and {src.shape}")
    if window[1] - window[0] < _MIN_LEVELS:
        raise ValueError(f"disparity window {window}: expected d_max - d_min of at least {_MIN_LEVELS} px")


def _compared(ref: FloatMap, src: FloatMap, valid: ValidMasks | None) -> _Compared:
    soft_ref, soft_src = (cv2.GaussianBlur(view, (0, 0), _BLUR_PX).astype(np.float32) for view in (ref, src))
    return _Compared((_census(soft_ref), _census(soft_src)), (_byte_planes(soft_ref), _byte_planes(soft_src)), valid)


def _matching_cost(compared: _Compared, rows: slice, *, window: tuple[int, int]) -> CostVolume:
    """Cost of every disparity of every pixel of some rows of ref, (H, D, W)."""
    ref_census, src_census = (census[rows] for census in compared.census)
    ref_planes, src_planes = ([plane[rows] for plane in planes] for planes in compared.planes)
    height, width = ref_census.shape
    cost_HDW = np.full((height, window[1] - window[0], width), _OUTSIDE_COST, dtype=np.uint16)
    for level, disparity_px in enumerate(range(*window)):
        at_ref, at_src = _overlap(disparity_px, width=width)
        bits = np.bitwise_count(ref_census[:, at_ref] ^ src_census[:, at_src])
        planes = zip(ref_planes, src_planes, strict=True)
        colour = _sum_of_three(*(_absolute_difference(r[:, at_ref], s[:, at_src]) for r, s in planes))
        cost_HDW[:, level, at_ref] = np.minimum(colour, _COLOUR_LIMIT) + bits * np.uint16(_BIT_COST)
    if compared.valid is not None:
        photographed = ValidMasks(compared.valid.ref[rows], compared.valid.src[rows])
        _forget_unphotographed(cost_HDW, photographed, window=window)
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
