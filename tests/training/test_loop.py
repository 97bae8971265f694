"""The loop: what is resumed is what would have been, stages end when they should, and nothing bad is kept."""

from __future__ import annotations

import contextlib
import copy
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch
from pydantic import ValidationError
from training.small import CPU, CROP_HW, Heard, ScriptedJudge, stage_of, three_stages, training_in

from telewide.cores import processor_name
from telewide.errors import QualityError, UsageError
from telewide.matching.inference import full_precision
from telewide.matching.networks import NETWORKS, StereoNetwork, build_network
from telewide.origin import source_state
from telewide.training import loop
from telewide.training.checkpoint import (
    STATE_NAME,
    TrainingState,
    load_state,
    load_weights,
    new_state,
    save_state,
)
from telewide.training.data import StepBatches, _interrupts_held
from telewide.training.loop import (
    COOL_DOWN_SHARE,
    LAST_LEARNING_RATE,
    WARM_UP_STEPS,
    go_on,
    learning_rate,
    set_learning,
    take_step,
    train,
)
from telewide.training.objective import Batch
from telewide.training.options import WEIGHTS_NAME, TrainOptions
from telewide.training.processes import Processes
from telewide.training.samples import SampleSource
from telewide.training.stages import Stage, ending_with, plan_stages
from telewide.training.weights_card import read_card


def fresh() -> TrainingState:
    return new_state("lite", seed=1, device=CPU)


def is_same(a: torch.nn.Module, b: torch.nn.Module) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a.state_dict().values(), b.state_dict().values(), strict=True))


def short(**options: object) -> TrainOptions:
    """Only what is named, at one judgement a step."""
    content: dict[str, object] = {"crop_hw": CROP_HW, "judge_every_steps": 1, "stages": 3}
    return TrainOptions.model_validate({**content, **options})


PHOTOMETRIC = {"steps": 1, "captured": 1}
FEATURE = {"steps": 1, "captured": 1, "captured_loss": "feature"}


# Stopping and going on


