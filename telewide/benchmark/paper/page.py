"""The page of a table: its blocks, 3PE against factor and against stage, and the pictures."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from telewide.benchmark.paper.means import Key, Mean, mean_errors, paper_blocks
from telewide.benchmark.paper.pictures import Sheet
from telewide.benchmark.paper.system import BEST
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Column, Table
from telewide.benchmark.report import BenchmarkReport
from telewide.capture.images import read_image
from telewide.pages.axes import Axis, axis_over
from telewide.pages.page import write_page
from telewide.pages.plots import Series, series_plot
from telewide.pages.report import ReportRow, thumbnail

STAGE_OF = {"basenet": 0, "method-k1": 1, "method-k2": 2, "method": 3}
"""Stages that systems end with."""
_MOST_SHEETS = 40
_SHEET_PX = 1400
_SUMMARY = (
    "3PE in per cent / EPE in px, means over scenes and seeds: the last weights and, as columns of their own, those "
    "best on validation; the published value stands in brackets. Pixels that both views see stand apart, where known."
)


def write_paper_page(path: Path, table: Table, report: BenchmarkReport, *, sheets: Sequence[Sheet]) -> Path:
    """Write the page of a table as one HTML file.

    Args:
        path: of the file.
        table: systems, columns and published values.
        report: the scores.
        sheets: pictures below the folder of the file; of many the first are shown.

    Returns:
        The path.
    """
    means = mean_errors(report.rows)
    rest = len(sheets) - _MOST_SHEETS
    further = [f"{rest} further sheets of pictures lie in {sheets[0].path.parent.name}."] if rest > 0 else []
    return write_page(
        path,
        "paper.html.j2",
        title=table.title,
        summary=_SUMMARY,
        blocks=paper_blocks(table, report.rows),
        plots=[*factor_plots(table, means), *stage_plots(table, means)],
        rows=[_shown(sheet, path.parent) for sheet in sheets[:_MOST_SHEETS]],
        notes=[*report.notes, *further],
        facts=_facts(report),
    )


def factor_plots(table: Table, means: Mapping[Key, Mean]) -> Iterator[Markup]:
    """Draw 3PE against the factor, for each data set and damage that has several; published values dashed."""
    for data_set, damage in dict.fromkeys((column.data_set, column.damage) for column in table.columns):
        columns = [(i, c) for i, c in enumerate(table.columns) if (c.data_set, c.damage) == (data_set, damage)]
        series = []
        for colour, system in enumerate(dict.fromkeys(key[0] for key in means)):
            ours = [(column.factor, _ours(means, system, column)) for _, column in columns]
            published = [(column.factor, _published(table, system, i)) for i, column in columns]
            series += _pair_of_series(SYSTEMS[system].title, ours, published, colour=colour)
        factors = [column.factor for _, column in columns]
        if series and len(factors) > 1:
            x = Axis("factor", min(factors) - 0.5, max(factors) + 0.5)
            yield _plot(series, x, f"{data_set}, {damage}: 3PE against the factor; dashed as published")


def stage_plots(table: Table, means: Mapping[Key, Mean]) -> Iterator[Markup]:
    """Draw 3PE against the stage of self-boosting, for each data set; published values dashed."""
    present = [system for system in STAGE_OF if any(key[0] == system for key in means)]
    for data_set in dict.fromkeys(column.data_set for column in table.columns):
        columns = [(i, column) for i, column in enumerate(table.columns) if column.data_set == data_set]
        series = []
        for colour, (i, column) in enumerate(columns):
            ours = [(float(STAGE_OF[system]), _ours(means, system, column)) for system in present]
            published = [(float(STAGE_OF[system]), _published(table, system, i)) for system in STAGE_OF]
            title = f"{column.damage} x{column.factor:g}"
            series += _pair_of_series(title, ours, published, colour=colour)
        if series and len(present) > 2:
            x = Axis("stages of self-boosting", -0.2, max(STAGE_OF.values()) + 0.2)
            yield _plot(series, x, f"{data_set}: 3PE against the stage; dashed as published")


def _pair_of_series(
    title: str, ours: Sequence[tuple[float, float]], published: Sequence[tuple[float, float]], *, colour: int
) -> list[Series]:
    """Ours and, dashed, what is published, as far as there is any."""
    named = ((title, ours, False), (f"{title}, published", published, True))
    found = [Series(label, np.array(points), colour, is_dashed) for label, points, is_dashed in named if len(points)]
    return [each for each in found if np.isfinite(each.points).all(axis=1).any()]


def _plot(series: Sequence[Series], x: Axis, caption: str) -> Markup:
    values = np.concatenate([each.points[:, 1] for each in series])
    return series_plot(series, x=x, y=axis_over(values.tolist(), label="3PE, %"), caption=caption)


def _ours(means: Mapping[Key, Mean], system: str, column: Column) -> float:
    """3PE of the last weights, or of those that have no name."""
    found = [mean for key, mean in means.items() if (key[0], key[2]) == (system, column.heading) and key[1] != BEST]
    return found[0].off_3px_5percent if found else float("nan")


def _published(table: Table, system: str, index: int) -> float:
    values = table.rows.get(system)
    value = None if values is None else values[index]
    return float("nan") if value is None else value.off_3px_5percent


def _shown(sheet: Sheet, root: Path) -> ReportRow:
    link = sheet.path.relative_to(root).as_posix()
    picture = thumbnail("disparity and error of each system", read_image(sheet.path), longest_px=_SHEET_PX, link=link)
    return ReportRow(f"{sheet.column}: {sheet.scene}", (picture,))


def _facts(report: BenchmarkReport) -> dict[str, str]:
    facts = {**report.options, **report.machine}
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in facts.items()}
