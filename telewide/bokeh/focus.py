"""Focus of a picture: a point, a distance, the nearest or the farthest surface, or the subject in the middle.

A surface is what lies within a slab of disparity; everything but a point is found from confident pixels alone.
Letters: H W image.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from telewide.bokeh.things import nearest_thing
from telewide.depth.edges import nearest_known
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap

FOCUS_WORDS = ("auto", "near", "far")
AF_WORD = "af"
"""The place that the photo's EXIF names; `named_focus` turns it into a point."""
OUTLIER_PERCENT = 0.5  # of the pixels at either end, whose disparity is taken for a mistake
CONFIDENT = 0.5
POINT_WINDOW_PX = 2
SAME_SURFACE_PX = 1.0
SLAB_SHARE, SLAB_MIN_PX = 0.1, 1.0
"""Thickness of the surface that "auto" looks for: a share of the scene's disparities, and at least so many px."""
SUBJECT_SHARE = 0.12
"""A surface that fills so much of the middle is large enough to be the subject."""
SUBJECT_ENDS = 0.02
"""Of the subject, at either end of its depth, that may be blurred: mistakes."""
_SLAB_STEPS = 8
_SAMPLED_PX = 1 << 20
_MIDDLE = 12
"""The middle fades out from the centre as ``exp(-12 r^2)``, r from 0 to 1 at the sides: about their inner half."""


@dataclass(frozen=True)
class Focus:
    """The place that is sharp.

    Attributes:
        disparity_px: of the plane of focus.
        x_px: column of the point of that plane nearest to where it was looked for.
        y_px: its row.
        sharp_px: farthest and nearest disparity that are sharp with it: a subject in its depth; None for the plane.
        is_on_surface: whether that point lies on the plane; else nothing does, and it is the nearest to it in depth.
    """

    disparity_px: float
    x_px: int
    y_px: int
    sharp_px: tuple[float, float] | None = None
    is_on_surface: bool = True


def find_focus(
    disparity_px: FloatMap,
    confidence: FloatMap,
    *,
    focus: str,
    disparity_at_m: Callable[[float], float] | None = None,
) -> Focus:
    """Find what to focus on.

    Args:
        disparity_px: (H, W) float32, px, on the tele photo.
        confidence: (H, W) float32 in [0, 1].
        focus: "X,Y", a point of the tele photo in px; "2.5m", a distance along the optical axis; "near" or "far", the
            nearest or farthest confident surface; "auto", the nearest surface that fills an eighth of the middle of the
            photo, or else its largest one, unless a large thing stands before it; sharp in its whole depth.
        disparity_at_m: tells the disparity at a distance, px; None where metres are not known.

    Returns:
        The plane of focus, and a point that lies on it.

    Raises:
        UsageError: the focus is none of these, a point outside the photo, or a distance where metres are not known.
        InputError: the map holds no known value.
    """
    known = np.isfinite(disparity_px)
    if not known.any():
        raise InputError("the disparity map holds no known value")
    distance_m = named_distance_m(focus)
    if _word(focus) == AF_WORD:
        raise UsageError(f"focus {focus!r}: a map holds no EXIF", hint="name a point, near, far or auto")
    if distance_m is not None and disparity_at_m is None:
        raise UsageError(f"focus {focus!r}: metres are not known of this shot", hint="name a point, near, far or auto")
    point_xy = named_point(focus, hw=disparity_px.shape) if distance_m is None else None
    if point_xy is not None:
        return _at_point(disparity_px, known, point_xy)
    trusted = known & (confidence >= CONFIDENT)
    if not trusted.any():
        trusted = known
    if distance_m is not None and disparity_at_m is not None:
        placed = _placed(disparity_px, trusted, disparity_at_m(distance_m))
        off_px = abs(float(disparity_px[placed.y_px, placed.x_px]) - placed.disparity_px)
        return replace(placed, is_on_surface=off_px <= SAME_SURFACE_PX)
    if _word(focus) == "auto":
        return _on_subject(disparity_px, trusted, confidence)
    percent = 100 - OUTLIER_PERCENT if _word(focus) == "near" else OUTLIER_PERCENT
    return _placed(disparity_px, trusted, float(np.percentile(disparity_px[trusted], percent)))