def test_resumed_training_is_the_uninterrupted_one(
    tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped three times, where it hurts: at a judgement, at the end of a stage, under a frozen extractor."""
    whole = Heard()
    judge = ScriptedJudge((0.9, 0.8, 0.7, 0.6, 0.5, 0.4))
    finished = train(training_in(tmp_path / "whole", source, judge=judge), fresh(), reporter=whole)
    assert list(whole.losses) == [
        (name, step) for name in ("rehearsal", "photometric", "feature-1") for step in range(1, 5)
    ]

    pieces = Heard()
    judge = ScriptedJudge((0.9, 0.8, 0.7, 0.6, 0.5, 0.4))
    training = training_in(tmp_path / "pieces", source, judge=judge)
    state = fresh()
    for stop in (("rehearsal", 3), ("photometric", 4), ("feature-1", 2)):
        pieces.after_step = lambda name, step, stop=stop: (
            signal.raise_signal(signal.SIGINT) if (name, step) == stop else None
        )
        with pytest.raises(KeyboardInterrupt):
            train(training, state, reporter=pieces)
        state = load_state(tmp_path / "pieces" / STATE_NAME, network_name="lite", device=CPU)
        load_weights(tmp_path / "pieces" / WEIGHTS_NAME, device=CPU)
    pieces.after_step = None
    resumed = train(training, state, reporter=pieces)

    assert pieces.losses == whole.losses
    assert pieces.judgements == whole.judgements
    assert resumed.trained_s == pytest.approx(pieces.seconds)
    assert is_same(resumed.network, finished.network)
    assert is_same(resumed.average, finished.average)
    assert resumed.stage_judgements == finished.stage_judgements == [0.8, 0.6, 0.4]


def test_a_checkpoint_taken_anywhere_leads_to_the_same_end(
    tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a kill: every checkpoint the loop writes by itself is tried, none of them after a polite stop."""
    monkeypatch.setattr(loop, "CHECKPOINT_EVERY_S", 0.0)
    kept: dict[tuple[int, int], bytes] = {}
    training = training_in(tmp_path, source, options=short(photometric={**PHOTOMETRIC, "steps": 3}, stages=0))

    def keep(name: str, step: int) -> None:
        path = tmp_path / STATE_NAME
        if path.is_file():
            state = load_state(path, network_name="lite", device=CPU)
            kept[state.stage_index, state.step] = path.read_bytes()

    whole = Heard(after_step=keep)
    end = train(training, fresh(), reporter=whole)
    assert sorted(kept) == [(0, 1), (0, 2)]
    for (_, step), content in kept.items():
        (tmp_path / STATE_NAME).write_bytes(content)
        again = Heard()
        state = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
        assert is_same(train(training, state, reporter=again).average, end.average)
        assert again.losses == {key: value for key, value in whole.losses.items() if key[1] > step}
        assert again.judgements == [answer for answer in whole.judgements if answer[1] > step]


class Killed(BaseException):
    """The process is gone."""


@pytest.mark.parametrize("write", range(1, 10))
def test_a_training_that_says_it_is_finished_has_its_weights(
    write: int, tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed before each of its writes in turn: the next call goes on, or all is there. The second step is the best."""
    writes = 0

    def killed_before(saving: Callable[..., None]) -> Callable[..., None]:
        def counted(*args: object, **kwargs: object) -> None:
            nonlocal writes
            writes += 1
            if writes == write:
                raise Killed
            saving(*args, **kwargs)

        return counted

    options = short(photometric={**PHOTOMETRIC, "steps": 3}, stages=0)
    training = training_in(tmp_path, source, options=options, judge=ScriptedJudge((0.9, 0.5, 0.7, 0.7, 0.7)))
    with monkeypatch.context() as patch:
        for name in ("save_state", "save_weights"):
            patch.setattr(loop, name, killed_before(getattr(loop, name)))
        patch.setattr(loop, "CHECKPOINT_EVERY_S", 0.0)
        with contextlib.suppress(Killed):
            train(training, fresh(), reporter=Heard())
    if not (tmp_path / STATE_NAME).is_file():
        return
    state = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
    if state.is_finished:
        kept, _ = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
        assert is_same(kept, state.average)


def test_a_second_interrupt_stops_at_once(tmp_path: Path, source: SampleSource) -> None:
    def twice(name: str, step: int) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(training_in(tmp_path, source), fresh(), reporter=Heard(after_step=twice))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_interrupts_are_as_usual_after_training(tmp_path: Path, source: SampleSource) -> None:
    train(training_in(tmp_path, source, options=short(photometric=PHOTOMETRIC, stages=0)), fresh(), reporter=Heard())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# What must not be kept


def test_a_loss_that_is_no_number_stops_before_the_weights(tmp_path: Path, source: SampleSource) -> None:
    stage = stage_of(steps=3, rehearsed=1, captured=1)
    training = training_in(tmp_path, source)
    state = fresh()
    good = StepBatches(source, stage, seed=0)[0]
    take_step(state, good, stage, training=training)
    save_state(state, tmp_path / STATE_NAME)
    poisoned = Batch(good.ref_BCHW * torch.nan, good.src_BCHW, good.truth_px_BHW, good.n_rehearsed)
    with pytest.raises(QualityError, match="not a number") as raised:
        take_step(state, poisoned, stage, training=training)
    assert "train.rehearsal.learning_rate" in str(raised.value.hint)
    kept = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
    assert is_same(kept.network, state.network)
    assert is_same(kept.average, state.average)


def test_a_gradient_that_is_no_number_stops_before_the_weights(
    tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A root at zero has a finite value and no finite slope."""

    class Rooted(StereoNetwork):
        def forward(self, ref: torch.Tensor, src: torch.Tensor, window: tuple[int, int]) -> object:  # type: ignore[override]
            output = super().forward(ref, src, window)
            output.disparities_px[-1] = output.disparities_px[-1] + (output.disparities_px[-1] * 0).abs().sqrt()
            return output

    def build() -> StereoNetwork:
        plain = build_network("lite", seed=1)
        return Rooted(plain.features, plain.matching)

    monkeypatch.setitem(NETWORKS, "rooted", build)
    state = new_state("rooted", seed=1, device=CPU)
    stage = stage_of(steps=3, rehearsed=1)
    before = {name: tensor.clone() for name, tensor in state.network.state_dict().items()}
    with pytest.raises(QualityError, match="gradient"):
        take_step(state, StepBatches(source, stage, seed=0)[0], stage, training=training_in(tmp_path, source))
    assert all(torch.equal(before[name], tensor) for name, tensor in state.network.state_dict().items())


def test_a_training_that_diverges_keeps_the_last_good_checkpoint(
    tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "CHECKPOINT_EVERY_S", 0.0)
    monkeypatch.setattr(loop, "WARM_UP_STEPS", 1)
    options = short(rehearsal={"steps": 9, "rehearsed": 1, "learning_rate": 1e25}, stages=0, judge_every_steps=100)
    with pytest.raises(QualityError, match="last good checkpoint is kept"):
        train(training_in(tmp_path, source, options=options), fresh(), reporter=Heard())
    state = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
    assert all(bool(parameter.isfinite().all()) for parameter in state.network.parameters())


# When stages end


def test_a_plateau_ends_a_stage(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 9}, stages=0, patience=2)
    heard = Heard()
    judge = ScriptedJudge((0.5, 0.4, 0.399, 0.4))  # two answers in a row that gain less than 0.002
    train(training_in(tmp_path, source, options=options, judge=judge), fresh(), reporter=heard)
    assert len(heard.losses) == 4
    assert heard.finished == ["photometric"]


def test_no_plateau_ends_a_stage_before_its_least_steps(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 9, "least_steps": 6}, stages=0, patience=1)
    heard = Heard()
    train(training_in(tmp_path, source, options=options, judge=ScriptedJudge((0.5,))), fresh(), reporter=heard)
    assert len(heard.losses) == 6


