"""Text as telewide writes it: counts, JSON that every reader takes, commands that a shell reads back."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest

from telewide.text import Invocation, command_line, counted, first_few, json_text, printable, shortened


def test_one_is_singular_and_no_other_number_is() -> None:
    assert [counted(number, "capture") for number in (0, 1, 2, 11)] == [
        "0 captures",
        "1 capture",
        "2 captures",
        "11 captures",
    ]
    assert counted(1, "new capture") == "1 new capture"


def test_a_list_of_what_others_wrote_is_short_and_of_one_line() -> None:
    assert first_few(["a", "b"]) == "a, b"
    assert first_few([]) == ""
    assert first_few([str(number) for number in range(20)], most=3) == "0, 1, 2 and 17 more"
    assert len(first_few(["x" * 10**6] * 10**4)) < 1300
    assert shortened("one\ntwo") == "one\\ntwo"
    assert shortened("x" * 61) == "x" * 57 + "..."
    assert shortened("x" * 60) == "x" * 60


@pytest.mark.parametrize("missing", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_numbers_that_do_not_exist_become_null_wherever_they_stand(missing: float) -> None:
    written = json_text({"a": missing, "b": [1.5, {"c": (missing, 2)}]})
    assert json.loads(written) == {"a": None, "b": [1.5, {"c": [None, 2]}]}


@pytest.mark.parametrize("indent", [None, 2])
def test_what_json_can_hold_comes_back(indent: int | None) -> None:
    value = {"name": "Käse [1]", "is_new": True, "none": None, "values": [1, -2.5, "x"], "inner": {"a": {}}}
    assert json.loads(json_text(value, indent=indent)) == value
    assert "Käse" in json_text(value)
    assert json.loads(json_text({"at": Path("a/b")})) == {"at": "a/b"}


def test_a_shell_reads_what_was_meant() -> None:
    written = command_line("depth", Path("it's mine/*"), run=Path("my run"), bokeh=True, rig=None, fresh=False)
    assert shlex.split(written) == ["telewide", "depth", "it's mine/*", "--run", "my run", "--bokeh"]
    assert command_line("calibrate", square_m=0.0243, from_scenes=True).endswith("--square-m 0.0243 --from-scenes")
    repeated = command_line("train", set=["a.b=1", "c=x y"], run=None)
    assert shlex.split(repeated) == ["telewide", "train", "--set", "a.b=1", "--set", "c=x y"]


def test_a_call_that_is_advised_keeps_what_was_stated() -> None:
    run = Invocation(
        "run", ("my captures",), {"out": "run B", "rig": "phone B.yaml", "seed": 3, "recipe": "quick", "set": ["a=1"]}
    )
    stated = "--out 'run B' --rig 'phone B.yaml' --seed 4 --recipe quick --set a=1"
    assert run.again(seed=4) == f"telewide run 'my captures' {stated}"
    assert run.again(recipe=None).count("--recipe") == 0
    train = run.instead("train", fresh=True)
    stated = "--out 'run B' --rig 'phone B.yaml' --recipe quick --set a=1 --seed 3"
    assert train == f"telewide train 'my captures' {stated} --fresh"
    assert run.instead("depth") == "telewide depth 'my captures' --run 'run B' --rig 'phone B.yaml'"
    assert run.instead("depth", "my captures/one", rig=None) == "telewide depth 'my captures/one' --run 'run B'"


def test_results_of_depth_are_no_run_folder() -> None:
    depth = Invocation("depth", ("captures",), {"run": "mine", "out": "results", "focus": "near", "device": "cpu"})
    assert depth.instead("train") == "telewide train captures --out mine --device cpu"
    again = depth.instead("depth", "captures/one", device=None)
    assert again == "telewide depth captures/one --run mine --out results --focus near"


HOSTILE = "a\x1b]0;owned\x07\x1b[2J\x7f\x9b31m\r\u202eb\x00\udcff"


def test_what_a_terminal_obeys_is_shown() -> None:
    assert printable(HOSTILE) == r"a\x1b]0;owned\x07\x1b[2J\x7f\x9b31m\x0d\u202eb\x00\xff"
    kept = "plain, é, 日本, two\nlines\tand a tab"
    assert printable(kept) == kept
    everything = printable("".join(map(chr, range(0x10000))))
    assert not set(everything) & {chr(code) for code in (*range(9), *range(11, 32), *range(127, 160))}
    everything.encode()


def test_json_holds_nothing_a_terminal_obeys_and_comes_back() -> None:
    text = json_text({HOSTILE: [HOSTILE]})
    assert text == printable(text)
    assert json.loads(text) == {HOSTILE: [HOSTILE]}
