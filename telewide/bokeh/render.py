"""Shallow depth of field from one sharp photo and its disparity.

The signed radius of the circle of confusion is ``radius_px = radius_per_px * (d - d_focus)``: positive in front of the
focus plane. Light is averaged in linear light and nothing is clipped; `lens` does the rendering.
Letters: H W image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from telewide.bokeh.aperture import DISK, Aperture
from telewide.bokeh.highlights import with_highlights
from telewide.bokeh.layers import Behind, SortedPhoto
from telewide.bokeh.lens import IN_FOCUS_PX, sort_for_lens, spread_sorted
from telewide.bokeh.subject import OUTLIER_PERCENT
from telewide.bokeh.surroundings import Surroundings
from telewide.bokeh.uncovered import Uncovered
from telewide.cores import usable_cores
from telewide.depth.nearest import fill_unknown
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.srgb import linear_from_srgb, srgb_from_linear

LARGEST_RADIUS_SHARE = 0.1  # of the shorter side: f/1.8 at half a metre stays below
STRIP_ROWS = 128
SAMPLED_PX = 1 << 20  # so many pixels tell how far disparities reach


def render_bokeh(
    image_srgb: FloatImage,
    disparity_px: FloatMap,
    *,
    focus_disparity_px: float,
    radius_per_px: float,
    sharp_px: tuple[float, float] | None = None,
    aperture: Aperture = DISK,
    highlights: float = 1.0,
    around: Surroundings | None = None,
    uncovered: Uncovered | None = None,
) -> FloatImage:
    """Blur a sharp photo as a wide-open lens would, focused at one disparity.

    Radii above a tenth of the shorter side are taken for that tenth.

    Args:
        image_srgb: (H, W, 3) float32, the sharp photo; values above 1 (recovered highlights) are welcome.
        disparity_px: (H, W) float32, px, on the photo; what is not finite is filled from its nearest neighbour.
        focus_disparity_px: the disparity that stays sharp, px.
        radius_per_px: radius of the circle of confusion per px of disparity away from the focus, >= 0.
        sharp_px: farthest and nearest disparity that stay sharp; blur counts from them. None for the focus alone.
        aperture: shape of the opening.
        highlights: how many times as bright as white small clipped lights are taken to have been, >= 1.
        around: what lies beyond the frame; beyond that, or without, the world is mirrored.
        uncovered: what wide shows of what lies hidden; the rest is continued from beside what hides it.

    Returns:
        (H, W, 3) float32, in the range of the input; above it only where highlights are.

    Raises:
        UsageError: focus, radius or highlights are no finite numbers, or below their least.
        InputError: the disparity has another size than the photo, or no known value.
    """
    blur = Blur(focus_disparity_px, radius_per_px, sharp_px, highlights=highlights)
    lit = light_and_radius(image_srgb, disparity_px, blur, around=around, uncovered=uncovered)
    if lit is None:
        return image_srgb.astype(np.float32, copy=True)
    photo = sort_for_lens(*lit)
    del lit  # a third of the memory
    margin_px = 0 if around is None else around.margin_px
    return rendered(photo, aperture=aperture, hw=disparity_px.shape, margin_px=margin_px)


@dataclass(frozen=True)
class Blur:
    """Blur of each disparity, and of what is clipped.

    Attributes:
        focus_disparity_px: the disparity that stays sharp, px.
        radius_per_px: radius of the circle of confusion per px of disparity away from the focus, >= 0.
        sharp_px: farthest and nearest disparity that stay sharp; None for the focus alone.
        highlights: how many times as bright as white small clipped lights are taken to have been, >= 1.
    """

    focus_disparity_px: float
    radius_per_px: float
    sharp_px: tuple[float, float] | None = None
    highlights: float = 1.0


def light_and_radius(
    image_srgb: FloatImage,
    disparity_px: FloatMap,
    blur: Blur,
    *,
    around: Surroundings | None = None,
    uncovered: Uncovered | None = None,
) -> tuple[FloatImage, FloatMap, Behind | None] | None:
    """Make of a photo what a lens needs; the photo itself may be let go.

    Args:
        image_srgb: (H, W, 3) float32, the sharp photo; values above 1 (recovered highlights) are welcome.
        disparity_px: (H, W) float32, px, on the photo; what is not finite is filled from its nearest neighbour.
        blur: of its disparities.
        around: what lies beyond the frame; beyond that, or without, the world is mirrored.
        uncovered: what wide shows of what lies hidden; the rest is continued from beside what hides it.

    Returns:
        Linear light (h, w, 3) and blur radius (h, w), px, the frame in the middle of what lies around, and what is
        known to lie behind them; None where all is sharp.

    Raises:
        UsageError: focus, radius or highlights are no finite numbers, or below their least.
        InputError: the disparity has another size than the photo, or no known value.
    """
    focus_disparity_px, radius_per_px = blur.focus_disparity_px, blur.radius_per_px
    if not (math.isfinite(radius_per_px) and radius_per_px >= 0 and math.isfinite(focus_disparity_px)):
        raise UsageError(
            f"blur of {radius_per_px} px per px at focus {focus_disparity_px} px: both must be finite, the blur >= 0"
        )
    if image_srgb.shape[:2] != disparity_px.shape:
        raise InputError(f"the disparity is {disparity_px.shape}, the photo {image_srgb.shape[:2]}: sizes must agree")
    cap_px = min(disparity_px.shape) * LARGEST_RADIUS_SHARE
    if around is not None:
        image_srgb, disparity_px = around.of(image_srgb), around.of_map(disparity_px)
    radius_px = _radius_px(fill_unknown(disparity_px), blur, cap_px=cap_px)
    if max(-float(radius_px.min()), float(radius_px.max())) <= IN_FOCUS_PX:
        return None
    margin_px = 0 if around is None else around.margin_px
    behind = None if uncovered is None else _behind(uncovered, blur, cap_px=cap_px, margin_px=margin_px)
    lit = with_highlights(_by_strips(linear_from_srgb, image_srgb), image_srgb, times=blur.highlights)
    return lit, radius_px, behind


def _behind(uncovered: Uncovered, blur: Blur, *, cap_px: float, margin_px: int) -> Behind:
    radius_px = _radius_px(uncovered.disparity_px, blur, cap_px=cap_px)
    return Behind(uncovered.y + margin_px, uncovered.x + margin_px, linear_from_srgb(uncovered.colour), radius_px)


def _radius_px(disparity_px: FloatMap, blur: Blur, *, cap_px: float) -> FloatMap:
    radius_px = away_from_focus_px(disparity_px, blur.focus_disparity_px, blur.sharp_px)
    radius_px *= np.float32(blur.radius_per_px)
    return np.clip(radius_px, -cap_px, cap_px, out=radius_px)


def rendered(photo: SortedPhoto, *, aperture: Aperture, hw: tuple[int, ...], margin_px: int) -> FloatImage:
    """Render a sorted photo through a lens.

    Args:
        photo: of :func:`light_and_radius`, sorted.
        aperture: shape of the opening.
        hw: height and width of the frame, px.
        margin_px: of what lies around it, on each side.

    Returns:
        (hw[0], hw[1], 3) float32, sRGB; beyond [0, 1] only where the photo was, or highlights are.
    """
    rows, columns = (slice(margin_px, margin_px + size) for size in hw)
    spread = spread_sorted(photo, aperture=aperture)[rows, columns]
    return _by_strips(srgb_from_linear, spread, out=spread)


def _by_strips(
    convert: Callable[[FloatImage], FloatImage], image: FloatImage, *, out: FloatImage | None = None
) -> FloatImage:
    """Convert values strip by strip, so that what a formula leaves between its steps stays small."""
    converted = np.empty(image.shape, np.float32) if out is None else out

    def convert_some(top: int) -> None:
        converted[top : top + STRIP_ROWS] = convert(image[top : top + STRIP_ROWS])

    with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
        list(pool.map(convert_some, range(0, len(image), STRIP_ROWS)))
    return converted


def away_from_focus_px(
    disparity_px: FloatMap, focus_disparity_px: float, sharp_px: tuple[float, float] | None
) -> FloatMap:
    """Subtract what is sharp: how far each disparity lies before (positive) or behind it, px.

    Args:
        disparity_px: any shape, px.
        focus_disparity_px: the disparity that stays sharp.
        sharp_px: farthest and nearest disparity that stay sharp with it; None for the focus alone.
    """
    far_px, near_px = sharp_px or (focus_disparity_px, focus_disparity_px)
    return np.asarray(disparity_px - np.clip(disparity_px, far_px, near_px), dtype=np.float32)


def radius_per_px_from_strength(
    disparity_px: FloatMap,
    focus_disparity_px: float,
    *,
    strength_px: float,
    sharp_px: tuple[float, float] | None = None,
) -> float:
    """Blur per px of disparity that gives the pixels farthest from the focus a wanted radius.

    Args:
        disparity_px: (H, W) float32, px; the nearest and the farthest 0.5 % are taken for mistakes.
        focus_disparity_px: the disparity that stays sharp, px.
        strength_px: radius of the circle of confusion where ``|d - d_focus|`` is largest, px.
        sharp_px: farthest and nearest disparity that stay sharp with it; None for the focus alone.

    Returns:
        px of radius per px of disparity; 0 where everything is in focus.

    Raises:
        UsageError: the strength is negative or no number.
    """
    if not (math.isfinite(strength_px) and strength_px >= 0):
        raise UsageError(f"bokeh strength {strength_px} px: expected a radius of 0 px or more")
    span_px = largest_step_px(disparity_px, focus_disparity_px, sharp_px=sharp_px)
    return strength_px / span_px if span_px > 0 else 0.0


def largest_step_px(
    disparity_px: FloatMap, focus_disparity_px: float, *, sharp_px: tuple[float, float] | None = None
) -> float:
    """Measure how far from the focus disparities reach, px; the nearest and the farthest 0.5 % are taken for mistakes.

    Args:
        disparity_px: (H, W), px.
        focus_disparity_px: the disparity that stays sharp.
        sharp_px: farthest and nearest disparity that stay sharp with it; None for the focus alone.

    Raises:
        InputError: the map holds no known value.
    """
    step = max(round(math.sqrt(disparity_px.size / SAMPLED_PX)), 1)
    some_px = disparity_px[step // 2 :: step, step // 2 :: step]
    known_px = some_px[np.isfinite(some_px)]
    if len(known_px) == 0:
        known_px = disparity_px[np.isfinite(disparity_px)]
    if len(known_px) == 0:
        raise InputError("the disparity map holds no known value")
    ends_px = np.percentile(known_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT))
    return float(np.abs(away_from_focus_px(ends_px, focus_disparity_px, sharp_px)).max())


def radius_per_px_from_f_number(*, f_number: float, baseline_m: float, equiv_focal_mm: float = 50.0) -> float:
    """Blur per px of disparity of a real aperture: ``r = A / (2 B)`` with ``A = f_equiv / N``.

    The thin lens gives a diameter ``f A |1/z - 1/z_focus|`` and stereo a disparity ``f B / z``, so the focal length of
    the photo cancels.

    Args:
        f_number: of the imitated lens.
        baseline_m: distance of the two lenses, m.
        equiv_focal_mm: focal length of the imitated lens on 35 mm film, mm.

    Raises:
        UsageError: one of them is not a positive number.
    """
    for name, value in (("f-number", f_number), ("baseline", baseline_m), ("focal length", equiv_focal_mm)):
        if not (math.isfinite(value) and value > 0):
            raise UsageError(f"{name} {value}: expected a number above 0")
    aperture_m = equiv_focal_mm / 1000 / f_number
    return aperture_m / (2 * baseline_m)
