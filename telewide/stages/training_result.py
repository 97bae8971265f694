"""The outcome of a training in words: which weights it leaves, and how much better they are than what it began with.

Read from the run folder without torch, for pages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from telewide.assets import BOX_WEIGHTS
from telewide.errors import TelewideError
from telewide.files import is_file
from telewide.stages.run_folder import RunFolder
from telewide.training.log import read_log
from telewide.training.weights_card import has_same_tensors, read_card


@dataclass(frozen=True)
class TrainingResult:
    """Weights that a training leaves.

    Attributes:
        stage: the training stage they come from.
        step: of that stage; 0 for the weights it began with, None where nobody recorded it.
        off_px: how far off they were judged, px; NaN without a judgement.
        before_px: how far off those were that the training began with, px; None where nobody knows.
        is_box: whether they are those that come with telewide, as they were.
    """

    stage: str
    step: int | None
    off_px: float
    before_px: float | None = None
    is_box: bool = False

    @property
    def told(self) -> str:
        """One line, without a full stop."""
        figure = "too few matches to judge by" if math.isnan(self.off_px) else f"judged {self.off_px:.3f} px off"
        if self.is_box:
            return (
                f"the network that comes with telewide stays, {figure}: no step of this training made it better; more "
                "captures or more steps may"
            )
        if self.step == 0:
            return f"the weights that {self.stage} began with, {figure}; no step was judged better"
        before = "" if self.before_px is None else f", {self.before_px:.3f} px before the training"
        return f"{self.stage}, step {self.step}, {figure}{before}"


def read_result(run: RunFolder) -> TrainingResult | None:
    """Read which weights lie in a run folder; None where there are none that can be read."""
    if not is_file(run.weights):
        return None
    try:
        facts = read_card(run.weights).training
        is_box = has_same_tensors(run.weights, BOX_WEIGHTS)
    except TelewideError:
        return None
    judged = facts.get("clipped_px")
    off_px = judged[-1] if isinstance(judged, list) and judged else None
    step = facts.get("step")
    return TrainingResult(
        str(facts.get("stage", "unknown")),
        step if isinstance(step, int) else None,
        float(off_px) if isinstance(off_px, int | float) else math.nan,
        before_px=before_px(run),
        is_box=is_box,
    )


def before_px(run: RunFolder) -> float | None:
    """Read how far off the weights were judged that a training began with; None where its log does not say."""
    begun = [line.judgement for line in read_log(run.training_log) if (line.stage_index, line.step) == (0, 0)]
    figures = [judgement["clipped_px"] for judgement in begun if "clipped_px" in judgement]
    return figures[-1] if figures and not math.isnan(figures[-1]) else None
