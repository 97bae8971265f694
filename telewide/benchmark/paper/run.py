"""One table of the publication: its cells computed or taken as they are kept, and set beside the published values."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from telewide.benchmark.damages import load_damages
from telewide.benchmark.paper.cells import Cells, Row, Wanted, plan_column
from telewide.benchmark.paper.system import BEST, Budget, System, Tell
from telewide.benchmark.paper.systems import SYSTEMS, find_systems
from telewide.benchmark.paper.tables import Column, Published, Table
from telewide.benchmark.report import BenchmarkReport, markdown_table, number, write_report_json
from telewide.cores import Device
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
        budget: of each training.
        seeds: 0 to one less than this are used, and the mean is shown.
        device: to compute on: auto, cpu or cuda.
        restorer_weights: files to take by the name of a restorer, instead of training it.
    """

    data_root: Path
    out: Path
    systems: tuple[str, ...] = ()
    damages: tuple[str, ...] = ()
    budget: Budget = field(default_factory=lambda: Budget(DEFAULT_BUDGET_MIN))
    seeds: int = 1
    device: Device = "auto"
    restorer_weights: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)


_Means = tuple[float, float, float]


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
            wanted = Wanted(
                options.data_root,
                known,
                seed,
                budget=options.budget,
                device=options.device,
                restorer_weights=options.restorer_weights,
            )
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
    facts = {"table": table.name, "budget": str(options.budget), "seeds": options.seeds, "device": options.device}
    return BenchmarkReport(f"paper {table.name}", facts, tuple(rows), tuple(notes))


def paper_table(table: Table, report: BenchmarkReport) -> str:
    """Set a report in Markdown, data set by data set: 3PE in per cent / EPE in px, means over scenes and seeds.

    Where a system has them, the last weights and those best on validation are two columns; the published value stands
    in brackets beside the first.
    """
    cells = _means(report.rows)
    data_sets = dict.fromkeys(column.data_set for column in table.columns)
    blocks = [_block(table, cells, data_set) for data_set in data_sets]
    return "\n\n".join(block for block in blocks if block)


def _block(table: Table, cells: Mapping[tuple[str, str, str], _Means], data_set: str) -> str:
    """The part of a table that is of one data set; nothing where it has no cell."""
    columns = [
        (index, column, weights)
        for index, column in enumerate(table.columns)
        for weights in ("", BEST)
        if column.data_set == data_set and any(_is_of(key, column, weights) for key in cells)
    ]
    if not columns:
        return ""
    lines = []
    for system in dict.fromkeys(key[0] for key in cells):
        published = table.rows.get(system) or (None,) * len(table.columns)
        line = [
            _cell(
                next((cells[key] for key in cells if key[0] == system and _is_of(key, column, weights)), None),
                None if weights else published[index],
            )
            for index, column, weights in columns
        ]
        lines.append([SYSTEMS[system].title, *line])
    names = [f"{column.damage} x{column.factor:g}{', best' if weights else ''}" for _, column, weights in columns]
    return f"**{data_set}**\n\n{markdown_table(['3PE % / EPE px', *names], lines)}"


def _is_of(key: tuple[str, str, str], column: Column, weights: str) -> bool:
    """Whether a mean belongs to a column of the best weights, or to one of all others."""
    return key[2] == column.heading and (key[1] == BEST) == (weights == BEST)


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
    budget = f"Budget of each training: {report.options['budget']}; seeds: {report.options['seeds']}."
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


def _means(rows: Sequence[Row]) -> dict[tuple[str, str, str], _Means]:
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


def _cell(ours: _Means | None, published: Published | None) -> str:
    shown = "-" if ours is None else f"{number(ours[0], '.2f')} / {number(ours[1], '.2f')}"
    if ours is not None and math.isfinite(ours[2]):
        shown += f" / {ours[2]:.2f} dB"
    return shown if published is None else f"{shown} ({published})"
