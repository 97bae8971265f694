"""One training in one run folder: begin, continue, finish, or refuse.

train/training.json                   see `stages.training_record`
train/log.jsonl, <stage>.png          see `stages.training_log`
train/state.pt, weights.safetensors, <stage>.safetensors      see `training.checkpoint`
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from telewide.assets import BOX_WEIGHTS
from telewide.capture.exif import read_photo_facts
from telewide.capture.pair import Capture, PairReader
from telewide.cores import usable_cores
from telewide.errors import InputError, UsageError
from telewide.files import changing, is_file, is_folder
from telewide.matching.inference import choose_device, match_with_network
from telewide.matching.networks import StereoNetwork
from telewide.pages.contact import ContactRow
from telewide.points.held_out import HeldOut
from telewide.recipe import Recipe
from telewide.stages.call import Call, alone
from telewide.stages.call import record as record_call
from telewide.stages.pairs import PreparedSet
from telewide.stages.run_folder import RunFolder
from telewide.stages.surfaces import surveyor_of, write_surfaces
from telewide.stages.training_log import LoggedReporter, drop_log_after
from telewide.stages.training_record import TrainingRecord, agreed_record, read_training, write_training
from telewide.stages.training_result import TrainingResult, before_px
from telewide.text import counted
from telewide.training.checkpoint import (
    STATE_NAME,
    BestWeights,
    TrainingState,
    load_state,
    new_optimiser,
    new_state,
    save_state,
)
from telewide.training.data import Batches, StepBatches, enlargement_of
from telewide.training.judge import JUDGE_SEED, Judge, crops_judge, joined_judge, judge_stage, network_judge
from telewide.training.loop import Training
from telewide.training.loop import train as run_training
from telewide.training.processes import Processes
from telewide.training.samples import CropArea, SampleSource, fitting_crop
from telewide.training.stages import Stage, plan_stages
from telewide.training.weights_card import has_same_tensors, read_card
from telewide.training.world_samples import WorldBatches, WorldSource

_OWN_FILES = re.compile(
    r"state\.pt|training\.json|log\.jsonl|weights\.safetensors|(rehearsal|photometric|space|feature-\d+)(-best)?\.(png|safetensors)"
)
USUAL_ASYMMETRY = (1.0, 6.0)
"""Where neither the recipe nor the pairs say how much coarser wide is."""
SHEET_ROWS = 6
JUDGED_STEPS = 4
"""Of rehearsed crops that judge, beside the held-out matches."""


@dataclass(frozen=True)
class TrainOutcome:
    """Outcome of a training, or of its continuation.

    Attributes:
        weights: the file to compute depth with.
        is_new: False where nothing was left to do.
        stages: name and last judgement of each finished stage.
        best_stage: the stage whose weights are the result.
        best_step: of that stage; 0 for the weights it began with, None where nobody recorded it.
        before_px: how far off the weights were judged that the training began with; None where nobody knows.
        is_box: whether the result is the network that comes with telewide, as it was.
        is_finished: False where the deadline came first; a call of the same kind goes on.
    """

    weights: Path
    is_new: bool
    stages: Mapping[str, float]
    best_stage: str
    best_step: int | None = None
    before_px: float | None = None
    is_box: bool = False
    is_finished: bool = True

    @property
    def told(self) -> str:
        """One line on which weights the result is."""
        off_px = self.stages.get(self.best_stage, math.nan)
        result = TrainingResult(self.best_stage, self.best_step, off_px, before_px=self.before_px, is_box=self.is_box)
        return f"result: {result.told}"


def train(call: Call, prepared: PreparedSet, *, fresh: bool) -> TrainOutcome:
    """Train a network on prepared pairs, or continue, and record it in the run folder.

    Args:
        call: run folder, recipe and observer.
        prepared: corrected pairs.
        fresh: forget a training that lies there.

    Returns:
        The outcome.

    Raises:
        UsageError: the training that lies there was begun with another recipe.
        KeyboardInterrupt: stopped by hand; a checkpoint is left.
    """
    prepared_s = time.monotonic()
    with alone(call.processes, call.folder.train, observer=call.observer):
        outcome = _train(call, prepared, fresh=fresh, device=choose_device(call.device))
    timings = {"prepare": prepared_s - call.begun_s, "train": time.monotonic() - prepared_s}
    asked = {**call.recipe.model_dump(mode="json"), "rig": call.rig_file, "device": call.device, "fresh": fresh}
    record_call(call, prepared, command="train", options=asked, timings=timings)
    if outcome.is_new and outcome.is_finished:
        call.observer.said(outcome.told)
    return outcome


def _train(call: Call, prepared: PreparedSet, *, fresh: bool, device: torch.device) -> TrainOutcome:
    run, recipe, processes, observer = call.folder, call.recipe, call.processes, call.observer
    plan = planned(recipe)
    if fresh and processes.is_writer:
        forget(run)
    processes.wait()
    record, state = _take_up(call, prepared, plan, device=device)
    processes.wait()  # all have read what the writer now changes
    if state.is_finished:
        return outcome_of(run, plan, state, is_new=False)
    observer.searching(record.window)
    if processes.is_writer:
        _note_what_is_taken_up(run, record, state)
    if any(stage.needs_surfaces for stage in plan):
        _survey(call, prepared, record, tick=observer.surveying(len(prepared.pairs)))
    processes.wait()
    logged = LoggedReporter(observer, run, partial(_rows, prepared, record), is_writer=processes.is_writer)
    training = _training(prepared, run, record, recipe, network=state.network, device=device, processes=processes)
    run_training(replace(training, deadline_s=call.deadline_s), state, reporter=logged)
    return outcome_of(run, plan, state, is_new=True)


def planned(recipe: Recipe) -> tuple[Stage, ...]:
    """List the stages of a recipe.

    Raises:
        UsageError: there are none, or one learns from a truth.
    """
    plan = plan_stages(recipe.train)
    if not plan:
        raise UsageError("the recipe has no stage with steps", hint="set train.rehearsal.steps above 0")
    if supervised := [stage.name for stage in plan if stage.needs_truth]:
        raise UsageError(
            f"stage {supervised[0]} learns from a truth, which captures do not have",
            hint="captured_loss: supervised is for the data sets of telewide benchmark paper",
        )
    return plan


def _survey(call: Call, prepared: PreparedSet, record: TrainingRecord, *, tick: Callable[[], None]) -> None:
    """Write the surfaces of this process' share of the captures, those that judge among them."""
    mine = call.processes.share(tuple(item.capture.name for item in prepared.pairs))
    surveyor = surveyor_of(call.recipe.train)
    write_surfaces(prepared, names=mine, window=record.window, surveyor=surveyor, device=call.device, tick=tick)


