"""A training as a chain of stages, each kept by the fingerprint of all that it and the stages before it depend on.

Systems that begin alike share what they have in common, and a training that is cut off goes on where it was.

    OUT/trainings/<fingerprint>/state.pt, <stage>.safetensors, <stage>-best.safetensors, stage.json
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import JsonValue

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.paper.pairs import TrainingPairs, digest_of
from telewide.benchmark.paper.sources import source_fingerprint, training_entries
from telewide.benchmark.paper.system import Place, Task
from telewide.files import fingerprint, is_file
from telewide.folders import alone_in
from telewide.matching.networks import StereoNetwork, build_network
from telewide.recipe import Recipe
from telewide.records import Record, read_record, write_record
from telewide.stages.train import workers_for
from telewide.training.checkpoint import STATE_NAME, TrainingState, load_state, new_state
from telewide.training.data import enlargement_of
from telewide.training.judge import Judge
from telewide.training.loop import Training, go_on
from telewide.training.loop import train as run_training
from telewide.training.options import TrainOptions
from telewide.training.pace import seconds_a_step
from telewide.training.processes import Processes
from telewide.training.samples import SampleSource, fitting_crop
from telewide.training.stages import Stage, ending_with, plan_stages

JUDGEMENTS_A_STAGE = 8
_RECORD = "stage.json"
_LEAST_STEPS_WITH_WORKERS = 100  # a process for the batches takes seconds to start
_TRIAL_STEPS = 10_000


class StageRecord(Record):
    """Content of ``stage.json``: how many steps the budget gave, and whether they are done."""

    steps: int
    is_done: bool


@dataclass(frozen=True)
class Chain:
    """A training of one system.

    Attributes:
        recipe: resolved; of its stages' lengths only those of 0 count.
        first_share: of the budget, where stages follow.
        task: budget, seed, device.
        place: where it is kept.
        pairs: to learn from.
        judge: asks the validation scenes.
        judge_facts: all that its answers depend on besides the network.
        asymmetry: range of the factor by which rehearsed views lose resolution.
    """

    recipe: Recipe
    first_share: float
    task: Task
    place: Place
    pairs: TrainingPairs
    judge: Judge
    judge_facts: JsonValue
    asymmetry: tuple[float, float]


@dataclass(frozen=True)
class Link:
    """A finished stage of a chain.

    Attributes:
        folder: its files.
        stage: in the plan of its training.
        plan: of all stages up to it.
        steps: of all of them together.
    """

    folder: Path
    stage: Stage
    plan: tuple[Stage, ...]
    steps: int


def train_chain(chain: Chain, *, device: torch.device, until: str | None = None) -> Link:
    """Train what is left of a chain.

    Args:
        chain: what and how.
        device: to compute on.
        until: name of the stage to end with; None for the last.

    Returns:
        The last stage.

    Raises:
        InputError: what is kept of it cannot be read.
        TelewideError: the training diverges.
    """
    plan = plan_stages(chain.recipe.train)
    steps: dict[str, int] = {}
    link: Link | None = None
    for stage in plan:
        link = _trained(chain, plan, stage, before=link, steps=steps, device=device)
        if stage.name == until:
            break
    if link is None:
        raise ValueError("a system that learns has no stage")
    return link


def _trained(
    chain: Chain,
    plan: Sequence[Stage],
    stage: Stage,
    *,
    before: Link | None,
    steps: dict[str, int],
    device: torch.device,
) -> Link:
    """One stage, from the one before; `steps` of its kind are added where they were not known."""
    folder = chain.place.folder / "trainings" / digest_of(_facts(chain, plan[: stage.index + 1], device))
    kind = _kind(stage)
    with alone_in(folder, waiting=chain.place.tell):
        path = folder / _RECORD
        record = read_record(path, StageRecord) if is_file(path) else None
        if record is None:
            n = steps.get(kind) or _steps_of(chain, plan, stage, before=before, steps=steps, device=device)
            record = StageRecord(steps=n, is_done=False)
            write_record(path, record)
        steps[kind] = record.steps
        options = ending_with(_lengthened(chain.recipe.train, steps), stage)
        own_plan = plan_stages(options)
        if not record.is_done:
            state = _begun(chain, folder, own_plan, before=before, device=device)
            if not state.is_finished:
                training = _training(chain, options, folder, device=device, n_steps=record.steps)
                run_training(training, state, reporter=_Told(chain.place))
            write_record(path, StageRecord(steps=record.steps, is_done=True))
    total = record.steps + (0 if before is None else before.steps)
    return Link(folder, own_plan[-1], own_plan, total)


def _facts(chain: Chain, stages: Sequence[Stage], device: torch.device) -> dict[str, JsonValue]:
    """All that the last of some stages depends on, and nothing that only later ones do."""
    options, last = chain.recipe.train, stages[-1]
    lengths = {"steps", "least_steps", "judge_every_steps"}
    described: list[JsonValue] = [
        [
            stage.name,
            stage.options.model_dump(mode="json", exclude=lengths),
            stage.space if stage.is_teaching_space or stage.needs_teacher else None,
        ]
        for stage in stages
    ]
    has_disparities = any(stage.needs_truth or stage.needs_surfaces for stage in stages)
    return {
        "network": chain.recipe.network,
        "start": fingerprint(BOX_WEIGHTS) if options.start == "box" else None,
        "crop_hw": list(options.crop_hw),
        "average_decay": options.average_decay,
        "stages": described,
        "shares": [*_shares(chain, len(plan_stages(options)))[: last.index + 1]],
        "asymmetry": list(chain.asymmetry) if options.rehearsal.steps else None,
        "budget": chain.task.budget.as_data(),
        "seed": chain.task.seed,
        "device": device.type,
        "pairs": chain.pairs.digest,
        "disparities": chain.pairs.disparities_folder.name
        if has_disparities and chain.pairs.disparities_folder
        else None,
        "judge": chain.judge_facts,
        "sources": source_fingerprint(training_entries(chain.recipe.network, stages)),
    }


def _shares(chain: Chain, n_stages: int) -> list[float]:
    """Shares of the budget of each stage."""
    if n_stages == 1:
        return [1.0]
    return [chain.first_share, *[(1 - chain.first_share) / (n_stages - 1)] * (n_stages - 1)]


def _kind(stage: Stage) -> str:
    """The section of the recipe that a stage is of."""
    return stage.name.partition("-")[0]


def _lengthened(options: TrainOptions, steps: Mapping[str, int]) -> TrainOptions:
    """Stages of the given lengths, whose last weights are kept and the best ones beside."""
    changed = {
        kind: getattr(options, kind).model_copy(
            update={"steps": n, "least_steps": 0, "judge_every_steps": max(1, -(-n // JUDGEMENTS_A_STAGE))}
        )
        for kind, n in steps.items()
    }
    return options.model_copy(update={**changed, "keeps": "last"})


def _steps_of(
    chain: Chain,
    plan: Sequence[Stage],
    stage: Stage,
    *,
    before: Link | None,
    steps: Mapping[str, int],
    device: torch.device,
) -> int:
    """Steps that a stage's share of the budget has room for; timed where the budget is one of minutes."""
    share, budget = _shares(chain, len(plan))[stage.index], chain.task.budget
    if budget.steps is not None:
        return max(1, round(share * budget.steps))
    options = ending_with(_lengthened(chain.recipe.train, {**steps, _kind(stage): _TRIAL_STEPS}), stage)
    state = _begun(chain, Path(), plan_stages(options), before=before, device=device)
    trial = _training(chain, options, Path(), device=device, n_steps=_TRIAL_STEPS)
    return max(1, round(share * 60 * budget.minutes / seconds_a_step(trial, state, plan_stages(options)[-1])))


