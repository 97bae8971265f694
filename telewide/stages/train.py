"""One training in one run folder: begin, continue, finish, or refuse.

train/training.json      resolved recipe, window, captures, and which of them are held out
train/log.jsonl          a line for every judgement and every few steps
train/<stage>.png        contact sheet of each finished stage
train/state.pt, weights.safetensors, <stage>.safetensors      see `training.checkpoint`
"""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from telewide.capture.exif import read_photo_facts
from telewide.capture.pair import Capture, PairReader
from telewide.cores import usable_cores
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, read_json, write_text
from telewide.folders import append_line
from telewide.matching.inference import choose_device, match_with_network
from telewide.matching.networks import StereoNetwork
from telewide.matching.window import Window, check_stated_window
from telewide.pages.contact import ContactRow, contact_sheet, write_sheet
from telewide.points.held_out import HeldOut
from telewide.recipe import Recipe, differing_keys
from telewide.stages.call import Call, alone
from telewide.stages.call import record as record_call
from telewide.stages.labels import write_labels
from telewide.stages.pairs import PreparedSet
from telewide.stages.prepare import RECORD_NAME
from telewide.stages.run_folder import RunFolder
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
from telewide.training.judge import network_judge
from telewide.training.log import read_log
from telewide.training.loop import Training
from telewide.training.loop import train as run_training
from telewide.training.processes import Processes
from telewide.training.reporter import Reporter
from telewide.training.samples import CropArea, SampleSource, fitting_crop
from telewide.training.stages import Stage, plan_stages

FORMAT = 1
_OWN_FILES = re.compile(
    r"state\.pt|training\.json|log\.jsonl|weights\.safetensors|(rehearsal|photometric|space|feature-\d+)\.(png|safetensors)"
)
LOG_EVERY_STEPS = 10
FEWEST_TO_HOLD_OUT = 5
"""With fewer captures a strip of each is held out instead of whole ones."""
MOST_HELD_OUT = 8
USUAL_ASYMMETRY = (1.0, 6.0)
"""Where neither the recipe nor the pairs say how much coarser wide is."""
SHEET_ROWS = 6


@dataclass(frozen=True)
class TrainOutcome:
    """Outcome of a training, or of its continuation.

    Attributes:
        weights: the file to compute depth with.
        is_new: False where nothing was left to do.
        stages: name and last judgement of each finished stage.
        best_stage: the stage whose weights are the result.
    """

    weights: Path
    is_new: bool
    stages: Mapping[str, float]
    best_stage: str


@dataclass(frozen=True)
class TrainingRecord:
    """Record of what a training was begun with; the file ``training.json``.

    Attributes:
        recipe: resolved recipe as plain data.
        window: disparities of the volume, px.
        captures: names of the captures it has seen or judged by.
        held_out: names of those kept for judging; empty where strips are.
        judged: names of those it is judged by: the held-out ones, or a strip of each that there was at first.
        pairs_sha256: of what each corrected pair was made from, by name; empty where an older version wrote none.
    """

    recipe: Mapping[str, object]
    window: Window
    captures: tuple[str, ...]
    held_out: tuple[str, ...]
    judged: tuple[str, ...]
    pairs_sha256: Mapping[str, str] = field(default_factory=dict)

    def changed_in(self, other: TrainingRecord) -> tuple[str, ...]:
        """Captures of both whose photos, rig or correction are no longer the same."""
        both = self.pairs_sha256.keys() & other.pairs_sha256.keys()
        return tuple(sorted(name for name in both if self.pairs_sha256[name] != other.pairs_sha256[name]))


