"""Means over scenes and seeds, and a table of them in Markdown beside the published values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from telewide.benchmark.paper.cells import Row
from telewide.benchmark.paper.system import BEST
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Column, Published, Table
from telewide.benchmark.report import markdown_table, number


@dataclass(frozen=True)
class Mean:
    """Errors of one system in one column.

    Attributes:
        off_3px_5percent: 3PE, per cent.
        end_point_error_px: EPE.
        space_psnr_db: PSNR of the features; NaN for what is no space.
    """

    off_3px_5percent: float
    end_point_error_px: float
    space_psnr_db: float

    def __str__(self) -> str:
        """As it stands in a table."""
        shown = f"{number(self.off_3px_5percent, '.2f')} / {number(self.end_point_error_px, '.2f')}"
        return f"{shown} / {self.space_psnr_db:.2f} dB" if math.isfinite(self.space_psnr_db) else shown


@dataclass(frozen=True)
class Block:
    """The part of a table that is of one data set.

    Attributes:
        data_set: its name.
        head: of the columns.
        lines: as many cells each, the first the title of a system.
    """

    data_set: str
    head: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


Key = tuple[str, str, str]
"""Name of a system, of its weights, and heading of a column."""


def mean_errors(rows: Sequence[Row]) -> dict[Key, Mean]:
    """Average the rows of all pixels over scenes and seeds."""
    values: dict[Key, list[Row]] = {}
    for row in rows:
        if row["region"] == "all":
            values.setdefault((str(row["system"]), str(row["weights"]), str(row["column"])), []).append(row)
    return {
        key: Mean(
            100 * _mean(found, "off_3px_5percent"), _mean(found, "end_point_error_px"), _mean(found, "space_psnr_db")
        )
        for key, found in values.items()
    }


def paper_table(table: Table, rows: Sequence[Row]) -> str:
    """Set rows in Markdown, data set by data set; see `table_blocks`."""
    blocks = table_blocks(table, mean_errors(rows))
    return "\n\n".join(f"**{block.data_set}**\n\n{markdown_table(block.head, block.lines)}" for block in blocks)


def table_blocks(table: Table, means: Mapping[Key, Mean]) -> list[Block]:
    """Set means in tables, one for each data set that has any: 3PE in per cent / EPE in px.

    Where a system has them, the last weights and those best on validation are two columns; the published value stands
    in brackets beside the first.

    Args:
        table: systems and columns.
        means: of `mean_errors`.
    """
    blocks = [_block(table, means, data_set) for data_set in dict.fromkeys(c.data_set for c in table.columns)]
    return [block for block in blocks if len(block.head) > 1]


def _block(table: Table, means: Mapping[Key, Mean], data_set: str) -> Block:
    columns = [
        (index, column, weights)
        for index, column in enumerate(table.columns)
        for weights in ("", BEST)
        if column.data_set == data_set and any(_is_of(key, column, weights) for key in means)
    ]
    lines = []
    for system in dict.fromkeys(key[0] for key in means):
        published = table.rows.get(system) or (None,) * len(table.columns)
        line = [
            _cell(
                next((means[key] for key in means if key[0] == system and _is_of(key, column, weights)), None),
                None if weights else published[index],
            )
            for index, column, weights in columns
        ]
        lines.append((SYSTEMS[system].title, *line))
    names = [f"{column.damage} x{column.factor:g}{', best' if weights else ''}" for _, column, weights in columns]
    shows_spaces = any(math.isfinite(mean.space_psnr_db) for mean in means.values())
    measures = "3PE % / EPE px / PSNR dB" if shows_spaces else "3PE % / EPE px"
    return Block(data_set, (measures, *names), tuple(lines))


def _is_of(key: Key, column: Column, weights: str) -> bool:
    """Whether a mean belongs to a column of the best weights, or to one of all others."""
    return key[2] == column.heading and (key[1] == BEST) == (weights == BEST)


def _mean(rows: Sequence[Row], key: str) -> float:
    values = [row[key] for row in rows]
    return float(np.mean([value if isinstance(value, int | float) else math.nan for value in values]))


def _cell(ours: Mean | None, published: Published | None) -> str:
    shown = "-" if ours is None else str(ours)
    return shown if published is None else f"{shown} ({published})"
