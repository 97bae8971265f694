"""Precision of a depth in metres, from what is known of the disparity, the rig and this shot.

``z = f B / d`` with ``d`` the disparity, in px of a map without doffs (or ``disparity_px + doffs_px``). With
independent errors (standard deviations s), to first order but for that of d, which is taken to the next order of
``1 / d``: where the zero of disparity is unsure, s_d is no longer small against d, and a depth that comes out far too
near would call itself sure.

    s_z^2 = z^2 ((s_B / B)^2 + (s_f / f)^2 + r^2 (1 + 8 r^2)),  r = s_d / d,  s_d^2 = s_match^2 + s_shift^2

`s_match` differs from pixel to pixel. `s_shift` is that of the lens's movement along the baseline, which moves every
disparity of a shot alike and which no epipolar line shows, and of the rig's zero of disparity where it was made without
a board; with `s_B` and `s_f` it does not average out over pixels.
Near things are known best: what a pixel of disparity is worth grows with z^2.
Letters: H W image; N shots.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.matcher import SEMIGLOBAL_STD, ConfidenceStd
from telewide.points.robust import std_about_zero

FILLED_STD_PX = 9.0
"""Standard deviation of a disparity that was not measured but filled in from beside it, px of the views matched."""
USUAL_SHIFT_SHARE = 0.58 / 1280
"""Spread of the offsets of a phone's shots, of the photo's width: measured over 30 pairs of one model."""
_USUAL_WEIGHT = 3.0  # as many shots the usual spread counts for


@dataclass(frozen=True)
class DepthPrecision:
    """Deviations that all depths of one shot share; the default is an exact rig that nothing moved.

    Attributes:
        baseline_std_m: of the distance of the lenses.
        f_std_px: of tele's focal length, px of the tele photo.
        lens_shift_std_px: of what shifts all disparities alike, px of the tele photo: the movement of the lenses along
            the baseline, and what the rig does not know of the zero of disparity.
        confidence_std: what the matcher's confidence says of a disparity; None where that was never measured.
    """

    baseline_std_m: float = 0.0
    f_std_px: float = 0.0
    lens_shift_std_px: float = 0.0
    confidence_std: ConfidenceStd | None = SEMIGLOBAL_STD


def disparity_std_px(disparity: DisparityMap, *, of: ConfidenceStd, scale: float = 1.0) -> FloatMap:
    """Standard deviation of matched disparities, by their confidence.

    ``s = sure^c unsure^(1 - c)`` of the confidence c, and FILLED where the value was not measured.

    Args:
        disparity: (H, W) maps.
        of: what full and no confidence mean.
        scale: px of the views that were matched for one px of these maps, at most 1 where they were matched smaller.

    Returns:
        (H, W) float32, px of the map.
    """
    confidence = np.clip(np.nan_to_num(disparity.confidence, nan=0.0), 0, 1)
    measured_px = of.unsure_px * (of.sure_px / of.unsure_px) ** confidence
    return np.asarray(np.where(disparity.valid, measured_px, FILLED_STD_PX) / scale, dtype=np.float32)


def depth_std_m(
    depth_m: FloatMap, match_std_px: FloatMap, *, f_px: float, baseline_m: float, precision: DepthPrecision
) -> FloatMap:
    """Standard deviation of every depth; the formula heads this module.

    Args:
        depth_m: (H, W) m, NaN where unknown.
        match_std_px: (H, W) standard deviation of the disparity, px of the map.
        f_px: focal length of the map, px.
        baseline_m: distance of the lenses.
        precision: what all depths of the shot share.

    Returns:
        (H, W) float32, m; NaN where the depth is unknown.
    """
    z_m = depth_m.astype(np.float64)
    common = (precision.baseline_std_m / baseline_m) ** 2 + (precision.f_std_px / f_px) ** 2
    disparity_px = f_px * baseline_m / z_m
    relative2 = (match_std_px.astype(np.float64) ** 2 + precision.lens_shift_std_px**2) / disparity_px**2
    return (z_m * np.sqrt(common + relative2 * (1 + 8 * relative2))).astype(np.float32)


def lens_shift_std_share(vertical_offset_shares: Sequence[float]) -> float:
    """Spread of the lens's movement along the baseline, from what is seen of it across the baseline.

    Stabilisation moves a lens in the picture plane, no direction before the other, away from where it stood for the
    calibration. So the offsets count from 0, not from their mean, and their median size times 1.4826 is not drawn out
    by a single bad shot. Few shots are pooled with what is usual: ``s^2 = (N s_shots^2 + N0 s_usual^2) / (N + N0)``.

    Args:
        vertical_offset_shares: (N,) one of each shot, by which it departs from the rig, over the longer side of its
            tele photo, as photos of one set may differ in size; NaN for shots without; may be empty.

    Returns:
        Standard deviation, over the longer side of the tele photo.
    """
    offsets = np.asarray(vertical_offset_shares, dtype=np.float64)
    offsets = offsets[np.isfinite(offsets)]
    shots = std_about_zero(offsets) if len(offsets) else 0.0
    n = len(offsets)
    return float(np.sqrt((n * shots**2 + _USUAL_WEIGHT * USUAL_SHIFT_SHARE**2) / (n + _USUAL_WEIGHT)))
