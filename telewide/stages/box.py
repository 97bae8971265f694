"""Weights without captures: a training on ray-cast worlds alone, whose result comes with the program.

It is kept in a run folder, stopped and continued like every training; worlds of another seed judge it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from telewide.cores import Device
from telewide.folders import refuse_links
from telewide.matching.inference import choose_device, match_with_network
from telewide.matching.networks import StereoNetwork
from telewide.pages.contact import ContactRow
from telewide.recipe import Recipe
from telewide.stages.call import alone
from telewide.stages.observer import Observer
from telewide.stages.rig_run import CAPTURES_FOLDER
from telewide.stages.run_folder import RunFolder, locate_run
from telewide.stages.train import SHEET_ROWS, TrainOutcome, forget, outcome_of, planned, state_for, workers_for
from telewide.stages.training_log import LoggedReporter, drop_log_after
from telewide.stages.training_record import TrainingRecord, read_training, refuse_another_recipe, write_training
from telewide.training.checkpoint import TrainingState
from telewide.training.judge import JUDGE_SEED, crops_judge, judge_stage
from telewide.training.loop import Training
from telewide.training.loop import train as run_training
from telewide.training.options import StageOptions
from telewide.training.processes import Processes, joined_processes
from telewide.training.stages import Stage
from telewide.training.world_samples import WorldBatches, WorldSource

JUDGED_STEPS = 8


def train_box(
    recipe: Recipe,
    *,
    run: Path | None,
    fresh: bool,
    device: Device,
    observer: Observer,
    deadline_s: float = math.inf,
) -> TrainOutcome:
    """Train on worlds, or continue.

    Args:
        recipe: resolved, with ``train.worlds``.
        run: run folder, or None for ``run`` here.
        fresh: forget a training that lies there.
        device: auto, cpu or cuda.
        observer: is told of the progress.
        deadline_s: when to stop, on the monotonic clock.

    Returns:
        The outcome.

    Raises:
        UsageError: no stage with steps, the training there was begun with another recipe, or a run folder that nobody
            named is a link.
        InputError: the training's folder in the run folder is a link.
        KeyboardInterrupt: stopped by hand; a checkpoint is left.
    """
    folder, chosen = locate_run(run, CAPTURES_FOLDER), choose_device(device)
    refuse_links(folder.root, folder.train)
    with joined_processes(device) as processes, alone(processes, folder.train, observer=observer):
        source, judged = (
            WorldSource(seed=seed, crop_hw=recipe.train.crop_hw, device=chosen)
            for seed in (recipe.seed, recipe.seed + JUDGE_SEED)
        )
        state = _take_up(folder, recipe, source, device=chosen, fresh=fresh, processes=processes, observer=observer)
        if state.is_finished:
            return outcome_of(folder, planned(recipe), state, is_new=False)
        training = _training(recipe, folder, source=source, judged=judged, processes=processes)
        logged = LoggedReporter(observer, folder, partial(_rows, judged), is_writer=processes.is_writer)
        run_training(replace(training, deadline_s=deadline_s), state, reporter=logged)
        return outcome_of(folder, planned(recipe), state, is_new=True)


def _training(
    recipe: Recipe, folder: RunFolder, *, source: WorldSource, judged: WorldSource, processes: Processes
) -> Training:
    return Training(
        folder=folder.train,
        options=recipe.train,
        source=source,
        judge=crops_judge(WorldBatches(judged, judge_stage(steps=JUDGED_STEPS)), window=judged.window_px),
        seed=recipe.seed,
        network_name=recipe.network,
        recipe=recipe.model_dump(mode="json"),
        device=source.device,
        processes=processes,
        # A GPU casts its worlds itself, in this process.
        workers=workers_for(source.device) if source.device.type == "cpu" else 0,
    )


def _take_up(
    folder: RunFolder,
    recipe: Recipe,
    source: WorldSource,
    *,
    device: torch.device,
    fresh: bool,
    processes: Processes,
    observer: Observer,
) -> TrainingState:
    """The training that lies in a run folder, or a new one."""
    resolved = recipe.model_dump(mode="json")
    if fresh and processes.is_writer:
        forget(folder)
    processes.wait()
    kept, state = read_training(folder), state_for(folder, recipe, device)
    if kept is not None:
        refuse_another_recipe(kept, resolved, anew="fresh=True")
        if state.step + state.stage_index and not state.is_finished:
            observer.said(f"resuming {planned(recipe)[state.stage_index].name} at step {state.step}")
    processes.wait()  # all have read what the writer now changes
    if processes.is_writer and not state.is_finished:
        write_training(
            folder, TrainingRecord(recipe=resolved, window=source.window_px, captures=(), held_out=(), judged=())
        )
        drop_log_after(folder.training_log, stage_index=state.stage_index, step=state.step)
    return state


def _rows(source: WorldSource, network: StereoNetwork) -> list[ContactRow]:
    """Rows of a contact sheet: crops of the judge's worlds."""
    batch = WorldBatches(source, Stage("sheet", 0, StageOptions(steps=1, rehearsed=SHEET_ROWS)))[0]
    views = (view.permute(0, 2, 3, 1).cpu().numpy() for view in (batch.ref_BCHW, batch.src_BCHW))
    rows = []
    for number, (ref, src) in enumerate(zip(*views, strict=True)):
        matched = match_with_network(ref, src, network=network, window=batch.window or source.window_px)
        rows.append(ContactRow(f"world {number}", ref, src, matched))
    return rows
