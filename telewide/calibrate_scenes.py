"""A rig without a board: EXIF and the matches of ordinary captures in, rig.yaml out.

    captures/ ── EXIF focal lengths ── match every capture ── solve jointly ── solve halves, to judge it ── rig.yaml

What such a rig cannot know (the length of the baseline, the zero of disparity) is part of its checks.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.calibrate import RIG_FILE, CalibrationObserver
from telewide.calibration.quality import CalibrationQuality, Check, Status, verdict_of
from telewide.calibration.result import CameraStd, TransformStd
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.calibration.validation import difference_px
from telewide.capture.exif import image_pipeline, read_photo_facts
from telewide.capture.images import read_image
from telewide.capture.pair import Capture, find_captures
from telewide.correction.epipolar import vertical_misfit_px
from telewide.correction.matches import Matches
from telewide.correction.photo_matches import find_photo_matches
from telewide.correction.scenes import MIN_SCENES, FocalPrior, SceneRig, first_rig, rig_from_scenes
from telewide.correction.shot import fit_shot, refined_rig
from telewide.errors import InputError

FloatArray = NDArray[np.float64]
Hw = tuple[int, int]

CAPTURES_FOLDER = Path("captures")
_FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_TYPICAL_DEPTH_BASELINES = 100.0
"""Depth, in baselines, at which two rigs are compared: about a metre on a phone."""
_GRID_HW = (12, 16)
_CENTRE_STD_SHARE = 0.01
"""Tele's principal point is taken as the photo's middle; lenses are off by about so much of the width."""
_MISMATCH_WIDE_PX = 3.0
# Limits: (passes, fails), as of the checks of a board.
_SCENES = (8, MIN_SCENES)
_F_STD = (0.02, 0.1)
_F_DEVIATION = (0.1, 0.3)
_ERROR_WIDE_PX = (0.75, 2.5)
_ZERO_PX = (1.0, math.inf)


@dataclass(frozen=True)
class SceneOptions:
    """What ``telewide calibrate --from-scenes`` was asked for.

    Attributes:
        baseline_m: distance of the lenses, where the user knows it.
        f35_mm: focal lengths of tele and wide as 35 mm equivalents; None takes those of EXIF.
        out: the file to write.
        seed: of the choice among many matches.
    """

    baseline_m: float | None = None
    f35_mm: tuple[float, float] | None = None
    out: Path = RIG_FILE
    seed: int = 0


@dataclass(frozen=True)
class SceneRun:
    """A rig from scenes and where it was written.

    Attributes:
        stored: the rig with its quality.
        rig: path of ``rig.yaml``.
        notes: what a person should know, one sentence each.
    """

    stored: StoredRig
    rig: Path
    notes: tuple[str, ...]


def calibrate_scenes(captures: Path, *, options: SceneOptions, observer: CalibrationObserver) -> SceneRun:
    """Find a rig from captures of ordinary scenes, and write it.

    Args:
        captures: folder of the captures, photos as they came from the phone.
        options: what is known besides, output.
        observer: hears of it.

    Returns:
        The rig, of any verdict, with the file written.

    Raises:
        UsageError: no such folder.
        InputError: the photos do not say their focal length, or too few of them match.
    """
    found = find_captures(captures)
    observer.said(f"{len(found.captures)} captures in {captures}")
    focal_mm = options.f35_mm or _stated_f35_mm(captures, found.captures)
    tick = observer.detecting(len(found.captures))
    scenes, sizes, notes = _matched(found.captures, focal_mm=focal_mm, tick=tick)
    focal = _focal_prior(focal_mm, sizes)

    def solved(some: Sequence[Matches]) -> SceneRig:
        return rig_from_scenes(
            some, tele_hw=sizes[0], wide_hw=sizes[1], focal=focal, baseline_m=options.baseline_m, seed=options.seed
        )

    whole = solved(scenes)
    halves = (solved(scenes[::2]), solved(scenes[1::2])) if len(scenes) >= 2 * MIN_SCENES else None
    facts = RigFacts(
        image_pipeline=image_pipeline(found.captures[0].tele_path),
        scale_verified=options.baseline_m is not None,
        source="scenes",
        notes=whole.notes,
    )
    stored = _stored(whole, quality=_quality(whole, halves, scenes, focal=focal), facts=facts)
    write_stored_rig(options.out, stored)
    return SceneRun(stored, options.out, (*whole.notes, *notes))


def _stated_f35_mm(folder: Path, captures: Sequence[Capture]) -> tuple[float, float]:
    """Medians over all captures of what EXIF says."""
    facts = [(read_photo_facts(each.tele_path), read_photo_facts(each.wide_path)) for each in captures]
    stated = [[photo.f35_mm for photo in lens if photo.f35_mm is not None] for lens in zip(*facts, strict=True)]
    if not all(stated):
        raise InputError(
            f"the photos in {folder} do not state their focal lengths (EXIF FocalLengthIn35mmFilm of both lenses)",
            hint="give them with --f35 TELE,WIDE, in 35 mm equivalents such as 80,27; or calibrate with a board",
        )
    return statistics.median(stated[0]), statistics.median(stated[1])


def _matched(
    captures: Sequence[Capture], *, focal_mm: tuple[float, float], tick: Callable[[], None]
) -> tuple[list[Matches], tuple[Hw, Hw], list[str]]:
    """Matches of all captures of the commonest photo sizes, those sizes, and notes on the others."""
    sizes = Counter(_sizes(capture) for capture in captures)
    common = sizes.most_common(1)[0][0]
    rig = first_rig(tele_hw=common[0], wide_hw=common[1], focal=_focal_prior(focal_mm, common))
    scenes, notes = [], []
    for capture in captures:
        if _sizes(capture) == common:
            tele, wide = read_image(capture.tele_path), read_image(capture.wide_path)
            scenes.append(find_photo_matches(tele, wide, rig=rig))
        else:
            notes.append(f"{capture.name}: photos of another size or held otherwise, left out")
        tick()
    return scenes, common, notes


def _sizes(capture: Capture) -> tuple[Hw, Hw]:
    sizes = [read_photo_facts(path).hw for path in (capture.tele_path, capture.wide_path)]
    if sizes[0] is None or sizes[1] is None:
        raise InputError(f"{capture.name}: the size of its photos cannot be read")
    return sizes[0], sizes[1]


def _focal_prior(focal_mm: tuple[float, float], sizes: tuple[Hw, Hw]) -> FocalPrior:
    """``f_px = f35 d_px / d_35``, d the diagonal (CIPA DCG-001)."""
    tele, wide = (
        f35_mm / _FULL_FRAME_DIAGONAL_MM * math.hypot(*hw) for f35_mm, hw in zip(focal_mm, sizes, strict=True)
    )
    return FocalPrior(tele_f_px=tele, wide_f_px=wide)


def _quality(
    whole: SceneRig, halves: tuple[SceneRig, SceneRig] | None, scenes: Sequence[Matches], *, focal: FocalPrior
) -> CalibrationQuality:
    errors_px = _held_out_px(halves, scenes) if halves is not None else np.zeros(0)
    p50, p90, p99 = np.percentile(errors_px, (50, 90, 99)) if len(errors_px) else (math.nan,) * 3
    cross_px = _cross_px(halves) if halves is not None else math.nan
    checks = _checks(whole, focal=focal, p90_px=float(p90), cross_px=cross_px)
    return CalibrationQuality(
        tele_rms_px=math.nan,
        wide_rms_px=math.nan,
        epipolar_p50_px=float(p50),
        epipolar_p90_px=float(p90),
        epipolar_p99_px=float(p99),
        cross_validation_px=cross_px,
        checks=checks,
        verdict=verdict_of(checks),
    )


def _held_out_px(halves: tuple[SceneRig, SceneRig], scenes: Sequence[Matches]) -> FloatArray:
    """Row errors of captures with the rig that did not see them, each shot's own correction on top, mismatches out."""
    errors = [np.zeros(0)]
    for number, matches in enumerate(scenes):
        other = halves[1 - number % 2].rig
        moved = refined_rig(other, fit_shot(matches, rig=other))
        errors.append(np.abs(vertical_misfit_px(matches.ref_px, matches.src_px, rig=moved)))
    all_px = np.concatenate(errors)
    return all_px[all_px < _MISMATCH_WIDE_PX * halves[0].rig.asymmetry]


