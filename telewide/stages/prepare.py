"""From captures to corrected pairs: read, measure, correct, and keep the result in the run folder.

    run/pairs/<name>/{tele,wide}.png   corrected pair at the working size
    run/pairs/<name>/pair.json         what was measured, and from which files it was made
    run/pairs/<name>/shot.json         with a rig: what moved in this shot
    run/pairs/<name>/matches.npz       matches, in corrected coordinates: fitted to, and held out

With a rig the photos are rectified first, corrected for what moved in this shot; without one they are taken for
rectified. A pair whose files and options have not changed is taken as it lies there.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from telewide.calibration.rig_file import StoredRig
from telewide.capture.exif import image_pipeline, pipeline_conflict
from telewide.capture.facts import FACTS_FILE
from telewide.capture.images import focal_length_mm, resize_bicubic, write_image, write_pfm
from telewide.capture.importer import is_imported
from telewide.capture.lenses import with_checked_lenses
from telewide.capture.pair import Capture, CaptureFacts, CaptureSet, Problem, RectifiedPair, read_pair, read_photos
from telewide.correction.blur import BlurEstimate, damage_range, fit_blur
from telewide.correction.verdict import (
    MIN_COMMON_MATCHES,
    CorrectedPair,
    PairReport,
    correct_pair,
    disparity_window,
    inspect_pair,
)
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, replacing, write_text
from telewide.geometry.stereo import FloatMap
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import VOLUME_STEP_PX, Window, joined_window
from telewide.points.held_out import HeldOut
from telewide.points.matches import find_matches
from telewide.recipe import Recipe
from telewide.stages.align import (
    Alignment,
    align_photos,
    alignment_as_json,
    alignment_from_json,
    plain_rig,
    read_shot_facts,
)
from telewide.stages.run_folder import RunFolder
from telewide.training.samples import LABELS_PREFIX, labels_path

FORMAT = 5
RECORD_NAME = "pair.json"
SHOT_NAME = "shot.json"
LABEL_CONFIDENCE = 0.5


@dataclass(frozen=True)
class PreparedPair:
    """A corrected pair in the run folder.

    Attributes:
        source: the capture it was made from.
        capture: the corrected pair, to be read like a capture.
        report: what was measured on the photos.
        scale: working size over the photo's size.
        held_out: its matches that no fit has seen.
        alignment: how the corrected pair lies to the photos; None where they were rectified when they came.
        blur: how much softer wide is; None where matches are too few to tell.
    """

    source: Capture
    capture: Capture
    report: PairReport
    scale: float
    held_out: HeldOut
    alignment: Alignment | None = None
    blur: BlurEstimate | None = None


@dataclass(frozen=True)
class PreparedSet:
    """All usable pairs of a capture folder.

    Attributes:
        pairs: sorted by name, never empty.
        facts: what the owner states.
        stated_window: disparities to search that the recipe states, px at the working size; None for measured ones.
        problems: captures left out, and why.
        rig: what the photos were rectified with; None without.
    """

    pairs: tuple[PreparedPair, ...]
    facts: CaptureFacts
    stated_window: Window | None
    problems: tuple[Problem, ...]
    rig: StoredRig | None = None

    @property
    def window(self) -> Window:
        """Disparities to search: stated, or measured on all pairs.

        Raises:
            InputError: nothing states them, and there are too few matches to measure them.
        """
        try:
            return self.stated_window or disparity_window([pair.report for pair in self.pairs], step_px=VOLUME_STEP_PX)
        except InputError as error:
            if self.rig is not None or self.facts.rectified:
                raise
            hint = f"photos as they were taken need a rig, {_how_to_calibrate(Path('CAPTURES'))}; or {error.hint}"
            raise InputError(error.message, hint=hint) from error

    def window_with(self, former: Window | None) -> Window:
        """Disparities to search by what has searched other captures before.

        Args:
            former: what it was trained for or has searched, px; None where nothing is known.

        Returns:
            The stated window, or one that holds both the former and what these pairs need, px.

        Raises:
            InputError: nothing states, measures or remembers a window.
        """
        if former is None or self.stated_window is not None:
            return self.window
        try:
            return joined_window((former, self.window))
        except InputError:  # too few matches to measure by
            return former

    @property
    def damage_factor(self) -> tuple[float, float] | None:
        """By how much wide is coarser, least and most over the pairs, as measured; None where nothing tells."""
        damage = damage_range([pair.blur for pair in self.pairs if pair.blur is not None])
        return None if damage is None else damage.factor


Tick = Callable[[PairReport | None], None]


def refuse_without_rig(captures: CaptureSet, *, rig: StoredRig | None) -> None:
    """Stop before anything is computed where photos straight from a phone have no rig.

    Args:
        captures: what was found.
        rig: what there is to rectify with.

    Raises:
        InputError: no rig lies by them, and they are stated not to be rectified, or all were imported and nobody states
            that they are rectified.
    """
    if rig is None and captures.facts.rectified is False:
        raise InputError(
            f"{captures.root / FACTS_FILE} states that the captures are not rectified, and no rig.yaml lies by them to "
            "rectify them with",
            hint=f"{_how_to_calibrate(captures.root)}; or name a rig with --rig",
        )
    folders = [capture.tele_path.parent for capture in captures.captures]
    if rig is None and not captures.facts.rectified and folders and all(map(is_imported, folders)):
        raise InputError(
            f"{captures.root} holds photos as the phone took them, and no rig.yaml lies by them to rectify them with",
            hint=f"{_how_to_calibrate(captures.root)}; if they are rectified, state rectified: true in "
            f"{captures.root / 'captures.yaml'}",
        )


def _how_to_calibrate(root: Path) -> str:
    return (
        "calibrate first: telewide calibrate boards/ from photos of a board, or without a board: "
        f"telewide calibrate {root} --from-scenes"
    )


def prepare_captures(
    captures: CaptureSet, run: RunFolder, *, recipe: Recipe, rig: StoredRig | None = None, tick: Tick | None = None
) -> PreparedSet:
    """Correct every capture of a set.

    Args:
        captures: what was found.
        run: where the pairs are kept.
        recipe: what is corrected; the working size; the window, where it states one.
        rig: what to rectify with; None for captures that are rectified.
        tick: called after each capture, with its report or None where it was left out.

    Returns:
        The pairs that can be used. Bad captures are among its problems.

    Raises:
        InputError: none can be used.
    """
    captures = with_checked_lenses(captures)
    pairs: list[PreparedPair] = []
    problems = list(captures.problems)
    for capture in captures.captures:
        try:
            prepared = _prepare_pair(capture, captures.facts, run, recipe=recipe, rig=rig)
        except (InputError, UsageError) as error:
            problems.append(Problem(capture.name, f"{error.message}; {error.hint}" if error.hint else error.message))
            prepared = None
        if prepared is not None and prepared.report.verdict == "refused":
            problems.append(Problem(capture.name, "; ".join(prepared.report.reasons)))
        elif prepared is not None:
            pairs.append(prepared)
            problems += _what_is_cut_off(prepared.report, recipe.window_px)
        if tick is not None:
            tick(prepared.report if prepared is not None else None)
    if not pairs:
        lines = "".join(f"\n  {problem.name}: {problem.message}" for problem in problems)
        hint = "mend the captures named above"
        if rig is None and not captures.facts.rectified:
            hint += f"; photos as they were taken need a rig, {_how_to_calibrate(captures.root)}"
        raise InputError(f"{captures.root}: no capture can be used{lines}", hint=hint)
    return PreparedSet(tuple(pairs), captures.facts, recipe.window_px, tuple(problems), rig)


def _what_is_cut_off(report: PairReport, stated: Window | None) -> list[Problem]:
    """A note where a stated window ends before the disparities of a capture do."""
    low_px, high_px = report.disparity_p02_px, report.disparity_p98_px
    if stated is None or report.n_matches < MIN_COMMON_MATCHES or (stated[0] <= low_px and high_px < stated[1]):
        return []
    message = (
        f"its matches lie at {low_px:.0f} to {high_px:.0f} px, and the recipe states window_px: {list(stated)}: depth "
        "of what lies beyond is wrong"
    )
    return [Problem(report.name, message, is_skipped=False)]


def _prepare_pair(
    capture: Capture, facts: CaptureFacts, run: RunFolder, *, recipe: Recipe, rig: StoredRig | None
) -> PreparedPair:
    folder = run.pairs / capture.name
    key = _key_of(capture, facts, recipe, rig)
    kept = _read_kept(capture, folder, key=key, recipe=recipe, rig=rig)
    if kept is not None:
        return kept
    if rig is None and not facts.rectified:
        _refuse_to_lose_the_rig(folder, key)
    (pair, scale), alignment = _rectified(capture, facts, recipe=recipe, rig=rig)
    matches = find_matches(pair.tele, pair.wide)
    focal_lengths_mm = (focal_length_mm(capture.tele_path), focal_length_mm(capture.wide_path))
    stated = facts if alignment is None else dataclasses.replace(facts, rectified=True)
    report = inspect_pair(pair, facts=stated, matches=matches, focal_lengths_mm=focal_lengths_mm)
    if alignment is not None:
        report = with_doubts(report, alignment.notes)
    corrected = correct_pair(
        pair,
        matches=matches,
        seed=recipe.seed,
        # What the fit of this shot has left is not worth a second resampling.
        has_vertical=recipe.correction.vertical and not (alignment and alignment.refinement.is_fitted),
        has_colour=recipe.correction.colour,
    )
    # Whatever happens until the new record is written, the old one must not vouch for new files.
    (folder / RECORD_NAME).unlink(missing_ok=True)
    _write_pair(folder, corrected)
    blur = fit_blur(corrected.pair.tele, corrected.pair.wide, corrected.matches_fit)
    content = {
        "key": key,
        "scale": scale,
        "report": dataclasses.asdict(report),
        "colour": {
            "parts": corrected.colour.parts,
            "delta_e_before": corrected.colour.delta_before,
            "delta_e_after": corrected.colour.delta_after,
        },
        "blur": None if blur is None else dataclasses.asdict(blur),
    }
    if alignment is not None:
        write_text(folder / SHOT_NAME, alignment_as_json(alignment))
    write_text(folder / RECORD_NAME, json.dumps(content, indent=2))
    kept = _read_kept(capture, folder, key=key, recipe=recipe, rig=rig)
    if kept is None:
        raise InputError(f"{folder / 'pair.json'} was written and cannot be read back")
    return kept


def with_doubts(report: PairReport, doubts: Sequence[str]) -> PairReport:
    """Add sentences to the reasons of a report, whatever its verdict; a good one is then usable."""
    verdict = "usable" if doubts and report.verdict == "good" else report.verdict
    return dataclasses.replace(report, verdict=verdict, reasons=(*report.reasons, *doubts))


def _refuse_to_lose_the_rig(folder: Path, key: dict[str, object]) -> None:
    """Photos that a rig once rectified are no less in need of it where it is not found any more."""
    try:
        former = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))["key"]
        are_the_same = all(former[name] == key[name] for name in ("tele_sha256", "wide_sha256"))
        had_rig = former["rig"] is not None
    except (OSError, ValueError, KeyError, TypeError):
        return
    if had_rig and are_the_same:
        raise InputError(
            "these photos were rectified with a rig, which is not found any more",
            hint=f"name it with --rig; if none is wanted, remove {folder}",
        )


def _rectified(
    capture: Capture, facts: CaptureFacts, *, recipe: Recipe, rig: StoredRig | None
) -> tuple[tuple[RectifiedPair, float], Alignment | None]:
    """The pair at its working size, with the scale of that; how it lies to the photos, where a rig was needed."""
    if rig is None:
        return _at_working_size(read_pair(capture, facts=facts), recipe.working_width_px), None
    if rig.facts.image_pipeline is not None:
        for path in (capture.tele_path, capture.wide_path):
            conflict = pipeline_conflict(rig.facts.image_pipeline, image_pipeline(path))
            if conflict is not None:
                raise InputError(f"{path}: {conflict}", hint="calibrate from photos of the kind you capture")
    rectified, alignment = align_photos(
        read_photos(capture),
        rig=rig.rig,
        working_width_px=recipe.working_width_px,
        facts=read_shot_facts(capture),
        seed=recipe.seed,
    )
    return (rectified.pair, alignment.geometry.scale), alignment


def _write_pair(folder: Path, corrected: CorrectedPair) -> None:
    write_image(folder / "tele.png", corrected.pair.tele)
    write_image(folder / "wide.png", corrected.pair.wide)
    with replacing(folder / "matches.npz") as temporary:
        np.savez(
            temporary,
            held_out_ref_px=corrected.matches_held_out.ref_px,
            held_out_src_px=corrected.matches_held_out.src_px,
            fitted_ref_px=corrected.matches_fit.ref_px,
            fitted_src_px=corrected.matches_fit.src_px,
        )
    for labels in folder.glob(f"{LABELS_PREFIX}*"):
        labels.unlink()


def _key_of(capture: Capture, facts: CaptureFacts, recipe: Recipe, rig: StoredRig | None) -> dict[str, object]:
    """What a prepared pair depends on."""
    return {
        "format": FORMAT,
        "tele_sha256": fingerprint(capture.tele_path),
        "wide_sha256": fingerprint(capture.wide_path),
        "facts": dataclasses.asdict(facts),
        "rig": None if rig is None else plain_rig(rig.rig),
        "correction": recipe.correction.model_dump(),
        "working_width_px": recipe.working_width_px,
        "seed": recipe.seed,
    }


def _read_kept(
    capture: Capture, folder: Path, *, key: dict[str, object], recipe: Recipe, rig: StoredRig | None
) -> PreparedPair | None:
    """The pair as an earlier call left it, or None where it is not there or was made from something else."""
    try:
        content = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
        if content["key"] != json.loads(json.dumps(key)):
            return None
        report = PairReport(**{**content["report"], "reasons": tuple(content["report"]["reasons"])})
        with np.load(folder / "matches.npz", allow_pickle=False) as matches:
            ref_px, src_px = matches["held_out_ref_px"], matches["held_out_src_px"]
        blur = None if content["blur"] is None else _blur_from_plain(content["blur"])
        alignment = None
        if rig is not None:
            text = (folder / SHOT_NAME).read_text(encoding="utf-8")
            alignment = alignment_from_json(text, rig=rig.rig, working_width_px=recipe.working_width_px)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    corrected = Capture(capture.name, folder / "tele.png", folder / "wide.png")
    if not (corrected.tele_path.is_file() and corrected.wide_path.is_file()):
        return None
    held_out = HeldOut(corrected, ref_px, ref_px[:, 0] - src_px[:, 0])
    return PreparedPair(capture, corrected, report, float(content["scale"]), held_out, alignment, blur)


def _blur_from_plain(plain: dict[str, Any]) -> BlurEstimate:
    return BlurEstimate(**{**plain, "sigma_px": tuple(plain["sigma_px"]), "sigma_std_px": tuple(plain["sigma_std_px"])})


def _at_working_size(pair: RectifiedPair, width_px: int) -> tuple[RectifiedPair, float]:
    height, width = pair.tele.shape[:2]
    if width <= width_px:
        return pair, 1.0
    wh = (width_px, round(height * width_px / width))
    tele, wide = (resize_bicubic(view, wh=wh) for view in (pair.tele, pair.wide))
    return RectifiedPair(pair.name, tele, wide), width_px / width


def write_labels(
    prepared: PreparedSet, *, names: Iterable[str], window: Window, tick: Callable[[], None] | None = None
) -> None:
    """Write the confident semi-global disparities of some pairs, to teach by; those that are there stay.

    Args:
        prepared: the pairs.
        names: of the pairs that training will see.
        window: disparities to search, px at the working size.
        tick: called after each.
    """
    wanted = set(names)
    for item in prepared.pairs:
        path = labels_path(item.capture.tele_path.parent, window_px=window)
        if item.capture.name in wanted and not path.is_file():
            pair = read_pair(item.capture)
            write_pfm(path, _confident(pair, window))
        if tick is not None:
            tick()


def _confident(pair: RectifiedPair, window: Window) -> FloatMap:
    matched = match_semiglobal(pair.tele, pair.wide, window=window)
    is_sure = matched.valid & (matched.confidence >= LABEL_CONFIDENCE)
    return np.where(is_sure, matched.disparity_px, np.nan).astype(np.float32)