def _take_up(
    call: Call, prepared: PreparedSet, plan: Sequence[Stage], *, device: torch.device
) -> tuple[TrainingRecord, TrainingState]:
    """The training that lies in a run folder, and what is new to it; or a new one."""
    run, anew = call.folder, call.invocation.instead("train", fresh=True)
    with _starting_over_told(anew):
        kept = read_training(run)
    record = agreed_record(kept, prepared, call.recipe, anew=anew)
    with _starting_over_told(anew):
        state = state_for(run, call.recipe, device)
    if kept is not None and state.step + state.stage_index > 0:
        grown, changed = sorted(set(record.captures) - set(kept.captures)), kept.changed_in(record)
        if grown or changed:
            _reopen(state)
        if set(changed) & set(record.judged):
            _forget_judgements(state)
        stands = _where_it_stands(run, plan, state, grown=grown, changed=changed)
        call.observer.said(f"{stands}; to start over: {anew}" if state.is_finished else stands)
    return record, state


@contextmanager
def _starting_over_told(anew: str) -> Iterator[None]:
    """Add the command that starts over to the error of a file that cannot be read."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, hint=f"start over: {anew}") from error


def _note_what_is_taken_up(run: RunFolder, record: TrainingRecord, state: TrainingState) -> None:
    """Record first that something is left to do, then that new captures are known: a stop in between loses neither."""
    if is_file(run.train / STATE_NAME):
        save_state(state, run.train / STATE_NAME)
    write_training(run, record)
    drop_log_after(run.training_log, stage_index=state.stage_index, step=state.step)


def _where_it_stands(
    run: RunFolder, plan: Sequence[Stage], state: TrainingState, *, grown: Sequence[str], changed: Sequence[str]
) -> str:
    """One line on a training that was begun before."""
    if state.is_finished:
        return f"finished already: {run.weights}"
    resuming = f"resuming {plan[state.stage_index].name} at step {state.step}"
    told = [
        f"{counted(len(names), f'{kind} capture')}: {', '.join(names[:5])}"
        for kind, names in (("new", grown), ("changed", changed))
        if names
    ]
    return "; ".join([*told, f"{resuming} on {'the larger set' if grown else 'them'}"]) if told else resuming


def state_for(run: RunFolder, recipe: Recipe, device: torch.device) -> TrainingState:
    """Read the training that lies in a run folder, or begin one."""
    path = run.train / STATE_NAME
    if is_file(path):
        return load_state(path, network_name=recipe.network, device=device, plan=plan_stages(recipe.train))
    weights = BOX_WEIGHTS if recipe.train.start == "box" else None
    return new_state(recipe.network, seed=recipe.seed, device=device, weights=weights)


def _reopen(state: TrainingState) -> None:
    """Repeat the last stage of a finished training on the larger set, from its result, so that it ends no worse."""
    if state.is_finished:
        state.is_finished, state.step, state.judgements = False, 0, []
        result = {name: value.clone() for name, value in state.average.state_dict().items()}
        state.best = BestWeights(0, state.stage_judgements[state.best_stage], result)
        state.stage_judgements = state.stage_judgements[: state.stage_index]
        state.best_stage = min(state.best_stage, max(0, state.stage_index - 1))
        state.optimiser = new_optimiser(state.network)


def _forget_judgements(state: TrainingState) -> None:
    """Forget what was judged by other photos: it is not comparable with what is judged now."""
    state.stage_judgements = [math.nan] * len(state.stage_judgements)
    state.judgements = [math.nan] * len(state.judgements)
    if state.best is not None:
        state.best.judgement = math.nan


def _training(
    prepared: PreparedSet,
    run: RunFolder,
    record: TrainingRecord,
    recipe: Recipe,
    *,
    network: StereoNetwork,
    device: torch.device,
    processes: Processes,
) -> Training:
    seen = tuple(item.capture for item in prepared.pairs if item.capture.name not in record.held_out)
    area = CropArea() if record.held_out else CropArea(end=1 - recipe.train.held_out_share)
    enlargement = enlargement_of(seen, network)
    source = SampleSource(
        captures=seen,
        crop_hw=_fitting_crop(seen, area, recipe, enlargement=enlargement),
        window_px=record.window,
        enlargement=enlargement,
        asymmetry=recipe.train.asymmetry or prepared.damage_factor or USUAL_ASYMMETRY,
        area=area,
        disparities_folder=run.pairs if any(stage.needs_surfaces for stage in plan_stages(recipe.train)) else None,
        surveyor=surveyor_of(recipe.train),
    )
    judge = network_judge(judged_captures(prepared, record, recipe), window=record.window, reader=PairReader())
    if recipe.train.rehearsal.steps and recipe.train.rehearsal.exact:
        judge = joined_judge(judge, _rehearsals_judge(prepared, record, recipe, like=source, device=device))
    return Training(
        folder=run.train,
        options=recipe.train,
        source=source,
        judge=judge,
        seed=recipe.seed,
        network_name=recipe.network,
        recipe=record.recipe,
        device=device,
        processes=processes,
        workers=workers_for(device),
    )


def _rehearsals_judge(
    prepared: PreparedSet, record: TrainingRecord, recipe: Recipe, *, like: SampleSource, device: torch.device
) -> Judge:
    """Ask worlds that owe nothing to the captures and, where photos are taken again, twice as many held-out ones."""
    seed = recipe.seed + JUDGE_SEED
    worlds = WorldSource(seed=seed, crop_hw=recipe.train.crop_hw, device=device)
    sources: list[Batches] = [WorldBatches(worlds, judge_stage(steps=JUDGED_STEPS))]
    if recipe.train.rehearsal.retaken:
        names = record.held_out or record.judged
        judged = tuple(item.capture for item in prepared.pairs if item.capture.name in names)
        area = CropArea() if record.held_out else CropArea(first=1 - recipe.train.held_out_share)
        crop_hw = _fitting_crop(judged, area, recipe, enlargement=like.enlargement)
        held_out = replace(like, captures=judged, area=area, crop_hw=crop_hw)
        sources.append(StepBatches(held_out, judge_stage(steps=2 * JUDGED_STEPS, retakes=True), seed=seed))
    return crops_judge(*sources, window=like.volume_px)


def _fitting_crop(seen: Sequence[Capture], area: CropArea, recipe: Recipe, *, enlargement: float) -> tuple[int, int]:
    """The recipe's crop, or a smaller one where the smallest picture would have to be enlarged to fill it."""
    with_size = [hw for capture in seen if (hw := read_photo_facts(capture.tele_path).hw) is not None]
    sizes_hw = [(height, int((area.end - area.first) * width)) for height, width in with_size]
    return fitting_crop(recipe.train.crop_hw, sizes_hw or [recipe.train.crop_hw], enlargement=enlargement)


