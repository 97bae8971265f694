"""Pin depth to a point of known distance: the zero of disparity, or, where that is unknown, the scale.

A lens that shifts along the baseline moves every disparity by the same, and no match shows it; one measured distance
does. A distance is what a tape shows from the phone to the point, along the ray and not along the optical axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from telewide.depth.result import FARTHEST_M
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import RectifiedGeometry
from telewide.points.robust import std_about_median

DISTANCE_STD_SHARE = 0.01
"""Relative standard deviation of a measured distance, unless said otherwise."""
FOCUS_STD_SHARE = 0.1
"""Likewise of the focus that EXIF states: autofocus stops where the picture is sharp enough."""
_WINDOW_SHARE = 0.004
_LEAST_SPREAD_PX = 0.1


@dataclass(frozen=True)
class KnownDistance:
    """A point of the tele photo and how far away it is.

    Attributes:
        x_px: column in the photo, upright.
        y_px: row.
        distance_m: from the phone to the point.
        std_share: standard deviation of the distance over the distance.
        is_focus: whether it is where EXIF says the lens was focused, not what somebody measured.
    """

    x_px: float
    y_px: float
    distance_m: float
    std_share: float = DISTANCE_STD_SHARE
    is_focus: bool = False


@dataclass(frozen=True)
class DistancePin:
    """Pin of a rectified pair to a known distance.

    Attributes:
        doffs_px: ``cx_src - cx_ref`` that makes the point's depth true, px of the rectified views.
        correction_px: how far that is from what the rig said.
        std_px: standard deviation, from the distance's and the spread of disparity around the point.
        seen_px: disparity of the point with the rig's own zero; 0 or less is beyond infinity.
        seen_std_px: spread of disparity around the point.
    """

    doffs_px: float
    correction_px: float
    std_px: float
    seen_px: float = float("nan")
    seen_std_px: float = float("nan")


@dataclass(frozen=True)
class ScalePin:
    """Scale by a known distance.

    Attributes:
        baseline_m: distance of the lenses.
        std_m: its standard deviation.
    """

    baseline_m: float
    std_m: float


def parse_known_distance(text: str) -> KnownDistance:
    """Read ``X,Y,M``: column, row (px of the tele photo) and distance (m).

    Args:
        text: three numbers with commas between them.

    Returns:
        The point.

    Raises:
        UsageError: something else was written, or the distance is not positive or beyond `FARTHEST_M`.
    """
    try:
        x_px, y_px, distance_m = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"a known distance is written X,Y,M: column, row and metres; found {text!r}") from None
    if not (np.isfinite([x_px, y_px, distance_m]).all() and distance_m > 0):
        raise UsageError(f"a known distance needs a place and a positive number of metres, found {text!r}")
    if distance_m > FARTHEST_M:
        raise UsageError(f"a known distance may be {FARTHEST_M:g} m at most, found {text!r}")
    return KnownDistance(x_px, y_px, distance_m)


def focused_at(distance_m: float, *, hw: tuple[int, int]) -> KnownDistance:
    """Take the distance a lens was focused at for that of the photo's middle.

    Args:
        distance_m: as EXIF states it; to be trusted only where the middle was focused on.
        hw: size of the tele photo, px, upright.

    Returns:
        The point at the middle of the tele photo.
    """
    height, width = hw
    return KnownDistance((width - 1) / 2, (height - 1) / 2, distance_m, FOCUS_STD_SHARE, is_focus=True)


def pin_distance(disparity_px: FloatMap, known: KnownDistance, *, geometry: RectifiedGeometry) -> DistancePin:
    """Find the zero of disparity that gives a point its distance.

    ``doffs = f B / z - d`` with ``z = M / |r|``, r the point's ray with z = 1.

    Args:
        disparity_px: (H, W) of the rectified ref, NaN where unknown.
        known: the point.
        geometry: of the pair; of a rig whose scale is known.

    Returns:
        The pin; depth is right with ``dataclasses.replace(geometry, doffs_px=pin.doffs_px)``.

    Raises:
        InputError: the scale is not known, the point is not in the photo, or its disparity is unknown.
    """
    if not geometry.rig.is_scale_known:
        raise InputError(
            "a known distance cannot pin the zero of disparity of a rig without a scale", hint="pin the scale with it"
        )
    d_px, spread_px, length = _disparity_at(disparity_px, known, geometry)
    wanted_px = geometry.f_px * geometry.rig.baseline_m * length / known.distance_m
    std_px = float(np.hypot(spread_px, wanted_px * known.std_share))
    doffs_px = wanted_px - d_px
    return DistancePin(
        doffs_px=doffs_px,
        correction_px=doffs_px - geometry.doffs_px,
        std_px=std_px,
        seen_px=d_px + geometry.doffs_px,
        seen_std_px=spread_px,
    )


def weigh_pin(pin: DistancePin, *, geometry: RectifiedGeometry, lens_shift_std_px: float) -> DistancePin:
    """Put a known distance and the rig together, each by how sure it is (inverse variances).

    A tape is sure enough to decide alone; what EXIF says of the focus may be less sure than the rig is.

    Args:
        pin: what the distance alone says.
        geometry: of the pair, as the rig has it.
        lens_shift_std_px: how far the rig's zero of disparity may be off at this shot, px of the rectified views.

    Returns:
        The pin of both.
    """
    rig_px2, pin_px2 = lens_shift_std_px**2, pin.std_px**2
    correction_px = pin.correction_px * rig_px2 / (rig_px2 + pin_px2)
    std_px = float(np.sqrt(rig_px2 * pin_px2 / (rig_px2 + pin_px2)))
    return replace(pin, doffs_px=geometry.doffs_px + correction_px, correction_px=correction_px, std_px=std_px)


def pin_scale(
    disparity_px: FloatMap, known: KnownDistance, *, geometry: RectifiedGeometry, lens_shift_std_px: float = 0.0
) -> ScalePin:
    """Find the length of the baseline that gives a point its distance, the zero of disparity being right.

    ``B = (d + doffs) M / (|r| f)``; its deviation is that of the distance and of ``d + doffs``.

    Args:
        disparity_px: (H, W) of the rectified ref, NaN where unknown.
        known: the point.
        geometry: of the pair; its own scale does not count.
        lens_shift_std_px: how far the zero of disparity may be off at this shot, px of the rectified views.

    Returns:
        The baseline.

    Raises:
        InputError: the point is not in the photo, its disparity is unknown, or it lies behind the cameras.
    """
    d_px, spread_px, length = _disparity_at(disparity_px, known, geometry)
    d_px += geometry.doffs_px
    if d_px <= 0:
        raise InputError(f"the point {known.x_px:g}, {known.y_px:g} is seen at infinity or beyond: it pins no scale")
    baseline_m = float(d_px * known.distance_m / length / geometry.f_px)
    off_share = np.hypot(spread_px, lens_shift_std_px) / d_px
    return ScalePin(baseline_m, float(baseline_m * np.hypot(known.std_share, off_share)))


def _disparity_at(
    disparity_px: FloatMap, known: KnownDistance, geometry: RectifiedGeometry
) -> tuple[float, float, float]:
    """Median disparity around the point, its robust spread, and the length of the point's ray with z = 1."""
    height, width = geometry.rig.tele.hw
    place = f"the point {known.x_px:g}, {known.y_px:g}"
    if not (0 <= known.x_px <= width - 1 and 0 <= known.y_px <= height - 1):
        raise InputError(f"{place} is not in the tele photo of {width} x {height} px")
    at_px = geometry.ref_from_tele(np.array([[known.x_px, known.y_px]]))[0]
    column, row = (int(value) for value in np.round(at_px))
    reach = max(1, round(_WINDOW_SHARE * disparity_px.shape[1]))
    window = disparity_px[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    seen = window[np.isfinite(window)].astype(np.float64)
    if not len(seen):
        raise InputError(f"{place} has no disparity", hint="choose a point with texture, away from edges")
    median_px = float(np.median(seen))
    spread_px = max(_LEAST_SPREAD_PX, float(std_about_median(seen)))
    ray = np.append((at_px - geometry.ref_centre_px) / geometry.f_px, 1.0)
    return median_px, spread_px, float(np.linalg.norm(ray))
