"""The tables of the publication and their values, from ``tables.yaml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from telewide.benchmark.datasets.catalogue import DATA_SETS
from telewide.benchmark.datasets.protocols import load_protocols
from telewide.errors import InputError, unknown_name
from telewide.options import Options, parse_options
from telewide.yaml_files import read_yaml

TABLES_FILE = Path(__file__).with_name("tables.yaml")
_NONE = "-"
_LEARNED_FROM = "middlebury-2006-third"
"""Protocol to learn from where a data set has no split to learn from."""


@dataclass(frozen=True)
class Published:
    """Published errors of one cell.

    Attributes:
        off_3px_5percent: 3PE, per cent.
        end_point_error_px: EPE; None where it is not stated.
        space_psnr_db: PSNR of the features; likewise.
    """

    off_3px_5percent: float
    end_point_error_px: float | None = None
    space_psnr_db: float | None = None

    def __str__(self) -> str:
        """As it stands in the brackets of a table."""
        end_point = "" if self.end_point_error_px is None else f" / {self.end_point_error_px:.2f}"
        psnr = "" if self.space_psnr_db is None else f" / {self.space_psnr_db:.2f} dB"
        return f"{self.off_3px_5percent:.2f}{end_point}{psnr}"


@dataclass(frozen=True)
class Column:
    """Data, damage and factor that the cells of a column share.

    Attributes:
        data_set: its name in the tables.
        test: names of protocols; the first whose scenes are there is taken.
        training: likewise for what is trained.
        damage: name of the damage of the second view.
        factor: how many times fewer pixels it has along each side.
    """

    data_set: str
    test: tuple[str, ...]
    training: tuple[str, ...]
    damage: str
    factor: float

    @property
    def heading(self) -> str:
        """As it stands above the column."""
        return f"{self.data_set} {self.damage} x{self.factor:g}"


class _DataSet(Options):
    test: Annotated[tuple[str, ...], Field(min_length=1)]
    training: Annotated[tuple[str, ...], Field(min_length=1)]


class _Table(Options):
    title: str
    data_sets: Annotated[tuple[str, ...], Field(min_length=1)]
    damages: Annotated[tuple[str, ...], Field(min_length=1)]
    factors: Annotated[tuple[float, ...], Field(min_length=1)]
    has_ratios: bool = False
    rows: dict[str, str]


class _File(Options):
    format: Literal[1]
    data_sets: dict[str, _DataSet]
    tables: dict[str, _Table]


@dataclass(frozen=True)
class Table:
    """One table.

    Attributes:
        name: by which it is asked for.
        title: for people.
        columns: from left to right.
        rows: by the name of the system, the published values, as many as columns; None where there is none.
        has_ratios: whether the other rows are also shown divided by the first.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: dict[str, tuple[Published | None, ...]]
    has_ratios: bool = False


def load_tables(*, path: Path = TABLES_FILE) -> dict[str, Table]:
    """Read a file of tables.

    Args:
        path: YAML of the form of ``tables.yaml``.

    Raises:
        UsageError: there is no such file.
        InputError: no YAML, an unknown key, or as many values in a row as there are not columns.
    """
    content = parse_options(_File, read_yaml(path) or {}, source=str(path), error=InputError)
    return {name: _table(name, table, content.data_sets, path) for name, table in content.tables.items()}


def find_table(name: str) -> Table:
    """Find a table by its name.

    Args:
        name: of the table.

    Raises:
        UsageError: there is no such table; the nearest name is told.
    """
    tables = load_tables()
    if name not in tables:
        raise unknown_name("table", name, tables)
    return tables[name]


def with_columns(table: Table, *, data_sets: Sequence[str] = (), factors: Sequence[float] = ()) -> Table:
    """Put other data sets and factors in the place of a table's own; the damages stay.

    Args:
        table: which one.
        data_sets: names of protocols, of data sets, which are judged whole, or of a table's; empty for its own.
        factors: times fewer pixels along each side; empty for its own.

    Returns:
        The table with a column for each data set, damage and factor. Published values stay with the columns that they
        are of.

    Raises:
        UsageError: a data set that does not exist; the nearest name is told.
    """
    own = table.columns
    known = {c.data_set: (c.test, c.training) for each in (*load_tables().values(), table) for c in each.columns}
    columns = tuple(
        Column(data_set, *_protocols_of(data_set, known), damage=damage, factor=factor)
        for data_set in dict.fromkeys(data_sets or [column.data_set for column in own])
        for damage in dict.fromkeys(column.damage for column in own)
        for factor in dict.fromkeys(factors or [column.factor for column in own])
    )
    rows = {
        system: tuple(values[own.index(column)] if column in own else None for column in columns)
        for system, values in table.rows.items()
    }
    return replace(table, columns=columns, rows=rows)


def _protocols_of(
    data_set: str, of_tables: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Protocols to be judged by and to learn from."""
    if data_set in of_tables:
        return of_tables[data_set]
    others = [*load_protocols(), *DATA_SETS]
    if data_set not in others:
        raise unknown_name("data set", data_set, [*(name for name in of_tables if "," not in name), *others])
    return (data_set,), (data_set, _LEARNED_FROM)


def _table(name: str, table: _Table, data_sets: dict[str, _DataSet], path: Path) -> Table:
    unknown = [data_set for data_set in table.data_sets if data_set not in data_sets]
    if unknown:
        raise InputError(f"{path}: table {name} names {', '.join(unknown)}, which data_sets does not describe")
    columns = tuple(
        Column(data_set, data_sets[data_set].test, data_sets[data_set].training, damage=damage, factor=factor)
        for data_set in table.data_sets
        for damage in table.damages
        for factor in table.factors
    )
    rows = {system: _values(text, len(columns), f"{path}: {name}, {system}") for system, text in table.rows.items()}
    return Table(name, table.title, columns, rows=rows, has_ratios=table.has_ratios)


def _values(text: str, expected: int, source: str) -> tuple[Published | None, ...]:
    words = text.split()
    if words == [_NONE]:
        return (None,) * expected
    if len(words) != expected:
        raise InputError(f"{source}: {len(words)} values; one for each of the {expected} columns was expected")
    try:
        return tuple(None if word == _NONE else _value(word) for word in words)
    except ValueError as error:
        raise InputError(f"{source}: values such as 12.41/1.849 were expected; {error}") from error


def _value(word: str) -> Published:
    numbers = [None if part == _NONE else float(part) for part in word.split("/")]
    if len(numbers) > 3 or numbers[0] is None:
        raise ValueError(f"found {word}")
    return Published(numbers[0], *numbers[1:])
