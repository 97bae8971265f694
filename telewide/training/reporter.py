"""Progress of a training, told to whoever called; free of torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from telewide.training.stages import Stage

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork


class Reporter(Protocol):
    """Receives the progress of a training."""

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """A stage begins, or goes on at ``first_step``."""

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """``step`` steps of the stage are done."""

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """The held-out matches were asked."""

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """A stage is done; ``network`` is its result."""

    def said(self, message: str) -> None:
        """Something worth a line."""
