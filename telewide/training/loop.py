"""The training loop of stereo networks: a stage says what a step does; the loop takes steps, judges, saves and goes on.

Cut off anywhere, it continues from the last checkpoint with the losses it would have had. Restorers have a short loop
of their own, in :mod:`telewide.restoration.training`.
"""

from __future__ import annotations

import copy
import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import torch
from torch import Tensor

from telewide.cores import processor_name
from telewide.errors import QualityError, UsageError
from telewide.matching.batch_norm import BatchNorm2d, BatchNorm3d
from telewide.matching.inference import full_precision, low_precision
from telewide.matching.networks import StereoNetwork, prepare_view
from telewide.matching.window import VOLUME_STEP_PX, Window
from telewide.origin import source_state
from telewide.training.checkpoint import (
    STATE_NAME,
    BestWeights,
    TrainingState,
    frozen_extractor,
    learner_of,
    load_weights,
    new_optimiser,
    save_state,
    save_weights,
)
from telewide.training.data import Source, iterate_batches, step_batches
from telewide.training.judge import Judge
from telewide.training.objective import Batch, objective
from telewide.training.options import WEIGHTS_NAME, TrainOptions
from telewide.training.processes import Processes
from telewide.training.reporter import Reporter
from telewide.training.spaces import build_space, space_objective
from telewide.training.stages import Stage, plan_stages
from telewide.training.weights_card import WeightsCard

CHECKPOINT_EVERY_S = 20.0
WARM_UP_STEPS = 50
COOL_DOWN_SHARE = 0.25
LAST_LEARNING_RATE = 0.1
NARROW_WINDOW_PLANES = 8
LEAST_GAIN_PX = 0.002
"""A judgement is better when the mean clipped error falls by this much."""

DECISIVE = "clipped_px"
"""The figure of a judgement that decides: shares of wrong matches stand still where the matches' own errors begin."""


@dataclass(frozen=True)
class Training:
    """Setting of a training that stays the same from the first step to the last.

    Attributes:
        folder: ``train/`` of the run.
        options: of the recipe.
        source: where crops come from.
        judge: asks rehearsals or held-out matches; its ``clipped_px`` decides.
        seed: of all samples.
        network_name: for the weights' card.
        recipe: resolved recipe, for the weights' card.
        device: to compute on.
        processes: this process among all.
        workers: processes that prepare batches.
        deadline_s: when to stop, on the monotonic clock; the step that it comes in is finished first.
    """

    folder: Path
    options: TrainOptions
    source: Source
    judge: Judge
    seed: int
    network_name: str
    recipe: Mapping[str, object]
    device: torch.device
    processes: Processes
    workers: int
    deadline_s: float = math.inf

    @property
    def window(self) -> Window:
        """Disparities of the volume, px."""
        return self.source.window_px


def train(training: Training, state: TrainingState, *, reporter: Reporter) -> TrainingState:
    """Run all stages that are left.

    Args:
        training: data, options, judge.
        state: new, or read from a checkpoint; changed as training goes on.
        reporter: is told of the progress.

    Returns:
        The same state, finished; its ``average`` holds the best stage's weights. Not finished, and saved, where the
        deadline came first.

    Raises:
        KeyboardInterrupt: asked to stop; the state has been saved.
        UsageError: more processes than crops in a step.
        QualityError: the loss is not finite; the last good checkpoint is kept.
    """
    plan = plan_stages(training.options)
    _check_processes(plan, training.processes)
    with _stop_request() as is_stop_requested, suppress(_TimeIsUpError):
        while not state.is_finished:
            stage = plan[state.stage_index]
            if state.step == 0:
                begin_stage(state, stage, seed=training.seed)
            reporter.stage_started(stage, first_step=state.step)
            _run_stage(training, state, stage, reporter, is_stop_requested=is_stop_requested)
            _end_stage(training=training, state=state, stage=stage, plan=plan, reporter=reporter)
            # Asked of all processes, so that none goes on before the writer has saved.
            if training.processes.is_any(is_stop_requested()):
                raise KeyboardInterrupt
            if _is_time_up(training):
                raise _TimeIsUpError
    return state


class _TimeIsUpError(Exception):
    """The deadline of a training has come; the state has been saved."""


def _check_processes(plan: tuple[Stage, ...], processes: Processes) -> None:
    for stage in plan:
        crops = stage.options.crops
        if crops < processes.world:
            raise UsageError(
                f"stage {stage.name} has {crops} crops a step, too few for {processes.world} processes",
                hint=f"start {crops} or fewer, or give a step of train.{_section(stage)} more crops",
            )


