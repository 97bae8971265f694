"""Shallow depth of field from one sharp photo and its disparity.

The signed radius of the circle of confusion is ``radius_px = radius_per_px * (d - d_focus)``: positive in front of the
focus plane. Light is averaged in linear light and nothing is clipped; `lens` does the rendering.
Letters: H W image.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from telewide.errors import InputError, UsageError
from telewide.geometry.stereo import BoolMap, FloatMap
from telewide.output.edges import fill_unknown, nearest_known
from telewide.output.lens import IN_FOCUS_PX, spread_light
from telewide.srgb import linear_from_srgb, srgb_from_linear

FloatImage = NDArray[np.float32]

FOCUS_WORDS = ("auto", "near", "far")
LARGEST_RADIUS_SHARE = 0.25  # of the shorter side; a larger disk leaves no picture
OUTLIER_PERCENT = 0.5  # of the pixels at either end, whose disparity is taken for a mistake
CONFIDENT = 0.5
POINT_WINDOW_PX = 2
SAME_SURFACE_PX = 1.0
MODE_WIDTH_PX = 1.0


def render_bokeh(
    image_srgb: FloatImage, disparity_px: FloatMap, *, focus_disparity_px: float, radius_per_px: float
) -> FloatImage:
    """Blur a sharp photo as a wide-open lens would, focused at one disparity.

    Radii above a quarter of the shorter side are taken for that quarter.

    Args:
        image_srgb: (H, W, 3) float32, the sharp photo; values above 1 (recovered highlights) are welcome.
        disparity_px: (H, W) float32, px, on the photo; what is not finite is filled from its nearest neighbour.
        focus_disparity_px: the disparity that stays sharp, px.
        radius_per_px: radius of the circle of confusion per px of disparity away from the focus, >= 0.

    Returns:
        (H, W, 3) float32, in the range of the input.

    Raises:
        UsageError: focus or radius is not a finite number, or the radius is negative.
        InputError: the disparity has another size than the photo, or no known value.
    """
    if not (math.isfinite(radius_per_px) and radius_per_px >= 0 and math.isfinite(focus_disparity_px)):
        raise UsageError(
            f"blur of {radius_per_px} px per px at focus {focus_disparity_px} px: both must be finite, the blur >= 0"
        )
    if image_srgb.shape[:2] != disparity_px.shape:
        raise InputError(f"the disparity is {disparity_px.shape}, the photo {image_srgb.shape[:2]}: sizes must agree")
    cap_px = min(disparity_px.shape) * LARGEST_RADIUS_SHARE
    radius_px = np.clip((fill_unknown(disparity_px) - focus_disparity_px) * radius_per_px, -cap_px, cap_px)
    radius_px = radius_px.astype(np.float32)
    if float(np.abs(radius_px).max()) <= IN_FOCUS_PX:
        return image_srgb.astype(np.float32, copy=True)
    return srgb_from_linear(spread_light(linear_from_srgb(image_srgb), radius_px))


def radius_per_px_from_strength(disparity_px: FloatMap, focus_disparity_px: float, *, strength_px: float) -> float:
    """Blur per px of disparity that gives the pixels farthest from the focus a wanted radius.

    Args:
        disparity_px: (H, W) float32, px; the nearest and the farthest 0.5 % are taken for mistakes.
        focus_disparity_px: the disparity that stays sharp, px.
        strength_px: radius of the circle of confusion where ``|d - d_focus|`` is largest, px.

    Returns:
        px of radius per px of disparity; 0 where everything is in focus.

    Raises:
        UsageError: the strength is negative or no number.
    """
    if not (math.isfinite(strength_px) and strength_px >= 0):
        raise UsageError(f"bokeh strength {strength_px} px: expected a radius of 0 px or more")
    known_px = disparity_px[np.isfinite(disparity_px)]
    if len(known_px) == 0:
        raise InputError("the disparity map holds no known value")
    ends_px = np.percentile(known_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT))
    span_px = float(np.abs(ends_px - focus_disparity_px).max())
    return strength_px / span_px if span_px > 0 else 0.0


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


def focus_disparity(disparity_px: FloatMap, confidence: FloatMap, *, focus: str) -> float:
    """Disparity to focus on.

    Args:
        disparity_px: (H, W) float32, px, on the tele photo.
        confidence: (H, W) float32 in [0, 1].
        focus: "X,Y", a point of the tele photo in px; "near" or "far", the nearest or farthest confident surface;
            "auto", the most common confident disparity of the middle of the photo, nearer ones preferred.

    Returns:
        Disparity, px.

    Raises:
        UsageError: the focus is none of these, or a point outside the photo.
        InputError: the map holds no known value.
    """
    known = np.isfinite(disparity_px)
    if not known.any():
        raise InputError("the disparity map holds no known value")
    word = focus.strip().lower()
    if word not in FOCUS_WORDS:
        return _at_point(disparity_px, known, _parsed_point(focus, hw=disparity_px.shape))
    trusted = known & (confidence >= CONFIDENT)
    if not trusted.any():
        trusted = known
    if word == "auto":
        return _subject_disparity(disparity_px, np.where(trusted, np.maximum(confidence, 1e-3), 0))
    percent = 100 - OUTLIER_PERCENT if word == "near" else OUTLIER_PERCENT
    return float(np.percentile(disparity_px[trusted], percent))


def _parsed_point(focus: str, *, hw: tuple[int, int]) -> tuple[int, int]:
    """Column and row named by "X,Y"."""
    try:
        x, y = (float(part) for part in focus.split(","))
    except ValueError:
        raise UsageError(
            f"focus {focus!r}: expected X,Y in pixels of the tele photo, or one of {', '.join(FOCUS_WORDS)}"
        ) from None
    if not (-0.5 <= x < hw[1] - 0.5 and -0.5 <= y < hw[0] - 0.5):
        raise UsageError(
            f"focus {focus!r} lies outside the tele photo of {hw[1]} x {hw[0]} px",
            hint=f"x runs from 0 to {hw[1] - 1}, y from 0 to {hw[0] - 1}",
        )
    return math.floor(x + 0.5), math.floor(y + 0.5)


def _at_point(disparity_px: FloatMap, known: BoolMap, point_xy: tuple[int, int]) -> float:
    """Median over the surface that a point lies on, so that neither one bad pixel nor a near edge moves it."""
    x, y = point_xy
    if not known[y, x]:
        y, x = np.unravel_index(nearest_known(known)[1][y, x], known.shape)
    rows, columns = (slice(max(v - POINT_WINDOW_PX, 0), v + POINT_WINDOW_PX + 1) for v in (int(y), int(x)))
    around_px = disparity_px[rows, columns]
    return float(np.median(around_px[np.abs(around_px - disparity_px[y, x]) <= SAME_SURFACE_PX]))


def _subject_disparity(disparity_px: FloatMap, weight: FloatMap) -> float:
    """Robust mode of the middle of the photo; the nearest surface counts three times as much as the farthest."""
    height, width = disparity_px.shape
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)[None]
    central = weight * np.exp(-4 * (x**2 + y**2))
    value_px, share = disparity_px[weight > 0].astype(np.float64), central[weight > 0]
    far_px, near_px = np.percentile(value_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT))
    inside = (value_px >= far_px) & (value_px <= near_px)
    value_px, share = value_px[inside], share[inside]
    share = share * (1 + 2 * (value_px - far_px) / max(near_px - far_px, 1e-6))
    step_px = MODE_WIDTH_PX / 4
    slot = np.floor((value_px - far_px) / step_px).astype(np.int64)
    histogram = np.bincount(slot, weights=share, minlength=7)
    peak = int(np.convolve(histogram, (1, 2, 3, 4, 3, 2, 1), mode="same").argmax())
    peak_px = far_px + (peak + 0.5) * step_px
    return float(np.median(value_px[np.abs(value_px - peak_px) <= MODE_WIDTH_PX]))