@pytest.mark.parametrize("answers", [(0.9, 0.7, 0.5, 0.3, 0.1), (float("nan"),)])
def test_a_stage_that_gets_better_goes_on_to_its_ceiling(
    tmp_path: Path, source: SampleSource, answers: tuple[float, ...]
) -> None:
    """And one that cannot be judged, for want of matches, too."""
    options = short(photometric={**PHOTOMETRIC, "steps": 5}, stages=0, patience=1)
    heard = Heard()
    state = train(training_in(tmp_path, source, options=options, judge=ScriptedJudge(answers)), fresh(), reporter=heard)
    assert len(heard.losses) == 5
    assert state.is_finished


def test_a_stage_results_in_the_weights_that_were_judged_best(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 9}, stages=0, patience=2)
    at_step: dict[int, StereoNetwork] = {}
    state = fresh()
    heard = Heard(after_step=lambda name, step: at_step.update({step: copy.deepcopy(state.average)}))
    judge = ScriptedJudge((0.5, 0.3, 0.4, 0.6))
    train(training_in(tmp_path, source, options=options, judge=judge), state, reporter=heard)
    assert len(at_step) == 4
    result, card = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
    assert is_same(result, at_step[2])
    assert not is_same(result, at_step[4])
    assert state.stage_judgements == [0.3]
    assert card.training["stage"] == "photometric"
    assert card.training["step"] == 2
    assert card.training["clipped_px"] == [0.3]


@pytest.mark.parametrize("worlds", [True, False])
def test_a_result_says_by_which_source_and_on_what_it_was_made_and_the_box_how_long(
    tmp_path: Path, source: SampleSource, *, worlds: bool
) -> None:
    state = fresh()
    state.trained_s = 7200.0  # before a resumption
    options = short(photometric={**PHOTOMETRIC, "steps": 2}, stages=0, worlds=worlds)
    train(training_in(tmp_path, source, options=options), state, reporter=Heard())
    made = read_card(tmp_path / WEIGHTS_NAME).training
    assert made["commit"] == source_state()
    assert made["device"] == processor_name()
    assert made.get("hours") == (pytest.approx(state.trained_s / 3600, abs=1e-4) if worlds else None)
    assert state.trained_s > 7200


def test_no_judgement_before_the_least_steps_counts(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 4, "least_steps": 3}, stages=0)
    judge = ScriptedJudge((0.1, 0.2, 0.5, 0.4))
    state = train(training_in(tmp_path, source, options=options, judge=judge), fresh(), reporter=Heard())
    assert state.stage_judgements == [0.4]


def test_a_training_that_starts_from_a_result_never_ends_below_it(tmp_path: Path, source: SampleSource) -> None:
    """It is judged before the first step, and kept where no step brought anything better."""
    state, heard = fresh(), Heard()
    start = copy.deepcopy(state.average)
    options = short(photometric={**PHOTOMETRIC, "steps": 3, "least_steps": 3}, stages=0, start="box")
    training = training_in(tmp_path, source, judge=ScriptedJudge((0.3, 0.9, 0.9, 0.4)), options=options)
    finished = train(training, state, reporter=heard)
    assert heard.judgements[0] == ("photometric", 0, 0.3)
    assert is_same(finished.average, start)
    assert finished.stage_judgements == [0.3]


