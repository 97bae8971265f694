"""Progress of the stages, reported to the caller: nothing below prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from telewide.capture.pair import CaptureSet, Problem
from telewide.stages.capture_depth import DepthOutcome
from telewide.stages.pairs import PreparedSet
from telewide.text import Invocation
from telewide.training.reporter import Reporter

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork
    from telewide.matching.window import Window
    from telewide.training.stages import Stage


class Observer(Reporter, Protocol):
    """Receives the progress of a pipeline or a calibration: what a training reports, and the other stages."""

    @property
    def invocation(self) -> Invocation | None:
        """The command that its person typed, which advised commands take up; None where a program calls."""

    def warned(self, message: str) -> None:
        """Something is less than what was asked for; a person is told even in quiet mode."""

    def detecting(self, total: int) -> Callable[[], None]:
        """Boards or matches are about to be looked for in ``total`` shots; the answer is called after each."""

    def preparing(self, captures: CaptureSet) -> None:
        """The captures of a set are about to be corrected."""

    def pair_prepared(self, name: str, *, is_kept: bool = False) -> None:
        """One capture is corrected, or left out; or is kept as a former call has corrected it."""

    def set_prepared(self, prepared: PreparedSet) -> None:
        """All captures are corrected."""

    def searching(self, window: Window) -> None:
        """Views are to be matched within this window, px."""

    def surveying(self, total: int) -> Callable[[], None]:
        """``total`` captures are about to be matched, to learn from; the answer is called after each."""

    def matching(self, total: int, *, method: str) -> None:
        """``total`` captures are about to be matched."""

    def depth_written(self, outcome: DepthOutcome) -> None:
        """One capture's depth is written."""

    def depth_failed(self, problem: Problem) -> None:
        """One capture was skipped."""


class Silent:
    """An observer that does nothing; subclasses override what they want to know."""

    @property
    def invocation(self) -> Invocation | None:
        """No command was typed."""
        return None

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """Ignore it."""

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """Ignore it."""

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """Ignore it."""

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """Ignore it."""

    def said(self, message: str) -> None:
        """Ignore it."""

    def warned(self, message: str) -> None:
        """Ignore it."""

    def detecting(self, total: int) -> Callable[[], None]:
        """Ignore it."""
        return _nothing

    def preparing(self, captures: CaptureSet) -> None:
        """Ignore it."""

    def pair_prepared(self, name: str, *, is_kept: bool = False) -> None:
        """Ignore it."""

    def set_prepared(self, prepared: PreparedSet) -> None:
        """Ignore it."""

    def searching(self, window: Window) -> None:
        """Ignore it."""

    def surveying(self, total: int) -> Callable[[], None]:
        """Ignore it."""
        return _nothing

    def matching(self, total: int, *, method: str) -> None:
        """Ignore it."""

    def depth_written(self, outcome: DepthOutcome) -> None:
        """Ignore it."""

    def depth_failed(self, problem: Problem) -> None:
        """Ignore it."""


def _nothing() -> None:
    pass
