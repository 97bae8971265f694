"""Refinement of a rig for one shot: what autofocus and stabilisation moved since the calibration.

The wide is said to have moved, tele stays: its principal point across the baseline, a turn, its focal length. Vertical
means across the baseline: along y of the frame in which both views are rectified, whose x points from tele to wide.
``vertical_px = y_tele - y_wide`` there, in tele's pixels (both views at tele's focal length), 0 for a perfect rig.
Letters: N matches.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from telewide.correction.pose import fit_pose
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rectification import rectifying_rotation
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import (
    matching_unit_px,
    moved_rig,
    turned_points,
    vertical_misfit_px,
)
from telewide.points.matches import Matches, split_matches
from telewide.points.robust import consensus_start, fit_robustly, numeric_jacobian
from telewide.records import Figure, Line, Vector

MIN_MATCHES = 20
"""Fewer matches than this carry no correction."""
AT_ONCE_S = 0.1
"""Exposures further apart than this were not taken at once."""
LARGEST_RESIDUAL_PX = 0.5
"""A median misfit of held-out matches above this says that wide stood elsewhere; px of the views that are matched."""
_HELD_OUT_SHARE = 0.3
_OFFSET_PRIOR_PX = 40.0
_ROLL_PRIOR_RAD = 0.01
_SCALE_PRIOR = 0.01
_TILT_PRIOR_RAD = 0.01
_WORTH_A_TILT = 0.96
_WORTH_A_POSE = 0.85
_AGREES_PX = 1.5
_MIN_AGREEING_SHARE = 0.3
_NOT_AT_ONCE = "the two photos were not taken at once: wide's pose is this shot's own, and depth is relative"


def _no_turn() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class ShotRefinement:
    """This shot's own correction of a rig; the default is no correction.

    Attributes:
        vertical_offset_px: ``y_tele - y_wide`` at the principal point that the rig leaves and this takes out, tele px.
        scale: what wide's focal length is multiplied with.
        rotation_vector: (3,) rad, turn of wide on top of the rig's, in wide's frame: ``R = exp(v) R_rig``.
        tilt_rad: turns about the axes along and across the baseline, the principal point moving with them so that
            the middle of the photo stays.
        translation_direction: (3,) unit vector of ``wide_from_tele``'s translation; None keeps the rig's.
        vertical_offset_std_px: standard deviation of the offset; NaN where nothing was fitted.
        scale_std: likewise.
        rotation_std_rad: (3,) likewise; 0 for turns that are not part of the model.
        tilt_std_rad: likewise.
        direction_std_rad: largest standard deviation of the translation's direction; 0 where it is the rig's.
        residual_before_px: median absolute vertical misfit of the held-out matches with the rig alone, tele px.
        residual_after_px: with this correction.
        n_matches: matches that agree with the correction, fitted and held out.
        is_fitted: False where the matches were too few, and this is the identity.
        is_at_once: False where wide stood elsewhere for this shot, so that the baseline's length is unknown.
        notes: one sentence for everything a person should know.
    """

    vertical_offset_px: float = 0.0
    scale: float = 1.0
    rotation_vector: Vector = field(default_factory=_no_turn)
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    translation_direction: Vector | None = None
    vertical_offset_std_px: Figure = float("nan")
    scale_std: Figure = float("nan")
    rotation_std_rad: Vector = field(default_factory=_no_turn)
    tilt_std_rad: tuple[Figure, Figure] = (0.0, 0.0)
    direction_std_rad: Figure = 0.0
    residual_before_px: Figure = float("nan")
    residual_after_px: Figure = float("nan")
    n_matches: int = 0
    is_fitted: bool = False
    is_at_once: bool = True
    notes: tuple[Line, ...] = ()


def refined_rig(rig: StereoRig, refinement: ShotRefinement) -> StereoRig:
    """Apply this shot's correction to a rig.

    Args:
        rig: as calibrated, for photos of the shot's size.
        refinement: what :func:`fit_shot` found on top of it.

    Returns:
        The rig of this shot: wide's focal length and principal point, its rotation, and, where it was fitted, the
        direction of the translation. Tele and the length of the baseline stay; a turn moves no lens centre.
    """
    moved = moved_rig(
        rig,
        offset_px=refinement.vertical_offset_px,
        scale=refinement.scale,
        rotation_vector=refinement.rotation_vector,
        tilt_rad=np.asarray(refinement.tilt_rad),
    )
    transform = moved.wide_from_tele
    if refinement.translation_direction is not None:
        transform = transform.copy()
        transform[:3, 3] = rig.baseline_m * refinement.translation_direction
    return replace(moved, wide_from_tele=transform, is_scale_known=rig.is_scale_known and refinement.is_at_once)


def fit_shot(
    matches: Matches, *, rig: StereoRig, seconds_between: float | None = None, seed: int = 0
) -> ShotRefinement:
    """Fit what moved between the calibration and this shot.

    A small model first: offset across the baseline, roll, focal scale; a tilt of the lens where held-out matches gain
    by it. Where the photos were not taken at once, or it leaves more than 0.5 px of the matched views on held-out
    matches, the pose of wide, if that explains them clearly better.

    Args:
        matches: of the photos as captured, as :func:`telewide.points.photo_matches.find_photo_matches` finds them.
        rig: for photos of these sizes.
        seconds_between: between the two exposures, at least, as EXIF tells; None where it does not.
        seed: seed of the split into matches to fit to and held-out ones.

    Returns:
        The correction, judged on held-out matches; none, and a note, where the matches are too few.
    """
    if len(matches) < MIN_MATCHES:
        return _rig_kept(len(matches), is_at_once=not _is_late(seconds_between))
    to_fit, held_out = split_matches(matches, held_out_share=_HELD_OUT_SHARE, seed=seed)
    best = _small_model(to_fit, held_out, rig=rig, seed=seed)
    after_px = _median_misfit_px(held_out, rig, best)
    if _is_late(seconds_between) or _is_much(after_px, rig):
        best = _pose(to_fit, held_out, rig=rig, small=best, is_late=_is_late(seconds_between), seed=seed)
        after_px = _median_misfit_px(held_out, rig, best)
    n = _n_agreeing(matches, rig, best)
    before_px = _median_misfit_px(held_out, rig, ShotRefinement())
    if n < max(MIN_MATCHES, _MIN_AGREEING_SHARE * len(matches)):
        kept = _rig_kept(n, is_at_once=best.is_at_once)
        return replace(kept, residual_before_px=before_px, residual_after_px=before_px)
    return replace(best, residual_before_px=before_px, residual_after_px=after_px, n_matches=n, is_fitted=True)


def _small_model(to_fit: Matches, held_out: Matches, *, rig: StereoRig, seed: int) -> ShotRefinement:
    """The smallest of the nested models that held-out matches do not gain from enlarging."""
    best = _fit_small(to_fit, rig, has_tilt=False, seed=seed)
    larger = _fit_small(to_fit, rig, has_tilt=True, seed=seed)
    is_worth_it = _cost(held_out, rig, larger) < _WORTH_A_TILT * _cost(held_out, rig, best)
    return larger if is_worth_it else best


def _fit_small(matches: Matches, rig: StereoRig, *, has_tilt: bool, seed: int) -> ShotRefinement:
    """Offset (px), roll (rad), log of the focal scale; tilt (2, rad) if asked for."""
    unit_px = matching_unit_px(rig.tele.hw)
    axes = rectifying_rotation(rig)  # a wide that turns about its lens centre does not move them
    tele_y = turned_points(rig.tele.normalised(matches.ref_px), rotation=axes)[:, 1]

    def misfit_px(x: FloatArray) -> FloatArray:
        moved = refined_rig(rig, _refinement_of(x))
        wide = turned_points(moved.wide.normalised(matches.src_px), rotation=axes @ moved.wide_from_tele[:3, :3].T)
        return np.asarray(rig.tele.f_px * (tele_y - wide[:, 1]))

    tilt_prior = (_TILT_PRIOR_RAD, _TILT_PRIOR_RAD) if has_tilt else ()
    prior_std = np.array([_OFFSET_PRIOR_PX * unit_px, _ROLL_PRIOR_RAD, _SCALE_PRIOR, *tilt_prior])
    none = np.zeros(len(prior_std))
    jacobian = numeric_jacobian(misfit_px, none, step=1e-3 * prior_std)
    start = consensus_start(misfit_px(none), jacobian, prior_std=prior_std, seed=seed, unit_px=unit_px)
    fit = fit_robustly(misfit_px, start, prior_std=prior_std, jacobian=lambda _x: jacobian, unit_px=unit_px)
    return replace(
        _refinement_of(fit.x),
        vertical_offset_std_px=float(fit.std[0]),
        scale_std=float(fit.std[2]),
        rotation_std_rad=np.array([0.0, 0.0, fit.std[1]]),
        tilt_std_rad=(float(fit.std[3]), float(fit.std[4])) if has_tilt else (0.0, 0.0),
    )


def _refinement_of(x: FloatArray) -> ShotRefinement:
    return ShotRefinement(
        vertical_offset_px=float(x[0]),
        scale=float(np.exp(x[2])),
        rotation_vector=np.array([0.0, 0.0, x[1]]),
        tilt_rad=(float(x[3]), float(x[4])) if len(x) > 3 else (0.0, 0.0),
    )


def _pose(
    to_fit: Matches, held_out: Matches, *, rig: StereoRig, small: ShotRefinement, is_late: bool, seed: int
) -> ShotRefinement:
    """Wide's pose, or the small model where that explains the held-out matches as well."""
    pose = fit_pose(to_fit, rig=rig, seed=seed)
    posed = ShotRefinement(
        scale=pose.scale,
        rotation_vector=pose.rotation_vector,
        translation_direction=pose.translation_direction,
        vertical_offset_std_px=0.0,
        scale_std=pose.scale_std,
        rotation_std_rad=pose.rotation_std_rad,
        direction_std_rad=pose.direction_std_rad,
        is_at_once=False,
        notes=(_NOT_AT_ONCE, *pose.notes),
    )
    is_better = pose.is_usable and _cost(held_out, rig, posed) < _WORTH_A_POSE * _cost(held_out, rig, small)
    if is_better:
        return posed
    if is_late:
        return replace(small, is_at_once=False, notes=(_NOT_AT_ONCE, *(() if pose.is_usable else pose.notes)))
    misfit_px = _median_misfit_px(held_out, rig, small)
    doubts = (_left_over_note(misfit_px, rig), *(() if pose.is_usable else pose.notes))
    return replace(small, notes=doubts if _is_much(misfit_px, rig) else ())