def test_a_stage_may_be_judged_at_steps_of_its_own(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 4, "judge_every_steps": 2}, stages=0)
    heard = Heard()
    train(training_in(tmp_path, source, options=options), fresh(), reporter=heard)
    assert [step for _, step, _ in heard.judgements] == [2, 4]


def test_the_best_weights_outlive_an_interruption(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 3}, stages=0)

    def stop(name: str, step: int) -> None:
        if step == 2:
            signal.raise_signal(signal.SIGINT)

    judge = ScriptedJudge((0.2, 0.4, 0.3))
    training = training_in(tmp_path, source, options=options, judge=judge)
    with pytest.raises(KeyboardInterrupt):
        train(training, fresh(), reporter=Heard(after_step=stop))
    state = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
    assert state.best is not None
    assert state.best.step == 1
    train(training, state, reporter=Heard())
    assert state.stage_judgements == [0.2]


def test_boosting_stops_when_the_judge_no_longer_falls(tmp_path: Path, source: SampleSource) -> None:
    heard = Heard()
    training = training_in(
        tmp_path,
        source,
        options=short(photometric=PHOTOMETRIC, feature=FEATURE, average_decay=0.0),
        judge=ScriptedJudge((0.5, 0.4, 0.45, 0.1)),
    )
    state = train(training, fresh(), reporter=heard)
    assert heard.finished == ["photometric", "feature-1", "feature-2"]
    assert plan_stages(training.options)[state.best_stage].name == "feature-1"
    assert [m for m in heard.messages if "feature-2" in m and "feature-1 is kept" in m]
    best, _ = load_weights(tmp_path / "feature-1.safetensors", device=CPU)
    worse, _ = load_weights(tmp_path / "feature-2.safetensors", device=CPU)
    result, card = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
    assert is_same(result, best)
    assert is_same(state.average, best)
    assert not is_same(result, worse)
    assert card.training["stage"] == "feature-1"
    assert state.stage_judgements == [0.5, 0.4, 0.45]


def test_boosting_goes_on_while_the_judge_falls(tmp_path: Path, source: SampleSource) -> None:
    heard = Heard()
    training = training_in(
        tmp_path,
        source,
        options=short(photometric=PHOTOMETRIC, feature=FEATURE),
        judge=ScriptedJudge((0.5, 0.4, 0.3, 0.2)),
    )
    state = train(training, fresh(), reporter=heard)
    assert heard.finished == ["photometric", "feature-1", "feature-2", "feature-3"]
    assert state.best_stage == 3
    assert state.is_finished
    assert heard.messages == []


def test_last_weights_are_kept_whatever_the_judge_says_and_the_best_beside(
    tmp_path: Path, source: SampleSource
) -> None:
    options = short(
        photometric={**PHOTOMETRIC, "steps": 2}, feature={**FEATURE, "steps": 2}, keeps="last", stages=1, patience=1
    )
    answers = (0.1, 0.5, 0.9, 0.7)
    training = training_in(tmp_path, source, options=options, judge=ScriptedJudge(answers))
    state = train(training, fresh(), reporter=Heard())
    assert plan_stages(options)[state.best_stage].name == "feature-1"
    assert state.stage_judgements == [0.5, 0.7]
    steps = {}
    for name in ("photometric", "photometric-best", "feature-1", "feature-1-best", "weights"):
        _, card = load_weights(tmp_path / f"{name}.safetensors", device=CPU)
        steps[name] = card.training["step"], card.training["clipped_px"]
    assert steps == {
        "photometric": (2, [0.5]),
        "photometric-best": (1, [0.1]),
        "feature-1": (2, [0.7]),
        "feature-1-best": (2, [0.7]),
        "weights": (2, [0.7]),
    }
    result, _ = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
    assert is_same(result, state.average)


def test_a_finished_training_goes_on_where_its_plan_is_longer(tmp_path: Path, source: SampleSource) -> None:
    whole = short(photometric=PHOTOMETRIC, feature=FEATURE, keeps="last", stages=2)
    training = training_in(tmp_path / "whole", source, options=whole)
    at_once = train(training, fresh(), reporter=Heard())
    folder, state = tmp_path / "piecewise", fresh()
    for stage in plan_stages(whole):
        options = ending_with(whole, stage)
        if stage.index:
            before = ending_with(whole, plan_stages(whole)[stage.index - 1])
            state = load_state(folder / STATE_NAME, network_name="lite", device=CPU, plan=plan_stages(before))
            go_on(state)
        state = train(training_in(folder, source, options=options), state, reporter=Heard())
    assert is_same(state.average, at_once.average)
    assert state.stage_judgements == at_once.stage_judgements


