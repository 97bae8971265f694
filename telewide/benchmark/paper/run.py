"""One table of the publication: its cells computed or taken as they are kept, and set beside the published values."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.damages import load_damages
from telewide.benchmark.paper.cells import Cells, Row, Wanted, plan_column
from telewide.benchmark.paper.systems import SYSTEMS, System, Tell, find_systems
from telewide.benchmark.paper.tables import Published, Table
from telewide.benchmark.report import BenchmarkReport, markdown_table, number, write_report_json
from telewide.errors import InputError, UsageError
from telewide.files import write_text

DEFAULT_BUDGET_MIN = 8.0


@dataclass(frozen=True)
class PaperOptions:
    """Choices of one call.

    Attributes:
        data_root: holds the data sets.
        out: folder of the cells and tables.
        systems: names of rows; empty for those of the table that telewide has.
        damages: names of damages; empty for those of the table.
        budget_min: minutes of each training.
        seeds: 0 to one less than this are used, and the mean is shown.
    """

    data_root: Path
    out: Path
    systems: tuple[str, ...] = ()
    damages: tuple[str, ...] = ()
    budget_min: float = DEFAULT_BUDGET_MIN
    seeds: int = 1


def benchmark_table(table: Table, options: PaperOptions, *, tell: Tell) -> BenchmarkReport:
    """Compute the cells of a table that are not kept yet.

    Args:
        table: which one.
        options: with what.
        tell: hears how far it is.

    Returns:
        A row for each system, column, seed, scene, weights and region; notes say what is left out.

    Raises:
        UsageError: a system or damage that does not exist, or no data folder.
        InputError: none of the table's data sets is there, or no cell can be computed.
    """
    systems, notes = _systems(table, options.systems)
    known = load_damages()
    columns = [c for c in table.columns if not options.damages or c.damage in {d.upper() for d in options.damages}]
    if not columns:
        raise UsageError(f"{table.name} has none of the damages {', '.join(options.damages)}")
    plans = []
    for seed in range(options.seeds):
        for column in columns:
            wanted = Wanted(options.data_root, known, seed, options.budget_min)
            of_column, said = plan_column(column, systems, wanted)
            plans += of_column
            notes += [note for note in said if note not in notes]
    if not plans:
        raise InputError(f"no data set of the table {table.name} is in {options.data_root}", hint="; ".join(notes))
    rows: list[Row] = []
    cells = Cells(options.out, tell)
    for plan, scored in cells.rows(plans):
        asked = {"system": plan.system.name, "column": plan.column.heading, "seed": plan.task.seed}
        rows += [{**asked, **row} for row in scored]
    if not rows:
        raise InputError(f"no cell of the table {table.name} could be computed", hint="; ".join(cells.problems))
    notes += cells.problems
    facts = {"table": table.name, "budget_min": options.budget_min, "seeds": options.seeds}
    return BenchmarkReport(f"paper {table.name}", facts, tuple(rows), tuple(notes))


def paper_table(table: Table, report: BenchmarkReport) -> str:
    """Set a report in Markdown: 3PE in per cent / EPE in px, means over scenes and seeds; published in brackets."""
    cells = _means(report.rows)
    columns = [column for column in table.columns if any(column.heading == key[2] for key in cells)]
    lines = []
    for system, weights in dict.fromkeys((key[0], key[1]) for key in cells):
        title = SYSTEMS[system].title + (f", {weights} weights" if weights else "")
        published = dict(zip((c.heading for c in table.columns), table.rows.get(system, ()), strict=False))
        line = [_cell(cells.get((system, weights, c.heading)), published.get(c.heading)) for c in columns]
        lines.append([title, *line])
    return markdown_table(["3PE % / EPE px", *(column.heading for column in columns)], lines)


def write_table(table: Table, report: BenchmarkReport, out: Path) -> tuple[Path, ...]:
    """Write a table as Markdown, CSV and JSON.

    Args:
        table: which one.
        report: of `benchmark_table`.
        out: the folder.

    Returns:
        The files.
    """
    paths = tuple(out / f"{table.name}.{suffix}" for suffix in ("md", "csv", "json"))
    notes = "".join(f"\n- {note}" for note in report.notes)
    budget = f"Budget of each training: {report.options['budget_min']} min; seeds: {report.options['seeds']}."
    write_text(paths[0], f"# {table.title}\n\n{paper_table(table, report)}\n\n{budget}\n{notes}\n")
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(report.rows[0]) if report.rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(report.rows)
    write_text(paths[1], stream.getvalue())
    write_report_json(report, paths[2])
    return paths


def _systems(table: Table, names: Sequence[str]) -> tuple[list[System], list[str]]:
    if names:
        return find_systems(names), []
    absent = [name for name in table.rows if name not in SYSTEMS]
    notes = [f"rows that telewide cannot compute yet: {', '.join(absent)}"] if absent else []
    return [SYSTEMS[name] for name in table.rows if name in SYSTEMS], notes


def _means(rows: Sequence[Row]) -> dict[tuple[str, str, str], tuple[float, float, float]]:
    """3PE in per cent, EPE in px and PSNR of the features in dB by system, weights and column."""
    values: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row["region"] == "all":
            values.setdefault((str(row["system"]), str(row["weights"]), str(row["column"])), []).append(row)
    return {
        key: (100 * _mean(found, "off_3px_5percent"), _mean(found, "end_point_error_px"), _mean(found, "space_psnr_db"))
        for key, found in values.items()
    }


def _mean(rows: Sequence[Mapping[str, object]], key: str) -> float:
    values = [row[key] for row in rows]
    return float(np.mean([value if isinstance(value, int | float) else math.nan for value in values]))


def _cell(ours: tuple[float, float, float] | None, published: Published | None) -> str:
    shown = "-" if ours is None else f"{number(ours[0], '.2f')} / {number(ours[1], '.2f')}"
    if ours is not None and math.isfinite(ours[2]):
        shown += f" / {ours[2]:.2f} dB"
    return shown if published is None else f"{shown} ({published})"
