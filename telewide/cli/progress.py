"""Progress of a command as a person sees it: a bar on a terminal, a line now and then elsewhere.

Everything here goes to standard error; standard output is for answers.
"""

from __future__ import annotations

import math
import statistics
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from telewide.text import Invocation, counted, is_worth_a_line

if TYPE_CHECKING:
    from telewide.capture.pair import CaptureSet, Problem
    from telewide.correction.verdict import PairReport
    from telewide.matching.networks import StereoNetwork
    from telewide.matching.window import Window
    from telewide.stages.capture_depth import DepthOutcome
    from telewide.stages.pairs import PreparedSet
    from telewide.training.stages import Stage

_LINE_EVERY_S = 15.0
"""Where there is no terminal, a training says so often how far it is."""
_LOSS_MEMORY = 0.97
_RECENT_STEPS = 31
"""The median of so many steps is the pace: neither an hour of sleep nor a busy minute long ago counts."""
_VERDICT_WORDS = {"usable": "warning"}  # beside "good", usable reads as an all-clear


@dataclass
class ConsoleObserver:
    """Tells a person at a console what a pipeline does.

    Attributes:
        console: of standard error.
        is_quiet: say nothing but problems.
        shows_table: print the table of the captures.
        invocation: the command that was typed.
        warnings: what was warned of so far.
    """

    console: Console
    is_quiet: bool = False
    shows_table: bool = True
    invocation: Invocation | None = None
    warnings: list[str] = field(default_factory=list)
    _progress: Progress | None = None
    _task: TaskID | None = None
    _label: str = ""
    _matching: str = "depth"
    _total: int = 0
    _done: int = 0
    _n_idle: int = 0
    _loss: float = math.nan
    _last_line_s: float = field(default_factory=time.monotonic)
    _judgement: str = ""
    _recent_s: deque[float] = field(default_factory=lambda: deque(maxlen=_RECENT_STEPS))
    _window: Window | None = None

    def close(self) -> None:
        """Take the bar away."""
        if self._progress is not None:
            self._progress.live.transient = self._n_idle == self._done > 0  # nothing was done that it tells of
            self._progress.stop()
        self._progress = self._task = None
        self._total = 0

    def preparing(self, captures: CaptureSet) -> None:
        """Show a bar over the captures."""
        self.said(f"{counted(len(captures.captures), 'capture')} in {captures.root}")
        self._begin("measuring and correcting", total=len(captures.captures))

    def pair_prepared(self, name: str, *, is_kept: bool = False) -> None:
        """Move the bar; of one that is kept no line is said."""
        self._advance(name=name, is_idle=is_kept)

    def set_prepared(self, prepared: PreparedSet) -> None:
        """Print the table of the captures and the problems."""
        self.close()
        if self.shows_table and not self.is_quiet:
            self.console.print(captures_table([pair.report for pair in prepared.pairs]))
        for pair in prepared.pairs:
            for reason in pair.report.reasons:
                self.warned(f"warning: {pair.report.name}: {reason}")
        self._warn(prepared.problems)
        if prepared.facts.rectified is None and prepared.rig is None and not self.is_quiet:
            rows_px = [abs(pair.report.vertical_residual_px) for pair in prepared.pairs]
            worst_px = max((row_px for row_px in rows_px if math.isfinite(row_px)), default=math.nan)
            rows = f"rows disagreed by up to {worst_px:.1f} px (median of a pair) before correction"
            self._line(
                "note: nothing states that these captures are rectified; "
                f"{rows if math.isfinite(worst_px) else 'matches are too few to see it'}. State rectified: true in "
                "captures.yaml if they are; make a rig if they are not: telewide calibrate",
            )

    def searching(self, window: Window) -> None:
        """Say it once."""
        if self.shows_table and window != self._window:
            self.said(f"disparities searched: {window[0]} to {window[1]} px")
        self._window = window

    def surveying(self, total: int) -> Callable[[], None]:
        """Show a bar over the captures that are matched first."""
        self._begin("matching your captures", total=total)
        return self._advance

    def detecting(self, total: int) -> Callable[[], None]:
        """Show a bar over the board photos."""
        self._begin("looking for the board", total=total)
        return self._advance

    def warned(self, message: str) -> None:
        """Print a line that is not kept back, and keep it for the answer in JSON."""
        self.warnings.append(message)
        self.console.print(message, style="yellow", markup=False, highlight=False, soft_wrap=True)

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """Show a bar over the steps."""
        self.close()
        self._loss, self._last_line_s = math.nan, time.monotonic()
        self._recent_s.clear()
        self._begin(stage.name, total=stage.options.steps, done=first_step, has_lines=False)

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """Move the bar; say the loss."""
        total = sum(losses.values())
        self._recent_s.append(seconds)
        self._loss = total if math.isnan(self._loss) else _LOSS_MEMORY * self._loss + (1 - _LOSS_MEMORY) * total
        self._advance(f"loss {self._loss:.3f}{self._judgement}")
        if not self.console.is_terminal and time.monotonic() - self._last_line_s > _LINE_EVERY_S:
            left_min = (stage.options.steps - step) * statistics.median(self._recent_s) / 60
            self.said(
                f"{stage.name} {step}/{stage.options.steps}  loss {self._loss:.3f}  {left_min:.0f} min left at most"
            )
            self._last_line_s = time.monotonic()

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """Say what the judge answered."""
        off_px, share = judgement["clipped_px"], judgement["off_1px"]
        told = f"  judged {off_px:.3f} px off, {share:.1%} of the held-out matches by > 1 px"
        self._judgement = "" if math.isnan(off_px) else told
        self.said(f"{stage.name} {step}:{self._judgement or ' too few matches to judge by'}")

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """Take the bar away."""
        self.close()

    def matching(self, total: int, *, method: str) -> None:
        """Show a bar over the captures."""
        self._matching = f"depth ({method})"
        self._begin("depth", total=total)

    def depth_written(self, outcome: DepthOutcome) -> None:
        """Move the bar; say what was left out, and do not keep back what is less than was asked for."""
        for note in outcome.notes:
            (self.warned if note in outcome.shortcomings else self.said)(note)
        label = "files of kept depth" if outcome.is_depth_kept else self._matching
        self._advance(name=outcome.name, label=label, is_idle=outcome.is_kept)

    def depth_failed(self, problem: Problem) -> None:
        """Say which capture was skipped."""
        self._warn([problem])
        self._advance(name=problem.name, label=self._matching)

    def said(self, message: str) -> None:
        """Print a line."""
        if not self.is_quiet:
            self._line(message)

    def _line(self, message: str) -> None:
        self.console.print(message, markup=False, highlight=False, soft_wrap=True)

    def _warn(self, problems: Sequence[Problem]) -> None:
        for problem in problems:
            verb = "skipped" if problem.is_skipped else "warning"
            text = f"{verb}: {problem.name}: {problem.message}"
            self.console.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)

    def _begin(self, label: str, *, total: int, done: int = 0, has_lines: bool = True) -> None:
        self.close()
        self._label, self._total, self._done, self._n_idle = label, 0, done, 0
        if self.is_quiet:
            return
        if not self.console.is_terminal:
            self._total = total if has_lines else 0
            return
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self.console,
        )
        self._progress.start()
        self._task = self._progress.add_task(label, total=total, completed=done, note="")

    def _advance(self, note: str = "", *, name: str = "", label: str = "", is_idle: bool = False) -> None:
        self._label = label or self._label
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, advance=1, note=note, description=self._label)
        self._done += 1
        self._n_idle += is_idle
        if is_worth_a_line(self._done, self._total) and not is_idle:
            self.said(f"{self._label} {self._done}/{self._total}{name and f': {name}'}")


def captures_table(reports: Sequence[PairReport]) -> Table:
    """The table of the captures that is shown before training."""
    table = Table(box=None, pad_edge=False)
    table.add_column("capture")
    for heading in ("matches", "vertical px", "asymmetry", "tele/wide R G B", "disparity px"):
        table.add_column(heading, justify="right")
    table.add_column("verdict")
    colours = {"good": "green", "usable": "yellow", "doubtful": "magenta", "refused": "red"}
    for report in reports:
        table.add_row(
            escape(report.name),
            str(report.n_matches),
            _number(report.vertical_offset_px, "+.2f"),
            "-" if report.asymmetry is None else f"{report.asymmetry:.1f}",
            " ".join(_number(ratio, ".2f") for ratio in report.colour_ratio),
            f"{_number(report.disparity_p02_px, '.0f')} to {_number(report.disparity_p98_px, '.0f')}",
            f"[{colours[report.verdict]}]{_VERDICT_WORDS.get(report.verdict, report.verdict)}[/]",
        )
    return table


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