def _rig_kept(n: int, *, is_at_once: bool) -> ShotRefinement:
    note = f"{n} matches, fewer than this shot's own correction needs: the rig is kept as calibrated"
    return ShotRefinement(n_matches=n, is_at_once=is_at_once, notes=(note, *(() if is_at_once else (_NOT_AT_ONCE,))))


def _is_late(seconds_between: float | None) -> bool:
    return seconds_between is not None and abs(seconds_between) > AT_ONCE_S


def _misfit_px(matches: Matches, rig: StereoRig, refinement: ShotRefinement) -> FloatArray:
    return vertical_misfit_px(matches.ref_px, matches.src_px, rig=refined_rig(rig, refinement))


def _median_misfit_px(matches: Matches, rig: StereoRig, refinement: ShotRefinement) -> float:
    return float(np.median(np.abs(_misfit_px(matches, rig, refinement))))


def _is_much(median_misfit_px: float, rig: StereoRig) -> bool:
    return median_misfit_px > _largest_misfit_px(rig)


def _largest_misfit_px(rig: StereoRig) -> float:
    return LARGEST_RESIDUAL_PX * matching_unit_px(rig.tele.hw)


def _left_over_note(median_misfit_px: float, rig: StereoRig) -> str:
    return (
        f"its matches lie {median_misfit_px:.2f} px off their rows (median, tele px) where at most "
        f"{_largest_misfit_px(rig):.2f} px are expected: trust its depth less. Something moved between the two photos: "
        "take them again, holding still; or, where many captures say so, the rig is of other lenses: calibrate again"
    )


def _n_agreeing(matches: Matches, rig: StereoRig, refinement: ShotRefinement) -> int:
    return int((np.abs(_misfit_px(matches, rig, refinement)) <= _AGREES_PX * matching_unit_px(rig.tele.hw)).sum())


def _cost(matches: Matches, rig: StereoRig, refinement: ShotRefinement) -> float:
    """Mean of the misfits, none counting for more than a clear mismatch."""
    limit_px = 2 * _AGREES_PX * matching_unit_px(rig.tele.hw)
    return float(np.minimum(np.abs(_misfit_px(matches, rig, refinement)), limit_px).mean())
