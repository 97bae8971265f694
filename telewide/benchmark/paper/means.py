"""Means over scenes and seeds, and tables of them in Markdown: of all pixels beside published ones, of visible ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from telewide.benchmark.paper.cells import Row
from telewide.benchmark.paper.system import BEST
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.benchmark.paper.tables import Column, Published, Table
from telewide.benchmark.report import markdown_table, number
from telewide.benchmark.scores import Region


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
    """The part of a table that is of one data set, or the ratios of two systems.

    Attributes:
        data_set: its name, and which of its pixels; or the names of both systems.
        head: of the columns.
        lines: as many cells each, the first the title of a system or the name of a data set.
    """

    data_set: str
    head: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


Key = tuple[str, str, str]
"""Name of a system, of its weights, and heading of a column."""


def mean_errors(rows: Sequence[Row], *, region: Region = "all") -> dict[Key, Mean]:
    """Average the rows of a region over scenes and seeds."""
    values: dict[Key, list[Row]] = {}
    for row in rows:
        if row["region"] == region:
            values.setdefault((str(row["system"]), str(row["weights"]), str(row["column"])), []).append(row)
    return {
        key: Mean(
            100 * _mean(found, "off_3px_5percent"), _mean(found, "end_point_error_px"), _mean(found, "space_psnr_db")
        )
        for key, found in values.items()
    }


def paper_table(table: Table, rows: Sequence[Row]) -> str:
    """Set rows in Markdown, data set by data set; see `paper_blocks`."""
    blocks = paper_blocks(table, rows)
    return "\n\n".join(f"**{block.data_set}**\n\n{markdown_table(block.head, block.lines)}" for block in blocks)


def paper_blocks(table: Table, rows: Sequence[Row]) -> list[Block]:
    """Set rows in tables: of each data set all pixels, then those that both views see; last the ratios, if any."""
    means = mean_errors(rows)
    # Nothing is published of visible pixels alone.
    unpublished, visible = replace(table, rows={}), mean_errors(rows, region="visible")
    apart = {block.data_set: block for block in table_blocks(unpublished, visible)}
    blocks = []
    for block in table_blocks(table, means):
        blocks.append(block)
        if seen := apart.get(block.data_set):
            blocks.append(replace(seen, data_set=f"{seen.data_set}, visible pixels"))
    return [*blocks, *(ratio_blocks(table, means) if table.has_ratios else ())]


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


def ratio_blocks(table: Table, means: Mapping[Key, Mean]) -> list[Block]:
    """Divide every system by the first: 3PE / EPE of each data set, and the mean over those that both have.

    Args:
        table: its first system is the measure.
        means: of `mean_errors`; where a system has two kinds of weights, the last ones count.
    """
    systems = [system for system in table.rows if any(key[0] == system for key in means)]
    sets = list(dict.fromkeys(column.data_set for column in table.columns))
    shown = list(dict.fromkeys((column.damage, column.factor) for column in table.columns))
    blocks = []
    for system in systems[1:]:
        ratios = {(c.data_set, c.damage, c.factor): _ratio(means, c, (systems[0], system)) for c in table.columns}
        in_sets = [[ratios[data_set, *kind] for kind in shown] for data_set in sets]
        over_sets = [_mean_ratio([ratios[data_set, *kind] for data_set in sets]) for kind in shown]
        named = [(name, line) for name, line in zip(sets, in_sets, strict=True) if np.isfinite(line).any()]
        lines = tuple((name, *map(_shown_ratio, line)) for name, line in [*named, ("mean", over_sets)])
        titles = f"{SYSTEMS[system].title}, divided by {SYSTEMS[systems[0]].title}"
        blocks.append(Block(titles, ("3PE / EPE", *(f"{damage} x{factor:g}" for damage, factor in shown)), lines))
    return blocks


Ratio = tuple[float, float]
"""Of 3PE and of EPE; NaN where there is none."""


def _ratio(means: Mapping[Key, Mean], column: Column, systems: tuple[str, str]) -> Ratio:
    """Divide the errors of the second system by those of the first."""
    first, second = (
        next((mean for key, mean in means.items() if key[0] == system and _is_of(key, column, "")), None)
        for system in systems
    )
    if first is None or second is None:
        return math.nan, math.nan
    return (
        _part(second.off_3px_5percent, of=first.off_3px_5percent),
        _part(second.end_point_error_px, of=first.end_point_error_px),
    )


def _part(value: float, *, of: float) -> float:
    return value / of if of else math.nan


def _mean_ratio(ratios: Sequence[Ratio]) -> Ratio:
    by_kind = [[value for value in values if math.isfinite(value)] for values in zip(*ratios, strict=True)]
    off, epe = (float(np.mean(values)) if values else math.nan for values in by_kind)
    return off, epe


def _shown_ratio(ratio: Ratio) -> str:
    return f"{number(ratio[0], '.2f')} / {number(ratio[1], '.2f')}"


def _is_of(key: Key, column: Column, weights: str) -> bool:
    """Whether a mean belongs to a column of the best weights, or to one of all others."""
    return key[2] == column.heading and (key[1] == BEST) == (weights == BEST)


def _mean(rows: Sequence[Row], key: str) -> float:
    values = [row[key] for row in rows]
    return float(np.mean([value if isinstance(value, int | float) else math.nan for value in values]))


def _cell(ours: Mean | None, published: Published | None) -> str:
    shown = "-" if ours is None else str(ours)
    return shown if published is None else f"{shown} ({published})"