def begin_stage(state: TrainingState, stage: Stage, *, seed: int) -> None:
    """Start from the last result, with a fresh optimiser (paper, section 4.3).

    Args:
        state: of a training at the first step of the stage; changed in place.
        stage: that begins.
        seed: of a feature space that it teaches.
    """
    state.network.load_state_dict(state.average.state_dict())
    if stage.is_teaching_space:
        device = next(state.network.parameters()).device
        state.teacher = build_space(stage.space, seed=seed).to(device)
    elif stage.needs_teacher and stage.space == "own":
        state.teacher = frozen_extractor(state.average)
    elif stage.needs_teacher and state.teacher is not None:
        state.teacher.eval().requires_grad_(False)
    else:
        state.teacher = None
    state.optimiser = new_optimiser(learner_of(state, stage))
    state.judgements = []


def _run_stage(
    training: Training,
    state: TrainingState,
    stage: Stage,
    reporter: Reporter,
    *,
    is_stop_requested: Callable[[], bool],
) -> None:
    processes = training.processes
    dataset = step_batches(training.source, stage, seed=training.seed, rank=processes.rank, world=processes.world)
    if _is_judgement_due(training, state, stage) and _is_converged(training, state, stage, reporter):
        return  # stopped just before it was asked
    saved_s = time.monotonic()
    set_learning(state, stage)
    begun_s = time.monotonic()
    for batch in iterate_batches(dataset, first_step=state.step, workers=training.workers):
        losses = take_step(state, batch.to(training.device), stage, training=training)
        state.step += 1
        seconds = time.monotonic() - begun_s
        state.trained_s += seconds
        reporter.step_done(stage, step=state.step, losses=losses, seconds=seconds)
        is_stopped = processes.is_any(is_stop_requested())
        if is_stopped or _is_time_up(training):
            _save_underway(training, state, stage)
            raise KeyboardInterrupt if is_stopped else _TimeIsUpError
        if _is_judgement_due(training, state, stage):
            if _is_converged(training, state, stage, reporter):
                break
            set_learning(state, stage)
        # After the judgement, which would otherwise be missing from the checkpoint of its own step.
        if time.monotonic() - saved_s > CHECKPOINT_EVERY_S:
            _save_underway(training, state, stage)
            saved_s = time.monotonic()
        begun_s = time.monotonic()  # the next step's time holds its wait for the batch


def _is_time_up(training: Training) -> bool:
    """Whether the deadline has come in any process."""
    return training.deadline_s < math.inf and training.processes.is_any(time.monotonic() >= training.deadline_s)


def set_learning(state: TrainingState, stage: Stage) -> None:
    """Put what a stage teaches into training mode, its batch normalisation as the stage asks for.

    Args:
        state: changed in place.
        stage: whose steps follow.
    """
    learner = learner_of(state, stage).train()
    if stage.options.batch_statistics == "kept":
        for layer in learner.modules():
            if isinstance(layer, BatchNorm2d | BatchNorm3d):
                layer.eval()


def take_step(state: TrainingState, batch: Batch, stage: Stage, *, training: Training) -> dict[str, float]:
    """Forward, backward, update; the averaged weights follow.

    Args:
        state: changed in place, but for its counters.
        batch: this process' crops of the joint batch.
        stage: losses and learning rate.
        training: window, processes.

    Returns:
        The parts of the loss.

    Raises:
        QualityError: the loss or its gradient is not finite; weights are as before the step.
    """
    for group in state.optimiser.param_groups:
        group["lr"] = learning_rate(stage, step=state.step)
    state.optimiser.zero_grad(set_to_none=True)
    loss, parts = _losses(state, batch, stage, training=training)
    is_good = math.isfinite(float(loss.detach()))
    if training.processes.is_any(not is_good):
        raise _diverged("loss", stage, state)
    torch.autograd.backward(loss)
    learner = learner_of(state, stage)
    training.processes.sum_gradients(learner)
    norm = torch.nn.utils.clip_grad_norm_(learner.parameters(), stage.options.gradient_norm or math.inf)
    if not math.isfinite(float(norm)):
        raise _diverged("gradient", stage, state)
    state.optimiser.step()
    if not stage.is_teaching_space:
        _follow(state.average, state.network, decay=_decay(training.options, state.step))
    return parts


def _losses(state: TrainingState, batch: Batch, stage: Stage, *, training: Training) -> tuple[Tensor, dict[str, float]]:
    window, global_sum = batch.window or training.window, training.processes.global_sum
    with _precision(window, training.device):
        if stage.is_teaching_space:
            space = learner_of(state, stage)
            return space_objective(space, batch, stage, network=state.average, window=window, global_sum=global_sum)
        shown = batch.views(is_symmetric=stage.options.symmetric_input)
        output = state.network(*(prepare_view(state.network.features, view) for view in shown), window)
        return objective(output, batch, stage, window=window, teacher=state.teacher, global_sum=global_sum)


