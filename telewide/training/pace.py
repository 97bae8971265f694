"""Pace of a training on the machine at hand: how many steps a stage has time for."""

from __future__ import annotations

import copy
import statistics
import time
from dataclasses import replace

import torch

from telewide.training.checkpoint import TrainingState
from telewide.training.data import iterate_batches, step_batches
from telewide.training.loop import Training, begin_stage, set_learning, take_step
from telewide.training.stages import Stage

_WARM_UP_STEPS, _TIMED_STEPS = 1, 3


def seconds_a_step(training: Training, state: TrainingState, stage: Stage) -> float:
    """Time some steps of a stage on copies of all that they change.

    Args:
        training: data, device and seed.
        state: at the first step of the stage; left as it is.
        stage: to be timed.

    Returns:
        The median, with the time that its batch takes where both take turns: on a processor, or where this process
        makes the batches. Else the longer of the two, the batches being made by several processes.
    """
    trial = copy.deepcopy(state)
    begin_stage(trial, stage, seed=training.seed)
    set_learning(trial, stage)
    longer = replace(stage, options=stage.options.model_copy(update={"steps": _WARM_UP_STEPS + _TIMED_STEPS}))
    processes = training.processes
    dataset = step_batches(training.source, longer, seed=training.seed, rank=processes.rank, world=processes.world)
    seconds = []
    begun_s = time.monotonic()
    for batch in iterate_batches(dataset, first_step=0, workers=0):
        made_s = time.monotonic()
        take_step(trial, batch.to(training.device), longer, training=training)
        if training.device.type == "cuda":
            torch.cuda.synchronize(training.device)
        taken_s = time.monotonic() - made_s
        made_s -= begun_s
        is_shared = training.device.type == "cpu" or not training.workers
        seconds.append(taken_s + made_s if is_shared else max(taken_s, made_s / training.workers))
        trial.step += 1
        begun_s = time.monotonic()
    return statistics.median(seconds[_WARM_UP_STEPS:])
