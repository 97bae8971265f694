"""What a person sees at a console."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from telewide.capture.pair import Capture, CaptureFacts, CaptureSet, Problem
from telewide.cli.console import bar
from telewide.cli.progress import ConsoleObserver, captures_table
from telewide.correction.verdict import PairReport, Verdict
from telewide.points.held_out import HeldOut
from telewide.stages.capture_depth import DepthOutcome
from telewide.stages.pairs import PreparedPair, PreparedSet
from telewide.stages.prepare import with_doubts
from telewide.training.options import StageOptions
from telewide.training.stages import Stage

NAN = math.nan


def report_of(name: str, verdict: Verdict, *reasons: str) -> PairReport:
    return PairReport(name, 9, NAN, NAN, NAN, None, (NAN, NAN, NAN), NAN, NAN, verdict, reasons)


@pytest.mark.parametrize("is_quiet", [False, True])
def test_a_doubt_about_a_capture_is_a_warning_and_never_kept_back(tmp_path: Path, *, is_quiet: bool) -> None:
    capture = Capture("000", tmp_path, tmp_path)
    report = report_of("000", "usable", "its matches lie 1.20 px off their rows")
    pair = PreparedPair(capture, capture, report, 1.0, HeldOut(capture, np.zeros((0, 2)), np.zeros(0)))
    console = Console(file=io.StringIO(), width=200)
    prepared = PreparedSet((pair,), CaptureFacts(rectified=True), (0, 32), (), root=tmp_path)
    ConsoleObserver(console, is_quiet=is_quiet).set_prepared(prepared)
    assert isinstance(console.file, io.StringIO)
    told = console.file.getvalue()
    assert "warning: 000: its matches lie 1.20 px off their rows\n" in told
    assert "usable" not in told
    assert is_quiet == (len(told.splitlines()) == 1)


@pytest.mark.parametrize(("before", "after"), [("good", "usable"), ("usable", "usable"), ("doubtful", "doubtful")])
def test_doubts_of_the_shot_stand_beside_those_of_the_pair(before: Verdict, after: Verdict) -> None:
    own = () if before == "good" else ("few matches",)
    report = with_doubts(report_of("000", before, *own), ("the rig is kept",))
    assert (report.verdict, report.reasons) == (after, (*own, "the rig is kept"))
    undoubted = with_doubts(report_of("000", before, *own), ())
    assert (undoubted.verdict, undoubted.reasons) == (before, own)


@pytest.mark.parametrize("is_quiet", [False, True])
def test_depth_that_is_less_than_asked_for_is_never_kept_back(*, is_quiet: bool) -> None:
    withheld, bokeh = "000: no depth in metres: why", "000: bokeh.jpg left out: why"
    held_back = "000: the strongest blur is held at a radius of 6 px"
    exchanged = "000: 100% of its disparities are negative; near and far are exchanged"
    notes = ("000: disparity.png left out", withheld, bokeh, held_back, exchanged)
    console = Console(file=io.StringIO(), width=200)
    observer = ConsoleObserver(console, is_quiet=is_quiet)
    observer.depth_written(DepthOutcome("000", (), notes, {}, withheld=withheld))
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue().splitlines() == list(notes[1:] if is_quiet else notes)
    assert observer.warnings == list(notes[1:])


def test_the_table_names_captures_as_they_are_called() -> None:
    report = report_of("beach[red]", "doubtful")
    told = Console(file=io.StringIO(), width=200)
    told.print(captures_table([report]))
    assert isinstance(told.file, io.StringIO)
    cells = told.file.getvalue().splitlines()[1].split()
    assert (cells[0], cells[1], cells[-1]) == ("beach[red]", "9", "doubtful")


@pytest.mark.parametrize(("total", "every"), [(3, 1), (20, 1), (21, 2), (1000, 50)])
def test_without_a_terminal_lines_say_how_far_it_is(total: int, every: int) -> None:
    console = Console(file=io.StringIO(), width=200)
    observer = ConsoleObserver(console)
    observer.matching(total, method="sgm")
    for number in range(1, total):
        observer.depth_written(DepthOutcome(f"{number:03d}", (), (), {}))
    observer.depth_failed(Problem("bad", "why"))
    assert isinstance(console.file, io.StringIO)
    *lines, failed, last = console.file.getvalue().splitlines()
    assert lines == [f"depth (sgm) {number}/{total}: {number:03d}" for number in range(every, total, every)]
    assert (failed, last) == ("skipped: bad: why", f"depth (sgm) {total}/{total}: bad")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_what_is_not_done_has_no_line(*, is_terminal: bool) -> None:
    console = Console(file=io.StringIO(), width=200, force_terminal=is_terminal, legacy_windows=False)
    observer = ConsoleObserver(console)
    observer.preparing(CaptureSet(Path("captures"), (), CaptureFacts(), ()))
    for is_kept in (True, True):
        observer.pair_prepared("000", is_kept=is_kept)
    observer.matching(3, method="sgm")
    for name, words in (("000", {"is_kept": True}), ("001", {"is_depth_kept": True}), ("002", {})):
        observer.depth_written(DepthOutcome(name, (), (), {}, **words))
    observer.close()
    assert isinstance(console.file, io.StringIO)
    told = console.file.getvalue()
    if not is_terminal:
        assert told.splitlines()[1:] == ["files of kept depth 2/3: 001", "depth (sgm) 3/3: 002"]
    else:
        shown = _left_on_the_screen(told)
        assert "measuring" in told
        assert "measuring" not in shown
        assert "depth (sgm)" in shown
        assert "3/3" in shown


def _left_on_the_screen(told: str) -> str:
    """What a terminal shows at the end: lines are erased by ESC [ 2 K, the cursor goes up by ESC [ 1 A."""
    lines, row = [""], 0
    for part in re.findall(r"\x1b\[[0-9;?]*[A-Za-z]|\r|\n|[^\x1b\r\n]+", told):
        if part == "\n":
            row += 1
            lines += [""] * (row == len(lines))
        elif part == "\x1b[1A":
            row -= 1
        elif part == "\x1b[2K":
            lines[row] = ""
        elif not part.startswith("\x1b") and part != "\r":
            lines[row] += part
    return "\n".join(lines)


def test_photos_of_a_roll_are_counted_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with bar("looking at photos") as shown:
        for done in range(1, 41):
            shown.reach(done, 40)
    with bar("looking at photos") as shown:
        shown.reach(3, 3)
    with bar("rendering", total=3) as shown:
        for _ in range(3):
            shown.advance()
    with bar("rendering", total=3, is_quiet=True) as shown:
        shown.advance()
    expected = [f"looking at photos {done}/40" for done in range(2, 41, 2)]
    assert capsys.readouterr().err.splitlines() == [*expected, *(f"rendering {done}/3" for done in (1, 2, 3))]


def test_a_terminal_has_its_bar_and_no_such_lines() -> None:
    console = Console(file=io.StringIO(), width=200, force_terminal=True)
    observer = ConsoleObserver(console)
    tick = observer.detecting(2)
    tick()
    observer.close()
    assert isinstance(console.file, io.StringIO)
    assert "looking for the board 1/2" not in console.file.getvalue()


def test_the_time_left_goes_by_the_recent_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second a step, but for one step that held an hour of sleep, and a busy quarter of an hour before."""
    console = Console(file=io.StringIO(), width=200)
    observer, clock = ConsoleObserver(console), iter(range(0, 100_000, 100))
    monkeypatch.setattr("telewide.cli.progress.time.monotonic", lambda: float(next(clock)))
    stage = Stage("rehearsal", 0, StageOptions(steps=700, rehearsed=1))
    observer.stage_started(stage, first_step=0)
    for step in range(1, 101):
        seconds = 9.0 if step < 60 else 3600.0 if step == 100 else 1.0
        observer.step_done(stage, step=step, losses={"x": 1.0}, seconds=seconds)
    assert isinstance(console.file, io.StringIO)
    assert "10 min left at most" in console.file.getvalue().splitlines()[-1]
    observer.stage_started(stage, first_step=0)
    observer.step_done(stage, step=100, losses={"x": 1.0}, seconds=6.0)
    assert "60 min left at most" in console.file.getvalue().splitlines()[-1]