def named_distance_m(focus: str) -> float | None:
    """Distance that a focus names, such as "2.5m"; None where it names none.

    Args:
        focus: as in :func:`find_focus`.

    Raises:
        UsageError: the distance is not above 0.
    """
    found = re.fullmatch(r"(\d*\.?\d+|\d+\.)\s*m", _word(focus))
    if found is None:
        return None
    distance_m = float(found[1])
    if not (math.isfinite(distance_m) and distance_m > 0):
        raise UsageError(f"focus {focus!r}: a distance above 0 m was expected")
    return distance_m


def named_point(focus: str, *, hw: tuple[int, int] | None) -> tuple[int, int] | None:
    """Column and row of the tele photo that a focus names; None for a word or a distance.

    Args:
        focus: as in :func:`find_focus`.
        hw: height and width of the photo, px; None where they are not known, and any point will do.

    Raises:
        UsageError: the focus is none of these, or a point outside the photo.
    """
    if _word(focus) in (*FOCUS_WORDS, AF_WORD) or named_distance_m(focus) is not None:
        return None
    try:
        x, y = (float(part) for part in focus.split(","))
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
    except (ValueError, OverflowError):  # also of nan and inf
        raise UsageError(
            f"focus {focus!r}: expected X,Y in pixels of the tele photo, a distance such as 2.5m, or one of "
            f"{', '.join((*FOCUS_WORDS, AF_WORD))}"
        ) from None
    if hw is not None and not (-0.5 <= x < hw[1] - 0.5 and -0.5 <= y < hw[0] - 0.5):
        raise UsageError(
            f"focus {focus!r} lies outside the tele photo of {hw[1]} x {hw[0]} px",
            hint=f"x runs from 0 to {hw[1] - 1}, y from 0 to {hw[0] - 1}",
        )
    return column, row


def named_focus(focus: str, subject_uv: tuple[float, float] | None, *, hw: tuple[int, int]) -> str:
    """Turn "af" into the point that EXIF names, or into "auto" where it names none; another focus stays as it is.

    Args:
        focus: as in :func:`find_focus`, or "af".
        subject_uv: the place that was focused on, as shares of the photo's width and height; None where nothing says.
        hw: height and width of the photo, px.
    """
    if _word(focus) != AF_WORD:
        return focus
    return "auto" if subject_uv is None else f"{subject_uv[0] * hw[1] - 0.5:.1f},{subject_uv[1] * hw[0] - 0.5:.1f}"


def _word(focus: str) -> str:
    return focus.strip().lower()


def _at_point(disparity_px: FloatMap, known: BoolMap, point_xy: tuple[int, int]) -> Focus:
    """Median over the surface that a point lies on, so that neither one bad pixel nor a near edge moves it."""
    x, y = point_xy
    if not known[y, x]:
        y, x = (int(v) for v in np.unravel_index(nearest_known(known)[1][y, x], known.shape))
    rows, columns = (slice(max(v - POINT_WINDOW_PX, 0), v + POINT_WINDOW_PX + 1) for v in (y, x))
    around_px = disparity_px[rows, columns]
    return Focus(float(np.median(around_px[np.abs(around_px - disparity_px[y, x]) <= SAME_SURFACE_PX])), x, y)


def _placed(disparity_px: FloatMap, trusted: BoolMap, focus_px: float) -> Focus:
    """The point nearest to the middle of the photo that is as sharp as any."""
    off_px = np.where(trusted, np.abs(disparity_px - focus_px), np.inf)
    is_sharp = off_px <= max(SAME_SURFACE_PX / 4, float(off_px.min()))
    height, width = disparity_px.shape
    rows, columns = np.nonzero(is_sharp)
    nearest = int(np.argmin((rows - (height - 1) / 2) ** 2 + (columns - (width - 1) / 2) ** 2))
    return Focus(focus_px, int(columns[nearest]), int(rows[nearest]))


