"""Options of training, as a recipe states them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from telewide.assets import Start
from telewide.options import Options
from telewide.ranges import MAX_CROP_PX, MAX_STAGES, MAX_STEP_PIXELS, MAX_STEPS

Count = Annotated[int, Field(ge=0, le=MAX_STEPS)]
Positive = Annotated[float, Field(gt=0)]
Side = Annotated[int, Field(ge=64, le=MAX_CROP_PX, multiple_of=16)]

WEIGHTS_NAME = "weights.safetensors"
"""Of the result of a training, in the folder of the training."""


CapturedLoss = Literal["photometric", "feature", "supervised"]
SpaceName = Literal["own", "contrastive", "auto-encoder"]
BatchStatistics = Literal["own", "kept"]
Keeps = Literal["best", "last"]


class StageOptions(Options):
    """One stage: where its crops come from, what they are compared by, how long it lasts."""

    steps: Count = 1000
    """Ceiling on steps; 0 leaves the stage out."""
    least_steps: Count = 0
    """Steps before a plateau may end the stage; its result is the best judged from there on, and of a shorter stage the
    last."""
    learning_rate: Positive = 1e-3
    """Of Adam; warmed up over the first steps, falling to a tenth over the last quarter of the ceiling."""
    final_rate_share: Annotated[float, Field(ge=0, le=1)] | None = None
    """Share of the learning rate that a cosine over all steps of the ceiling ends at; null takes the fall over the last
    quarter instead."""
    gradient_norm: Positive | None = 1.0
    """Longest gradient of a step; a longer one is shortened to it. null leaves all as they are, as published."""
    batch_statistics: BatchStatistics = "own"
    """Mean and variance by which batch normalisation scales: each batch's own, or those the stage begins with, kept."""
    rehearsed: Count = 0
    """Crops a step of cast worlds, painted with the user's photos where there are any, with exact disparity."""
    retaken: Count = 0
    """Crops a step of the user's sharp photos and what a lens beside would see of them by their matched disparity
    (`simulate.beside`): rehearsed too, in real scenes, with exact disparity."""
    captured: Count = 0
    """Crops a step of the real captures."""
    captured_loss: CapturedLoss = "photometric"
    """Comparison of the real crops: by eq. 3, by eq. 5, or smooth L1 against the truth of a data set."""
    captured_weight: Positive = 1.0
    """Weight of the real crops' loss beside the rehearsed crops'."""
    alpha: Annotated[float, Field(ge=0)] = 3.0
    """Weight of the structural part in eq. 3 and eq. 5."""
    halvings: Annotated[int, Field(ge=0, le=6)] = 0
    """Times that views are halved and compared by eq. 3 again, for networks that regress disparity from afar."""
    unit_features: bool = True
    """Scale features to unit length over the channels before eq. 5 compares them; the paper does not."""
    smoothness: Annotated[float, Field(ge=0)] = 0.1
    """lambda, weight of eq. 6."""
    occlusion_masks: bool = True
    """Leave pixels out of the real crops' loss that fail the left-right check."""
    swaps_views: bool = False
    """Exchange the views of real crops half of the time, mirrored, as the paper does."""
    symmetric_input: bool = False
    """Show the network undamaged views; for data sets that are damaged on purpose (settings S2 and S4 of the paper)."""
    symmetric_loss: bool = False
    """Compare undamaged views, whatever the network is shown (settings S3 and S4)."""
    judge_every_steps: Annotated[int, Field(ge=1)] | None = None
    """Steps between two questions to the held-out matches; null takes what holds for all stages."""

    @property
    def exact(self) -> int:
        """Crops a step whose disparity is exact."""
        return self.rehearsed + self.retaken

    @property
    def crops(self) -> int:
        """All crops of a step."""
        return self.exact + self.captured

    @property
    def counts_from(self) -> int:
        """Steps from which on a judgement decides."""
        return min(self.least_steps, self.steps)

    @model_validator(mode="after")
    def _has_crops(self) -> StageOptions:
        if self.steps and not self.crops:
            raise ValueError("a stage with steps needs crops: rehearsed, retaken or captured above 0")
        return self


