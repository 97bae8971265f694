"""Reports of benchmarks: what their JSON and tables hold, and that timed turns alternate."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from telewide.benchmark.report import BenchmarkReport, describe_machine, markdown_table, number, write_report_json
from telewide.benchmark.timing import time_side_by_side


def test_json_states_machine_versions_options_and_rows(tmp_path: Path) -> None:
    report = BenchmarkReport("speed", {"hw": (2, 3)}, ({"matcher": "sgm", "mean_px": math.nan},), ("a note",))
    write_report_json(report, tmp_path / "out.json")
    content = json.loads((tmp_path / "out.json").read_text())
    assert content.keys() == {"format", "benchmark", "machine", "options", "rows", "notes"}
    assert content["format"] == 1
    assert content["options"] == {"hw": [2, 3]}
    assert content["rows"] == [{"matcher": "sgm", "mean_px": None}]  # JSON knows no NaN
    assert content["machine"]["versions"]["numpy"]


def test_machine_has_cores_and_a_name() -> None:
    machine = describe_machine()
    assert isinstance(machine["cores"], int)
    assert machine["cores"] >= 1
    assert machine["processor"]


def test_table_is_aligned() -> None:
    lines = markdown_table(["a", "long heading"], [["x", "1"], ["a longer cell", "22"]]).splitlines()
    assert len(lines) == 4
    assert {len(line) for line in lines} == {len(lines[0])}
    assert lines[1].endswith("-: |")


@pytest.mark.parametrize(("value", "expected"), [(1.25, "1.2"), (math.nan, "-"), (None, "-"), (math.inf, "-")])
def test_number(value: float | None, expected: str) -> None:
    assert number(value, ".1f") == expected


def test_turns_alternate_and_warm_up_is_not_counted() -> None:
    order: list[str] = []
    waits: list[int] = []
    cases = {name: lambda name=name: order.append(name) for name in ("a", "b")}
    timings = time_side_by_side(cases, repeats=3, warm_up=1, synchronise=lambda: waits.append(len(order)))
    assert order == ["a", "b"] * 4
    assert waits == [n for turn in range(8) for n in (turn, turn + 1)]  # the device is waited for on both sides
    for timing in timings.values():
        assert timing.repeats == 3
        assert 0 <= timing.q1_s <= timing.median_s <= timing.q3_s
