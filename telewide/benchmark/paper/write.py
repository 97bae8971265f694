"""A table on disk: Markdown, CSV and JSON, and a page with plots and pictures."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from telewide.benchmark.paper.means import paper_table
from telewide.benchmark.paper.page import write_paper_page
from telewide.benchmark.paper.run import PaperResult
from telewide.benchmark.paper.tables import Table
from telewide.benchmark.report import machine_facts, machine_line, write_report_json
from telewide.files import write_text


def write_table(table: Table, result: PaperResult, out: Path) -> tuple[Path, ...]:
    """Write a table as Markdown, CSV, JSON and a page.

    Args:
        table: which one.
        result: of `benchmark_table`.
        out: the folder.

    Returns:
        The files.
    """
    report = result.report
    text, rows, numbers, page = (out / f"{table.name}.{suffix}" for suffix in ("md", "csv", "json", "html"))
    machine = machine_facts(report.machine)
    notes = "".join(f"\n- {note}" for note in report.notes)
    budget = f"Budget of each training: {report.options['budget']}; seeds: {report.options['seeds']}."
    made_on = f"Machine: {machine_line(report.machine)}."
    write_text(text, f"# {table.title}\n\n{paper_table(table, report.rows)}\n\n{budget}\n\n{made_on}\n{notes}\n")
    stream = io.StringIO()
    of_all = {"budget": report.options["budget"], **machine}
    writer = csv.DictWriter(stream, [*report.rows[0], *of_all], lineterminator="\n")
    writer.writeheader()
    writer.writerows({**row, **of_all} for row in report.rows)
    write_text(rows, stream.getvalue())
    write_report_json(report, numbers)
    write_paper_page(page, table, report, sheets=result.sheets)
    return text, rows, numbers, page