def _precision(window: Window, device: torch.device) -> AbstractContextManager[object]:
    """bf16, but not on processors in narrow windows.

    There the coarsest volume has two planes, and oneDNN's bf16 gradient of a 3-D convolution over two planes reads
    memory that nobody has written (seen in torch 2.13: infinite and wrong weights' gradients, every time).
    """
    planes = (window[1] - window[0]) // VOLUME_STEP_PX
    is_narrow = planes <= NARROW_WINDOW_PLANES
    return full_precision() if is_narrow and device.type == "cpu" else low_precision(device)


def _diverged(what: str, stage: Stage, state: TrainingState) -> QualityError:
    return QualityError(
        f"the {what} of stage {stage.name} is not a number at step {state.step}; the last good checkpoint is kept",
        hint=f"lower the learning rate: `set` train.{_section(stage)}.learning_rate=...",
    )


def learning_rate(stage: Stage, *, step: int) -> float:
    """Warm-up, then a fall: to a tenth over the last quarter of the stage's ceiling, or as the stage states."""
    left, share = (stage.options.steps - step) / stage.options.steps, stage.options.final_rate_share
    if share is None:
        cooled = LAST_LEARNING_RATE + (1 - LAST_LEARNING_RATE) * min(1.0, left / COOL_DOWN_SHARE)
    else:
        cooled = share + (1 - share) * (1 - math.cos(math.pi * left)) / 2
    return stage.options.learning_rate * min(1.0, (step + 1) / WARM_UP_STEPS) * cooled


def _decay(options: TrainOptions, step: int) -> float:
    """Of the average, which soon forgets random weights; of learned ones it keeps a share, to be on the safe side."""
    return options.average_decay if options.start == "box" else min(options.average_decay, (step + 1) / (step + 10))


@torch.no_grad()
def _follow(average: StereoNetwork, network: StereoNetwork, *, decay: float) -> None:
    torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), 1 - decay)
    for kept, current in zip(average.buffers(), network.buffers(), strict=True):
        kept.copy_(current)


def _is_judgement_due(training: Training, state: TrainingState, stage: Stage) -> bool:
    if stage.is_teaching_space:  # which changes no match
        return False
    every, last = stage.options.judge_every_steps or training.options.judge_every_steps, stage.options.steps
    due = state.step // every + (state.step == last and last % every != 0) + _has_result_before(training, stage)
    return len(state.judgements) < due


def _has_result_before(training: Training, stage: Stage) -> bool:
    """Whether the weights before a stage's first step are a result that it may fall back to."""
    return training.options.start == "box" and stage.index == 0


def _is_converged(training: Training, state: TrainingState, stage: Stage, reporter: Reporter) -> bool:
    """Ask the held-out matches; True when the last ``patience`` answers brought nothing better."""
    judgement = _ask(training, state)
    state.judgements.append(judgement[DECISIVE])
    _keep_best(state, stage)
    reporter.judged(stage, step=state.step, judgement=judgement)
    patience = training.options.patience
    if training.options.keeps == "last":
        return False
    if state.step < stage.options.counts_from or len(state.judgements) <= patience:
        return False
    before, recent = (_least_px(some) for some in (state.judgements[:-patience], state.judgements[-patience:]))
    return before < math.inf and recent > before - LEAST_GAIN_PX


def _least_px(judgements: Sequence[float]) -> float:
    """The best of some judgements; infinite where none could be made."""
    return min((judgement for judgement in judgements if not math.isnan(judgement)), default=math.inf)


def _keep_best(state: TrainingState, stage: Stage) -> None:
    """Remember the average if it is the best yet; of what comes before the least steps, only the start counts."""
    judgement = state.judgements[-1]
    is_better = state.best is None or not _is_no_better(judgement, than=state.best.judgement)
    if (state.step >= stage.options.counts_from or state.step == 0) and is_better:
        weights = {name: value.clone() for name, value in state.average.state_dict().items()}
        state.best = BestWeights(state.step, judgement, weights)


def _is_no_better(judgement: float, *, than: float) -> bool:
    """Whether a judgement speaks against what came later; where nothing could be judged at all, the later is taken."""
    if math.isnan(than):
        return False
    return math.isnan(judgement) or judgement >= than


def _ask(training: Training, state: TrainingState) -> dict[str, float]:
    """The writer judges; every process gets the answer, so that all decide alike."""
    judgement = dict(training.judge(state.average)) if training.processes.is_writer else {}
    names = ("off_1px", "off_3px", "mean_px", DECISIVE)
    values = training.processes.from_writer([judgement.get(name, math.nan) for name in names])
    return dict(zip(names, values, strict=True))


