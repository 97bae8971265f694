"""Where wide stood in a shot that was not taken at once: its rotation and the direction of its translation.

The intrinsics are the rig's; only wide's focal length may breathe, within half a percent, since over a narrow field it
looks like a step forward. Through a narrow field turn and translation look alike too: priors at the rig's pose hold
what the matches do not show, and the standard deviations say how much that is. The translation's length is never seen.
Letters: N matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rectification import MAX_TILT_DEG
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import (
    epipolar_misfit_px,
    matching_unit_px,
    moved_rig,
    rectified_points,
    turned_points,
)
from telewide.points.matches import Matches
from telewide.points.robust import (
    Residuals,
    RobustFit,
    consensus_start,
    fit_robustly,
    numeric_jacobian,
    std_about_median,
    std_about_zero,
)

ROTATION_PRIOR_RAD = float(np.radians(3.0))
DIRECTION_PRIOR_RAD = 1.0
BREATHING_PRIOR = 0.005
_UNCERTAIN_DEG = 15.0
_MAX_MATCHES = 1500
_PRIOR_STD = np.array([*[ROTATION_PRIOR_RAD] * 3, BREATHING_PRIOR, DIRECTION_PRIOR_RAD, DIRECTION_PRIOR_RAD])
_AWAY_DEG = (40.0, 80.0)
_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)
_KEPT_STARTS = 2


@dataclass(frozen=True)
class PoseFit:
    """Wide's pose in one shot, on top of a rig.

    Attributes:
        rotation_vector: (3,) rad, turn of wide on top of the rig's, in wide's frame.
        translation_direction: (3,) unit vector of ``wide_from_tele``'s translation.
        scale: what wide's focal length is multiplied with.
        rotation_std_rad: (3,) standard deviations of the turn.
        direction_std_rad: largest standard deviation of the direction.
        scale_std: standard deviation of the scale.
        is_usable: False where wide stood nearly in front of tele or behind it.
        notes: what a person should know.
    """

    rotation_vector: FloatArray
    translation_direction: FloatArray
    scale: float
    rotation_std_rad: FloatArray
    direction_std_rad: float
    scale_std: float
    is_usable: bool
    notes: tuple[str, ...]


def fit_pose(matches: Matches, *, rig: StereoRig, seed: int = 0) -> PoseFit:
    """Fit wide's rotation and the direction of its translation, the intrinsics fixed.

    Begins at the rig's pose, at directions around it and at the essential matrix's; the cheapest solution stands.

    Args:
        matches: N of the photos as captured, N at least 8.
        rig: for photos of these sizes.
        seed: seed of what is drawn at random.

    Returns:
        The pose, with standard deviations.
    """
    used = matches
    if len(matches) > _MAX_MATCHES:
        used = matches.select(np.random.default_rng(seed).permutation(len(matches))[:_MAX_MATCHES])
    unit_px = matching_unit_px(rig.tele.hw)

    tele, wide = rig.tele.normalised(used.ref_px), rig.wide.normalised(used.src_px)

    def misfit_px(x: FloatArray) -> FloatArray:
        transform = _posed(rig, x).wide_from_tele
        return epipolar_misfit_px(tele, wide * np.exp(-x[3]), wide_from_tele=transform, f_px=rig.tele.f_px)

    starts = _starts(misfit_px, seed=seed, unit_px=unit_px)
    essential = _essential_start(tele, wide, rig=rig, unit_px=unit_px)
    if essential is not None:
        starts.append(essential)
    fits = [fit_robustly(misfit_px, start, prior_std=_PRIOR_STD, unit_px=unit_px) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    return _described(best, rig=rig, matches=used)


def _described(fit: RobustFit, *, rig: StereoRig, matches: Matches) -> PoseFit:
    posed = _posed(rig, fit.x)
    centre = _wide_centre(rig, fit.x)
    covariance = _covariance(fit, posed, matches)
    yaw_axis = posed.wide_from_tele[:3, :3] @ np.cross([0.0, 0.0, 1.0], centre)
    yaw_std_px = float(np.sqrt(yaw_axis @ covariance[:3, :3] @ yaw_axis)) * rig.tele.f_px
    tele, wide = rectified_points(matches.ref_px, matches.src_px, rig=posed) if _is_across(centre) else (None, None)
    if tele is not None and wide is not None:
        disparity_px = rig.tele.f_px * float(np.median(tele[:, 0] - wide[:, 0]))
        # seen from the other side, everything would lie behind the cameras
        if disparity_px < -3 * yaw_std_px:
            centre = -centre
    direction_std_rad = float(np.sqrt(np.linalg.eigvalsh(covariance[4:, 4:])[-1]))
    notes = []
    if not _is_across(centre):
        notes.append("wide stood nearly in front of tele or behind it: such a pair cannot be rectified")
    if np.degrees(direction_std_rad) > _UNCERTAIN_DEG:
        notes.append(f"the direction wide moved in is known to {np.degrees(direction_std_rad):.0f} deg only")
    if yaw_std_px > 1.0:
        notes.append(f"the zero of disparity is known to {yaw_std_px:.1f} px only")
    return PoseFit(
        rotation_vector=fit.x[:3],
        translation_direction=-posed.wide_from_tele[:3, :3] @ centre,
        scale=float(np.exp(fit.x[3])),
        rotation_std_rad=np.sqrt(np.diag(covariance)[:3]),
        direction_std_rad=direction_std_rad,
        scale_std=float(np.sqrt(covariance[3, 3])),
        is_usable=_is_across(centre),
        notes=tuple(notes),
    )


def _covariance(fit: RobustFit, posed: StereoRig, matches: Matches) -> FloatArray:
    """The fit's covariance, less what noise pretends to know.

    A match says of the baseline's direction as much as it lies apart from where it would at infinity. Noise along the
    baseline makes it lie apart too, of points however far: that share of the parallax is no information.
    """
    tele, wide = posed.tele.normalised(matches.ref_px), posed.wide.normalised(matches.src_px)
    at_infinity = turned_points(tele, rotation=posed.wide_from_tele[:3, :3])
    apart_px = posed.tele.f_px * (wide - at_infinity)
    spread_px = std_about_median(apart_px)
    noise_px = std_about_zero(fit.residuals)
    # the spread of n matches is itself known to 2 / sqrt(n) of it, at 95 %
    noise_share = (1 + 4 / np.sqrt(len(matches))) * noise_px**2 / max(float((spread_px**2).sum()) - noise_px**2, 1e-12)
    true_share = max(0.0, 1 - noise_share)
    shrink = np.array([1, 1, 1, 1, *[np.sqrt(true_share)] * 2])
    information = np.linalg.inv(fit.covariance) - np.diag(1 / _PRIOR_STD**2)
    return np.asarray(np.linalg.inv(shrink[:, None] * information * shrink + np.diag(1 / _PRIOR_STD**2)))


def _posed(rig: StereoRig, x: FloatArray) -> StereoRig:
    """Turn (3, rad), log of the focal scale, and the way on the sphere from the rig's direction (2, rad)."""
    return moved_rig(rig, scale=float(np.exp(x[3])), rotation_vector=x[:3], wide_centre=_wide_centre(rig, x))