def test_a_finished_training_takes_no_step(tmp_path: Path, source: SampleSource) -> None:
    training = training_in(tmp_path, source, options=short(photometric=PHOTOMETRIC, stages=0))
    state = train(training, fresh(), reporter=Heard())
    heard = Heard()
    train(training, state, reporter=heard)
    assert heard.losses == {}


def test_each_stage_compares_by_the_extractor_of_the_one_before(tmp_path: Path, source: SampleSource) -> None:
    teachers: list[torch.nn.Module] = []
    state = fresh()
    heard = Heard(after_step=lambda name, step: teachers.append(state.teacher) if state.teacher is not None else None)
    training = training_in(
        tmp_path,
        source,
        options=short(photometric=PHOTOMETRIC, feature=FEATURE, stages=2),
        judge=ScriptedJudge((0.5, 0.4, 0.3)),
    )
    train(training, state, reporter=heard)
    before = [load_weights(tmp_path / f"{name}.safetensors", device=CPU)[0] for name in ("photometric", "feature-1")]
    assert len(teachers) == 2
    assert all(is_same(teacher, network.features) for teacher, network in zip(teachers, before, strict=True))


@dataclass
class Watching(Heard):
    """Remembers what each stage begins with, and how many steps the optimiser knows of after each step."""

    state: TrainingState | None = None
    begun: dict[str, StereoNetwork] = field(default_factory=dict)
    moments: dict[str, int] = field(default_factory=dict)
    ages: dict[tuple[str, int], float] = field(default_factory=dict)

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        assert self.state is not None
        self.begun[stage.name] = copy.deepcopy(self.state.network)
        self.moments[stage.name] = len(self.state.optimiser.state)

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        assert self.state is not None
        self.ages[stage.name, step] = max(float(of["step"]) for of in self.state.optimiser.state.values())


@pytest.mark.parametrize("name", ["lite", "psmnet-s"])
def test_a_stage_starts_from_the_last_result_with_a_fresh_optimiser(
    tmp_path: Path, source: SampleSource, name: str
) -> None:
    """The result is the average as it was judged best, here not the last one; Adam has seen nothing yet."""
    options = short(
        photometric={**PHOTOMETRIC, "steps": 3}, feature={**FEATURE, "steps": 2}, stages=1, average_decay=0.5
    )
    watching = Watching(state=new_state(name, seed=1, device=CPU))
    judge = ScriptedJudge((0.5, 0.2, 0.4, 0.1, 0.1))
    assert watching.state is not None
    train(training_in(tmp_path, source, options=options, judge=judge, network=name), watching.state, reporter=watching)
    result, card = load_weights(tmp_path / "photometric.safetensors", device=CPU)
    assert card.training["step"] == 2
    assert is_same(watching.begun["feature-1"], result)
    assert watching.moments == {"photometric": 0, "feature-1": 0}
    assert watching.ages == {
        ("photometric", 1): 1,
        ("photometric", 2): 2,
        ("photometric", 3): 3,
        ("feature-1", 1): 1,
        ("feature-1", 2): 2,
    }


# Steps


def test_learning_rate_warms_up_and_cools_down() -> None:
    stage = stage_of(steps=1000, rehearsed=1, learning_rate=2e-3)
    rates = [learning_rate(stage, step=step) for step in range(1000)]
    assert rates[0] == pytest.approx(2e-3 / WARM_UP_STEPS)
    assert rates[WARM_UP_STEPS - 1 : 750] == pytest.approx([2e-3] * (751 - WARM_UP_STEPS))
    assert all(a > b for a, b in pairwise(rates[751:]))
    assert rates[-1] == pytest.approx(2e-3 * (LAST_LEARNING_RATE + 0.9 * 0.001 / COOL_DOWN_SHARE))


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_learning_rate_falls_along_the_cosine_of_torch(share: float) -> None:
    """Oracle: ``CosineAnnealingLR``."""
    stage = stage_of(steps=200, rehearsed=1, learning_rate=2e-3, final_rate_share=share)
    optimiser = torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, T_max=200, eta_min=share * 2e-3)
    for step in range(200):
        warmth = min(1.0, (step + 1) / WARM_UP_STEPS)
        assert learning_rate(stage, step=step) == pytest.approx(warmth * optimiser.param_groups[0]["lr"], rel=1e-6)
        optimiser.step()
        schedule.step()


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_learning_rate_that_ends_below_nothing_or_above_itself_is_refused(share: float) -> None:
    with pytest.raises(ValidationError, match="final_rate_share"):
        stage_of(steps=200, rehearsed=1, final_rate_share=share)


