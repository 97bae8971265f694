"""Means of a table by the rules of their definition: what is worked out by hand from a few rows is what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest

from telewide.benchmark.paper.means import Block, mean_errors, paper_blocks, ratio_blocks, table_blocks
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Table, find_table

SETS = ("Middlebury 2003", "KITTI2015, whole")


@pytest.fixture
def table() -> Table:
    """Two data sets of the table `prior`."""
    prior = find_table("prior")
    return replace(prior, columns=tuple(column for column in prior.columns if column.data_set in SETS))


def rows_of(table: Table, errors: Mapping[tuple[str, str], float], *, region: str = "all") -> list[dict[str, object]]:
    """The same errors at every factor, by system and data set; EPE is ten times 3PE."""
    return [
        {
            **{"system": system, "column": column.heading, "weights": "", "region": region},
            **{"off_3px_5percent": error, "end_point_error_px": 10 * error, "space_psnr_db": None},
        }
        for (system, data_set), error in errors.items()
        for column in table.columns
        if column.data_set == data_set
    ]


def cells_of(block: Block) -> dict[str, tuple[str, ...]]:
    return {line[0]: line[1:] for line in block.lines}


def test_ratios_to_the_first_system_and_their_mean_over_the_sets(table: Table) -> None:
    errors = {("sgm", SETS[0]): 0.2, ("ours", SETS[0]): 0.1, ("sgm", SETS[1]): 0.4, ("ours", SETS[1]): 0.3}
    (block,) = ratio_blocks(table, mean_errors(rows_of(table, errors)))
    assert block.head == ("3PE / EPE", "BIC x1", "BIC x4", "BIC x8")
    assert cells_of(block) == {
        SETS[0]: ("0.50 / 0.50",) * 3,
        SETS[1]: ("0.75 / 0.75",) * 3,
        "mean": ("0.62 / 0.62",) * 3,
    }


def test_a_system_that_errs_as_the_first_has_ratios_of_one(table: Table) -> None:
    errors = {(system, name): 0.01 * (1 + len(name)) for system in ("sgm", "ours") for name in SETS}
    (block,) = ratio_blocks(table, mean_errors(rows_of(table, errors)))
    assert {cell for line in block.lines for cell in line[1:]} == {"1.00 / 1.00"}


def test_a_set_without_the_first_system_or_without_its_errors_counts_in_no_mean(table: Table) -> None:
    full = {("sgm", SETS[0]): 0.2, ("ours", SETS[0]): 0.1}
    for more in ({("ours", SETS[1]): 0.3}, {("sgm", SETS[1]): 0.0, ("ours", SETS[1]): 0.3}):
        (block,) = ratio_blocks(table, mean_errors(rows_of(table, {**full, **more})))
        assert cells_of(block) == {SETS[0]: ("0.50 / 0.50",) * 3, "mean": ("0.50 / 0.50",) * 3}
    assert ratio_blocks(table, mean_errors(rows_of(table, {("sgm", SETS[0]): 0.2}))) == []


def test_visible_pixels_stand_below_all_of_the_sets_that_know_them(table: Table) -> None:
    rows = rows_of(table, {("sgm", name): 0.2 for name in SETS})
    rows += rows_of(table, {("sgm", SETS[0]): 0.1}, region="visible")
    blocks = paper_blocks(table, rows)
    assert [block.data_set for block in blocks] == [SETS[0], f"{SETS[0]}, visible pixels", SETS[1]]
    title = SYSTEMS["sgm"].title
    assert [cells_of(block)[title][0] for block in blocks] == ["20.00 / 2.00", "10.00 / 1.00", "20.00 / 2.00"]


def test_no_published_value_stands_beside_visible_pixels() -> None:
    table = find_table("stages")
    column = table.columns[0]
    rows = [
        row
        for region in ("all", "visible")
        for row in rows_of(table, {("basenet", column.data_set): 0.3}, region=region)
    ]
    whole, visible = paper_blocks(table, rows)
    assert "(12.56)" in " ".join(whole.lines[0])
    assert "(" not in " ".join(visible.lines[0])


def test_tables_of_the_publication_have_no_ratios() -> None:
    table = find_table("stages")
    means = mean_errors(rows_of(table, {("basenet", "Inria_SLFD"): 0.3, ("method", "Inria_SLFD"): 0.2}))
    rows = rows_of(table, {("basenet", "Inria_SLFD"): 0.3, ("method", "Inria_SLFD"): 0.2})
    assert paper_blocks(table, rows) == table_blocks(table, means)
