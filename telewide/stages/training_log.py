"""The log of a training in its run folder: ``log.jsonl``, and a contact sheet of each finished stage."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from telewide.files import changing, is_file, write_text
from telewide.folders import append_line
from telewide.pages.contact import ContactRow, contact_sheet, write_sheet
from telewide.records import record_text
from telewide.stages.run_folder import RunFolder
from telewide.training.log import LogLine, read_log
from telewide.training.reporter import Reporter
from telewide.training.stages import Stage

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork

LOG_EVERY_STEPS = 10


@dataclass
class LoggedReporter:
    """Passes everything on, and keeps the log and the contact sheets."""

    inner: Reporter
    run: RunFolder
    rows: Callable[[StereoNetwork], list[ContactRow]]
    is_writer: bool
    _sums: dict[str, float] = field(default_factory=dict)
    _n_summed: int = 0
    _former_px: float = math.nan

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """Begin a mean of the losses."""
        self._forget_sums()
        self.inner.stage_started(stage, first_step=first_step)

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """Log the mean of some steps."""
        for name, value in losses.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._n_summed += 1
        if step % LOG_EVERY_STEPS == 0:
            # Fewer steps than usual after a resumption in between.
            rounded = {name: round(value / self._n_summed, 5) for name, value in self._sums.items()}
            self._log(_line(stage, step, losses=rounded, seconds=round(seconds, 3)))
            self._forget_sums()
        self.inner.step_done(stage, step=step, losses=losses, seconds=seconds)

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """Log what the judge says."""
        self._log(_line(stage, step, judgement=dict(judgement)))
        self.inner.judged(stage, step=step, judgement=judgement)

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """Draw the stage's contact sheet."""
        if self.is_writer:
            sheet = contact_sheet(self.rows(network), title=f"{stage.name}")
            write_sheet(self.run.train / f"{stage.name}.png", sheet)
        self.inner.stage_finished(stage, network=network, judgement=judgement)
        self.inner.said(f"{stage.name} is done: {self._what_is_kept(stage, judgement['clipped_px'])}")
        if not stage.is_teaching_space:
            self._former_px = judgement["clipped_px"]

    def said(self, message: str) -> None:
        """Pass a line on."""
        self.inner.said(message)

    def _what_is_kept(self, stage: Stage, result_px: float) -> str:
        """Say which weights a stage results in, by what was judged in it."""
        if stage.is_teaching_space:
            return "its feature space is learned"
        if math.isnan(result_px):
            return "its last weights are kept; too few matches to judge by"
        lines = [line for line in read_log(self.run.training_log) if line.stage_index == stage.index]
        judged_px = {line.step: line.judgement["clipped_px"] for line in lines if "clipped_px" in line.judgement}
        step = next((step for step, off_px in judged_px.items() if off_px == result_px), None)
        figure = f"judged {result_px:.3f} px off"
        if step == 0:
            return f"the weights it began with are kept, {figure}; no step of it was judged better"
        kept = "its weights are" if step is None else f"the weights of step {step} are"
        before_px = judged_px.get(0, self._former_px)
        before = "" if math.isnan(before_px) else f", {before_px:.3f} px before"
        return f"{kept} kept, {figure}{before}"

    def _forget_sums(self) -> None:
        self._sums.clear()
        self._n_summed = 0

    def _log(self, line: LogLine) -> None:
        if self.is_writer:
            with changing(self.run.train):
                self.run.train.mkdir(parents=True, exist_ok=True)
            append_line(self.run.training_log, _text(line))


def drop_log_after(path: Path, *, stage_index: int, step: int) -> None:
    """Forget the lines of steps that a resumed training takes again."""
    if is_file(path):
        kept = [_text(line) for line in read_log(path) if (line.stage_index, line.step) <= (stage_index, step)]
        write_text(path, "".join(f"{line}\n" for line in kept))


def _line(stage: Stage, step: int, **content: Any) -> LogLine:
    return LogLine(stage=stage.name, stage_index=stage.index, step=step, **content)


def _text(line: LogLine) -> str:
    return record_text(line, indent=None, has_defaults=False).rstrip()
