"""Precision of a capture's metres, in words: how far away something is, how sure that is, and what pinned it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from telewide.depth.pin import DistancePin, KnownDistance, pin_distance, pin_scale, weigh_pin
from telewide.depth.precision import DepthPrecision, depth_std_m
from telewide.depth.result import DepthResult
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import RectifiedGeometry

ALL_NEGATIVE = "of its disparities are negative"
"""Note of :func:`without_depth_behind` on disparities without metres."""
BEHIND_SHARE = 0.9
"""Where so much of a photo has a negative disparity, the lenses rather stand the other way round."""
HARDLY_KNOWN_SHARE = 0.5
"""A depth whose standard deviation is a larger share of it is hardly known."""
MEANINGLESS_SHARE = 1.0
"""A depth whose standard deviation is a larger share of it means nothing."""


CONTRADICTING_STDS = 4.0
"""A known distance that is farther from what the rig said is more likely a slip."""


@dataclass(frozen=True)
class PinnedShot:
    """A shot as a known distance leaves it.

    Attributes:
        geometry: with the zero of disparity, or the baseline, that makes the distance true.
        precision: likewise.
        notes: one sentence on what changed.
    """

    geometry: RectifiedGeometry
    precision: DepthPrecision
    notes: tuple[str, ...] = ()


def pinned_shot(
    name: str,
    disparity_px: FloatMap,
    known: KnownDistance | None,
    *,
    geometry: RectifiedGeometry,
    precision: DepthPrecision,
) -> PinnedShot:
    """Pin a shot's zero of disparity, or its scale where the rig knows none, to a known distance, and say what it did.

    Args:
        name: of the capture.
        disparity_px: (H, W) of the rectified ref, NaN where unknown.
        known: the point; None leaves the shot as it is.
        geometry: of the pair, as the rig has it.
        precision: likewise.

    Raises:
        InputError: the point is not in the photo, its disparity is unknown, or it pins nothing.
    """
    if known is None:
        return PinnedShot(geometry, precision)
    place = f"x {known.x_px:.0f}, y {known.y_px:.0f}"
    source = "EXIF's distance of the focus" if known.is_focus else "as stated"
    taken = f"{name}: {place} is taken to be {known.distance_m:.2f} m away, {source}"
    shift_px = precision.lens_shift_std_px * geometry.scale
    if not geometry.rig.is_scale_known:
        scale = pin_scale(disparity_px, known, geometry=geometry, lens_shift_std_px=shift_px)
        told = f"{taken}; the rig alone knew no metres, so its lenses are {scale.baseline_m * 1e3:.2f} mm apart"
        return PinnedShot(
            replace(geometry, rig=geometry.rig.with_baseline(scale.baseline_m)),
            replace(precision, baseline_std_m=scale.std_m),
            (f"{told} (± {scale.std_m * 1e3:.2g} mm)",),
        )
    alone = pin_distance(disparity_px, known, geometry=geometry)
    pin = weigh_pin(alone, geometry=geometry, lens_shift_std_px=shift_px)
    by_rig = _rig_words(alone, known, geometry=geometry, precision=precision)
    moved = f"the zero of disparity moved by {pin.correction_px / geometry.scale:+.1f} px of the tele photo"
    n_std = abs(alone.correction_px) / math.hypot(alone.std_px, shift_px)
    contradicts = (
        f"{name}: that contradicts the rig by {n_std:.0f} standard deviations: check the point and the distance"
    )
    return PinnedShot(
        replace(geometry, doffs_px=pin.doffs_px),
        replace(precision, lens_shift_std_px=pin.std_px / geometry.scale),
        (f"{taken}; the rig alone said {by_rig}; {moved}", *((contradicts,) if n_std > CONTRADICTING_STDS else ())),
    )


def hardly_known_notes(result: DepthResult) -> tuple[str, ...]:
    """Say where most of a capture's depths are hardly known, and what would help; empty where they are known."""
    share = _typical_std_share(result)
    if share is None or not share > HARDLY_KNOWN_SHARE:
        return ()
    return (
        f"{result.name}: its depth in metres is hardly known: one standard deviation is {share:.0%} of the "
        "depth (median); a measured point (`distance` X,Y,M) or a rig from photos of a board would tell more",
    )


