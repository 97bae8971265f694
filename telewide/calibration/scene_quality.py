"""Quality of a rig from scenes: it judges captures that it was solved without, and asks what no match can show.

Errors are distances from the row, tele px, each capture's own correction on top, mismatches left out.
Letters: S captures, N matches of one capture.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.quality import (
    SHARE,
    CalibrationQuality,
    Check,
    Status,
    at_least,
    at_most,
    epipolar_percentiles_px,
    larger_than_usual,
    verdict_of,
)
from telewide.calibration.scene_rig import CONTRADICTIONS, SceneRig, SideSource
from telewide.calibration.scene_solver import MIN_SCENES
from telewide.calibration.validation import difference_px
from telewide.correction.refinement import fit_shot, refined_rig
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rectification import rectifying_rotation
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import vertical_misfit_px
from telewide.points.matches import Matches

MIN_CHECKED_SCENES = 2 * MIN_SCENES
"""Fewer captures than this cannot be parted into two rigs that judge each other's captures."""
ZERO_CHECK = "zero of disparity, standard deviation"
"""Name of the check whose value is the standard deviation of the disparity at infinity, tele px."""
_TYPICAL_DEPTH_BASELINES = 100.0
"""Depth, in baselines, at which two rigs are compared: about a metre on a phone."""
_GRID_HW = (12, 16)
_MISMATCH_WIDE_PX = 3.0
# Limits: (passes, fails), as of the checks of a board.
_SCENES = (8, MIN_SCENES)
_F_STD = (0.02, 0.1)
_ERROR_WIDE_PX = (0.75, 2.5)
_ZERO_PX = 1.0
_DEVIATIONS = "standard deviations"
_BASELINE_STD = (0.01, 0.2)
_SIDE_CHECKS: dict[SideSource, tuple[Status, str]] = {
    "guessed": (
        "warn",
        "The captures do not show on which side the wide lens stands; if the guess is wrong, near and far are "
        "exchanged. Look at the back of the phone and state it with `wide_side`.",
    ),
    "contradicted": (
        "fail",
        "The wide lens is stated to stand where the matches show it cannot, unless the photos were cropped: near and "
        "far would be exchanged. Look again at the back of the phone, held as the photos are upright.",
    ),
}


@dataclass(frozen=True)
class SceneEvidence:
    """Evidence that a rig from scenes is judged by.

    Attributes:
        whole: the rig from all captures.
        halves: rigs from every second capture and from the others; None with too few captures.
        errors_px: of each capture (N,) its row errors with the rig of the half that did not see it; empty without
            halves.
    """

    whole: SceneRig
    halves: tuple[SceneRig, SceneRig] | None
    errors_px: tuple[FloatArray, ...] = ()


def row_errors_px(matches: Matches, *, rig: StereoRig, seed: int = 0) -> FloatArray:
    """Measure how far a capture's matches lie from their rows, with its own correction on top of a rig.

    Args:
        matches: (N,) of the photos as captured.
        rig: solved without them, if it is to be judged by them.
        seed: of the correction.

    Returns:
        (N,) tele px.
    """
    moved = refined_rig(rig, fit_shot(matches, rig=rig, seed=seed))
    return np.abs(vertical_misfit_px(matches.ref_px, matches.src_px, rig=moved))


def is_match(errors_px: FloatArray, *, rig: StereoRig) -> NDArray[np.bool_]:
    """(N,) which matches are no mismatches by their error: within three wide px of their row, as of 12 megapixels."""
    return np.asarray(errors_px < _MISMATCH_WIDE_PX * _wide_px(rig))


def _wide_px(rig: StereoRig) -> float:
    """Tele px of one px of a wide photo of usual size: what errors are counted in."""
    return max(rig.asymmetry, 1.0) * larger_than_usual(rig.tele.hw)


def judge_scenes(evidence: SceneEvidence) -> CalibrationQuality:
    """Judge a rig from scenes.

    Where nothing could be held out the rig is insufficient, however well it explains what it was fitted to.

    Args:
        evidence: what it is judged by.

    Returns:
        Its figures, checks and verdict; NaN for what could not be found out.
    """
    p50, p90, p99 = epipolar_percentiles_px(np.concatenate([np.zeros(0), *evidence.errors_px]))
    cross_px = math.nan if evidence.halves is None else _cross_px(evidence.halves)
    checks = (
        *_capture_checks(evidence, p90_px=p90, cross_px=cross_px),
        *_focal_checks(evidence.whole),
        *_unseen_checks(evidence.whole),
    )
    return CalibrationQuality(
        tele_rms_px=math.nan,
        wide_rms_px=math.nan,
        epipolar_p50_px=p50,
        epipolar_p90_px=p90,
        epipolar_p99_px=p99,
        cross_validation_px=cross_px,
        checks=checks,
        verdict=verdict_of(checks),
    )


def zero_std_px(quality: CalibrationQuality) -> float:
    """Read how sure the zero of disparity is from what a rig is worth.

    Args:
        quality: of the rig; that of a board does not ask, as the corners pin the zero.

    Returns:
        Standard deviation, tele px of the photos the rig was made from; 0 where it was not asked.
    """
    return next((c.value for c in quality.checks if c.name == ZERO_CHECK and math.isfinite(c.value)), 0.0)


