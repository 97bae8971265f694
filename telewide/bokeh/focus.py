"""Focus of a picture: a point, a distance, the nearest or the farthest surface, or the subject in the middle.

Everything but a point is found from confident pixels alone; the subject as :mod:`telewide.bokeh.subject` says.
Letters: H W image.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from telewide.bokeh.subject import OUTLIER_PERCENT, find_subject
from telewide.depth.nearest import nearest_known
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import BoolMap, FloatMap

FOCUS_WORDS = ("auto", "near", "far")
AF_WORD = "af"
"""The place that the photo's EXIF names; `named_focus` turns it into a point."""
CONFIDENT = 0.5
POINT_WINDOW_PX = 2
MOST_LIKELY_M = 10.0  # a larger number without a unit may be centimetres
SAME_SURFACE_PX = 1.0
_DISTANCE = re.compile(r"(\d*\.?\d+|\d+\.)\s*(c?)m")


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
    valid: BoolMap | None = None,
) -> Focus:
    """Find what to focus on.

    Args:
        disparity_px: (H, W) float32, px, on the tele photo.
        confidence: (H, W) float32 in [0, 1].
        focus: "X,Y", a point of the tele photo in px; "2.5m" or "80cm", a distance along the optical axis; "near" or
            "far", the nearest or farthest confident surface; "auto", the subject, sharp in its whole depth.
        disparity_at_m: tells the disparity at a distance, px; None where metres are not known.
        valid: (H, W) bool, what was measured, on which "near", "far" and a distance are looked for; None for all.

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
    if _word(focus) == "auto":
        return _on_subject(disparity_px, trusted, confidence)
    if valid is not None and (trusted & valid).any():
        trusted = trusted & valid
    if distance_m is not None and disparity_at_m is not None:
        placed = _placed(disparity_px, trusted, disparity_at_m(distance_m))
        off_px = abs(float(disparity_px[placed.y_px, placed.x_px]) - placed.disparity_px)
        return replace(placed, is_on_surface=off_px <= SAME_SURFACE_PX)
    percent = 100 - OUTLIER_PERCENT if _word(focus) == "near" else OUTLIER_PERCENT
    return _placed(disparity_px, trusted, float(np.percentile(disparity_px[trusted], percent)))


def named_distance_m(focus: str) -> float | None:
    """Distance that a focus names, such as "2.5m" or "80cm"; None where it names none.

    Args:
        focus: as in :func:`find_focus`.

    Raises:
        UsageError: the distance is not above 0.
    """
    found = _DISTANCE.fullmatch(_word(focus))
    if found is None:
        return None
    distance_m = float(found[1]) / (100 if found[2] else 1)
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
            f"focus {focus!r}: expected X,Y in pixels of the tele photo, a distance such as 2.5m or 80cm, or one of "
            f"{', '.join((*FOCUS_WORDS, AF_WORD))}",
            hint=_perhaps_meant(_word(focus)),
        ) from None
    if hw is not None and not (-0.5 <= x < hw[1] - 0.5 and -0.5 <= y < hw[0] - 0.5):
        raise UsageError(
            f"focus {focus!r} lies outside the tele photo of {hw[1]} x {hw[0]} px",
            hint=f"x runs from 0 to {hw[1] - 1}, y from 0 to {hw[0] - 1}",
        )
    return column, row


def _perhaps_meant(word: str) -> str | None:
    """Guess the distance that a word without a unit, or with a decimal comma, was meant to be."""
    dotted = word.replace(",", ".")
    if _DISTANCE.fullmatch(dotted):
        return f"did you mean {dotted}?"
    if not _DISTANCE.fullmatch(f"{dotted}m"):
        return None
    return f"did you mean {dotted}m?" if float(dotted) < MOST_LIKELY_M else f"did you mean {dotted}cm, or {dotted}m?"


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
    """The middle of the subject's depth, all of which is sharp."""
    subject = find_subject(disparity_px, trusted, confidence)
    placed = _placed(disparity_px, subject.trusted, subject.middle_px)
    return replace(placed, sharp_px=(subject.farthest_px, subject.nearest_px))
