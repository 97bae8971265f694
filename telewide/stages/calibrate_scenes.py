"""A rig without a board: EXIF and the matches of ordinary captures in, rig.yaml and a page about it out.

    captures/ ── EXIF focal lengths ── match every capture ── solve jointly ── solve halves, to judge it
              ── rig.yaml + rig_report.html

What such a rig cannot know (the length of the baseline, the zero of disparity) is part of its checks. A rig that is
not good enough is written too, and marked; refusing it is up to the caller.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.result import CameraStd, TransformStd
from telewide.calibration.rig_file import RIG_FILE, RigFacts, StoredRig, write_stored_rig
from telewide.calibration.scene_quality import (
    MIN_CHECKED_SCENES,
    SceneEvidence,
    is_match,
    judge_scenes,
    row_errors_px,
)
from telewide.calibration.scene_rig import FocalPrior, SceneRig, SceneStd, Side
from telewide.calibration.scene_solver import MIN_SCENE_MATCHES, first_rig, rig_from_scenes
from telewide.capture.exif import PhotoFacts, common_pipeline, read_photo_facts
from telewide.capture.lenses import with_checked_lenses
from telewide.capture.pair import Capture, CaptureSet, PhotoPair, Problem, find_captures, read_photos
from telewide.correction.refinement import fit_shot, refined_rig
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatArray
from telewide.geometry.camera import focal_px_from_f35
from telewide.geometry.rig import Camera
from telewide.pages.report import NextStep
from telewide.pages.rig_page import write_rig_page
from telewide.pages.scenes_rig import SceneView, scenes_rig_page
from telewide.points.matches import Matches
from telewide.points.photo_matches import find_photo_matches
from telewide.stages.observer import Observer
from telewide.stages.rig_run import (
    CalibrationRun,
    RectifiedPreview,
    rectified_preview,
    report_facts,
    report_path,
    stated_rig,
    steps_with_rig,
)
from telewide.text import Invocation, command_line, counted

Hw = tuple[int, int]


@dataclass(frozen=True)
class SceneOptions:
    """Options of a calibration from captures of scenes.

    Attributes:
        baseline_m: distance of the lenses, where the user states it.
        wide_side: the side of tele on which wide stands, where the user states it.
        f35_mm: focal lengths of tele and wide as 35 mm equivalents; None takes those of EXIF.
        out: the file to write; the report lies beside it.
        seed: of the choice among many matches.
    """

    baseline_m: float | None = None
    wide_side: Side | None = None
    f35_mm: tuple[float, float] | None = None
    out: Path = RIG_FILE
    seed: int = 0


@dataclass(frozen=True)
class _Kind:
    """Properties that captures of one rig have in common.

    Attributes:
        sizes: of tele's and of wide's photo, upright.
        orientations: their EXIF orientations: a phone held upside down has its lenses exchanged.
    """

    sizes: tuple[Hw, Hw]
    orientations: tuple[int, int]


@dataclass(frozen=True)
class _Matched:
    """Captures of one size with their matches.

    Attributes:
        captures: of the commonest photo sizes.
        scenes: their matches.
        sizes: of tele's and of wide's photos.
        orientations: their EXIF orientations.
        notes: on captures that are not used.
        shown: number and photos of the capture with the most matches, for the page.
    """

    captures: tuple[Capture, ...]
    scenes: tuple[Matches, ...]
    sizes: tuple[Hw, Hw]
    orientations: tuple[int, int]
    notes: tuple[str, ...]
    shown: tuple[int, PhotoPair] | None

    @property
    def telling(self) -> tuple[int, ...]:
        """Indices of the captures that have enough matches."""
        return tuple(n for n, matches in enumerate(self.scenes) if len(matches) >= MIN_SCENE_MATCHES)


def calibrate_scenes(captures: Path, *, options: SceneOptions, observer: Observer) -> CalibrationRun:
    """Find a rig from captures of ordinary scenes, and write it and a page about it.

    Args:
        captures: folder of the captures, photos as they came from the phone.
        options: what is known besides, output.
        observer: is told of the progress.

    Returns:
        The rig, of any verdict, with the files written.

    Raises:
        UsageError: no such folder, or wide cannot stand where it is stated to.
        InputError: the photos do not state their focal length, differ in kind, or too few of them match.
    """
    found = with_checked_lenses(_found_captures(captures))
    problems = tuple(_spoken(problem) for problem in found.problems)
    if not found.captures:
        raise InputError(f"{captures}: no capture can be used" + "".join(f"\n  {line}" for line in problems))
    observer.said(f"{counted(len(found.captures), 'capture')} in {captures}")
    pipeline = common_pipeline(path for capture in found.captures for path in (capture.tele_path, capture.wide_path))
    focal_mm = options.f35_mm or _stated_f35_mm(captures, found.captures)
    matched = _matched(found.captures, focal_mm=focal_mm, tick=observer.detecting(len(found.captures)))
    focal = _focal_prior(focal_mm, matched.sizes)
    try:
        evidence = _solved(matched, focal=focal, options=options)
    except InputError as error:
        told = "".join(f"\n  {line}" for line in (*problems, *matched.notes))
        raise InputError(f"{error.message}{told}", hint=error.hint) from error
    facts = RigFacts(
        image_pipeline=pipeline,
        orientations=matched.orientations,
        scale_verified=False,  # a distance that somebody states is not measured in these photos
        source="scenes",
        notes=evidence.whole.notes,
    )
    stored = _stored(evidence.whole, quality=judge_scenes(evidence), facts=facts)
    write_stored_rig(options.out, stored)
    report = _write_report(captures, matched, evidence, stored=stored, options=options)
    return CalibrationRun(stored, options.out, report, (*evidence.whole.notes, *problems, *matched.notes))


def _found_captures(captures: Path) -> CaptureSet:
    try:
        return find_captures(captures)
    except UsageError as error:
        roll = command_line("import", "DCIM", captures)
        hint = f"put pairs into {captures}/1/tele.jpg and wide.jpg, and so on; or take them from a roll: {roll}"
        raise UsageError(error.message, hint=hint) from error


def _spoken(problem: Problem) -> str:
    return f"{'left out: ' if problem.is_skipped else ''}{problem.name}: {problem.message}"


def _stated_f35_mm(folder: Path, captures: Sequence[Capture]) -> tuple[float, float]:
    """Medians over all captures of what EXIF says."""
    facts = [_stated(capture) for capture in captures]
    stated = [[photo.f35_mm for photo in lens if photo.f35_mm is not None] for lens in zip(*facts, strict=True)]
    if not all(stated):
        raise InputError(
            f"the photos in {folder} do not state their focal lengths (EXIF FocalLengthIn35mmFilm of both lenses)",
            hint="give them with --f35 TELE,WIDE, in 35 mm equivalents such as 80,27; or calibrate with a board",
        )
    return statistics.median(stated[0]), statistics.median(stated[1])


def _matched(captures: Sequence[Capture], *, focal_mm: tuple[float, float], tick: Callable[[], None]) -> _Matched:
    """Match all captures of the commonest photo sizes; notes on the others, and on photos that cannot be read."""
    kinds = {capture.name: kind for capture in captures if (kind := _kind(capture)) is not None}
    if not kinds:
        raise InputError(f"none of the {counted(len(captures), 'capture')} has two photos that can be read")
    most = Counter(kinds.values()).most_common(1)[0][0]
    common = most.sizes
    rig = first_rig(tele_hw=common[0], wide_hw=common[1], focal=_focal_prior(focal_mm, common))
    alike, scenes, notes = list[Capture](), list[Matches](), list[str]()
    shown: tuple[int, PhotoPair] | None = None
    for capture in captures:
        try:
            if kinds.get(capture.name, most) != most:
                notes.append(f"left out: {capture.name}: photos of another size or held otherwise")
                continue
            photos = read_photos(capture)
            scene = find_photo_matches(photos.tele, photos.wide, rig=rig)
        except (InputError, UsageError) as error:
            notes.append(f"left out: {capture.name}: {error.message}")
            continue
        finally:
            tick()
        if shown is None or len(scene) > len(scenes[shown[0]]):
            shown = len(scenes), photos
        alike.append(capture)
        scenes.append(scene)
        if len(scene) < MIN_SCENE_MATCHES:
            notes.append(f"{capture.name}: {len(scene)} matches, too few for a say")
    return _Matched(
        tuple(alike),
        tuple(scenes),
        sizes=common,
        orientations=most.orientations,
        notes=tuple(notes),
        shown=shown,
    )


def _kind(capture: Capture) -> _Kind | None:
    """Sizes of the two photos and how the phone was held; None where one cannot be read."""
    tele, wide = _stated(capture)
    if tele.hw is None or wide.hw is None:
        return None
    return _Kind((tele.hw, wide.hw), (tele.orientation, wide.orientation))


def _stated(capture: Capture) -> tuple[PhotoFacts, PhotoFacts]:
    """Return what the photos of a capture state; nothing where one cannot be read, which matching reports."""
    try:
        return read_photo_facts(capture.tele_path), read_photo_facts(capture.wide_path)
    except (InputError, UsageError):
        return PhotoFacts("unknown"), PhotoFacts("unknown")


def _focal_prior(focal_mm: tuple[float, float], sizes: tuple[Hw, Hw]) -> FocalPrior:
    tele, wide = (focal_px_from_f35(f35_mm, hw=hw) for f35_mm, hw in zip(focal_mm, sizes, strict=True))
    return FocalPrior(tele_f_px=tele, wide_f_px=wide)


def _solved(matched: _Matched, *, focal: FocalPrior, options: SceneOptions) -> SceneEvidence:
    """Solve the rig from all captures and, where there are enough, from each half, judged by the other half."""

    def rig_of(some: Sequence[Matches], wide_side: Side | None) -> SceneRig:
        return rig_from_scenes(
            some,
            tele_hw=matched.sizes[0],
            wide_hw=matched.sizes[1],
            focal=focal,
            baseline_m=options.baseline_m,
            wide_side=wide_side,
            seed=options.seed,
        )

    whole = rig_of(matched.scenes, options.wide_side)
    scenes = [matched.scenes[n] for n in matched.telling]
    if len(scenes) < MIN_CHECKED_SCENES:
        return SceneEvidence(whole, None)
    # Which side it is has a check of its own: halves that guess differently would say nothing about the rest.
    halves = (rig_of(scenes[::2], whole.wide_side), rig_of(scenes[1::2], whole.wide_side))
    errors_px = [row_errors_px(each, rig=halves[1 - n % 2].rig) for n, each in enumerate(scenes)]
    kept_px = tuple(errors[is_match(errors, rig=whole.rig)] for errors in errors_px)
    return SceneEvidence(whole, halves, kept_px)


def _stored(whole: SceneRig, *, quality: CalibrationQuality, facts: RigFacts) -> StoredRig:
    rig, std = whole.rig, whole.std
    wide_f_share = math.hypot(std.tele_f_share, std.ratio_share)
    # In the picture plane and out of it: the two directions in which a unit vector can move.
    direction_m = rig.baseline_m * np.array([std.direction_rad[0], std.direction_rad[0], std.direction_rad[1]])
    length_m = std.baseline_m * rig.wide_from_tele[:3, 3] / rig.baseline_m
    covariance = np.diag(np.concatenate([std.rotation_rad, direction_m]) ** 2)
    covariance[3:, 3:] += np.outer(length_m, length_m)
    return StoredRig(
        rig=rig,
        tele_std=CameraStd(
            std.tele_f_share * rig.tele.f_px,
            float(std.tele_centre_px[0]),
            float(std.tele_centre_px[1]),
            _distortion_std(rig.tele, std, 0),
        ),
        wide_std=CameraStd(
            wide_f_share * rig.wide.f_px,
            float(std.wide_centre_px[0]),
            float(std.wide_centre_px[1]),
            _distortion_std(rig.wide, std, 1),
        ),
        transform_std=TransformStd(
            rotation_deg=np.degrees(std.rotation_rad),
            translation_m=np.sqrt(np.diag(covariance)[3:]),
            baseline_m=std.baseline_m,
            covariance=covariance,
        ),
        quality=quality,
        facts=facts,
        n_joint_views=whole.n_scenes,
    )


def _distortion_std(camera: Camera, std: SceneStd, lens: int) -> FloatArray:
    """Of k1; the other coefficients are held at 0."""
    return np.asarray(std.distortion[lens] * (np.arange(len(camera.distortion)) == 0), dtype=np.float64)


def _write_report(
    folder: Path, matched: _Matched, evidence: SceneEvidence, *, stored: StoredRig, options: SceneOptions
) -> Path:
    facts = {
        "captures": str(folder),
        "focal lengths": "EXIF" if options.f35_mm is None else "stated, {:g} and {:g} mm".format(*options.f35_mm),
    }
    page = scenes_rig_page(
        evidence.whole,
        quality=stored.quality,
        views=_views(matched, evidence),
        facts=report_facts(options.out, facts),
        next_steps=_next_steps(folder, stored, options=options, evidence=evidence),
        rectified=_rectified_capture(matched, evidence.whole),
    )
    return write_rig_page(report_path(options.out), page)


def _views(matched: _Matched, evidence: SceneEvidence) -> tuple[SceneView, ...]:
    held_out = dict(zip(matched.telling, evidence.errors_px, strict=False))
    views = []
    for number, (capture, matches) in enumerate(zip(matched.captures, matched.scenes, strict=True)):
        is_used = number in matched.telling
        agreeing = matches
        if is_used:
            errors_px = row_errors_px(matches, rig=evidence.whole.rig)
            agreeing = matches.select(is_match(errors_px, rig=evidence.whole.rig))
        views.append(
            SceneView(
                name=capture.name,
                matches=agreeing,
                n_found=len(matches),
                errors_px=held_out.get(number, np.zeros(0)),
                is_used=is_used,
            )
        )
    return tuple(views)


def scenes_call(captures: Path, options: SceneOptions) -> Invocation:
    """The call that makes this rig from these captures, for the calls advised after it."""
    stated = {
        "from_scenes": True,
        "f35": None if options.f35_mm is None else "{:g},{:g}".format(*options.f35_mm),
        "baseline_m": options.baseline_m,
        "wide_side": options.wide_side,
        "seed": options.seed or None,
        "out": stated_rig(options.out),
    }
    return Invocation("calibrate", (captures,), stated)


def _next_steps(
    folder: Path, stored: StoredRig, *, options: SceneOptions, evidence: SceneEvidence
) -> tuple[NextStep, ...]:
    call, rig = scenes_call(folder, options), stated_rig(options.out)
    steps = []
    if any(check.unit == "captures" and check.status != "pass" for check in stored.quality.checks):
        steps.append(NextStep("Add such captures to the folder and calibrate again:", call.again()))
    if evidence.whole.side_source == "guessed":
        again = call.again(wide_side=evidence.whole.wide_side)
        steps.append(NextStep("State where the wide lens stands, seen from behind:", again))
    if options.baseline_m is None:
        text = "For metres, measure from the middle of one lens to that of the other, and give it in metres:"
        steps.append(NextStep(text, call.again(baseline_m="M")))
    if stored.quality.verdict != "insufficient":
        steps += steps_with_rig(folder, options.out)
        text = "Pin a capture's depth to a point (column, row) of the tele photo and its distance in metres:"
        steps.append(NextStep(text, command_line("depth", folder / "NAME", distance="X,Y,M", rig=rig)))
    return tuple(steps)


def _rectified_capture(matched: _Matched, whole: SceneRig) -> RectifiedPreview | None:
    """The capture with the most matches, rectified; None where the rig cannot."""
    if matched.shown is None:
        return None
    number, photos = matched.shown
    return rectified_preview(photos, rig=refined_rig(whole.rig, fit_shot(matched.scenes[number], rig=whole.rig)))