def _cross_px(halves: tuple[SceneRig, SceneRig]) -> float:
    depth_m = _TYPICAL_DEPTH_BASELINES * halves[0].rig.baseline_m
    moved = difference_px(halves[0].rig, halves[1].rig, distance_m=depth_m, grid_hw=_GRID_HW)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


def _checks(whole: SceneRig, *, focal: FocalPrior, p90_px: float, cross_px: float) -> tuple[Check, ...]:
    factor = max(whole.rig.asymmetry, 1.0)
    limits_px = (_ERROR_WIDE_PX[0] * factor, _ERROR_WIDE_PX[1] * factor)
    more = "Take more captures of scenes with texture all over the tele photo, near and far."
    n = whole.n_scenes
    return (
        Check(
            "captures",
            "pass" if n >= _SCENES[0] else "warn",
            n,
            _SCENES[0],
            "" if n >= _SCENES[0] else f"{n} captures had matches enough. {more}",
        ),
        _at_most(
            "focal length",
            whole.std.tele_f_share,
            _F_STD,
            "Focal lengths are only as good as EXIF's, or as stated: photograph a board.",
        ),
        _at_most(
            "focal length against EXIF",
            abs(whole.rig.tele.f_px / focal.tele_f_px - 1),
            _F_DEVIATION,
            f"Matches want a tele focal length of {whole.rig.tele.f_px:.0f} px, EXIF says {focal.tele_f_px:.0f}: they "
            "contradict each other; photograph a board.",
        ),
        _at_most("focal ratio", whole.std.ratio_share, _F_STD, more),
        _at_most("held-out epipolar error", p90_px, limits_px, more),
        _at_most("odd/even difference", cross_px, limits_px, more),
        _at_most(
            "zero of disparity",
            whole.std.zero_px,
            _ZERO_PX,
            f"What is infinitely far is known to {whole.std.zero_px:.1f} px of disparity only: state a known distance "
            "with --distance, or photograph a board.",
        ),
    )


