"""Results of a benchmark: rows of numbers with the machine they come from, as JSON and as a Markdown table."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

from telewide.cores import processor_name, usable_cores
from telewide.files import write_text
from telewide.text import counted, json_text

FORMAT = 1
_PACKAGES = ("telewide", "numpy", "opencv-contrib-python-headless", "scipy", "torch")


@dataclass(frozen=True)
class BenchmarkReport:
    """The numbers of one benchmark.

    Attributes:
        benchmark: its name.
        options: what was asked for.
        rows: one a line of the table or finer; NaN and None where a number does not exist.
        notes: what a reader must know.
        machine: see :func:`describe_machine`.
        further: rows of other tables of the same run, by their names.
    """

    benchmark: str
    options: Mapping[str, object]
    rows: tuple[Mapping[str, object], ...]
    notes: tuple[str, ...] = ()
    machine: Mapping[str, object] = field(default_factory=lambda: describe_machine())
    further: Mapping[str, tuple[Mapping[str, object], ...]] = field(default_factory=dict)


def describe_machine() -> dict[str, object]:
    """State processor, cores, memory, load and the versions of what computes."""
    return {
        "system": platform.platform(),
        "processor": processor_name(),
        "cores": usable_cores(),
        "load_1min": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "versions": library_versions(),
    }


def library_versions() -> dict[str, str | None]:
    """State the versions of what computes; None for what is not installed."""
    return {name: _version(name) for name in _PACKAGES}


def machine_facts(machine: Mapping[str, object]) -> dict[str, object]:
    """Pick what a table is read by: processor, GPU where there is one, cores, torch and telewide.

    Args:
        machine: of :func:`describe_machine`, with ``gpu`` where networks computed on one.
    """
    versions = machine["versions"]
    named = {name: versions.get(name) for name in ("torch", "telewide")} if isinstance(versions, Mapping) else {}
    return {"processor": machine["processor"], "gpu": machine.get("gpu"), "cores": machine["cores"], **named}


def machine_line(machine: Mapping[str, object]) -> str:
    """State the facts of :func:`machine_facts` in one line."""
    facts = machine_facts(machine)
    computes = "; ".join(str(facts[name]) for name in ("processor", "gpu") if facts[name])
    versions = [f"{name} {facts[name] or 'not installed'}" for name in ("torch", "telewide")]
    return ", ".join([computes, counted(int(str(facts["cores"])), "core"), *versions])


def write_report_json(report: BenchmarkReport, path: Path) -> None:
    """Write a report as one JSON object; a number that does not exist becomes null.

    Args:
        report: what to write.
        path: the file to write or to replace.
    """
    content = {
        "format": FORMAT,
        "benchmark": report.benchmark,
        "machine": report.machine,
        "options": report.options,
        "rows": report.rows,
        "notes": report.notes,
        **({"further": report.further} if report.further else {}),
    }
    write_text(path, json_text(content, indent=2) + "\n")


def markdown_table(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Set a table in Markdown, its columns aligned for a terminal too; the first one to the left.

    Args:
        headings: of the columns.
        lines: as many cells each.

    Returns:
        The text, without a line end at its end.
    """
    widths = [max(3, *(len(row[column]) for row in (headings, *lines))) for column in range(len(headings))]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    aligned = [
        [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        for row in (headings, rule, *lines)
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in aligned)


def number(value: object, form: str) -> str:
    """Format a number; a dash where there is none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "-"
    return format(value, form)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
