"""Disparity windows: which disparities are searched. Free of torch, for recipes and for semi-global matching.

A window ``[d_min, d_max)`` has one plane every ``VOLUME_STEP_PX`` px of the full-size image and may be negative.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from telewide.errors import InputError
from telewide.ranges import MAX_DISPARITY_PX, MAX_SPAN_PX

VOLUME_STEP_PX = 4
_MARGIN_SHARE = 0.2
"""Searched beyond what was measured, at either end: a share of the range measured, and at least one step."""
_MIN_WIDTH_PX = 32
Window = tuple[int, int]


def measured_window(ranges_px: Sequence[tuple[float, float] | None]) -> Window:
    """Choose the disparities to search, from all pairs of one set.

    Args:
        ranges_px: least and largest disparity of each pair, px; None where its matches do not tell.

    Raises:
        InputError: the matches of no pair tell.
    """
    told_px = [range_px for range_px in ranges_px if range_px is not None]
    if not told_px:
        raise InputError("no pair has consistent matches enough to measure which disparities to search")
    low_px, high_px = min(low for low, _ in told_px), max(high for _, high in told_px)
    margin_px = max(VOLUME_STEP_PX, _MARGIN_SHARE * (high_px - low_px))
    d_min = VOLUME_STEP_PX * math.floor((low_px - margin_px) / VOLUME_STEP_PX)
    d_max = VOLUME_STEP_PX * math.ceil((high_px + margin_px) / VOLUME_STEP_PX)
    while d_max - d_min < _MIN_WIDTH_PX:
        # near things, the larger disparities, are the ones matches miss
        d_max += VOLUME_STEP_PX
        if d_max - d_min < _MIN_WIDTH_PX:
            d_min -= VOLUME_STEP_PX
    return d_min, d_max


def check_window(window: Window) -> None:
    """Refuse a disparity window the volume cannot hold.

    Raises:
        ValueError: unless d_min < d_max and both are multiples of the volume's step.
    """
    d_min, d_max = window
    if d_min >= d_max or d_min % VOLUME_STEP_PX or d_max % VOLUME_STEP_PX:
        raise ValueError(f"disparity window {window}: expected d_min < d_max, multiples of {VOLUME_STEP_PX} px")


def check_stated_window(window: Window) -> None:
    """Refuse a window that a file states and no pair needs: it would ask for a volume of many gigabytes.

    Raises:
        ValueError: it does not fit the volume, or reaches or spans too far.
    """
    check_window(window)
    d_min, d_max = window
    if max(abs(d_min), abs(d_max)) > MAX_DISPARITY_PX or d_max - d_min > MAX_SPAN_PX:
        raise ValueError(
            f"disparity window {window}: at most {MAX_SPAN_PX} px within {-MAX_DISPARITY_PX} to {MAX_DISPARITY_PX} px"
        )


def widened_window(window: Window, *, planes: int) -> Window:
    """The window widened until both ends are multiples of ``planes`` planes, counted from disparity zero.

    What a volume is halved by then falls on the same planes whatever window was asked for.
    """
    check_window(window)
    span_px = planes * VOLUME_STEP_PX
    return window[0] // span_px * span_px, -(-window[1] // span_px) * span_px


def scaled_window(window: Window, scale: float) -> Window:
    """The narrowest window that holds those disparities at another size of the picture."""
    first, end = (scale * limit / VOLUME_STEP_PX for limit in window)
    return math.floor(first) * VOLUME_STEP_PX, math.ceil(end) * VOLUME_STEP_PX


def within_width(window: Window, width_px: int) -> Window:
    """The part of a window that a picture of this width can show: src has no column farther away.

    Raises:
        InputError: there is none.
    """
    reach_px = -(-width_px // VOLUME_STEP_PX) * VOLUME_STEP_PX
    d_min, d_max = max(window[0], -reach_px), min(window[1], reach_px)
    if d_min >= d_max:
        raise InputError(
            f"disparities of {window[0]} to {window[1]} px are to be searched in pictures {width_px} px wide",
            hint="state another window_px, or take weights of such captures",
        )
    return d_min, d_max


def planes_of(window: Window, *, within: Window) -> slice:
    """The planes of a window among those of a wider one."""
    first = (window[0] - within[0]) // VOLUME_STEP_PX
    return slice(first, first + (window[1] - window[0]) // VOLUME_STEP_PX)


def joined_window(windows: Iterable[Window]) -> Window:
    """The narrowest window that holds every one of some windows."""
    firsts, ends = zip(*windows, strict=True)
    return min(firsts), max(ends)
