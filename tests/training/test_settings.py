"""Settings S1 to S4, losses by name, and the plan of a feature space of its own."""

from __future__ import annotations

import dataclasses
import signal
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch.nn import functional
from training.small import CPU, WINDOW, Heard, ScriptedJudge, source_of, stage_of, tensor_of, training_in, write_pairs

from telewide.capture.images import read_image, write_image
from telewide.capture.pair import Capture
from telewide.capture.pfm import write_pfm
from telewide.errors import UsageError
from telewide.matching.networks import NetworkOutput, standardise
from telewide.simulate.degrade import shrink_and_enlarge
from telewide.training.captured_losses import CAPTURED_LOSSES, Comparison
from telewide.training.checkpoint import load_state, new_state
from telewide.training.data import StepBatches
from telewide.training.loop import take_step, train
from telewide.training.losses import Term
from telewide.training.objective import Batch, objective
from telewide.training.options import CapturedLoss, SpaceName, TrainOptions
from telewide.training.samples import SampleSource, disparity_path
from telewide.training.spaces import SPACES
from telewide.training.stages import plan_stages


@pytest.fixture
def damaged(tmp_path: Path) -> SampleSource:
    """Two captures with a blurred source view, and the same before the damage."""
    sharp = write_pairs(tmp_path / "sharp")
    captures = []
    for capture in sharp:
        blurred = Capture(capture.name, capture.tele_path, tmp_path / "damaged" / f"{capture.name}.png")
        write_image(blurred.wide_path, shrink_and_enlarge(read_image(capture.wide_path), factor=4.0))
        captures.append(blurred)
    undamaged = {capture.name: capture for capture in sharp}
    return dataclasses.replace(source_of(captures), undamaged=undamaged)


def blur_of(view: torch.Tensor) -> float:
    """Mean step between neighbours, which blur lowers."""
    return float(torch.diff(view, dim=-1).abs().mean())


@pytest.mark.parametrize("swaps", [False, True])
def test_undamaged_views_are_the_same_crop_before_the_damage(damaged: SampleSource, swaps: bool) -> None:
    stage = stage_of(steps=9, captured=3, symmetric_loss=True, swaps_views=swaps)
    batches = StepBatches(damaged, stage, seed=3)
    n_exchanged = 0
    for step in range(6):
        batch = batches[step]
        ref, src = batch.views(is_symmetric=True)
        for shown, whole in ((batch.ref_BCHW, ref), (batch.src_BCHW, src)):
            for one, other in zip(shown, whole, strict=True):
                apart = functional.avg_pool2d(one - other, 16).abs().mean()
                assert apart < 0.02, "the same place and tint"
        is_ref_blurred = [blur_of(a) < 0.9 * blur_of(b) for a, b in zip(batch.ref_BCHW, ref, strict=True)]
        is_src_blurred = [blur_of(a) < 0.9 * blur_of(b) for a, b in zip(batch.src_BCHW, src, strict=True)]
        assert all(a != b for a, b in zip(is_ref_blurred, is_src_blurred, strict=True))
        n_exchanged += sum(is_ref_blurred)
    assert (n_exchanged > 0) == swaps


def test_real_captures_have_no_undamaged_views(source: SampleSource) -> None:
    with pytest.raises(UsageError, match="undamaged"):
        StepBatches(source, stage_of(steps=1, captured=1, symmetric_input=True), seed=0)
    batch = StepBatches(source, stage_of(steps=1, captured=1), seed=0)[0]
    with pytest.raises(ValueError, match="undamaged"):
        batch.views(is_symmetric=True)


SETTINGS = {"S1": (False, False), "S2": (True, False), "S3": (False, True), "S4": (True, True)}


