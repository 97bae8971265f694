"""Real pairs judged by marks made by hand: whether walls are flat, thin things stand and edges lie where they are seen.

Judged is the map that ``telewide depth`` writes: on the tele photo, filled, its edges followed. Every matcher searches
the same window on the same corrected pairs. px are those of photos of the size that the file of marks states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from telewide.benchmark.mark_scores import MarkScore, score_marks
from telewide.benchmark.mark_sheets import write_mark_sheet
from telewide.benchmark.marks import CaptureMarks, Marks
from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.benchmark.written import JudgedSet, judged_set
from telewide.capture.images import read_image
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import resize_disparity
from telewide.matching.matcher import Matcher
from telewide.recipe import Recipe
from telewide.stages.pairs import PreparedPair
from telewide.stages.run_folder import RunFolder
from telewide.text import first_few

MEAN = "mean"
_MEASURES = tuple(field.name for field in fields(MarkScore))
_SAME_SHAPE = 0.01


def benchmark_marks(
    captures_root: Path,
    contenders: Sequence[Matcher],
    marks: Marks,
    *,
    run: RunFolder,
    recipe: Recipe,
    tell: Callable[[str], None],
    rig: Path | None = None,
    sheets: Path | None = None,
) -> BenchmarkReport:
    """Judge matchers by marks on real pairs.

    Args:
        captures_root: folder of the captures.
        contenders: what to judge.
        marks: made by hand.
        run: its corrected pairs are used; they are made where they are missing.
        recipe: what is corrected.
        tell: hears how far it is.
        rig: rig file, or None for the one that lies by the captures.
        sheets: folder for a picture of each capture, those without marks too; None for none.

    Returns:
        A row for each matcher and marked capture; then, of each matcher, the mean over the captures.

    Raises:
        InputError: no capture can be used or none of them is marked, or a photo has another shape than the marked one.
        UsageError: the folder for the pictures cannot be made.
    """
    if sheets is not None:
        _make_folder(sheets)
    judged = judged_set(captures_root, contenders, run=run, recipe=recipe, rig=rig)
    prepared = judged.prepared
    names = {item.capture.name for item in prepared.pairs}
    if not names & marks.captures.keys():
        raise InputError(
            f"none of the captures in {captures_root} is marked",
            hint=f"the file holds marks of {first_few(sorted(marks.captures)) or 'nothing'}",
        )
    judge = _Judge(judged, tuple(contenders), marks, tell=tell)
    rows = [row for item in prepared.pairs for row in judge.rows_of(item, sheets=sheets)]
    notes = [f"{problem.name}: {problem.message}" for problem in prepared.problems]
    notes += [f"{name} is marked and is not among the captures" for name in sorted(marks.captures.keys() - names)]
    options = {
        "captures": sorted(names & marks.captures.keys()),
        "window": list(judged.window),
        "px_of_wh": marks.photo_wh,
    }
    return BenchmarkReport("marks", options, (*rows, *_means(rows, contenders)), tuple(notes))


def marks_table(report: BenchmarkReport) -> str:
    """Set the means of a report in Markdown, a line for each matcher."""
    headings = ("matcher", "planes: off px", "90 % px", "thin stand %", "edges within 2 px %", "within 7.5 px %")
    return markdown_table(headings, [_line(row) for row in report.rows if row["capture"] == MEAN])


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder} cannot be made: {error.strerror or error}", hint="name another folder") from error


def _marked_photo(item: PreparedPair, marks: Marks) -> FloatMap:
    photo = read_image(item.source.tele_path)
    height, width = photo.shape[:2]
    marked_width, marked_height = marks.photo_wh
    if abs(width * marked_height / (height * marked_width) - 1) > _SAME_SHAPE:
        raise InputError(
            f"{item.source.tele_path} has {width} x {height} px; its marks were made on a photo of {marked_width} x "
            f"{marked_height} px",
            hint="marks are of the very photos they were made on, at any size",
        )
    return photo


@dataclass(frozen=True)
class _Judge:
    """All that the judgement of every capture has alike."""

    judged: JudgedSet
    contenders: tuple[Matcher, ...]
    marks: Marks
    tell: Callable[[str], None]

    def rows_of(self, item: PreparedPair, *, sheets: Path | None) -> list[dict[str, object]]:
        """A row for each contender; none where the capture has no marks, which is still drawn if asked for."""
        name = item.capture.name
        of_capture = self.marks.captures.get(name)
        if of_capture is None and sheets is None:
            return []
        photo = _marked_photo(item, self.marks)
        maps_px: dict[str, FloatMap] = {}
        for contender in self.contenders:
            self.tell(f"{name}: {contender.name}")
            maps_px[contender.name] = self._written_map(item, contender, photo)
        if sheets is not None and maps_px:
            turned_deg = self.judged.prepared.facts.rotated_deg
            drawn = of_capture or CaptureMarks()
            write_mark_sheet(sheets / f"{name}.png", photo, drawn, maps_px=maps_px, rotated_deg=turned_deg)
        if of_capture is None:
            return []
        scores = {contender: score_marks(map_px, of_capture) for contender, map_px in maps_px.items()}
        return [{"matcher": contender, "capture": name, **asdict(score)} for contender, score in scores.items()]

    def _written_map(self, item: PreparedPair, contender: Matcher, photo: FloatMap) -> FloatMap:
        """(H, W) disparity as ``telewide depth`` writes it, at the size of the marks."""
        result = self.judged.depth(item, contender, photo=photo)
        return resize_disparity(result.disparity.disparity_px, wh=self.marks.photo_wh)


def _means(rows: Sequence[Mapping[str, object]], contenders: Sequence[Matcher]) -> list[dict[str, object]]:
    """Rows of the means over the captures that have marks of a kind."""
    means: list[dict[str, object]] = []
    for contender in contenders:
        values = np.array([[row[key] for key in _MEASURES] for row in rows if row["matcher"] == contender.name], float)
        counts = np.isfinite(values).sum(axis=0)
        sums = np.nansum(values, axis=0)
        mean = {key: float(s / n) if n else float("nan") for key, s, n in zip(_MEASURES, sums, counts, strict=True)}
        means.append({"matcher": contender.name, "capture": MEAN, **mean})
    return means


def _line(row: Mapping[str, object]) -> list[str]:
    planes = [number(row[key], ".2f") for key in ("plane_mean_px", "plane_p90_px")]
    shares = [float(str(row[key])) * 100 for key in ("thin_right", "edges_within_2px", "edges_found")]
    return [str(row["matcher"]), *planes, *(number(share, ".1f") for share in shares)]