def _cross_px(halves: tuple[SceneRig, SceneRig]) -> float:
    """RMS difference of two rigs, tele px, but for a shift along the baseline.

    No match shows that shift; the check of the zero of disparity counts it in.
    """
    first, second = (half.rig for half in halves)
    depth_m = _TYPICAL_DEPTH_BASELINES * first.baseline_m
    moved = difference_px(first, second, distance_m=depth_m, grid_hw=_GRID_HW)
    along = (first.wide_from_tele[:3, :3] @ rectifying_rotation(first)[0])[:2]
    along /= np.linalg.norm(along)
    moved = moved - np.mean(moved @ along) * along
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


def _capture_checks(evidence: SceneEvidence, *, p90_px: float, cross_px: float) -> Iterator[Check]:
    whole, n = evidence.whole, evidence.whole.n_scenes
    kind = "of scenes with texture all over the tele photo, near and far"
    advice = f"{n} captures had matches enough. Take {max(_SCENES[0] - n, 1)} more {kind}."
    yield at_least("captures with matches enough", n, _SCENES, advice=advice, unit="captures")
    advice = (
        f"Nothing could be held out, so nobody knows whether the rig holds for a capture it has not seen. Take "
        f"{MIN_CHECKED_SCENES - n} more captures or more, {kind}: with {MIN_CHECKED_SCENES} one half judges the other."
    )
    limits = (MIN_CHECKED_SCENES, MIN_CHECKED_SCENES)
    yield at_least("captures to check the rig by", n, limits, advice=advice, unit="captures")
    if evidence.halves is None:
        return
    limits_px = (_ERROR_WIDE_PX[0] * _wide_px(whole.rig), _ERROR_WIDE_PX[1] * _wide_px(whole.rig))
    advice = (
        f"A tenth of the matches held out lie more than {p90_px:.2f} tele px off their row. Take more captures, both "
        "photos at the same moment, nothing moving."
    )
    yield at_most("held-out epipolar error of 90 %", p90_px, limits_px, advice=advice, unit="tele px")
    advice = f"Rigs from every second capture differ by {cross_px:.2f} tele px. Take twice as many captures, {kind}."
    yield at_most("difference of rigs from half the captures", cross_px, limits_px, advice=advice, unit="tele px")


def _focal_checks(whole: SceneRig) -> Iterator[Check]:
    yield at_most(
        "tele focal length, standard deviation",
        whole.std.tele_f_share,
        _F_STD,
        advice="Focal lengths are only as good as EXIF's, or as stated: photograph a board.",
        unit=SHARE,
    )
    focal, rig = whole.focal, whole.rig
    off = whole.tele_f_contradiction
    advice = _contradiction_advice("tele focal length", f"{rig.tele.f_px:.0f} px", f"{focal.tele_f_px:.0f} px", off)
    yield at_most("tele focal length against EXIF", off, CONTRADICTIONS, advice=advice, unit=_DEVIATIONS)
    off, stated = whole.ratio_contradiction, focal.tele_f_px / focal.wide_f_px
    advice = _contradiction_advice("ratio of the focal lengths", f"{rig.asymmetry:.3f}", f"{stated:.3f}", off)
    yield at_most("f_tele / f_wide against EXIF", off, CONTRADICTIONS, advice=advice, unit=_DEVIATIONS)
    advice = "Take more captures with texture all over the tele photo."
    yield at_most("f_tele / f_wide, standard deviation", whole.std.ratio_share, _F_STD, advice=advice, unit=SHARE)


def _contradiction_advice(name: str, by_matches: str, stated: str, n_deviations: float) -> str:
    return (
        f"Matches want a {name} of {by_matches}, EXIF or `f35` says {stated}: {n_deviations:.1f} standard deviations "
        "apart, and matches of few scenes or of little depth are the likelier ones to be wrong. Take more captures "
        "with near and far things all over the tele photo, or photograph a board."
    )


def _unseen_checks(whole: SceneRig) -> Iterator[Check]:
    advice = (
        f"What is infinitely far is known to {whole.std.zero_px:.1f} px of disparity only, and every depth is as "
        "unsure: state a known distance with `distance`, or photograph a board."
    )
    limits_px = (_ZERO_PX * larger_than_usual(whole.rig.tele.hw), math.inf)
    yield at_most(ZERO_CHECK, whole.std.zero_px, limits_px, advice=advice, unit="tele px")
    if whole.side_source in _SIDE_CHECKS:
        status, advice = _SIDE_CHECKS[whole.side_source]
        yield Check(name="side of the wide lens", status=status, value=math.nan, limit=math.nan, advice=advice)
    if whole.rig.is_scale_known:
        share = whole.std.baseline_m / whole.rig.baseline_m
        advice = (
            f"The distance of the lenses was stated and is known to {share:.1%}, as every depth is. For better, "
            "photograph a board with measured squares."
        )
        name = "distance of the lenses, standard deviation"
        yield at_most(name, share, _BASELINE_STD, advice=advice, unit=SHARE)
