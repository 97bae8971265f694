"""Who hears what a pipeline does: whoever calls hands in an :class:`Observer`, and nothing below prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from telewide.capture.pair import CaptureSet, Problem
from telewide.correction.verdict import PairReport
from telewide.stages.capture_depth import DepthOutcome
from telewide.stages.pairs import PreparedSet

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork
    from telewide.matching.window import Window
    from telewide.training.stages import Stage


class Observer(Protocol):
    """Hears what a pipeline does; its first five are what the training loop tells its reporter."""

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """A stage of the training begins, or goes on at ``first_step``."""

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """``step`` steps of the stage are done."""

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """The held-out matches were asked."""

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """A stage is done."""

    def said(self, message: str) -> None:
        """Something worth a line."""

    def preparing(self, captures: CaptureSet) -> None:
        """The captures of a set are about to be corrected."""

    def pair_prepared(self, report: PairReport | None) -> None:
        """One capture is corrected, or left out."""

    def set_prepared(self, prepared: PreparedSet) -> None:
        """All captures are corrected."""

    def searching(self, window: Window) -> None:
        """Views are to be matched within this window, px."""

    def labelling(self, total: int) -> Callable[[], None]:
        """Labels of ``total`` captures are about to be computed; the answer is called after each."""

    def matching(self, total: int, *, method: str) -> None:
        """``total`` captures are about to be matched."""

    def depth_written(self, outcome: DepthOutcome) -> None:
        """One capture's depth is written."""

    def depth_failed(self, problem: Problem) -> None:
        """One capture was skipped."""