def _wide_centre(rig: StereoRig, x: FloatArray) -> FloatArray:
    """(3,) unit vector from tele to wide, in tele's frame."""
    centre, first, second = _tangent(rig)
    way = x[4] * first + x[5] * second
    angle = float(np.linalg.norm(way))
    return np.asarray(np.cos(angle) * centre + np.sinc(angle / np.pi) * way)


def _tangent(rig: StereoRig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The rig's direction to wide, and two more that make a right-handed frame with it."""
    centre = -rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3] / rig.baseline_m
    first = np.cross(np.array([0.0, 0.0, 1.0]), centre)
    length = float(np.linalg.norm(first))
    first = first / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return centre, first, np.cross(centre, first)


def _is_across(centre: FloatArray) -> bool:
    return bool(np.degrees(np.arcsin(np.clip(abs(centre[2]), 0, 1))) < MAX_TILT_DEG)


def _starts(misfit_px: Residuals, *, seed: int, unit_px: float) -> list[FloatArray]:
    """Fits that most matches agree with, for directions at the rig's and around it: the best three, to begin from."""
    prior_std = _PRIOR_STD[:4]
    starts, costs = [], []
    for away_rad, turn_rad in [(0.0, 0.0), *((np.radians(a), np.radians(t)) for a in _AWAY_DEG for t in _TURNS_DEG)]:
        way = away_rad * np.array([np.cos(turn_rad), np.sin(turn_rad)])

        def turned_px(x: FloatArray, way: FloatArray = way) -> FloatArray:
            return misfit_px(np.concatenate([x, way]))

        jacobian = numeric_jacobian(turned_px, np.zeros(4), step=1e-3 * prior_std)
        x = consensus_start(turned_px(np.zeros(4)), jacobian, prior_std=prior_std, seed=seed, unit_px=unit_px)
        starts.append(np.concatenate([x, way]))
        costs.append(float(np.log1p((turned_px(x) / unit_px) ** 2).sum()))
    return [starts[i] for i in np.argsort(costs)[:_KEPT_STARTS]]


def _essential_start(tele: FloatArray, wide: FloatArray, *, rig: StereoRig, unit_px: float) -> FloatArray | None:
    """The pose of the essential matrix that most matches agree with (RANSAC), nearest to the rig's."""
    f_px = rig.tele.f_px
    K = np.diag([f_px, f_px, 1.0])
    E, _ = cv2.findEssentialMat(f_px * tele, f_px * wide, K, method=cv2.RANSAC, prob=0.999, threshold=1.5 * unit_px)
    if E is None or E.shape != (3, 3):
        return None
    first, second, translation = cv2.decomposeEssentialMat(E)
    rotations = [R @ rig.wide_from_tele[:3, :3].T for R in (first, second)]
    turns = [np.asarray(cv2.Rodrigues(R)[0], dtype=np.float64).ravel() for R in rotations]
    nearest = min((0, 1), key=lambda i: float(np.linalg.norm(turns[i])))
    centre, along, across = _tangent(rig)
    seen = -(first, second)[nearest].T @ translation.ravel()
    seen = seen * (1.0 if seen @ centre >= 0 else -1.0)
    angle = float(np.arccos(np.clip(seen @ centre, -1, 1)))
    way = seen - (seen @ centre) * centre
    way = way * angle / max(float(np.linalg.norm(way)), 1e-12)
    turn = np.clip(turns[nearest], -5 * ROTATION_PRIOR_RAD, 5 * ROTATION_PRIOR_RAD)
    return np.array([*turn, 0.0, way @ along, way @ across])