def without_unknown_std(result: DepthResult, *, precision: DepthPrecision) -> tuple[DepthResult, tuple[str, ...]]:
    """Take the standard deviation away where nothing tells how sure the matches are, and say so.

    Args:
        result: of a shot with a rig.
        precision: of that shot.
    """
    if precision.confidence_std is not None or result.depth_std_m is None:
        return result, ()
    told = (
        f"{result.name}: no depth_std_m: how sure this network is of a disparity was never measured; `method` sgm "
        "states it"
    )
    return replace(result, depth_std_m=None), (told,)


def without_meaningless_metres(result: DepthResult) -> tuple[DepthResult, str | None]:
    """Take metres away that mean nothing: those of which one standard deviation is more than the depth itself.

    Args:
        result: of a shot with a rig.

    Returns:
        The result, without metres where most of them mean nothing; and what to say of that, None where they stay.
    """
    share = _typical_std_share(result)
    if share is None or share <= MEANINGLESS_SHARE:
        return result, None
    told = (
        f"{result.name}: no depth in metres: the rig and this shot leave it so unsure that one standard deviation is "
        "more than the depth itself; disparity and bokeh are as good as ever. A measured point (`distance` X,Y,M) or a "
        "rig from photos of a board gives metres"
    )
    return replace(result, depth_m=None, depth_std_m=None), told


def without_depth_behind(result: DepthResult, *, has_rig: bool) -> tuple[DepthResult, str | None]:
    """Take metres away where most of them would lie behind the cameras, and say so of disparities that look like it.

    Args:
        result: of one capture.
        has_rig: whether a rig says where the lenses stand; otherwise the photos were rectified when they came.

    Returns:
        The result, without such metres; and what to say of it, None where all is well.
    """
    disparity_px = result.disparity.disparity_px
    is_known = np.isfinite(disparity_px)
    share = float((disparity_px[is_known] + result.doffs_px < 0).mean()) if is_known.any() else 0.0
    if share < BEHIND_SHARE:
        return result, None
    side = (
        "if the phone was held otherwise than for the calibration, near and far are exchanged: photograph as you "
        "calibrated; if all of it is far away, a measured point (`distance` X,Y,M) helps"
        if has_rig
        else "near and far are exchanged: state wide_side: left in captures.yaml if wide stands to the left of tele, "
        "or exchange the two photos if they are swapped"
    )
    if result.depth_m is None:
        return result, f"{result.name}: {share:.0%} {ALL_NEGATIVE}; {side}"
    else_px = "" if has_rig else "state doffs_px, or "
    told = f"{result.name}: no depth in metres: {share:.0%} of it would lie behind the cameras; {else_px}{side}"
    return replace(result, depth_m=None, depth_std_m=None), told


def _typical_std_share(result: DepthResult) -> float | None:
    """Median of the standard deviation over the depth; None without metres."""
    if result.depth_m is None or result.depth_std_m is None:
        return None
    is_known = np.isfinite(result.depth_m)
    return float(np.median(result.depth_std_m[is_known] / result.depth_m[is_known])) if is_known.any() else None


def away_words(depth_m: float, std_m: float | None) -> str:
    """Say how far away something is, with one standard deviation where it is known: "0.79 ± 0.05 m away"."""
    if std_m is not None and not std_m <= HARDLY_KNOWN_SHARE * depth_m:
        return "at a distance the rig hardly knows; `distance` X,Y,M would tell"
    return f"{_metres(depth_m, std_m)} away"


def _rig_words(
    alone: DistancePin, known: KnownDistance, *, geometry: RectifiedGeometry, precision: DepthPrecision
) -> str:
    """Words for what the rig said of the point: "0.30 ± 0.19 m"."""
    if alone.seen_px <= 0:
        return "that it is beyond infinity"
    distance_m = known.distance_m * (alone.seen_px + alone.correction_px) / alone.seen_px
    std_m = depth_std_m(
        np.full((1, 1), distance_m, np.float32),
        np.full((1, 1), alone.seen_std_px / geometry.scale, np.float32),
        f_px=geometry.rig.tele.f_px,
        baseline_m=geometry.rig.baseline_m,
        precision=precision,
    )
    if float(std_m[0, 0]) > MEANINGLESS_SHARE * distance_m:
        return "that it does not know"
    return _metres(distance_m, float(std_m[0, 0]))


def _metres(depth_m: float, std_m: float | None) -> str:
    return f"{depth_m:.2f} m" if std_m is None else f"{depth_m:.2f} ± {std_m:.2g} m"