def test_no_gradient_is_longer_than_one(tmp_path: Path, source: SampleSource) -> None:
    """A lesson a thousand times as loud moves the weights no farther."""
    state, training = fresh(), training_in(tmp_path, source)
    loud = stage_of(steps=1000, captured=1, captured_loss="photometric", captured_weight=1e3)
    take_step(state, StepBatches(source, loud, seed=0)[0], loud, training=training)
    gradient = torch.cat([p.grad.flatten() for p in state.network.parameters() if p.grad is not None])
    assert float(gradient.norm()) == pytest.approx(1.0, rel=1e-3)


def test_without_a_norm_a_gradient_is_as_long_as_the_loss_is_loud(tmp_path: Path, source: SampleSource) -> None:
    lengths = []
    for weight in (1e2, 1e3):
        state, training = fresh(), training_in(tmp_path, source)
        options = {"captured_loss": "photometric", "captured_weight": weight, "smoothness": 0.0, "gradient_norm": None}
        stage = stage_of(steps=1000, captured=1, **options)
        take_step(state, StepBatches(source, stage, seed=0)[0], stage, training=training)
        gradient = torch.cat([p.grad.flatten() for p in state.network.parameters() if p.grad is not None])
        lengths.append(float(gradient.norm()))
    assert lengths[0] > 1
    assert lengths[1] == pytest.approx(10 * lengths[0], rel=0.02)


def test_the_average_follows_the_weights(tmp_path: Path, source: SampleSource) -> None:
    stage = stage_of(steps=30, rehearsed=1)
    state = fresh()
    training = training_in(tmp_path, source, options=three_stages(average_decay=0.0))
    take_step(state, StepBatches(source, stage, seed=0)[0], stage, training=training)
    assert is_same(state.average, state.network), "no decay keeps the last weights"
    state, training = fresh(), training_in(tmp_path, source, options=three_stages(average_decay=0.9))
    start = {name: tensor.clone() for name, tensor in state.network.state_dict().items()}
    state.step = 20
    take_step(state, StepBatches(source, stage, seed=0)[0], stage, training=training)
    weight = 1 - min(0.9, 21 / 30)
    for name, now in state.network.state_dict().items():
        expected = torch.lerp(start[name], now, weight)
        torch.testing.assert_close(state.average.state_dict()[name], expected)


@pytest.mark.parametrize(("start", "kept"), [("box", 0.9), ("scratch", 1 / 10)])
def test_learned_weights_keep_their_share_of_the_average_and_random_ones_do_not(
    tmp_path: Path, source: SampleSource, start: str, kept: float
) -> None:
    """The first step: the decay as stated, or the warm-up's (step + 1) / (step + 10)."""
    state = fresh()
    before = {name: tensor.clone() for name, tensor in state.network.named_parameters()}
    training = training_in(tmp_path, source, options=three_stages(average_decay=0.9, start=start))
    stage = stage_of(steps=30, rehearsed=1)
    take_step(state, StepBatches(source, stage, seed=0)[0], stage, training=training)
    now = dict(state.network.named_parameters())
    for name, average in state.average.named_parameters():
        torch.testing.assert_close(average, torch.lerp(now[name], before[name], kept))