def _at_most(name: str, value: float, limits: tuple[float, float], advice: str) -> Check:
    status: Status = "pass" if value <= limits[0] else "fail" if value > limits[1] else "warn"
    return Check(name, status, value, limits[0], "" if status == "pass" else advice)


def _stored(whole: SceneRig, *, quality: CalibrationQuality, facts: RigFacts) -> StoredRig:
    rig, std = whole.rig, whole.std
    wide_f_share = math.hypot(std.tele_f_share, std.ratio_share)
    centre_px = _CENTRE_STD_SHARE * max(rig.tele.hw)
    # In the picture plane and out of it: the two directions in which a unit vector can move.
    direction_m = rig.baseline_m * np.array([std.direction_rad[0], std.direction_rad[0], std.direction_rad[1]])
    return StoredRig(
        rig=rig,
        tele_std=CameraStd(std.tele_f_share * rig.tele.f_px, centre_px, centre_px, np.zeros(len(rig.tele.distortion))),
        wide_std=CameraStd(
            wide_f_share * rig.wide.f_px,
            float(std.wide_centre_px[0]),
            float(std.wide_centre_px[1]),
            np.zeros(len(rig.wide.distortion)),
        ),
        transform_std=TransformStd(
            rotation_deg=np.degrees(std.rotation_rad),
            translation_m=direction_m,
            baseline_m=0.0,
            covariance=np.diag(np.concatenate([std.rotation_rad, direction_m]) ** 2),
        ),
        quality=quality,
        facts=facts,
        n_joint_views=whole.n_scenes,
    )