@pytest.mark.parametrize(("of_input", "of_loss"), SETTINGS.values(), ids=SETTINGS)
def test_each_setting_shows_and_compares_what_it_says(
    damaged: SampleSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of_input: bool, of_loss: bool
) -> None:
    stage = stage_of(
        steps=1, captured=2, smoothness=0.0, occlusion_masks=False, symmetric_input=of_input, symmetric_loss=of_loss
    )
    batch = StepBatches(damaged, stage, seed=1)[0]
    state = new_state("lite", seed=1, device=CPU)
    shown: list[torch.Tensor] = []
    compared: list[torch.Tensor] = []
    state.network.features.register_forward_hook(lambda module, given, result: shown.append(given[0]))
    plain = CAPTURED_LOSSES["photometric"]

    def watched(crops: Comparison) -> Term:
        compared.append(crops.src_BCHW)
        return plain(crops)

    monkeypatch.setitem(CAPTURED_LOSSES, "photometric", watched)
    take_step(state, batch, stage, training=training_in(tmp_path, damaged))
    sharp = StepBatches(damaged, stage_of(steps=1, captured=2, symmetric_loss=True), seed=1)[0].views(is_symmetric=True)
    blurred = (batch.ref_BCHW, batch.src_BCHW)
    torch.testing.assert_close(compared[0], (sharp if of_loss else blurred)[1])
    expected = [standardise(view) for view in (sharp if of_input else blurred)]
    torch.testing.assert_close(shown[0], torch.cat(expected))
    assert not torch.allclose(sharp[1], blurred[1], atol=0.01)


def test_supervision_is_smooth_l1_alone(tmp_path: Path) -> None:
    """Per pixel ``e^2 / 2`` below a pixel and ``e - 1/2`` above, over known pixels of the window; no other term."""
    truth_px = torch.full((1, 8, 12), 10.0)
    truth_px[0, 0, 0], truth_px[0, 0, 1] = torch.nan, 99.0
    answer_px = torch.full((1, 8, 12), 10.5)
    answer_px[0, 7] = 13.0
    batch = Batch(torch.rand(1, 3, 8, 12), torch.rand(1, 3, 8, 12), truth_px, 0)
    output = NetworkOutput([answer_px], torch.zeros(1, 8, 2, 3))
    stage = stage_of(steps=1, captured=1, captured_loss="supervised", smoothness=0.0)
    loss, parts = objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)
    assert float(loss) == pytest.approx((82 * 0.125 + 12 * 2.5) / 94)
    assert parts["supervised"] == pytest.approx(float(loss))
    assert set(parts) == {"supervised", "smoothness"}


def test_supervised_stages_read_the_truth(captures: tuple[Capture, ...], tmp_path: Path) -> None:
    for capture in captures:
        path = disparity_path(tmp_path / capture.name, window_px=WINDOW)
        path.parent.mkdir()
        write_pfm(path, np.full((96, 144), 9.0, np.float32))
    source = source_of(captures, disparities=tmp_path)
    stage = stage_of(steps=1, captured=2, captured_loss="supervised")
    assert stage.needs_truth
    assert StepBatches(source, stage, seed=0)[0].truth_px_BHW.isfinite().all()


def test_every_loss_and_space_of_a_recipe_is_in_its_table() -> None:
    assert set(CAPTURED_LOSSES) == set(get_args(CapturedLoss))
    assert {*SPACES, "own"} == set(get_args(SpaceName))


# Feature spaces in the plan

SPACE = {"steps": 3, "captured": 2, "learning_rate": 1e-3}
FEATURE = {"steps": 2, "captured": 1, "captured_loss": "feature", "occlusion_masks": False}
PHOTOMETRIC = {"steps": 2, "captured": 1}


def test_a_space_is_taught_before_the_stages_that_use_it() -> None:
    options = TrainOptions.model_validate(
        {"photometric": PHOTOMETRIC, "feature_space": "contrastive", "space": SPACE, "feature": FEATURE, "stages": 1}
    )
    plan = plan_stages(options)
    assert [(s.name, s.is_teaching_space, s.needs_teacher, s.space) for s in plan] == [
        ("photometric", False, False, "contrastive"),
        ("space", True, False, "contrastive"),
        ("feature-1", False, True, "contrastive"),
    ]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"feature_space": "contrastive", "photometric": PHOTOMETRIC, "feature": FEATURE}, "space.steps"),
        ({"space": SPACE, "photometric": PHOTOMETRIC}, "feature_space own"),
        ({"feature_space": "contrastive", "space": SPACE, "feature": FEATURE}, "photometric.steps"),
        ({"feature_space": "auto-encoder", "space": {**SPACE, "captured": 0, "rehearsed": 1}}, "real crops"),
    ],
)
def test_a_plan_without_what_a_space_needs_is_refused(options: dict[str, object], word: str) -> None:
    with pytest.raises(ValidationError, match=word):
        TrainOptions.model_validate(options)