def _begun(
    chain: Chain, folder: Path, plan: Sequence[Stage], *, before: Link | None, device: torch.device
) -> TrainingState:
    """The training that lies in a folder, or the one of the stage before, turned to the next, or a new one."""
    network = chain.recipe.network
    if is_file(folder / STATE_NAME):
        return load_state(folder / STATE_NAME, network_name=network, device=device, plan=plan)
    if before is None:
        weights = BOX_WEIGHTS if chain.recipe.train.start == "box" else None
        return new_state(network, seed=chain.task.seed, device=device, weights=weights)
    state = load_state(before.folder / STATE_NAME, network_name=network, device=device, plan=before.plan)
    go_on(state)
    return state


def _training(chain: Chain, options: TrainOptions, folder: Path, *, device: torch.device, n_steps: int) -> Training:
    pairs = chain.pairs
    enlargement = enlargement_of(pairs.captures, build_network(chain.recipe.network))
    source = SampleSource(
        captures=pairs.captures,
        crop_hw=fitting_crop(options.crop_hw, pairs.sizes_hw, enlargement=enlargement),
        window_px=chain.task.window,
        enlargement=enlargement,
        asymmetry=chain.asymmetry,
        disparities_folder=pairs.disparities_folder,
        undamaged=pairs.undamaged,
    )
    return Training(
        folder=folder,
        options=options,
        source=source,
        judge=chain.judge,
        seed=chain.task.seed,
        network_name=chain.recipe.network,
        recipe=chain.recipe.model_dump(mode="json"),
        device=device,
        processes=Processes(),
        workers=workers_for(device) if n_steps >= _LEAST_STEPS_WITH_WORKERS else 0,
    )


@dataclass(frozen=True)
class _Told:
    """Tells in a few lines how far a training is."""

    place: Place

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        after = f", from step {first_step}" if first_step else ""
        self.place.tell(f"{stage.name}: {stage.options.steps} steps{after}")

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """Steps are too many to tell."""

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        off, figures = judgement["off_3px"], ""
        if math.isfinite(off):  # a task may have no scene to judge by
            figures = f", {100 * off:.1f} % off by more than 3 px on validation"
        self.place.tell(f"{stage.name}: step {step}{figures}")

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """Told by whoever asked."""

    def said(self, message: str) -> None:
        self.place.tell(message)
