"""The order of training: rehearsal, photometric, a feature space, feature-metric stages 1 to K (paper, section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

from telewide.training.options import SpaceName, StageOptions, TrainOptions

SPACE_STAGE = "space"
"""Name of the stage that teaches a feature space."""


@dataclass(frozen=True)
class Stage:
    """One stage of a plan.

    Attributes:
        name: as it stands in logs and file names.
        index: position in the plan; part of every sample's seed.
        options: crops, loss and length.
        space: in which a feature-metric loss compares, or which is taught.
    """

    name: str
    index: int
    options: StageOptions
    space: SpaceName = "own"

    @property
    def is_teaching_space(self) -> bool:
        """Whether it teaches the feature space and leaves the network as it is."""
        return self.name == SPACE_STAGE

    @property
    def needs_teacher(self) -> bool:
        """Whether its loss looks through a frozen extractor: of the stage before, or a feature space of its own."""
        return not self.is_teaching_space and self.options.captured > 0 and self.options.captured_loss == "feature"

    @property
    def needs_truth(self) -> bool:
        """Whether the truth of a data set takes part."""
        return self.options.captured > 0 and self.options.captured_loss == "supervised" and not self.is_teaching_space

    @property
    def needs_surfaces(self) -> bool:
        """Whether the captures' disparities take part, by which their photos are taken again."""
        return self.options.retaken > 0

    @property
    def needs_undamaged(self) -> bool:
        """Whether undamaged views take part, which real captures do not have."""
        return self.options.symmetric_input or self.options.symmetric_loss


def ending_with(options: TrainOptions, stage: Stage) -> TrainOptions:
    """Options whose plan is the same up to a stage, and ends with it.

    Args:
        options: of a training.
        stage: of its plan.
    """
    section, _, number = stage.name.partition("-")
    if section == "feature":
        return options.model_copy(update={"stages": int(number)})
    changes: dict[str, object] = {"stages": 0}
    if not stage.is_teaching_space:
        changes |= {"feature_space": "own", "space": options.space.model_copy(update={"steps": 0})}
    if section == "rehearsal":
        changes["photometric"] = options.photometric.model_copy(update={"steps": 0})
    return options.model_copy(update=changes)


def plan_stages(options: TrainOptions) -> tuple[Stage, ...]:
    """List the stages in order; those without steps are left out."""
    named = [("rehearsal", options.rehearsal), ("photometric", options.photometric), (SPACE_STAGE, options.space)]
    named += [(f"feature-{k}", options.feature) for k in range(1, options.stages + 1)]
    kept = [(name, stage) for name, stage in named if stage.steps]
    return tuple(Stage(name, index, stage, options.feature_space) for index, (name, stage) in enumerate(kept))