def test_a_network_added_by_name_trains(tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line in NETWORKS is all a new network needs."""
    monkeypatch.setitem(NETWORKS, "twin", NETWORKS["lite"])
    state = new_state("twin", seed=1, device=CPU)
    before = copy.deepcopy(state.network)
    options = short(photometric={**PHOTOMETRIC, "steps": 2}, stages=0)
    train(training_in(tmp_path, source, options=options, network="twin"), state, reporter=Heard())
    moved = {name for name, p in state.network.named_parameters() if not torch.equal(p, before.get_parameter(name))}
    assert {name.partition(".")[0] for name in moved} == {"features", "matching"}
    result, card = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
    assert card.network == "twin"
    assert is_same(result, state.average)


def test_running_statistics_of_psmnet_are_part_of_the_result(tmp_path: Path, source: SampleSource) -> None:
    """The average takes the network's own, undecayed, and the weights on disk hold them."""
    state = new_state("psmnet-s", seed=1, device=CPU)
    fresh_buffers = {name: buffer.clone() for name, buffer in state.network.named_buffers()}
    options = short(photometric={**PHOTOMETRIC, "steps": 2, "learning_rate": 1e-2}, stages=0, average_decay=0.9)
    judge = ScriptedJudge((0.5, 0.4))
    train(training_in(tmp_path, source, options=options, judge=judge, network="psmnet-s"), state, reporter=Heard())
    result, _ = load_weights(tmp_path / WEIGHTS_NAME, device=CPU)
    assert len(fresh_buffers) > 100
    for name, buffer in state.network.named_buffers():
        assert not torch.equal(buffer, fresh_buffers[name]), name
        assert torch.equal(state.average.get_buffer(name), buffer), name
        assert torch.equal(result.get_buffer(name), buffer), name
    weights = [name for name, p in state.network.named_parameters() if not torch.equal(p, result.get_parameter(name))]
    assert weights, "the weights themselves are an average"


def test_a_stage_may_keep_the_statistics_it_begins_with(tmp_path: Path, source: SampleSource) -> None:
    """Its steps answer as the judge is answered, and no batch moves a buffer, after a judgement neither."""
    options = short(
        photometric={**PHOTOMETRIC, "steps": 2, "learning_rate": 1e-2},
        feature={"steps": 3, "captured": 1, "captured_loss": "feature", "batch_statistics": "kept"},
        stages=1,
        keeps="last",
        judge_every_steps=1,
    )
    state = new_state("psmnet-s", seed=1, device=CPU)
    training = training_in(tmp_path, source, options=options, network="psmnet-s")
    train(training, state, reporter=Heard())
    before, _ = load_weights(tmp_path / "photometric.safetensors", device=CPU)
    after, _ = load_weights(tmp_path / "feature-1.safetensors", device=CPU)
    assert not is_same(before, after)
    for name, buffer in before.named_buffers():
        assert torch.equal(after.get_buffer(name), buffer), name
    stage = plan_stages(options)[1]
    set_learning(state, stage)
    view = torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        learning = state.network.features(view)[0]
        assert torch.equal(learning, state.network.eval().features(view)[0])
        set_learning(state, replace(stage, options=stage.options.model_copy(update={"batch_statistics": "own"})))
        assert not torch.equal(learning, state.network.features(view)[0])


def test_psmnet_learns_by_every_step(tmp_path: Path, source: SampleSource) -> None:
    """On one batch over and over the photometric loss falls."""
    state = new_state("psmnet-s", seed=1, device=CPU)
    stage = stage_of(steps=1000, captured=1, captured_loss="photometric", smoothness=0.0, learning_rate=5e-3)
    batch = StepBatches(source, stage, seed=0)[0]
    losses = []
    for step in range(12):
        state.step = step + WARM_UP_STEPS
        losses.append(take_step(state, batch, stage, training=training_in(tmp_path, source))["photometric"])
    assert losses[-1] < 0.97 * losses[0]


@pytest.mark.parametrize("name", ["lite", "psmnet-s"])
def test_narrow_windows_are_trained_in_full_precision(tmp_path: Path, source: SampleSource, name: str) -> None:
    """Two planes at the coarsest level: a bf16 kernel would add what happens to lie in memory."""
    stage = stage_of(steps=2, captured=1, captured_loss="photometric")
    states = [new_state(name, seed=1, device=CPU) for _ in range(2)]
    batch = StepBatches(source, stage, seed=0)[0]
    take_step(states[0], batch, stage, training=training_in(tmp_path, source))
    with full_precision():
        take_step(states[1], batch, stage, training=training_in(tmp_path, source))
    assert is_same(states[0].network, states[1].network)


def test_more_processes_than_crops_are_refused(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "captured": 2}, stages=0)
    training = training_in(tmp_path, source, options=options, processes=Processes(rank=1, world=3))
    with pytest.raises(UsageError, match="2 crops a step") as raised:
        train(training, fresh(), reporter=Heard())
    assert "train.photometric.captured" in str(raised.value.hint) or "photometric" in str(raised.value.hint)


# What contradicts, and what cannot be judged


def test_a_stage_shorter_than_its_least_steps_has_a_result(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 2, "least_steps": 600}, stages=0)
    judge = ScriptedJudge((0.1, 0.3))
    state = train(training_in(tmp_path, source, options=options, judge=judge), fresh(), reporter=Heard())
    assert state.stage_judgements == [0.3]
    assert state.best is not None


NAN = float("nan")