def test_tensors_of_a_sample_are_its_views(damaged: SampleSource) -> None:
    stage = stage_of(steps=1, rehearsed=1, captured=1, symmetric_loss=True)
    batch = StepBatches(replace(damaged, asymmetry=(5.0, 6.0)), stage, seed=0)[0]
    assert batch.undamaged is not None
    views = zip(batch.undamaged, (batch.ref_BCHW, batch.src_BCHW), strict=True)
    for_ref, for_src = (float((sharp[0] - seen[0]).abs().mean()) for sharp, seen in views)
    assert for_ref < 0.4 * for_src, "of what is rehearsed, ref has lost little, and src much"
    assert tensor_of(np.zeros((4, 5, 3), np.float32)).shape == (1, 3, 4, 5)
    assert batch.to(CPU).undamaged is not None


@pytest.mark.parametrize("space", ["contrastive", "auto-encoder"])
def test_a_space_is_taught_frozen_and_used_and_a_stopped_training_goes_on(
    source: SampleSource, tmp_path: Path, space: str
) -> None:
    """Stopped within the stage of the space, it ends with the weights of one that was not stopped."""
    content = {
        "crop_hw": source.crop_hw,
        "photometric": PHOTOMETRIC,
        "feature_space": space,
        "space": SPACE,
        "feature": FEATURE,
        "stages": 2,
    }
    options = TrainOptions.model_validate(content)
    whole = _run(tmp_path / "whole", source, options)
    stopped = _run(tmp_path / "stopped", source, options, stop_after=("space", 2))
    assert whole[0].keys() == {*PHASES}
    assert whole[0] == pytest.approx(stopped[0], rel=1e-4)
    assert all(torch.equal(a, b) for a, b in zip(whole[1], stopped[1], strict=True))


PHASES = [
    *(("photometric", step) for step in (1, 2)),
    *(("space", step) for step in (1, 2, 3)),
    *((f"feature-{k}", step) for k in (1, 2) for step in (1, 2)),
]


def _run(
    folder: Path, source: SampleSource, options: TrainOptions, *, stop_after: tuple[str, int] | None = None
) -> tuple[dict[tuple[str, int], float], list[torch.Tensor]]:
    """Losses of every step, and the frozen space at the end."""
    folder.mkdir()
    training = training_in(folder, source, options=options, judge=ScriptedJudge((0.5, 0.4, 0.3)))
    state, losses = new_state("lite", seed=1, device=CPU), {}
    taught: list[torch.Tensor] = []

    def note(name: str, step: int) -> None:
        losses[name, step] = sum(heard.losses[name, step].values())
        if name.startswith("feature"):
            assert state.teacher is not None
            assert not any(p.requires_grad for p in state.teacher.parameters())
            now = [p.clone() for p in state.teacher.state_dict().values()]
            assert not taught or all(torch.equal(a, b) for a, b in zip(taught, now, strict=True))
            taught[:] = now
        if (name, step) == stop_after:
            signal.raise_signal(signal.SIGINT)

    heard = Heard(after_step=note)
    if stop_after is not None:
        with pytest.raises(KeyboardInterrupt):
            train(training, state, reporter=heard)
        state = load_state(folder / "state.pt", network_name="lite", device=CPU, plan=plan_stages(options))
        assert state.stage_index == 1
        assert state.step == stop_after[1]
    train(training, state, reporter=heard)
    assert not (folder / "space.safetensors").exists()
    return losses, taught


@pytest.mark.parametrize(
    "options",
    [
        {"stages": 101},
        {"stages": 10**18},
        {"rehearsal": {"steps": 10**10, "rehearsed": 1}},
        {"crop_hw": [10**6, 64]},
        {"rehearsal": {"steps": 1, "rehearsed": 10**9}},
        {"crop_hw": [512, 512], "photometric": {"steps": 1, "captured": 65}},
    ],
)
def test_numbers_that_ask_for_more_memory_than_there_is_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TrainOptions.model_validate(options)