def _on_subject(disparity_px: FloatMap, trusted: BoolMap, confidence: FloatMap) -> Focus:
    """Nearest slab that holds enough of the middle of the photo, or the fullest, unless a thing stands before it."""
    whole_px, all_trusted = disparity_px, trusted
    step = max(round(math.sqrt(disparity_px.size / _SAMPLED_PX)), 1)
    sampled = (slice(step // 2, None, step), slice(step // 2, None, step))
    disparity_px, trusted, confidence = disparity_px[sampled], trusted[sampled], confidence[sampled]
    if not trusted.any():
        disparity_px, trusted, confidence = whole_px, all_trusted, np.ones(whole_px.shape, np.float32)
    weight = np.where(trusted, np.maximum(confidence, 1e-3), 0)
    height, width = disparity_px.shape
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)[None]
    central = weight * np.exp(-_MIDDLE * (x**2 + y**2))
    value_px, share = disparity_px[weight > 0].astype(np.float64), central[weight > 0].astype(np.float64)
    far_px, near_px = np.percentile(value_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT))
    inside = (value_px >= far_px) & (value_px <= near_px)
    value_px, share = value_px[inside], share[inside]
    slab_px = max(SLAB_SHARE * (near_px - far_px), SLAB_MIN_PX)
    start_px = _nearest_slab(value_px - far_px, share / share.sum(), slab_px=slab_px) + far_px
    in_slab = (value_px >= start_px) & (value_px <= start_px + slab_px)
    farthest_px, middle_px, nearest_px = _weighted_quantiles(
        value_px[in_slab], share[in_slab], quantiles=(SUBJECT_ENDS, 0.5, 1 - SUBJECT_ENDS)
    )
    thing = nearest_thing(disparity_px, weight, before_px=nearest_px, slab_px=slab_px)
    if thing is not None:
        beyond = trusted[thing] & (disparity_px[thing] > nearest_px)
        farthest_px, middle_px, nearest_px = _of_thing(disparity_px[thing][beyond].astype(np.float64), slab_px=slab_px)
        rows, columns = (slice(side.start * step, side.stop * step) for side in thing)
        there = np.zeros_like(all_trusted)
        there[rows, columns] = all_trusted[rows, columns]
        all_trusted = there
    return replace(_placed(whole_px, all_trusted, middle_px), sharp_px=(farthest_px, nearest_px))


def _of_thing(value_px: FloatArray, *, slab_px: float) -> list[float]:
    """Farthest, middle and nearest disparity of a thing, by the fullest slab of its box."""
    ordered_px = np.sort(value_px)
    held = np.searchsorted(ordered_px, ordered_px + slab_px, side="right") - np.arange(len(ordered_px))
    first = int(held.argmax())
    own_px = ordered_px[first : first + int(held[first])]
    return _weighted_quantiles(own_px, np.ones(len(own_px)), quantiles=(SUBJECT_ENDS, 0.5, 1 - SUBJECT_ENDS))


def _nearest_slab(value_px: FloatArray, share: FloatArray, *, slab_px: float) -> float:
    """Far side of the slab of :func:`_on_subject`."""
    step_px = slab_px / _SLAB_STEPS
    histogram = np.bincount((value_px / step_px).astype(np.int64), weights=share)
    held = np.convolve(histogram, np.ones(_SLAB_STEPS))[_SLAB_STEPS - 1 :]  # by slab, named by its farthest step
    large = np.flatnonzero(held >= SUBJECT_SHARE)
    first = int(large[-1]) if len(large) else int(held.argmax())
    nearest = first
    while len(large) and first > max(nearest - _SLAB_STEPS, 0) and held[first - 1] > held[first]:
        first -= 1  # the whole surface, not its near side alone; but no other one, at the far end of the ground
    return first * step_px


def _weighted_quantiles(values: FloatArray, weights: FloatArray, *, quantiles: tuple[float, ...]) -> list[float]:
    order = np.argsort(values)
    passed = np.cumsum(weights[order])
    return [float(values[order][np.searchsorted(passed, share * passed[-1])]) for share in quantiles]
