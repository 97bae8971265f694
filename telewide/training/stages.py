"""The order of training: rehearsal, photometric, then feature-metric stages 1 to K (paper, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

from telewide.training.options import StageOptions, TrainOptions


@dataclass(frozen=True)
class Stage:
    """One stage of a plan.

    Attributes:
        name: as it stands in logs and file names.
        index: position in the plan; part of every sample's seed.
        options: crops, loss and length.
    """

    name: str
    index: int
    options: StageOptions

    @property
    def needs_teacher(self) -> bool:
        """Whether its loss looks through the frozen extractor of the stage before."""
        return self.options.captured > 0 and self.options.captured_loss == "feature"

    @property
    def needs_labels(self) -> bool:
        """Whether confident labels of the captures take part."""
        options = self.options
        return options.captured > 0 and (options.captured_loss == "labels" or options.labels_weight > 0)


def plan_stages(options: TrainOptions) -> tuple[Stage, ...]:
    """List the stages in order; those without steps are left out."""
    named = [("rehearsal", options.rehearsal), ("photometric", options.photometric)]
    named += [(f"feature-{k}", options.feature) for k in range(1, options.stages + 1)]
    kept = [(name, stage) for name, stage in named if stage.steps]
    return tuple(Stage(name, index, stage) for index, (name, stage) in enumerate(kept))