def judged_captures(prepared: PreparedSet, record: TrainingRecord, recipe: Recipe) -> list[HeldOut]:
    """Held-out captures with their matches; with few captures, the held-out strip of each."""
    if record.held_out:
        return [item.held_out for item in prepared.pairs if item.capture.name in record.held_out]
    reader = PairReader(max_bytes=0)
    strips = []
    for item in (item for item in prepared.pairs if item.capture.name in record.judged):
        width = reader.read(item.capture).tele.shape[1]
        strips.append(item.held_out.beyond((1 - recipe.train.held_out_share) * width))
    return strips


def workers_for(device: torch.device) -> int:
    """Return how many processes prepare batches: one for a processor, more for a GPU, within its share of the cores."""
    if device.type == "cpu":
        return 1
    return min(8, max(1, usable_cores() // int(os.environ.get("LOCAL_WORLD_SIZE", "1")) - 1))


def outcome_of(run: RunFolder, plan: Sequence[Stage], state: TrainingState, *, is_new: bool) -> TrainOutcome:
    """Sum up a training, finished or stopped by its deadline."""
    stages = {stage.name: value for stage, value in zip(plan, state.stage_judgements, strict=False)}
    step = read_card(run.weights).training.get("step")
    best_step = step if isinstance(step, int) else None
    is_judged_alike = not math.isnan(stages.get(plan[0].name, math.nan))  # else other photos judged in the beginning
    return TrainOutcome(
        run.weights,
        is_new,
        stages,
        plan[state.best_stage].name,
        best_step=best_step,
        before_px=before_px(run) if is_judged_alike else None,
        is_box=best_step == 0 and has_same_tensors(run.weights, BOX_WEIGHTS),
        is_finished=state.is_finished,
    )


def forget(run: RunFolder) -> None:
    """Remove the files a training wrote, by their names, and nothing else that may lie there.

    The record goes last, so that what is left after a stop still has its record.
    """
    if is_folder(run.train):
        for path in sorted(run.train.iterdir(), key=lambda path: path.name == run.training_record.name):
            if _OWN_FILES.fullmatch(path.name) and not is_folder(path):
                with changing(path):
                    path.unlink()


def _rows(prepared: PreparedSet, record: TrainingRecord, network: StereoNetwork) -> list[ContactRow]:
    """Rows of a contact sheet, held-out captures first: they tell what a new photo would get."""
    captures = sorted(
        (item.capture for item in prepared.pairs), key=lambda capture: capture.name not in record.held_out
    )
    reader, rows = PairReader(max_bytes=0), []
    for capture in captures[:SHEET_ROWS]:
        pair = reader.read(capture)
        disparity = match_with_network(pair.tele, pair.wide, network=network, window=record.window, valid=pair.valid)
        name = f"{capture.name} (held out)" if capture.name in record.held_out else capture.name
        rows.append(ContactRow(name, pair.tele, pair.wide, disparity, rotated_deg=prepared.facts.rotated_deg))
    return rows
