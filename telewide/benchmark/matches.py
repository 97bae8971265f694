"""Real pairs without a truth: how often matchers miss the matches that no fit and no training has seen.

Every matcher gets the same corrected pairs. Matches of all captures tell how a map fits the captures it was trained
on; those of the captures no training has seen, what a new photo would get. At an edge of depth a match may belong to
either surface, mostly the nearer one, and blames who draws the edge where it is: so those away from edges stand apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.calibration.rig_file import StoredRig
from telewide.capture.images import resize_bicubic
from telewide.capture.pair import CaptureFacts, CaptureSet, RectifiedPair, find_captures, read_pair
from telewide.errors import UsageError
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.matching.matcher import Matcher
from telewide.matching.window import Window, joined_window
from telewide.points.held_out import HeldOut, match_errors_px, sampled_at, summarise_errors
from telewide.recipe import Recipe
from telewide.stages.pairs import PreparedPair
from telewide.stages.prepare import prepare_captures
from telewide.stages.rig import locate_rig, refuse_without_rig
from telewide.stages.run_folder import RunFolder
from telewide.stages.training_record import read_training

UNCORRECTED = "uncorrected"
SETS = ALL, AWAY_FROM_EDGES, HELD_OUT = "all", "all, away from edges", "held out"
EDGE_STEP_PX, AWAY_PX = 1.5, 4.0
"""An edge is where a map steps by more than the first; a match is away from it beyond the second. On ten pairs of
Middlebury 2006 at x4, 29 % of the matches nearer to a true edge are off by more than 1 px, and 2 % of the others."""
_NONE_UNSEEN = "no capture is known to be unseen by every network, so all matches are of captures trained on"
_HELD_OUT_CHOSE = "held-out captures chose the best weights of each training: a new capture may fare slightly worse"


@dataclass(frozen=True)
class Entrant:
    """A contender and the pairs it is given.

    Attributes:
        contender: what makes the disparity.
        is_corrected: whether the pairs are corrected.
    """

    contender: Matcher
    is_corrected: bool = True

    @property
    def name(self) -> str:
        """As it stands in tables."""
        return self.contender.name if self.is_corrected else f"{self.contender.name}, {UNCORRECTED}"


def benchmark_matches(
    captures_root: Path,
    entrants: Sequence[Entrant],
    *,
    run: RunFolder,
    recipe: Recipe,
    tell: Callable[[str], None],
    trained_runs: Sequence[RunFolder] = (),
    rig: Path | None = None,
) -> BenchmarkReport:
    """Judge matchers by the held-out matches of real pairs.

    Args:
        captures_root: folder of the captures.
        entrants: what to judge.
        run: its corrected pairs and their matches are used; they are made where they are missing.
        recipe: what is corrected.
        tell: hears how far it is.
        trained_runs: their records say which captures no training has seen.
        rig: rig file, or None for the one that lies by the captures.

    Returns:
        A row for each entrant and set of matches: all, those away from the edges that any entrant draws, and those
        of captures that none of the runs has seen.

    Raises:
        UsageError: uncorrected pairs are asked for, and the captures are rectified with a rig.
        InputError: no capture can be used.
    """
    captures = find_captures(captures_root)
    prepared = prepare_captures(captures, run, recipe=recipe, rig=_suitable_rig(rig, captures, entrants))
    unseen = _unseen_captures(trained_runs)
    trained = [entrant.contender.window for entrant in entrants if entrant.contender.window is not None]
    window = joined_window([prepared.window, *trained])
    names = [item.capture.name for item in prepared.pairs]
    sets = {ALL: names, HELD_OUT: [name for name in names if name in unseen]}
    errors_px: dict[str, dict[str, list[FloatArray]]] = {label: {} for label in SETS}
    for item in prepared.pairs:
        tell(f"{item.capture.name}: {len(item.held_out.ref_px)} matches")
        maps_px = {e.name: _disparity_px(item, e, facts=prepared.facts, window=window) for e in entrants}
        for label, of_set_px in _errors_by_set(maps_px, item.held_out, is_unseen=item.capture.name in unseen).items():
            for name, values_px in of_set_px.items():
                errors_px[label].setdefault(name, []).append(values_px)
    notes = [f"{problem.name}: {problem.message}" for problem in prepared.problems]
    if trained_runs:
        notes.append(_HELD_OUT_CHOSE if sets[HELD_OUT] else _NONE_UNSEEN)
    return BenchmarkReport(
        "matches", {"captures": sets, "window": list(window)}, _rows(errors_px, entrants), tuple(notes)
    )


def _suitable_rig(stated: Path | None, captures: CaptureSet, entrants: Sequence[Entrant]) -> StoredRig | None:
    """The rig to rectify the captures with, where that leaves something to judge."""
    rig = locate_rig(stated, captures)
    refuse_without_rig(captures, rig=rig)
    if rig is not None and not all(entrant.is_corrected for entrant in entrants):
        raise UsageError(
            f"the captures in {captures.root} are rectified with a rig: without it no row of one photo is that of the "
            "other, and no match can be judged",
            hint=f"leave `{UNCORRECTED}` out",
        )
    return rig


def matches_table(report: BenchmarkReport) -> str:
    """Set a report in Markdown: a line for each entrant, first on all captures, then on the held-out ones."""
    headings = ("matcher", "captures", "matches", "off > 1 px %", "off > 3 px %", "mean px")
    return markdown_table(headings, [_line(row) for row in report.rows])


def _unseen_captures(runs: Sequence[RunFolder]) -> frozenset[str]:
    """Captures that none of the trainings has seen."""
    records = [record for record in map(read_training, runs) if record is not None]
    if not records or len(records) < len(runs):
        return frozenset()
    return frozenset.intersection(*(frozenset(record.held_out) for record in records))


def _disparity_px(item: PreparedPair, entrant: Entrant, *, facts: CaptureFacts, window: Window) -> FloatMap:
    pair = read_pair(item.capture) if entrant.is_corrected else _uncorrected(item, facts)
    return entrant.contender.match(pair.tele, pair.wide, window=window, valid=pair.valid).disparity_px


def _errors_by_set(
    maps_px: Mapping[str, FloatMap], held_out: HeldOut, *, is_unseen: bool
) -> dict[str, dict[str, FloatArray]]:
    """Errors of each map at the matches of one capture, by the set of matches."""
    of_all_px = {name: match_errors_px(map_px, held_out) for name, map_px in maps_px.items()}
    is_away = _is_away_from_edges(list(maps_px.values()), held_out)
    of_sets = {ALL: of_all_px, AWAY_FROM_EDGES: {name: values_px[is_away] for name, values_px in of_all_px.items()}}
    return {**of_sets, HELD_OUT: of_all_px} if is_unseen else {**of_sets}


def _is_away_from_edges(maps_px: Sequence[FloatMap], held_out: HeldOut) -> NDArray[np.bool_]:
    """Whether no map steps within `AWAY_PX` of each match."""
    square = np.ones((3, 3), np.uint8)
    steps_px = np.max([cv2.dilate(d, square) - cv2.erode(d, square) for d in maps_px], axis=0)
    is_smooth = (steps_px <= EDGE_STEP_PX).astype(np.uint8)
    # No edge at all leaves distances undefined.
    if is_smooth.all():
        return np.ones(len(held_out.ref_px), np.bool_)
    away_px = cv2.distanceTransform(is_smooth, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return sampled_at(away_px, held_out) > AWAY_PX


def _uncorrected(item: PreparedPair, facts: CaptureFacts) -> RectifiedPair:
    """The pair as it was photographed, at the working size; the correction moves rows only, so matches still hold."""
    height, width = read_pair(item.capture).tele.shape[:2]
    pair = read_pair(item.source, facts=facts.model_copy(update={"wide_side": item.wide_side}))
    if pair.tele.shape[:2] == (height, width):
        return pair
    tele, wide = (resize_bicubic(view, wh=(width, height)) for view in (pair.tele, pair.wide))
    return RectifiedPair(pair.name, tele, wide)


def _rows(
    errors_px: Mapping[str, Mapping[str, list[FloatArray]]], entrants: Sequence[Entrant]
) -> tuple[dict[str, object], ...]:
    return tuple(
        _row(entrant.name, _label(label, entrant), of_set_px[entrant.name])
        for label, of_set_px in errors_px.items()
        if of_set_px
        for entrant in entrants
    )


def _row(matcher: str, captures: str, errors_px: Sequence[FloatArray]) -> dict[str, object]:
    summary = summarise_errors(np.concatenate(errors_px))
    return {"matcher": matcher, "captures": captures, **summary, "matches": int(summary["matches"])}


def _label(captures: str, entrant: Entrant) -> str:
    """The captures of a row; a training was stopped where it did best on those that it held out."""
    return f"{captures}, chose the weights" if captures == HELD_OUT and entrant.contender.window else captures


def _line(row: Mapping[str, object]) -> list[str]:
    shares = [number(float(str(row[key])) * 100, ".2f") for key in ("off_1px", "off_3px")]
    return [str(row["matcher"]), str(row["captures"]), str(row["matches"]), *shares, number(row["mean_px"], ".3f")]