@pytest.mark.parametrize(
    ("answers", "best"),
    [
        ((0.4, NAN, 0.9), "rehearsal"),
        ((0.4, NAN, 0.3), "feature-1"),
        ((NAN, 0.5, 0.9), "photometric"),
        ((0.5, 0.4, NAN), "photometric"),
        ((NAN, NAN, NAN), "feature-1"),
    ],
)
def test_no_stage_is_chosen_by_what_could_not_be_judged(
    tmp_path: Path, source: SampleSource, answers: tuple[float, ...], best: str
) -> None:
    """A later stage must not be worse than an earlier one; unknown is not better; all unknown, the last is taken."""
    options = short(rehearsal={"steps": 1, "rehearsed": 1}, photometric=PHOTOMETRIC, feature=FEATURE, stages=1)
    training = training_in(tmp_path, source, options=options, judge=ScriptedJudge(answers))
    state = train(training, fresh(), reporter=Heard())
    assert plan_stages(options)[state.best_stage].name == best
    assert load_weights(tmp_path / WEIGHTS_NAME, device=CPU)[1].training["stage"] == best


def test_no_weights_are_chosen_by_what_could_not_be_judged(tmp_path: Path, source: SampleSource) -> None:
    options = short(photometric={**PHOTOMETRIC, "steps": 9}, stages=0, patience=2)
    heard = Heard()
    judge = ScriptedJudge((0.5, NAN, NAN, 0.1))
    state = train(training_in(tmp_path, source, options=options, judge=judge), fresh(), reporter=heard)
    assert len(heard.losses) == 3, "two answers in a row that brought nothing better"
    assert state.best is not None
    assert (state.best.step, state.best.judgement) == (1, 0.5)


# Interrupts that come when no step is taken


@dataclass
class StoppedJudge(ScriptedJudge):
    """Is interrupted while it answers for the n-th time."""

    at: int = 1

    def __call__(self, network: StereoNetwork) -> dict[str, float]:
        answer = super().__call__(network)
        if self.asked == self.at:
            signal.raise_signal(signal.SIGINT)
        return answer


@pytest.mark.parametrize("at", [1, 2])
def test_an_interrupt_during_a_stages_last_judgement_stops_the_training(
    tmp_path: Path, source: SampleSource, at: int
) -> None:
    """With what was judged kept: nothing is asked twice, and the end is the uninterrupted one."""
    options = short(photometric=PHOTOMETRIC, feature=FEATURE, stages=1)
    training = training_in(tmp_path, source, options=options, judge=StoppedJudge((0.5, 0.4), at=at))
    with pytest.raises(KeyboardInterrupt):
        train(training, fresh(), reporter=Heard())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    state = load_state(tmp_path / STATE_NAME, network_name="lite", device=CPU)
    assert (state.stage_judgements, state.is_finished) == (([0.5], False), ([0.5, 0.4], True))[at - 1]
    heard = Heard()
    end = train(training, state, reporter=heard)
    assert end.stage_judgements == [0.5, 0.4]
    assert list(heard.losses) == ([("feature-1", 1)], [])[at - 1]


def test_workers_start_deaf_to_what_ends_a_process_group() -> None:
    """``timeout`` and batch systems send SIGTERM to all; whoever trains answers it, between two steps."""
    with _interrupts_held():
        held = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert {signal.SIGINT, signal.SIGTERM} <= held
    assert not {signal.SIGINT, signal.SIGTERM} & signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interrupt_while_workers_start_is_answered_afterwards() -> None:
    def start() -> None:
        with _interrupts_held():
            signal.raise_signal(signal.SIGINT)
            reached.append("the end of the block")

    reached: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        start()
    assert reached


@dataclass(frozen=True)
class Asked(Processes):
    """One process that notes when all are asked something."""

    events: list[str] = field(default_factory=list)

    def is_any(self, flag: bool) -> bool:
        self.events.append("asked")
        return flag


def test_no_process_goes_on_before_the_writer_has_saved(
    tmp_path: Path, source: SampleSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every file of weights is followed by a question to all, which waits for the one that writes."""
    processes = Asked()

    def noted(*args: object, **kwargs: object) -> None:
        processes.events.append("saved")

    monkeypatch.setattr(loop, "save_weights", noted)
    options = short(photometric=PHOTOMETRIC, stages=0)
    train(training_in(tmp_path, source, options=options, processes=processes), fresh(), reporter=Heard())
    assert "saved" in processes.events
    assert processes.events[-1] == "asked"
