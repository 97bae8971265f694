"""From captures to corrected pairs: read, measure, correct, and keep the result in the run folder.

With a rig the photos are rectified first, corrected for what moved in this shot; without one they are taken for
rectified. A pair whose files and options have not changed is not made again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from telewide.calibration.rig_file import StoredRig
from telewide.capture.exif import image_pipeline, pipeline_conflict, read_photo_facts
from telewide.capture.facts import WideSide
from telewide.capture.images import focal_length_mm, resize_bicubic
from telewide.capture.lenses import with_checked_lenses
from telewide.capture.mixed_sizes import check_sizes
from telewide.capture.pair import (
    MIN_SIDE_PX,
    Capture,
    CaptureFacts,
    CaptureSet,
    PhotoPair,
    Problem,
    RectifiedPair,
    UnlikeSizesError,
    pair_from_photos,
    read_photos,
)
from telewide.capture.photo_store import PhotoStore
from telewide.capture.sizes import narrowed_hw
from telewide.correction.blur import fit_blur
from telewide.correction.correct import CorrectedPair, correct_pair
from telewide.correction.verdict import MIN_EVIDENCE_MATCHES, PairReport, inspect_pair
from telewide.errors import InputError, QualityError, TelewideError, UsageError, within_memory
from telewide.files import changing, fingerprint, write_text
from telewide.folders import refuse_links
from telewide.matching.window import Window
from telewide.points.matches import find_matches, photographed_matches
from telewide.recipe import Recipe
from telewide.records import as_read, read_record, write_record
from telewide.stages.align import (
    Alignment,
    align_photos,
    alignment_as_json,
    read_shot_facts,
)
from telewide.stages.call import Call, alone
from telewide.stages.kept_pairs import SHOT_NAME, files_of_pair, key_of, read_kept, write_pair
from telewide.stages.pair_record import RECORD_NAME, ColourFigures, PairRecord
from telewide.stages.pairs import PreparedPair, PreparedSet
from telewide.stages.rig import how_to_calibrate, lying_rig, where_rig_lies
from telewide.stages.run_folder import RunFolder
from telewide.text import command_line

_FOUND_ON_THE_LEFT = (
    "by the stated doffs_px all of it would lie behind the cameras, so wide is taken to stand to the left of tele; "
    "state wide_side: left in captures.yaml if that is so"
)


@dataclass(frozen=True)
class CorrectedShot:
    """A shot whose two views can be compared.

    Attributes:
        corrected: the pair at its working size, with its matches.
        report: what was measured, and a verdict.
        alignment: geometry between the pair and the photos; None where they were rectified when they came.
        wide_side: of such photos: where wide stands, "left" for a mirrored pair.
    """

    corrected: CorrectedPair
    report: PairReport
    alignment: Alignment | None
    wide_side: WideSide = "right"


class Tick(Protocol):
    """Hears of each capture that is corrected, or left out."""

    def __call__(self, name: str, *, is_kept: bool) -> None:
        """Take its name, and whether a former call has corrected it."""


def prepare(call: Call) -> PreparedSet:
    """Correct the pairs of a call; each of several processes does its share and then reads the others'.

    Args:
        call: captures, rig, recipe and where the pairs go.

    Returns:
        The pairs that can be used.

    Raises:
        InputError: none can be used.
        QualityError: none can be used, and all because of what was measured on them.
    """
    captures, recipe, heard = call.captures, call.recipe, call.observer.pair_prepared
    rig_file = call.rig_file or lying_rig(captures)
    if call.rig is not None and rig_file is not None:
        call.observer.said(f"rig: {where_rig_lies(rig_file, captures, is_stated=call.rig_file is not None)}")
    if call.rig is not None and call.rig.quality.verdict == "insufficient":
        shown = command_line("show", rig_file)
        call.observer.warned(f"the rig is marked insufficient: {shown} says what to photograph for a better one")
    call.observer.preparing(captures)
    with alone(call.processes, call.folder.pairs, observer=call.observer):
        if call.processes.world == 1:
            prepared = prepare_captures(
                captures, call.folder, recipe=recipe, rig=call.rig, photos=call.photos, tick=heard
            )
        else:
            mine = replace(captures, captures=call.processes.share(captures.captures))
            # An empty share, or none of it fit for use, which is said of all together.
            with suppress(InputError, QualityError):
                prepare_captures(mine, call.folder, recipe=recipe, rig=call.rig, photos=call.photos, tick=heard)
            call.processes.wait()
            prepared = prepare_captures(captures, call.folder, recipe=recipe, rig=call.rig)
    call.observer.set_prepared(prepared)
    return prepared


def prepare_captures(
    captures: CaptureSet,
    run: RunFolder,
    *,
    recipe: Recipe,
    rig: StoredRig | None = None,
    photos: PhotoStore | None = None,
    tick: Tick | None = None,
) -> PreparedSet:
    """Correct every capture of a set.

    Args:
        captures: what was found.
        run: where the pairs are kept.
        recipe: what is corrected; the working size; the window, where it states one.
        rig: what to rectify with; None for captures that are rectified.
        photos: keeps photos for the stages after; None where there are none.
        tick: called for each capture.

    Returns:
        The pairs that can be used. Bad captures are among its problems.

    Raises:
        InputError: none can be used.
        QualityError: none can be used, and all because of what was measured on them.
    """
    captures = with_checked_lenses(captures)
    store = photos or PhotoStore(max_bytes=0)
    pairs: list[PreparedPair] = []
    n_refused, is_uncut = 0, False
    problems = [*captures.problems, *(check_sizes(captures) if rig is None else ())]
    for capture in captures.captures:
        try:
            with within_memory("this pair"):
                prepared = _prepare_pair(capture, captures.facts, run, recipe=recipe, rig=rig, photos=store)
        except (InputError, UsageError) as error:
            problems.append(Problem(capture.name, f"{error.message}; {error.hint}" if error.hint else error.message))
            prepared, is_uncut = None, is_uncut or isinstance(error, UnlikeSizesError)
        if prepared is not None and prepared.report.verdict == "refused":
            problems.append(Problem(capture.name, "; ".join(prepared.report.reasons)))
            n_refused += 1
        elif prepared is not None:
            pairs.append(prepared)
            cut_off = _what_is_cut_off(prepared.report, recipe.window_px)
            problems += [*cut_off, *_where_wide_stands(prepared, captures.facts)]
        if tick is not None:
            tick(capture.name, is_kept=prepared is not None and prepared.is_kept)
    if not pairs:
        raise _none_left(captures, problems, n_refused=n_refused, needs_rig=rig is None and (n_refused > 0 or is_uncut))
    return PreparedSet(tuple(pairs), captures.facts, recipe.window_px, tuple(problems), rig=rig, root=captures.root)


def _none_left(
    captures: CaptureSet, problems: Sequence[Problem], *, n_refused: int, needs_rig: bool
) -> InputError | QualityError:
    """The error of a set without a pair that can be used; of quality where all were refused by what was measured."""
    lines = "".join(f"\n  {problem.name}: {problem.message}" for problem in problems)
    hint = "mend the captures named above"
    if needs_rig and not captures.facts.rectified:
        hint += f"; photos as they were taken need a rig, {how_to_calibrate(captures.root)}"
    is_measured = 0 < n_refused == sum(problem.is_skipped for problem in problems)
    kind = QualityError if is_measured else InputError
    return kind(f"{captures.root}: no capture can be used{lines}", hint=hint)


def _what_is_cut_off(report: PairReport, stated: Window | None) -> list[Problem]:
    """A note where a stated window ends before the disparities of a capture do."""
    range_px = report.disparity_range_px
    if stated is None or range_px is None or (stated[0] <= range_px[0] and range_px[1] < stated[1]):
        return []
    message = (
        f"its matches lie at {range_px[0]:.0f} to {range_px[1]:.0f} px, and the recipe states window_px: "
        f"{list(stated)}: depth of what lies beyond is wrong"
    )
    return [Problem(report.name, message, is_skipped=False)]


def _where_wide_stands(pair: PreparedPair, facts: CaptureFacts) -> list[Problem]:
    """A note where the side of wide was found and not stated."""
    if facts.wide_side is not None or pair.wide_side == "right":
        return []
    return [Problem(pair.capture.name, _FOUND_ON_THE_LEFT, is_skipped=False)]


def _prepare_pair(
    capture: Capture, facts: CaptureFacts, run: RunFolder, *, recipe: Recipe, rig: StoredRig | None, photos: PhotoStore
) -> PreparedPair:
    folder = run.pairs / capture.name
    refuse_links(run.root, folder)
    rig = None if rig is None else _as_held(rig, capture)
    key = key_of(capture, facts, recipe=recipe, rig=rig)
    kept = read_kept(capture, folder, key=key, recipe=recipe, rig=rig)
    if kept is not None:
        return replace(kept, is_kept=True)
    if rig is None and not facts.rectified:
        _refuse_to_lose_the_rig(folder, key)
    _refuse_another_kind(capture, rig)
    taken = read_photos(capture, read=photos.read)
    (pair, scale), alignment = _rectified(capture, taken, facts, recipe=recipe, rig=rig)
    shot = correct_shot(
        pair,
        alignment,
        facts=facts,
        recipe=recipe,
        scale=scale,
        focal_lengths_mm=(focal_length_mm(capture.tele_path), focal_length_mm(capture.wide_path)),
    )
    report, corrected = shot.report, shot.corrected
    with changing(folder):
        # Whatever happens until the new record is written, the old one must not vouch for new files.
        (folder / RECORD_NAME).unlink(missing_ok=True)
        write_pair(folder, corrected)
    blur = fit_blur(corrected.pair.tele, corrected.pair.wide, corrected.matches_fit)
    if alignment is not None:
        write_text(folder / SHOT_NAME, alignment_as_json(alignment))
    colour = corrected.colour
    record = PairRecord(
        key=as_read(key),
        scale=scale,
        wide_side=shot.wide_side,
        report=report,
        colour=ColourFigures(parts=colour.parts, delta_e_before=colour.delta_before, delta_e_after=colour.delta_after),
        blur=blur,
        files_sha256={name: fingerprint(folder / name) for name in files_of_pair(rig)},
    )
    write_record(folder / RECORD_NAME, record)
    kept = read_kept(capture, folder, key=key, recipe=recipe, rig=rig)
    if kept is None:
        raise InputError(f"{folder / 'pair.json'} was written and cannot be read back")
    return kept


def _as_held(rig: StoredRig, capture: Capture) -> StoredRig:
    """The rig as it stands in these photos, which say how the phone was held."""
    tele, wide = (read_photo_facts(path) for path in (capture.tele_path, capture.wide_path))
    if tele.hw is None:  # a photo that cannot be read says so where it is read
        return rig
    return replace(rig, rig=rig.as_held((tele.orientation, wide.orientation), tele_hw=tele.hw))


def correct_shot(
    pair: RectifiedPair,
    alignment: Alignment | None,
    *,
    facts: CaptureFacts,
    recipe: Recipe,
    scale: float = 1.0,
    focal_lengths_mm: tuple[float | None, float | None] = (None, None),
) -> CorrectedShot:
    """Measure and judge a pair at its working size, and bring wide's rows and colours to tele's.

    Args:
        pair: two views of one size.
        alignment: their geometry to the photos; None for photos that were rectified when they came.
        facts: what the owner states; where that leaves the side of wide open, a stated zero of disparity may show it.
        recipe: what is corrected; its seed splits the matches.
        scale: px of the pair for one px of the photo.
        focal_lengths_mm: of tele's and wide's lens as EXIF states them.

    Returns:
        The corrected pair with its report, of any verdict.
    """
    matches = photographed_matches(find_matches(pair.tele, pair.wide), pair.valid)
    stated = facts if alignment is None else facts.model_copy(update={"rectified": True})
    report = inspect_pair(pair, facts=stated, matches=matches, focal_lengths_mm=focal_lengths_mm)
    if alignment is None and _is_wide_on_the_left(report, facts, scale=scale):
        facts = facts.model_copy(update={"wide_side": "left"})
        mirrored = pair.mirrored
        return correct_shot(mirrored, None, facts=facts, recipe=recipe, focal_lengths_mm=focal_lengths_mm)
    if alignment is not None:
        swapped = alignment.asymmetry.swapped
        report = with_doubts(report, alignment.notes) if swapped is None else refused(report, swapped)
    corrected = correct_pair(
        pair,
        matches=matches,
        seed=recipe.seed,
        # What the fit of this shot has left is not worth a second resampling.
        has_vertical=recipe.correction.vertical and not (alignment and alignment.refinement.is_fitted),
        has_colour=recipe.correction.colour,
    )
    side = facts.wide_side if alignment is None and facts.wide_side is not None else "right"
    return CorrectedShot(corrected, report, alignment, side)


def _is_wide_on_the_left(report: PairReport, facts: CaptureFacts, *, scale: float) -> bool:
    """Whether all that is seen would lie behind the cameras, were wide on the right of tele.

    Without `doffs_px` no disparity is known to be that of infinity: the views may have been cropped anyhow.
    """
    if facts.wide_side is not None or facts.doffs_px is None or report.n_matches <= MIN_EVIDENCE_MATCHES:
        return False
    return report.disparity_p98_px + facts.doffs_px * scale < 0


def with_doubts(report: PairReport, doubts: Sequence[str]) -> PairReport:
    """Add sentences to the reasons of a report, whatever its verdict; a good one is then usable."""
    verdict = "usable" if doubts and report.verdict == "good" else report.verdict
    return dataclasses.replace(report, verdict=verdict, reasons=(*report.reasons, *doubts))


def refused(report: PairReport, reason: str) -> PairReport:
    """Refuse a pair for one reason that explains all others."""
    return dataclasses.replace(report, verdict="refused", reasons=(reason,))


def _refuse_to_lose_the_rig(folder: Path, key: dict[str, object]) -> None:
    """Refuse photos that were rectified with a rig before, where no rig is found any more."""
    try:
        former = read_record(folder / RECORD_NAME, PairRecord).key
        are_the_same = all(former[name] == key[name] for name in ("tele_sha256", "wide_sha256"))
        had_rig = former["rig"] is not None
    except (TelewideError, KeyError, TypeError):
        return
    if had_rig and are_the_same:
        raise InputError(
            "these photos were rectified with a rig, which is not found any more",
            hint=f"name it with --rig; if none is wanted, remove {folder}",
        )


def _refuse_another_kind(capture: Capture, rig: StoredRig | None) -> None:
    """Photos of another kind, or camera, than those of the calibration are refused before they are decoded."""
    if rig is None or rig.facts.image_pipeline is None:
        return
    for path in (capture.tele_path, capture.wide_path):
        conflict = pipeline_conflict(rig.facts.image_pipeline, image_pipeline(path))
        if conflict is not None:
            raise InputError(f"{path}: {conflict}", hint="calibrate from photos of the kind you capture")


def _rectified(
    capture: Capture, photos: PhotoPair, facts: CaptureFacts, *, recipe: Recipe, rig: StoredRig | None
) -> tuple[tuple[RectifiedPair, float], Alignment | None]:
    """Return the pair at its working size with its scale and, where a rig was needed, its geometry to the photos."""
    if rig is None:
        labels = (str(capture.tele_path), str(capture.wide_path))
        return at_working_size(pair_from_photos(photos, labels=labels, facts=facts), recipe.working_width_px), None
    rectified, alignment = align_photos(
        photos,
        rig=rig.rig,
        working_width_px=recipe.working_width_px,
        facts=read_shot_facts(capture),
        seed=recipe.seed,
    )
    return (rectified.pair, alignment.geometry.scale), alignment


def at_working_size(pair: RectifiedPair, width_px: int) -> tuple[RectifiedPair, float]:
    """Shrink a pair that is wider than the working size.

    Args:
        pair: two views of one size.
        width_px: the largest width to match at.

    Returns:
        The pair, and its scale: px of it for one px of the given pair.

    Raises:
        InputError: too little of its height is left.
    """
    width = pair.tele.shape[1]
    if width <= width_px:
        return pair, 1.0
    height_px, _ = narrowed_hw(pair.tele.shape[:2], width_px=width_px)
    if height_px < MIN_SIDE_PX:
        raise InputError(
            f"at the working width of {width_px} px the views are {height_px} px high; "
            f"{MIN_SIDE_PX} or more were expected",
            hint="crop the photos to a less narrow view, or state a larger working_width_px",
        )
    tele, wide = (resize_bicubic(view, wh=(width_px, height_px)) for view in (pair.tele, pair.wide))
    return RectifiedPair(pair.name, tele, wide), width_px / width
