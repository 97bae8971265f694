"""A record written as JSON comes back equal; what is no JSON, too large or of another type is refused."""

from __future__ import annotations

import json
import math
import tracemalloc
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from telewide.errors import InputError
from telewide.records import (
    MAX_JSON_VALUES,
    Figure,
    Line,
    Name,
    Points,
    Record,
    Vector,
    checked,
    parse_json,
    read_json,
    read_record,
    record_text,
    write_record,
)


@dataclass(frozen=True)
class Part:
    """A dataclass inside a record."""

    turn_rad: Vector
    outline_px: Points
    ratio: float | None
    pair: tuple[Figure, Figure]


class Sample(Record):
    """One field of each kind."""

    name: Name
    n: int
    is_good: bool
    size_px: Figure
    notes: tuple[str, ...]
    kind: Literal["a", "b"] | None
    part: Part
    more: dict[str, Figure]


PART = Part(np.array([0.1, math.nan, 1 / 3]), np.array([[1.0, 2.0], [3.0, 4.0]]), None, (1.0, math.nan))
GOOD = Sample(
    name="one\udcff", n=3, is_good=True, size_px=math.nan, notes=("é", "two"), kind="a", part=PART, more={"x": math.inf}
)


def plain(**changes: object) -> dict[str, object]:
    content = parse_json(record_text(GOOD))
    assert isinstance(content, dict)
    return {**content, **changes}


def test_what_was_written_comes_back_and_nothing_is_nan_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "sample.json"
    write_record(path, GOOD)
    assert not {"NaN", "Infinity"} & set(path.read_text().replace(",", " ").split())
    again = read_record(path, Sample)
    assert again.model_dump(exclude={"size_px", "part", "more"}) == GOOD.model_dump(exclude={"size_px", "part", "more"})
    assert again.name == "one\udcff", "a byte of a file name that is no UTF-8"
    assert math.isnan(again.size_px)
    assert math.isnan(again.more["x"])
    np.testing.assert_array_equal(again.part.turn_rad, PART.turn_rad)
    np.testing.assert_array_equal(again.part.outline_px, PART.outline_px)
    assert (again.part.ratio, again.part.pair[0]) == (None, 1.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("name", 3), ("n", True), ("n", 1.5), ("n", "3"), ("n", None), ("is_good", 1), ("size_px", "1")],
        *[("size_px", "inf"), ("size_px", True), ("notes", "text"), ("notes", [1]), ("kind", "c"), ("part", [])],
        *[("more", {"x": "nan"}), ("more", [])],
    ],
)
def test_a_value_of_another_type_is_refused_by_the_name_of_its_key(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        checked(plain(**{name: value}), Sample)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("turn_rad", [1, 2]), ("turn_rad", ["1", 2, 3]), ("outline_px", [[1], [2, 3]]), ("outline_px", "text")],
        *[("outline_px", [["inf", 1]]), ("ratio", []), ("pair", [1]), ("pair", 1), ("pair", [1, "2"])],
    ],
)
def test_so_is_one_of_a_dataclass_inside(name: str, value: object) -> None:
    part = plain()["part"]
    assert isinstance(part, dict)
    with pytest.raises(ValueError, match=f"part.{name}"):
        checked(plain(part={**part, name: value}), Sample)  # type: ignore[arg-type]


def test_a_missing_key_and_something_else_are_refused(tmp_path: Path) -> None:
    for content in ([], None, "text", {key: value for key, value in plain().items() if key != "n"}):
        (tmp_path / "x.json").write_text(json.dumps(content))
        with pytest.raises(InputError, match=r"x\.json is no such record"):
            read_record(tmp_path / "x.json", Sample)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[" * 100_000,
        "[" * 50 + "]" * 50,
        '{"a": ' * 50_000,
        "Infinity",
        "[NaN]",
        "1e400",
        "1" + "0" * 400,
        str(1 << 63),
        '"\x00"',
    ],
)
def test_json_that_cannot_be_used_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"x\.json cannot be read as JSON"):
        read_json(path)


def test_a_line_break_in_a_line_is_shown() -> None:
    assert checked(parse_json(json.dumps("one\nerror: two")), Line) == "one\\nerror: two"


def test_json_of_more_values_than_any_record_is_not_built() -> None:
    for one in ("[]", "0", '"x"'):
        for text in (f"[{f'{one},' * MAX_JSON_VALUES}{one}]", f"[{f'{one},' * MAX_JSON_VALUES}{one}]".encode()):
            tracemalloc.start()
            with pytest.raises(ValueError, match="more than 1048576 values"):
                parse_json(text)
            assert tracemalloc.get_traced_memory()[1] < 20e6
            tracemalloc.stop()
    assert len(parse_json(f"[{'0,' * 1000}0]")) == 1001


def test_json_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b'"\xff\xfe"')
    with pytest.raises(InputError, match="cannot be read as JSON"):
        read_json(path)


def test_json_comes_back_as_it_was_written(tmp_path: Path) -> None:
    content = {"a": [1, -2.5, (1 << 63) - 1, None, True, "é"], "b": {}}
    path = tmp_path / "x.json"
    path.write_text(json.dumps(content))
    assert read_json(path) == content