def _end_stage(
    training: Training, state: TrainingState, stage: Stage, plan: tuple[Stage, ...], reporter: Reporter
) -> None:
    """Keep the stage's result; go on, or stop boosting when it no longer helps."""
    result, step = _take_result(training, state, stage)
    card = _card(training, state, stage, step=step, judgements=[result])
    if training.processes.is_writer and not stage.is_teaching_space:
        save_weights(state.average, training.folder / f"{stage.name}.safetensors", card=card)
    reporter.stage_finished(stage, network=state.average, judgement={DECISIVE: result})
    may_be_worse = training.options.keeps == "best" and bool(state.stage_judgements)
    is_worse = may_be_worse and _is_no_better(result, than=state.stage_judgements[state.best_stage])
    state.stage_judgements.append(result)
    if not is_worse:
        state.best_stage = stage.index
    is_last = stage.index + 1 == len(plan)
    if is_last or (is_worse and stage.needs_teacher):
        state.is_finished = True
        if is_worse:
            card = _return_to_best(training, state, plan, reporter, worse=stage)
    else:
        go_on(state)
    _save(training, state, card)


def go_on(state: TrainingState) -> None:
    """Turn to the stage after one that is done."""
    state.is_finished, state.stage_index, state.step, state.best = False, state.stage_index + 1, 0, None


def _take_result(training: Training, state: TrainingState, stage: Stage) -> tuple[float, int]:
    """Make the average the stage's result; the figure it is judged by, and the step it is of."""
    best = state.best
    if training.options.keeps == "last":
        if best is not None:
            _save_best_beside(training, state, stage, best)
        return (state.judgements[-1] if state.judgements else math.nan), state.step
    if best is None:
        return math.nan, state.step
    state.average.load_state_dict(best.weights)
    return best.judgement, best.step


def _save_best_beside(training: Training, state: TrainingState, stage: Stage, best: BestWeights) -> None:
    """Write the weights that were judged best to a file of their own."""
    if not training.processes.is_writer:
        return
    network = copy.deepcopy(state.average)
    network.load_state_dict(best.weights)
    card = _card(training, state, stage, step=best.step, judgements=[best.judgement])
    save_weights(network, training.folder / best_name(stage), card=card)


def best_name(stage: Stage) -> str:
    """Name of the file with the weights of a stage that were judged best, where the last ones are its result."""
    return f"{stage.name}-best.safetensors"


def _return_to_best(
    training: Training, state: TrainingState, plan: tuple[Stage, ...], reporter: Reporter, *, worse: Stage
) -> WeightsCard:
    best = plan[state.best_stage]
    reporter.said(f"{worse.name} was judged no better; {best.name} is kept and boosting ends")
    network, card = load_weights(training.folder / f"{best.name}.safetensors", device=training.device)
    state.average.load_state_dict(network.state_dict())
    return card


def _save(training: Training, state: TrainingState, card: WeightsCard) -> None:
    if training.processes.is_writer:
        # The state last: a training that says it is finished has its weights.
        save_weights(state.average, training.folder / WEIGHTS_NAME, card=card)
        save_state(state, training.folder / STATE_NAME)


def _save_underway(training: Training, state: TrainingState, stage: Stage) -> None:
    _save(training, state, _card(training, state, stage, step=state.step, judgements=state.judgements[-1:]))


def _card(
    training: Training, state: TrainingState, stage: Stage, *, step: int, judgements: Sequence[float]
) -> WeightsCard:
    facts = {
        "stage": stage.name,
        "step": step,
        DECISIVE: list(judgements),
        "commit": source_state(),
        "device": _devices(training),
    }
    if training.options.worlds:  # equal trainings on own photos are equal files
        facts["hours"] = round(state.trained_s / 3600, 4)
    return WeightsCard(
        network=training.network_name,
        window=training.window,
        recipe=training.recipe,
        training=facts,
    )


def _devices(training: Training) -> str:
    """Name what a training computes on, and how many of it."""
    device, n_processes = training.device, training.processes.world
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else processor_name()
    return name if n_processes == 1 else f"{n_processes} x {name}"


def _section(stage: Stage) -> str:
    return stage.name.partition("-")[0]


@contextmanager
def _stop_request() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C into a request that is answered between two steps or stages; the second one is as usual."""
    requested = False

    def note(signum: int, frame: FrameType | None) -> None:
        nonlocal requested
        requested = True
        signal.signal(signal.SIGINT, signal.default_int_handler)

    try:
        previous = signal.signal(signal.SIGINT, note)
    except ValueError:  # not in the main thread: Ctrl-C does not come here
        yield lambda: False
        return
    try:
        yield lambda: requested
    finally:
        signal.signal(signal.SIGINT, previous)
