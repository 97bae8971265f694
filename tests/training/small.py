"""Trainings small enough for a test: two captures of 96x144 px, crops of 64x96, a window of 32 px, a few steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from telewide.capture.images import write_image
from telewide.capture.pair import Capture
from telewide.matching.networks import StereoNetwork
from telewide.simulate.layers import RenderedPair, render_pair
from telewide.simulate.scene import random_scene
from telewide.training.judge import Judge
from telewide.training.loop import Training
from telewide.training.options import StageOptions, TrainOptions
from telewide.training.processes import Processes
from telewide.training.samples import CropArea, SampleSource
from telewide.training.stages import Stage

WINDOW = (0, 32)
CROP_HW = (64, 96)
CPU = torch.device("cpu")


def rendered(seed: int, *, hw: tuple[int, int] = (96, 144)) -> RenderedPair:
    """A random scene with disparities of 2 to 26 px."""
    return render_pair(random_scene(np.random.default_rng(seed), hw=hw, disparity_window_px=(2.0, 26.0)))


def tensor_of(image: NDArray[np.float32]) -> torch.Tensor:
    """(H, W, 3) to (1, 3, H, W)."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


def write_pairs(folder: Path, *, count: int = 2, hw: tuple[int, int] = (96, 144)) -> tuple[Capture, ...]:
    """Captures as they lie corrected in a run folder."""
    captures = []
    for seed in range(count):
        pair = rendered(seed, hw=hw)
        capture = Capture(f"{seed:03d}", folder / f"{seed:03d}" / "tele.png", folder / f"{seed:03d}" / "wide.png")
        write_image(capture.tele_path, pair.ref)
        write_image(capture.wide_path, pair.src)
        captures.append(capture)
    return tuple(captures)


def source_of(
    captures: Sequence[Capture], *, area: CropArea | None = None, disparities: Path | None = None
) -> SampleSource:
    """Small crops of some captures."""
    return SampleSource(
        tuple(captures), crop_hw=CROP_HW, window_px=WINDOW, area=area or CropArea(), disparities_folder=disparities
    )


def stage_of(index: int = 0, *, name: str = "rehearsal", **options: object) -> Stage:
    """A stage with the named options."""
    return Stage(name, index, StageOptions.model_validate(options))


@dataclass
class ScriptedJudge:
    """Gives the answers it was handed, the last one for ever."""

    answers: Sequence[float] = (0.5,)
    asked: int = 0

    def __call__(self, network: StereoNetwork) -> dict[str, float]:
        answer = self.answers[min(self.asked, len(self.answers) - 1)]
        self.asked += 1
        return {"off_1px": answer, "off_3px": answer / 2, "mean_px": 1.0, "clipped_px": answer}


@dataclass
class Heard:
    """A reporter that remembers."""

    losses: dict[tuple[str, int], dict[str, float]] = field(default_factory=dict)
    judgements: list[tuple[str, int, float]] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    finished: list[str] = field(default_factory=list)
    after_step: Callable[[str, int], None] | None = None
    seconds: float = 0.0

    def stage_started(self, stage: Stage, *, first_step: int) -> None: ...

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        self.losses[stage.name, step] = dict(losses)
        self.seconds += seconds
        if self.after_step is not None:
            self.after_step(stage.name, step)

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        self.judgements.append((stage.name, step, judgement["clipped_px"]))

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        self.finished.append(stage.name)

    def said(self, message: str) -> None:
        self.messages.append(message)


def three_stages(**options: object) -> TrainOptions:
    """Rehearsal, photometric and feature-metric stages of four steps each."""
    rehearsal = {"steps": 4, "rehearsed": 2}
    photometric = {"steps": 4, "captured": 1, "captured_loss": "photometric", "swaps_views": True}
    feature = {"steps": 4, "captured": 1, "captured_loss": "feature"}
    content: dict[str, object] = {
        "crop_hw": CROP_HW,
        "stages": 1,
        "rehearsal": rehearsal,
        "photometric": photometric,
        "feature": feature,
        "judge_every_steps": 3,
    }
    return TrainOptions.model_validate({**content, **options})


def training_in(
    folder: Path,
    source: SampleSource,
    *,
    options: TrainOptions | None = None,
    judge: Judge | None = None,
    processes: Processes | None = None,
    network: str = "lite",
) -> Training:
    """A training on this process alone unless told otherwise."""
    return Training(
        folder=folder,
        options=options or three_stages(),
        source=source,
        judge=judge or ScriptedJudge(),
        seed=5,
        network_name=network,
        recipe={},
        device=CPU,
        processes=processes or Processes(),
        workers=0,
    )