def train(call: Call, prepared: PreparedSet, *, fresh: bool) -> TrainOutcome:
    """Train a network on prepared pairs, or continue, and record it in the run folder.

    Args:
        call: where checkpoints and logs lie, who is told.
        prepared: corrected pairs.
        fresh: forget a training that lies there.

    Returns:
        What was reached.

    Raises:
        UsageError: the training that lies there was begun with another recipe.
        KeyboardInterrupt: stopped by hand; a checkpoint is left.
    """
    prepared_s = time.monotonic()
    with alone(call, call.folder.train):
        outcome = _train(call, prepared, fresh=fresh, device=choose_device(call.device))
    timings = {"prepare": prepared_s - call.begun_s, "train": time.monotonic() - prepared_s}
    asked = {**call.recipe.model_dump(mode="json"), "rig": call.rig_file, "device": call.device, "fresh": fresh}
    record_call(call, prepared, command="train", options=asked, timings=timings)
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
    if any(stage.needs_labels for stage in plan[state.stage_index :]):
        _label(prepared, record, processes, tick=observer.labelling(len(prepared.pairs)))
    processes.wait()
    logged = LoggedReporter(observer, run, partial(_rows, prepared, record), is_writer=processes.is_writer)
    run_training(_training(prepared, run, record, recipe, device=device, processes=processes), state, reporter=logged)
    return outcome_of(run, plan, state, is_new=True)


def planned(recipe: Recipe) -> tuple[Stage, ...]:
    """List the stages of a recipe.

    Raises:
        UsageError: there are none.
    """
    plan = plan_stages(recipe.train)
    if not plan:
        raise UsageError("the recipe has no stage with steps", hint="set train.rehearsal.steps above 0")
    return plan


def _label(prepared: PreparedSet, record: TrainingRecord, processes: Processes, *, tick: Callable[[], None]) -> None:
    """Write the labels of this process' share of the captures that training sees."""
    names = tuple(item.capture.name for item in prepared.pairs if item.capture.name not in record.held_out)
    write_labels(prepared, names=processes.share(names), window=record.window, tick=tick)


