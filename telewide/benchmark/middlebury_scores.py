"""Errors against the truth of Middlebury 2006, the other camera made soft.

Third-size scenes, the right view shrunk and enlarged again; disparities 0 to 80 px; all pixels with known truth count
but those of the first 53 columns, whose partners mostly lie outside the other view. Maps are filled, and judged as
they come from the matcher and after :func:`telewide.depth.edges.follow_edges`.
3PE is the share of pixels off by more than 3 px and by more than 5 % of the truth; EPE the mean absolute error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.middlebury import read_middlebury_2006, write_middlebury_captures
from telewide.benchmark.datasets.protocols import find_protocol
from telewide.benchmark.reliability import (
    Reliability,
    count_reliability,
    hidden_row,
    reliability_rows,
    reliability_tables,
)
from telewide.benchmark.report import BenchmarkReport, markdown_table, number
from telewide.benchmark.scores import Score, score_pixels
from telewide.capture.pair import RectifiedPair, find_captures, read_pair, read_truth
from telewide.depth.edges import follow_edges
from telewide.errors import InputError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.matcher import Matcher

PUBLISHED = (
    "for comparison: on six other scenes of Middlebury at x4 the authors of the method that the recipe paper follows "
    "report 8.72 % / 1.36 px for its stage 0, 5.78 % / 1.09 px for its last, 8.87 % / 1.54 px for semi-global matching"
)
"""Chen et al., CVPR 2022, bicubic degradation; see the README for what differs."""
PROTOCOL = "middlebury-2006-third"
"""Of `telewide.benchmark.datasets.protocols`: splits, window and left-out columns."""
SCALE_DENOMINATOR = 3
Row = Mapping[str, object]
MEAN = "mean"


def score_map(estimate_px: FloatMap, truth_px: FloatMap, *, left_out_columns: int) -> Score:
    """Judge a filled map.

    Args:
        estimate_px: (H, W) disparity, px.
        truth_px: (H, W) disparity, px; NaN where unknown.
        left_out_columns: first columns that do not count.
    """
    counts = np.zeros(truth_px.shape, dtype=np.bool_)
    counts[:, left_out_columns:] = True
    return score_pixels(estimate_px, truth_px, counts)


def benchmark_middlebury(
    data_root: Path,
    contenders: Sequence[Matcher],
    *,
    scenes: Sequence[str],
    factor: float,
    captures: Path,
    tell: Callable[[str], None],
) -> BenchmarkReport:
    """Judge matchers on scenes with known disparity.

    Args:
        data_root: holds one folder per scene.
        contenders: what to judge.
        scenes: names of the scenes.
        factor: how many times fewer pixels the soft view has along each side.
        captures: folder to write the pairs to.
        tell: hears how far it is.

    Returns:
        A row for each matcher, with and without followed edges, and scene; then the mean over the scenes. Further rows
        tell how reliable confidence is, and what is called hidden.

    Raises:
        UsageError: a scene that is not there.
        InputError: a file cannot be read.
    """
    protocol = find_protocol(PROTOCOL)
    window, left_out_columns = protocol.window_px or (0, 0), protocol.left_out_columns
    write_middlebury_captures(data_root, captures, scenes=scenes, factor=factor, scale_denominator=SCALE_DENOMINATOR)
    found = {capture.name: capture for capture in find_captures(captures).captures}
    rows: list[Row] = []
    reliability: dict[str, list[Reliability]] = {}
    for scene in scenes:
        pair, truth_px = read_pair(found[scene]), read_truth(found[scene])
        if truth_px is None:
            raise InputError(f"{captures / scene} was written and has no truth")
        occluded = read_middlebury_2006(data_root / scene, scale_denominator=SCALE_DENOMINATOR).occluded
        for contender in contenders:
            tell(f"{scene}: {contender.name}")
            disparity = contender.match(pair.tele, pair.wide, window=window)
            for follows, estimate_px in ((False, disparity.disparity_px), (True, _followed(disparity, pair))):
                score = score_map(estimate_px, truth_px, left_out_columns=left_out_columns)
                errors = (score.off_3px_5percent, score.end_point_error_px)
                rows.append(_row(contender.name, scene, errors, follows=follows))
            counted = count_reliability(disparity, truth_px, occluded=occluded, left_out_columns=left_out_columns)
            reliability.setdefault(contender.name, []).append(counted)
    options = {"scenes": list(scenes), "factor": factor, "window": window, "skipped_columns": left_out_columns}
    judged = tuple(_with_means(rows))
    return BenchmarkReport("middlebury", options, judged, notes=(PUBLISHED,), further=_further(reliability))


def _further(reliability: Mapping[str, Sequence[Reliability]]) -> dict[str, tuple[Row, ...]]:
    """Rows of the scenes of each matcher together."""
    counts = {name: reduce(Reliability.__add__, of_scenes) for name, of_scenes in reliability.items()}
    return {
        "reliability": tuple(row for name, counted in counts.items() for row in reliability_rows(name, counted)),
        "hidden": tuple(hidden_row(name, counted) for name, counted in counts.items()),
    }


def middlebury_table(report: BenchmarkReport) -> str:
    """Set a report in Markdown: 3PE in per cent / EPE in px; a line for each matcher, with and without edges.

    Below are the tables of `reliability_tables`, of the maps as matched.
    """
    scenes = list(dict.fromkeys(str(row["scene"]) for row in report.rows))
    cells = {(row["matcher"], row["follow_edges"], row["scene"]): _cell(row) for row in report.rows}
    keys = dict.fromkeys((row["matcher"], row["follow_edges"]) for row in report.rows)
    lines = [
        [f"{name}, edges followed" if follows else str(name), *(cells[name, follows, scene] for scene in scenes)]
        for name, follows in keys
    ]
    errors = markdown_table(["3PE % / EPE px", *scenes], lines)
    return f"{errors}\n\n{reliability_tables(report.further['reliability'], report.further['hidden'])}"


def _followed(disparity: DisparityMap, pair: RectifiedPair) -> FloatMap:
    return follow_edges(disparity.disparity_px, pair.tele, confidence=disparity.confidence, valid=disparity.valid)


def _row(matcher: str, scene: str, errors: tuple[float, float], *, follows: bool) -> Row:
    return {"matcher": matcher, "follow_edges": follows, "scene": scene, "3PE": errors[0], "EPE_px": errors[1]}


def _mean(rows: Sequence[Row], key: str) -> float:
    return float(np.mean([float(str(row[key])) for row in rows]))


def _with_means(rows: Sequence[Row]) -> list[Row]:
    """The rows, and after them the means over the scenes."""
    variants = dict.fromkeys((str(row["matcher"]), bool(row["follow_edges"])) for row in rows)
    means = []
    for matcher, follows in variants:
        mine = [row for row in rows if (row["matcher"], row["follow_edges"]) == (matcher, follows)]
        means.append(_row(matcher, MEAN, (_mean(mine, "3PE"), _mean(mine, "EPE_px")), follows=follows))
    return [*rows, *means]


def _cell(row: Row) -> str:
    return f"{100 * float(str(row['3PE'])):.2f} / {number(row['EPE_px'], '.2f')}"