class TrainOptions(Options):
    """The stages in their order and what they share."""

    crop_hw: tuple[Side, Side] = (256, 384)
    """Height and width of the crops, px."""
    start: Start = "scratch"
    """From the weights that come with telewide, or from random ones."""
    stages: Annotated[int, Field(ge=0, le=MAX_STAGES)] = 3
    """K, how many feature-metric stages follow at most."""
    rehearsal: StageOptions = StageOptions(steps=0)
    """Supervised by rendered pairs; before the paper's stages."""
    photometric: StageOptions = StageOptions(steps=0)
    """Stage 0 of the paper, eq. 3."""
    feature_space: SpaceName = "own"
    """Where eq. 5 compares: in the features of the stage before (the paper), of DeFeat-Net, or of FeatDepth."""
    space: StageOptions = StageOptions(steps=0)
    """Stage that teaches a feature space other than the network's own, on real crops; before the stages that use it."""
    feature: StageOptions = StageOptions(steps=0, captured_loss="feature")
    """Stages 1 to K of the paper, eq. 5 with the extractor of the stage before."""
    average_decay: Annotated[float, Field(ge=0, lt=1)] = 0.995
    """Decay of the running average of the weights that is kept as the result; 0 keeps the last weights."""
    judge_every_steps: Annotated[int, Field(ge=1)] = 250
    """Steps between two questions to the held-out matches."""
    keeps: Keeps = "best"
    """Result of a stage, from which the next one goes on: the weights judged best, or the last ones whatever the judge
    says. Then no plateau ends a stage and no stage ends the boosting, and those judged best lie beside the last."""
    patience: Annotated[int, Field(ge=1)] = 3
    """A stage has converged when so many judgements in a row brought nothing better."""
    worlds: bool = False
    """Rehearse on ray-cast worlds alone, without captures: how the weights in the box are made."""
    held_out_share: Annotated[float, Field(gt=0, lt=0.5)] = 0.2
    """Share of the captures (of each picture's width, when there are few) kept for judging."""
    asymmetry: tuple[Annotated[float, Field(ge=1)], Annotated[float, Field(ge=1)]] | None = None
    """Range of the factor by which rehearsed views lose resolution; null takes what was measured on the pairs."""

    @model_validator(mode="after")
    def _has_what_its_stages_need(self) -> TrainOptions:
        if self.asymmetry is not None and self.asymmetry[0] > self.asymmetry[1]:
            raise ValueError(f"asymmetry {list(self.asymmetry)} runs from the smaller factor to the larger")
        self._check_space()
        self._check_crops()
        # An auto-encoder needs pictures alone, a contrastive space the matches of a network.
        is_first = not (self.rehearsal.steps or self.photometric.steps) and self.feature_space != "auto-encoder"
        feature = self.feature
        if is_first and self.stages and feature.steps and feature.captured and feature.captured_loss == "feature":
            raise ValueError(
                "feature-metric stages compare by what the stage before has learned: rehearsal.steps or "
                "photometric.steps above 0"
            )
        return self

    def _check_crops(self) -> None:
        """Refuse steps that ask for more memory than machines have."""
        for name in ("rehearsal", "photometric", "space", "feature"):
            stage: StageOptions = getattr(self, name)
            n_pixels = stage.crops * self.crop_hw[0] * self.crop_hw[1]
            if stage.steps and n_pixels > MAX_STEP_PIXELS:
                raise ValueError(
                    f"{name}: {stage.crops} crops of {self.crop_hw[0]} x {self.crop_hw[1]} px a "
                    f"step; together at most {MAX_STEP_PIXELS} px"
                )

    def _check_space(self) -> None:
        if (self.feature_space == "own") != (self.space.steps == 0):
            raise ValueError(
                f"feature_space {self.feature_space} with space.steps {self.space.steps}: a space of its own is taught "
                "in a stage of its own, and the network's own space needs none"
            )
        if self.space.steps and (self.space.exact or not self.space.captured):
            raise ValueError(
                "a feature space is taught on real crops: space.captured above 0, space.rehearsed and space.retaken 0"
            )
