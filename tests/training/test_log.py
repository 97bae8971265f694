"""The training log: what was written is read; lines that are cut off, or are something else, are passed over."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from telewide.records import record_text
from telewide.training.log import read_log

GOOD = '{"stage": "rehearsal", "stage_index": 0, "step": 10, "losses": {"photometric": 0.5}, "seconds": 1.0}'
JUDGED = '{"stage": "rehearsal", "stage_index": 0, "step": 20, "judgement": {"off_1px": 0.25, "mean_px": null}}'


def test_lines_come_back(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(f"{GOOD}\n{JUDGED}\n")
    first, second = read_log(path)
    assert (first.stage, first.step, dict(first.losses), dict(first.judgement)) == (
        *("rehearsal", 10),
        *({"photometric": 0.5}, {}),
    )
    assert (second.step, second.losses, second.judgement["off_1px"]) == (20, {}, 0.25)
    assert math.isnan(second.judgement["mean_px"])
    again = [record_text(line, indent=None, has_defaults=False).rstrip() for line in (first, second)]
    assert again == [GOOD, JUDGED]


@pytest.mark.parametrize(
    "line",
    [
        *[GOOD[:40], "", "[]", "null", "[" * 100_000, "\x00\xff", GOOD.replace("0.5", "Infinity")],
        *[GOOD.replace('{"photometric": 0.5}', other) for other in ("[]", '"text"', '{"a": []}', '{"a": "text"}')],
        *[GOOD.replace("10", other) for other in ('"10"', "-1", "1" + "0" * 400, "[]", "1.5")],
        GOOD.replace('"rehearsal"', "[]"),
    ],
)
def test_a_line_that_cannot_be_read_is_passed_over(tmp_path: Path, line: str) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(f"{GOOD}\n{line}\n{JUDGED}\n{line}")
    assert [entry.step for entry in read_log(path)] == [10, 20]


def test_a_log_that_is_not_there_has_no_lines(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert read_log(tmp_path / "pipe") == read_log(tmp_path / "none") == ()


def test_a_file_that_is_no_log_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    line = '{"stage": "rehearsal", "step": 1}\n'
    path.write_text(line + 999 * "?\n" + line + "?\n" + "?\n" + line)
    assert len(read_log(path)) == 2
