"""A disparity map as a person sees it: perceptual colours, a scale with rounded numbers, guesses hatched.

Colours run with disparity (far is blue, near is red), so a scale in metres is not even: its ticks stand where their
disparity is.
Images are (H, W, 3) float32 RGB in [0, 1]. Letters: H W image.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from telewide.depth.result import DepthResult
from telewide.drawing import (
    Tick,
    draw_colour_bar,
    fitted_text,
    fitted_wh,
    hatched,
    image_from_page,
    new_page,
    number_labels,
    painted,
    paste_image,
    rounded_ticks,
    scaled_image,
    scaled_mask,
    text_width_px,
    upright,
    upright_mask,
    write_text,
)
from telewide.geometry.arrays import BoolMap, FloatMap

DISPLAY_PERCENTILES = (1.0, 99.0)
MIN_SPAN_PX = 2.0
"""A flat map is shown flat: a narrower range would paint its noise as depth."""

_STACK_FROM_ASPECT = 1.5  # a photo wider than this has its depth below it, not beside it
_SMALLEST_PANEL_PX = 420
_METRE_MANTISSAS: tuple[tuple[float, ...], ...] = (
    (1, 2, 5),
    (1, 1.5, 2, 3, 5, 7),
    (1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 3.5, 4, 5, 6, 7, 8, 9),
)


def display_range_px(disparity_px: FloatMap, *, valid: BoolMap | None = None) -> tuple[float, float]:
    """Find the range worth showing: 1st to 99th percentile, at least 2 px wide.

    Args:
        disparity_px: (H, W), px; NaN is left out.
        valid: (H, W) bool, measured pixels; where they are too few all known ones count.

    Returns:
        Lowest and highest disparity, px.
    """
    is_known = np.isfinite(disparity_px)
    chosen = is_known if valid is None or (valid & is_known).mean() < 0.05 else valid & is_known
    if not chosen.any():
        return 0.0, MIN_SPAN_PX
    low, high = (float(value) for value in np.percentile(disparity_px[chosen], DISPLAY_PERCENTILES))
    missing = max(0.0, MIN_SPAN_PX - (high - low)) / 2
    return low - missing, high + missing


def colourise(disparity_px: FloatMap, *, range_px: tuple[float, float] | None = None) -> FloatMap:
    """Paint a disparity map: far blue, near red, unknown grey.

    Args:
        disparity_px: (H, W), px; NaN is unknown.
        range_px: disparities of the first and last colour; by default the 1st and 99th percentile.

    Returns:
        (H, W, 3) float32 RGB in [0, 1].
    """
    return painted(disparity_px, value_range=range_px or display_range_px(disparity_px))


def disparity_panel(result: DepthResult, *, wh: tuple[int, int]) -> FloatMap:
    """Paint a result upright at a given size, what was filled in or is unknown hatched.

    Args:
        result: of one capture.
        wh: size of the picture, after it was turned upright.

    Returns:
        (wh[1], wh[0], 3) float32 RGB in [0, 1].
    """
    disparity = result.disparity
    range_px = display_range_px(disparity.disparity_px, valid=disparity.valid)
    colours = upright(colourise(disparity.disparity_px, range_px=range_px), rotated_deg=result.rotated_deg)
    is_measured = upright_mask(disparity.valid & np.isfinite(disparity.disparity_px), rotated_deg=result.rotated_deg)
    return hatched(scaled_image(colours, wh=wh), scaled_mask(~is_measured, wh=wh))


def preview(image: FloatMap, result: DepthResult, *, longest_px: int = 1280) -> FloatMap:
    """Draw the photo and its depth with a labelled scale, in metres where they are known, else in pixels.

    Args:
        image: (H, W, 3) the ref photo, RGB in [0, 1].
        result: of the same capture, of the same size.
        longest_px: longest side of either picture on the page.

    Returns:
        The page, float32 RGB in [0, 1].
    """
    photo = upright(image, rotated_deg=result.rotated_deg)
    photo_wh = (photo.shape[1], photo.shape[0])
    panel_side = min(longest_px, max(_SMALLEST_PANEL_PX, *photo_wh))
    panel_wh = fitted_wh(photo_wh, box_wh=(panel_side, panel_side))
    is_stacked = panel_wh[0] >= _STACK_FROM_ASPECT * panel_wh[1]
    text_px = max(13, min(20, panel_wh[0] // 42))
    pad, gap = text_px, text_px // 2
    foot_height = round(text_px * 4.2)
    depth_xy = (pad, pad + panel_wh[1] + gap) if is_stacked else (pad + panel_wh[0] + gap, pad)
    least_foot = 16 * text_px  # a photo much higher than wide leaves no room for a scale below its panel
    right = max(depth_xy[0] + panel_wh[0], pad + least_foot)
    page = new_page(wh=(right + pad, depth_xy[1] + panel_wh[1] + foot_height))
    paste_image(page, scaled_image(photo, wh=panel_wh), at_xy=(pad, pad))
    paste_image(page, disparity_panel(result, wh=panel_wh), at_xy=depth_xy)

    foot_y = depth_xy[1] + panel_wh[1]
    unit, ticks = scale_ticks(result, n_wanted=max(3, panel_wh[0] // 110))
    unit = "distance, m" if unit == "m" else "disparity, px"
    caption = f"{result.name}   {_measured_text(result)}"
    beside_y = foot_y + round(text_px * 1.1)
    if not is_stacked and panel_wh[0] >= least_foot:
        line = fitted_text(caption, width_px=panel_wh[0], size_px=text_px)
        write_text(page, line, at_xy=(pad, beside_y), size_px=text_px, is_faint=True)
        caption = ""
    bar_left = depth_xy[0]
    if right - bar_left < least_foot:
        bar_left, caption = right - least_foot, ""
    if caption and panel_wh[0] > 3 * text_width_px(caption, size_px=text_px) / 2:
        write_text(page, caption, at_xy=(pad, beside_y), size_px=text_px, is_faint=True)
        bar_left += math.ceil(text_width_px(caption, size_px=text_px)) + 2 * pad
    unit_width = math.ceil(text_width_px(unit, size_px=text_px)) + gap
    bar_wh = (right - bar_left - unit_width, text_px)
    bar_y = foot_y + round(text_px * 0.7)
    draw_colour_bar(page, at_xy=(bar_left, bar_y), wh=bar_wh, table="turbo", ticks=ticks, size_px=text_px)
    write_text(page, unit, at_xy=(right, beside_y), size_px=text_px, anchor="rm")
    return image_from_page(page)


def scale_ticks(result: DepthResult, *, n_wanted: int = 6) -> tuple[str, list[Tick]]:
    """Choose the rounded marks of a result's colour bar.

    Args:
        result: of one capture; its shown range is that of :func:`display_range_px`.
        n_wanted: about how many.

    Returns:
        The unit (``m`` where the depth is known in metres, else ``px``) and the marks from far to near.
    """
    low, high = display_range_px(result.disparity.disparity_px, valid=result.disparity.valid)
    if result.depth_m is None or result.K is None or result.baseline_m is None or high + result.doffs_px <= 0:
        values = rounded_ticks(low, high, n_wanted=n_wanted)
        labels = number_labels(values)
        return "px", [Tick((value - low) / (high - low), label) for value, label in zip(values, labels, strict=True)]
    scale_px_m = float(result.K[0, 0]) * result.baseline_m
    return "m", _metre_ticks(low + result.doffs_px, high + result.doffs_px, scale_px_m=scale_px_m, n_wanted=n_wanted)


def _metre_ticks(low_px: float, high_px: float, *, scale_px_m: float, n_wanted: int) -> list[Tick]:
    """Rounded distances spread over a bar that is even in disparity: the coarsest set that gives enough of them."""
    nearest_m = scale_px_m / high_px
    farthest_m = scale_px_m / low_px if low_px > 0 else math.inf
    ticks: list[Tick] = []
    for mantissas in _METRE_MANTISSAS:
        candidates = _mantissa_values(mantissas, low=nearest_m, high=min(farthest_m, 1000 * nearest_m))
        ticks = _spread(
            [Tick((scale_px_m / z - low_px) / (high_px - low_px), f"{z:.6g}") for z in candidates], n_most=n_wanted + 2
        )
        if len(ticks) >= min(4, n_wanted):
            return ticks
    if math.isfinite(farthest_m):  # a scene so shallow that no such number lies in it: even steps will do
        values = rounded_ticks(nearest_m, farthest_m, n_wanted=n_wanted)
        even = [
            Tick((scale_px_m / z - low_px) / (high_px - low_px), label)
            for z, label in zip(values, number_labels(values), strict=True)
        ]
        ticks = max(ticks, _spread(even, n_most=n_wanted + 2), key=len)
    return ticks


def _mantissa_values(mantissas: Sequence[float], *, low: float, high: float) -> list[float]:
    exponents = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
    values = (mantissa * 10.0**exponent for exponent, mantissa in itertools.product(exponents, mantissas))
    return [value for value in values if low <= value <= high]


def _spread(ticks: Sequence[Tick], *, n_most: int) -> list[Tick]:
    """Keep marks that stand at least ``1 / n_most`` of the bar apart."""
    kept: list[Tick] = []
    for tick in sorted(ticks, key=lambda tick: -tick.position):
        if not kept or kept[-1].position - tick.position >= 1 / n_most:
            kept.append(tick)
    return kept[::-1]


def _measured_text(result: DepthResult) -> str:
    is_measured = result.disparity.valid & np.isfinite(result.disparity.disparity_px)
    guess_share = 1 - float(is_measured.mean())
    return "all measured" if guess_share < 5e-4 else f"hatched: not measured, {guess_share:.0%}"