def _take_up(
    call: Call, prepared: PreparedSet, plan: Sequence[Stage], *, device: torch.device
) -> tuple[TrainingRecord, TrainingState]:
    """The training that lies in a run folder, and what is new to it; or a new one."""
    run, anew = call.folder, call.invocation.instead("train", fresh=True)
    with _damage_told(anew):
        kept = read_record(run)
    record = _agreed_record(kept, prepared, call.recipe, anew=anew)
    with _damage_told(anew):
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
def _damage_told(anew: str) -> Iterator[None]:
    """Say of a file of a training that cannot be read by which command to start over."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, hint=f"start over: {anew}") from error


def _note_what_is_taken_up(run: RunFolder, record: TrainingRecord, state: TrainingState) -> None:
    """First that something is left to do, then that new captures are known: a stop in between loses neither."""
    if (run.train / STATE_NAME).is_file():
        save_state(state, run.train / STATE_NAME)
    write_record(run, record)
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


def read_record(run: RunFolder) -> TrainingRecord | None:
    """The record of the training in a run folder, or None where there is none.

    Raises:
        InputError: the file is damaged.
    """
    path = run.training_record
    if not path.exists():
        return None
    try:
        content = cast(dict[str, Any], read_json(path))
        first, end = content["window"]
        check_stated_window((first, end))
        captures, held_out = _names(content["captures"]), _names(content["held_out"])
        judged = _names(content.get("judged", held_out or captures))
        prints = {str(name): str(value) for name, value in content.get("pairs_sha256", {}).items()}
        return TrainingRecord(
            recipe={**content["recipe"]},
            window=(first, end),
            captures=captures,
            held_out=held_out,
            judged=judged,
            pairs_sha256=prints,
        )
    except (InputError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is damaged") from error


def _names(plain: Sequence[object]) -> tuple[str, ...]:
    if not all(isinstance(name, str) for name in plain):
        raise TypeError("names are texts")
    return tuple(map(str, plain))


def _agreed_record(kept: TrainingRecord | None, prepared: PreparedSet, recipe: Recipe, *, anew: str) -> TrainingRecord:
    """The record to go on with: the kept one with what is new, or refuse where the recipe has changed.

    Args:
        kept: of the training that lies there.
        prepared: the pairs.
        recipe: the resolved recipe.
        anew: the command that starts over, to be advised.
    """
    names = tuple(item.capture.name for item in prepared.pairs)
    resolved = recipe.model_dump(mode="json")
    prints = {item.capture.name: fingerprint(item.capture.tele_path.with_name(RECORD_NAME)) for item in prepared.pairs}
    if kept is None:
        held_out = _choose_held_out(names, recipe)
        return TrainingRecord(
            recipe=resolved,
            window=prepared.window_with(None),
            captures=names,
            held_out=held_out,
            judged=held_out or names,
            pairs_sha256=prints,
        )
    refuse_another_recipe(kept, resolved, anew=anew)
    # Held-out captures stay: the judge must not change under a network.
    held_out, judged = (tuple(name for name in of_kept if name in names) for of_kept in (kept.held_out, kept.judged))
    if not judged:
        raise UsageError(
            f"the captures that this training is judged by are no longer there: {', '.join(kept.judged)}",
            hint=f"put them back, or start over: {anew}",
        )
    if len(held_out) == len(names):
        raise UsageError(
            f"all captures that are left are held out to judge by, and none to train on: {', '.join(names)}",
            hint=f"add captures, or start over: {anew}",
        )
    return TrainingRecord(
        recipe=resolved,
        window=prepared.window_with(kept.window),
        captures=names,
        held_out=held_out,
        judged=judged,
        pairs_sha256=prints,
    )


def refuse_another_recipe(kept: TrainingRecord, resolved: Mapping[str, object], *, anew: str) -> None:
    """Refuse to go on with a training by another recipe than it was begun with.

    Args:
        kept: of the training that lies there.
        resolved: the recipe of now, as plain data.
        anew: how to start over.

    Raises:
        UsageError: naming the keys that differ.
    """
    changed = differing_keys(kept.recipe, resolved)
    if changed:
        raise UsageError(
            f"the training in this run folder was begun with another recipe; these keys differ: {', '.join(changed)}",
            hint=f"continue with the same recipe, name another run folder with --out, or start over: {anew}",
        )


def _choose_held_out(names: Sequence[str], recipe: Recipe) -> tuple[str, ...]:
    if len(names) < FEWEST_TO_HOLD_OUT:
        return ()
    count = min(MOST_HELD_OUT, max(1, round(recipe.train.held_out_share * len(names))))
    chosen = np.random.default_rng(recipe.seed).choice(len(names), size=count, replace=False)
    return tuple(names[index] for index in sorted(chosen))


def state_for(run: RunFolder, recipe: Recipe, device: torch.device) -> TrainingState:
    """Read the training that lies in a run folder, or begin one."""
    path = run.train / STATE_NAME
    if path.is_file():
        return load_state(path, network_name=recipe.network, device=device, plan=plan_stages(recipe.train))
    return new_state(recipe.network, seed=recipe.seed, device=device)


def _reopen(state: TrainingState) -> None:
    """A finished training takes its last stage again on the larger set, from its result, and ends no worse."""
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
    device: torch.device,
    processes: Processes,
) -> Training:
    seen = tuple(item.capture for item in prepared.pairs if item.capture.name not in record.held_out)
    area = CropArea() if record.held_out else CropArea(end=1 - recipe.train.held_out_share)
    source = SampleSource(
        captures=seen,
        crop_hw=_fitting_crop(seen, area, recipe),
        window_px=record.window,
        asymmetry=recipe.train.asymmetry or prepared.damage_factor or USUAL_ASYMMETRY,
        area=area,
        labels_folder=run.pairs if any(stage.needs_labels for stage in plan_stages(recipe.train)) else None,
    )
    judge = network_judge(judged_captures(prepared, record, recipe), window=record.window, reader=PairReader())
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


def _fitting_crop(seen: Sequence[Capture], area: CropArea, recipe: Recipe) -> tuple[int, int]:
    """The recipe's crop, or a smaller one where the smallest picture would have to be enlarged to fill it."""
    with_size = [hw for capture in seen if (hw := read_photo_facts(capture.tele_path).hw) is not None]
    sizes_hw = [(height, int((area.end - area.first) * width)) for height, width in with_size]
    return fitting_crop(recipe.train.crop_hw, sizes_hw or [recipe.train.crop_hw])


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
    """One process prepares batches beside two computing cores; a GPU is fed by more, out of its share of the cores."""
    if device.type == "cpu":
        return 1
    return min(8, max(1, usable_cores() // int(os.environ.get("LOCAL_WORLD_SIZE", "1")) - 1))


def outcome_of(run: RunFolder, plan: Sequence[Stage], state: TrainingState, *, is_new: bool) -> TrainOutcome:
    """Sum up a finished training."""
    stages = {stage.name: value for stage, value in zip(plan, state.stage_judgements, strict=False)}
    return TrainOutcome(run.weights, is_new, stages, plan[state.best_stage].name)


def forget(run: RunFolder) -> None:
    """Remove the files a training wrote, by their names, and nothing else that may lie there.

    The record goes last: stopped in between, what is left still has the record it was made by.
    """
    if run.train.is_dir():
        for path in sorted(run.train.iterdir(), key=lambda path: path.name == run.training_record.name):
            if _OWN_FILES.fullmatch(path.name) and not path.is_dir():
                path.unlink()


def write_record(run: RunFolder, record: TrainingRecord) -> None:
    """Write ``training.json``."""
    content = {
        "format": FORMAT,
        "recipe": record.recipe,
        "window": list(record.window),
        "captures": list(record.captures),
        "held_out": list(record.held_out),
        "judged": list(record.judged),
        "pairs_sha256": dict(record.pairs_sha256),
    }
    write_text(run.training_record, json.dumps(content, indent=2) + "\n")


def drop_log_after(path: Path, *, stage_index: int, step: int) -> None:
    """Forget the lines of steps that a resumed training takes again."""
    if path.is_file():
        kept = [line.text for line in read_log(path) if (line.stage_index, line.step) <= (stage_index, step)]
        write_text(path, "".join(f"{line}\n" for line in kept))


@dataclass
class LoggedReporter:
    """Passes everything on, and keeps the log and the contact sheets."""

    inner: Reporter
    run: RunFolder
    rows: Callable[[StereoNetwork], list[ContactRow]]
    is_writer: bool
    _sums: dict[str, float] = field(default_factory=dict)
    _n_summed: int = 0

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """Begin a mean of the losses."""
        self._forget_sums()
        self.inner.stage_started(stage, first_step=first_step)

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """Log the mean of some steps."""
        for name, value in losses.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._n_summed += 1
        if step % LOG_EVERY_STEPS == 0:
            # Fewer steps than usual after a resumption in between.
            rounded = {name: round(value / self._n_summed, 5) for name, value in self._sums.items()}
            self._log(stage, step, {"losses": rounded, "seconds": round(seconds, 3)})
            self._forget_sums()
        self.inner.step_done(stage, step=step, losses=losses, seconds=seconds)

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """Log what the judge says."""
        finite = {name: value if math.isfinite(value) else None for name, value in judgement.items()}
        self._log(stage, step, {"judgement": finite})
        self.inner.judged(stage, step=step, judgement=judgement)

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """Draw the stage's contact sheet."""
        if self.is_writer:
            sheet = contact_sheet(self.rows(network), title=f"{stage.name}")
            write_sheet(self.run.train / f"{stage.name}.png", sheet)
        self.inner.stage_finished(stage, network=network, judgement=judgement)

    def said(self, message: str) -> None:
        """Pass a line on."""
        self.inner.said(message)

    def _forget_sums(self) -> None:
        self._sums.clear()
        self._n_summed = 0

    def _log(self, stage: Stage, step: int, content: Mapping[str, object]) -> None:
        if not self.is_writer:
            return
        self.run.train.mkdir(parents=True, exist_ok=True)
        line = {"stage": stage.name, "stage_index": stage.index, "step": step, **content}
        append_line(self.run.training_log, json.dumps(line))


def _rows(prepared: PreparedSet, record: TrainingRecord, network: StereoNetwork) -> list[ContactRow]:
    """Rows of a contact sheet, held-out captures first: they tell what a new photo would get."""
    captures = sorted(
        (item.capture for item in prepared.pairs), key=lambda capture: capture.name not in record.held_out
    )
    reader, rows = PairReader(max_bytes=0), []
    for capture in captures[:SHEET_ROWS]:
        pair = reader.read(capture)
        disparity = match_with_network(pair.tele, pair.wide, network=network, window=record.window)
        name = f"{capture.name} (held out)" if capture.name in record.held_out else capture.name
        rows.append(ContactRow(name, pair.tele, pair.wide, disparity, rotated_deg=prepared.facts.rotated_deg))
    return rows
