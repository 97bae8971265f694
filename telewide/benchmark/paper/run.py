"""One table of the publication: its cells computed or taken as they are kept, and set beside the published values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from telewide.benchmark.damages import load_damages
from telewide.benchmark.paper.cells import CellPlan, Cells, Row, Wanted, plan_column
from telewide.benchmark.paper.pictures import Found, Sheet, kept_map, write_scene_sheet
from telewide.benchmark.paper.system import BEST, LAST, Budget, Prepared, System, Tell
from telewide.benchmark.paper.systems import SYSTEMS, find_systems
from telewide.benchmark.paper.tables import Table
from telewide.benchmark.report import BenchmarkReport, describe_machine
from telewide.cores import Device
from telewide.errors import InputError, UsageError
from telewide.training.processes import take_own_gpu, this_process

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
        weights: files of others to take, by the name of a restorer or of `psmnet`, instead of training it.
    """

    data_root: Path
    out: Path
    systems: tuple[str, ...] = ()
    damages: tuple[str, ...] = ()
    budget: Budget = field(default_factory=lambda: Budget(DEFAULT_BUDGET_MIN))
    seeds: int = 1
    device: Device = "auto"
    weights: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class PaperResult:
    """Scores and pictures of a table.

    Attributes:
        report: a row for each system, column, seed, scene, weights and region; notes say what is left out.
        sheets: a picture of each scene in each column.
    """

    report: BenchmarkReport
    sheets: tuple[Sheet, ...]


def benchmark_table(table: Table, options: PaperOptions, *, tell: Tell) -> PaperResult:
    """Compute the cells of a table that are not kept yet; of several processes each takes those that nobody is at.

    Args:
        table: which one.
        options: with what.
        tell: hears how far it is.

    Returns:
        Scores and pictures; of several processes those that do not write have no pictures.

    Raises:
        UsageError: a system or damage that does not exist, or no data folder.
        InputError: none of the table's data sets is there, or no cell can be computed.
    """
    plans, notes = planned_cells(table, options)
    processes = this_process()
    if processes.world > 1 and any(plan.system.learns for plan in plans):
        take_own_gpu(options.device)
    first = len(plans) * processes.rank // processes.world  # so that they do not ask for the same cells at once
    rows: list[Row] = []
    cells = Cells(options.out, tell)
    for plan, scored in cells.rows([*plans[first:], *plans[:first]]):
        asked = {"system": plan.system.name, "column": plan.column.heading, "seed": plan.task.seed}
        rows += [{**asked, **row} for row in scored]
    if not rows:
        raise InputError(f"no cell of the table {table.name} could be computed", hint="; ".join(cells.problems))
    facts = {"table": table.name, "budget": str(options.budget), "seeds": options.seeds, "device": options.device}
    report = BenchmarkReport(
        f"paper {table.name}",
        facts,
        tuple(rows),
        notes=(*notes, *cells.problems),
        machine=_machine(plans, options.device),
    )
    folder = options.out / table.name
    return PaperResult(report, tuple(_drawn(plans, cells, rows, folder=folder)) if processes.is_writer else ())


def _machine(plans: Sequence[CellPlan], device: Device) -> dict[str, object]:
    """State the machine and, where networks are asked, what they compute on."""
    machine = describe_machine()
    if any(plan.system.learns or plan.system.files for plan in plans):
        from telewide.benchmark.networks import device_facts

        machine |= device_facts(device)
    return machine


def planned_cells(table: Table, options: PaperOptions) -> tuple[list[CellPlan], list[str]]:
    """Plan the cells of a table.

    Args:
        table: which one.
        options: with what.

    Returns:
        The plans; and notes on what is left out.

    Raises:
        UsageError: a system or damage that does not exist, or no data folder.
        InputError: none of the table's data sets is there.
    """
    systems, notes = _systems(table, options.systems)
    known = load_damages()
    columns = [c for c in table.columns if not options.damages or c.damage in {d.upper() for d in options.damages}]
    if not columns:
        raise UsageError(f"{table.name} has none of the damages {', '.join(options.damages)}")
    plans = []
    for seed in range(options.seeds):
        wanted = Wanted(
            options.data_root,
            known,
            seed,
            budget=options.budget,
            device=options.device,
            weights=options.weights,
        )
        for column in columns:
            of_column, said = plan_column(column, systems, wanted)
            plans += of_column
            notes += [note for note in said if note not in notes]
    if not plans:
        raise InputError(f"no data set of the table {table.name} is in {options.data_root}", hint="; ".join(notes))
    return plans, notes


def _drawn(plans: Sequence[CellPlan], cells: Cells, rows: Sequence[Row], *, folder: Path) -> Iterator[Sheet]:
    """Draw every scene of every column, with the first seed's maps: the best weights' where there are such."""
    errors = {
        (row["column"], row["scene"], row["system"], row["weights"]): float(str(row["off_3px_5percent"]))
        for row in rows
        if row["region"] == "all" and row["seed"] == 0
    }
    shown = [plan for plan in plans if plan.task.seed == 0]
    for heading in dict.fromkeys(plan.column.heading for plan in shown):
        of_column = [plan for plan in shown if plan.column.heading == heading]
        for scene in of_column[0].scenes:
            found = []
            for plan in of_column:
                place = (heading, scene.name, plan.system.name)
                weights = next((name for name in (BEST, LAST, "") if (*place, name) in errors), None)
                map_px = None if weights is None else kept_map(cells.folder(plan), scene.name, weights)
                if weights is not None and map_px is not None:
                    title = f"{plan.system.title}, best" if weights == BEST else plan.system.title
                    found.append(Found(title, errors[*place, weights], map_px))
            if found:
                path = folder / f"{re.sub(r'[^A-Za-z0-9_]+', '-', f'{heading} {scene.name}')}.png"
                seen = Prepared({}).seen_pair(of_column[0].task, scene.name, scene.read())
                write_scene_sheet(path, seen, found)
                yield Sheet(heading, scene.name, path)


def _systems(table: Table, names: Sequence[str]) -> tuple[list[System], list[str]]:
    if names:
        return find_systems(names), []
    absent = [name for name in table.rows if name not in SYSTEMS]
    notes = [f"rows that telewide cannot compute yet: {', '.join(absent)}"] if absent else []
    return [SYSTEMS[name] for name in table.rows if name in SYSTEMS], notes
