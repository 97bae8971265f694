"""The whole method, top to bottom: captures in, weights, depth and bokeh out.

    captures ── prepare (correct each shot) ── train (rehearsal ► photometric ► feature-metric stages) ── weights
                         └────────────────────── match ── follow tele's edges ── depth ── bokeh ── files

Only this module and `prepare` know the run folder. Whoever calls hears of the progress through an :class:`Observer`.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from telewide.capture.images import write_image
from telewide.capture.pair import CaptureFacts, CaptureSet, Problem, find_captures, read_pair, read_truth
from telewide.capture.rundir import RunFolder, fingerprint, locate_run, write_run_record
from telewide.correction.held_out import match_errors_px, summarise_errors
from telewide.correction.inspect import PairReport
from telewide.errors import InputError, UsageError
from telewide.geometry.stereo import DisparityMap, FloatMap, resize_disparity
from telewide.matching.semiglobal import match_semiglobal
from telewide.metrics import end_point_error_px, three_pixel_error
from telewide.options import parse_options
from telewide.output.bokeh_picture import BokehOptions, bokeh_picture, check_bokeh
from telewide.output.depth import depth_result
from telewide.output.edges import follow_edges
from telewide.output.export import write_depth
from telewide.output.kept import KEPT_NAME, KeptDepth, read_kept, write_kept
from telewide.page import report_row, write_page
from telewide.prepare import PreparedPair, PreparedSet, prepare_captures
from telewide.recipe import DEFAULT_RECIPE, Recipe, load_recipe

if TYPE_CHECKING:
    from telewide.matching.networks import StereoNetwork
    from telewide.train import TrainOutcome
    from telewide.training.processes import Processes
    from telewide.training.stages import Stage

Matcher = Callable[[FloatMap, FloatMap], DisparityMap]
METHODS = ("network", "sgm")


class Observer(Protocol):
    """Hears what a pipeline does; its first five are what the training loop tells its reporter."""

    def stage_started(self, stage: Stage, *, first_step: int) -> None:
        """A stage of the training begins, or goes on at ``first_step``."""

    def step_done(self, stage: Stage, *, step: int, losses: Mapping[str, float], seconds: float) -> None:
        """``step`` steps of the stage are done."""

    def judged(self, stage: Stage, *, step: int, judgement: Mapping[str, float]) -> None:
        """The held-out matches were asked."""

    def stage_finished(self, stage: Stage, *, network: StereoNetwork, judgement: Mapping[str, float]) -> None:
        """A stage is done."""

    def said(self, message: str) -> None:
        """Something worth a line."""

    def preparing(self, captures: CaptureSet) -> None:
        """The captures of a set are about to be corrected."""

    def pair_prepared(self, report: PairReport | None) -> None:
        """One capture is corrected, or left out."""

    def set_prepared(self, prepared: PreparedSet) -> None:
        """All captures are corrected."""

    def labelling(self, total: int) -> Callable[[], None]:
        """Labels of ``total`` captures are about to be computed; the answer is called after each."""

    def matching(self, total: int, *, method: str) -> None:
        """``total`` captures are about to be matched."""

    def depth_written(self, outcome: DepthOutcome) -> None:
        """One capture's depth is written."""

    def depth_failed(self, problem: Problem) -> None:
        """One capture was skipped."""


@dataclass(frozen=True)
class DepthOutcome:
    """What was made of one capture.

    Attributes:
        name: of the capture.
        paths: files written.
        notes: what was left out, and why.
        numbers: seconds, shares of held-out matches missed, errors against a truth where the set has one.
    """

    name: str
    paths: tuple[Path, ...]
    notes: tuple[str, ...]
    numbers: Mapping[str, float]


@dataclass(frozen=True)
class DepthRun:
    """What was made of a set.

    Attributes:
        folder: where it lies.
        outcomes: one a capture.
        problems: captures left out, and why.
        report: the report page, where one was written.
    """

    folder: Path
    outcomes: tuple[DepthOutcome, ...]
    problems: tuple[Problem, ...]
    report: Path | None = None


@dataclass(frozen=True)
class DepthOptions:
    """What ``telewide depth`` was asked for.

    Attributes:
        method: "network" or "sgm".
        weights: a weights file, or None for the run's newest.
        bokeh: None for no bokeh picture.
        out: folder for the results, or None for ``depth/`` of the run.
        device: auto, cpu or cuda.
    """

    method: str = "network"
    weights: Path | None = None
    bokeh: BokehOptions | None = None
    out: Path | None = None
    device: str = "auto"


def train_captures(
    captures_root: Path, *, run: Path | None, recipe: Recipe, fresh: bool, device: str, observer: Observer
) -> TrainOutcome:
    """Train on a folder of captures, or continue.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: resolved recipe.
        fresh: start over where a training lies in the run folder.
        device: auto, cpu or cuda.
        observer: hears of it.

    Returns:
        What was reached, and where the weights are.

    Raises:
        TelewideError: see `prepare_captures` and `train_prepared`.
        KeyboardInterrupt: stopped by hand; a checkpoint is left.
    """
    from telewide.matching.inference import choose_device
    from telewide.train import train_prepared
    from telewide.training.processes import joined_processes

    torch_device = choose_device(device)
    folder = locate_run(run, captures_root)
    begun_s = time.monotonic()
    with joined_processes(torch_device) as processes:
        prepared = _prepare(captures_root, folder, recipe, observer, processes=processes)
        prepared_s = time.monotonic()
        outcome = train_prepared(
            prepared,
            folder,
            recipe=recipe,
            fresh=fresh,
            device=torch_device,
            processes=processes,
            reporter=observer,
            labelling=observer.labelling,
        )
    if is_writer():
        write_run_record(
            folder,
            command="train",
            options=recipe.model_dump(mode="json"),
            inputs=_inputs(prepared),
            timings={"prepare": prepared_s - begun_s, "train": time.monotonic() - prepared_s},
        )
    return outcome


def depth_captures(
    captures_root: Path, *, run: Path | None, recipe: Recipe, options: DepthOptions, observer: Observer
) -> DepthRun:
    """Compute depth, and bokeh if asked, of every capture of a folder.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: what is corrected, where no weights file says it.
        options: method, weights, bokeh, place.
        observer: hears of it.

    Returns:
        What was written; bad captures are among its problems.

    Raises:
        InputError: no capture could be used.
        UsageError: no trained run, or a bokeh that needs a baseline.
    """
    folder = locate_run(run, captures_root)
    captures = find_captures(captures_root)
    check_bokeh(options.bokeh, captures)
    matcher_for, matcher_key = _choose_matcher(folder, options)
    out = options.out or folder.depth
    _make_folder(out)
    prepared = _prepare_together(captures_root, folder, recipe, observer)
    rank, world = rank_and_world()
    mine = prepared.pairs[rank::world]
    observer.matching(len(mine), method=options.method)
    match = matcher_for(prepared)
    begun_s = time.monotonic()
    outcomes, problems, n_kept = [], list(prepared.problems), 0
    failure: InputError | UsageError | None = None
    for item in mine:
        place, key = out / item.capture.name, _depth_key(item, prepared, options, matcher_key=matcher_key)
        try:
            done = kept = read_kept(place, key)
            if done is None:
                (place / KEPT_NAME).unlink(missing_ok=True)  # its files are about to change
                done = _depth_of(item, prepared.facts, match, bokeh=options.bokeh, folder=place)
                write_kept(place, done, key=key)
        except (InputError, UsageError) as error:
            failure = error
            problems.append(Problem(item.capture.name, error.message))
            observer.depth_failed(problems[-1])
            continue
        n_kept += kept is not None
        outcomes.append(
            DepthOutcome(item.source.name, tuple(place / name for name in done.files), done.notes, done.numbers)
        )
        observer.depth_written(outcomes[-1])
    if failure is not None and not outcomes:
        message = f"{captures_root}: no depth could be computed; {problems[-1].name}: {failure.message}"
        raise type(failure)(message, hint=failure.hint)
    if n_kept:
        observer.said(f"{n_kept} of {len(outcomes)} captures are as they were: same photos, same weights, same options")
    if is_writer():
        write_run_record(
            folder,
            command="depth",
            options={"method": options.method, "weights": str(options.weights or "newest of the run")},
            inputs=_inputs(prepared),
            timings={"depth": time.monotonic() - begun_s},
        )
    return DepthRun(out, tuple(outcomes), tuple(problems))


def _make_folder(folder: Path) -> None:
    """Say before the work, not after it, that a place cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"{folder} cannot be made: {reason}", hint="name another folder with --out") from error


def run_captures(
    captures_root: Path, *, run: Path | None, recipe: Recipe, options: DepthOptions, observer: Observer
) -> DepthRun:
    """Do what is still to do: train, compute depth and bokeh, write the report page.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: resolved recipe.
        options: of the depth.
        observer: hears of it.

    Returns:
        What was written, with its report.

    Raises:
        TelewideError: see `train_captures` and `depth_captures`.
    """
    folder = locate_run(run, captures_root)
    check_bokeh(options.bokeh, find_captures(captures_root))
    train_captures(captures_root, run=folder.root, recipe=recipe, fresh=False, device=options.device, observer=observer)
    done = depth_captures(captures_root, run=folder.root, recipe=recipe, options=options, observer=observer)
    captures = {capture.name: capture for capture in find_captures(captures_root).captures}
    rows = (
        report_row(
            read_pair(captures[outcome.name]), done.folder / outcome.name, root=folder.root, numbers=outcome.numbers
        )
        for outcome in done.outcomes
    )
    page = write_page(folder, rows, recipe=recipe.description, captures=captures_root)
    return replace(done, report=page)


def recipe_of_run(run: Path | None, captures_root: Path) -> Recipe:
    """The recipe a run was trained with, so that its pairs are corrected alike; the default without one.

    Raises:
        InputError: the run's record is damaged.
    """
    path = locate_run(run, captures_root).train / "training.json"
    if not path.is_file():
        return load_recipe(DEFAULT_RECIPE)
    try:
        return parse_options(Recipe, json.loads(path.read_text())["recipe"], source=str(path), error=InputError)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is damaged", hint="train again with --fresh") from error


def _prepare(
    captures_root: Path, folder: RunFolder, recipe: Recipe, observer: Observer, *, processes: Processes | None = None
) -> PreparedSet:
    """Correct the pairs; of several processes the writer does, and the others find them done."""
    captures = find_captures(captures_root)
    observer.preparing(captures)
    if processes is not None and not processes.is_writer:
        processes.wait()
    prepared = prepare_captures(captures, folder, recipe=recipe, tick=observer.pair_prepared)
    if processes is not None and processes.is_writer:
        processes.wait()
    observer.set_prepared(prepared)
    return prepared


def _prepare_together(captures_root: Path, folder: RunFolder, recipe: Recipe, observer: Observer) -> PreparedSet:
    if rank_and_world()[1] == 1:
        return _prepare(captures_root, folder, recipe, observer)
    from telewide.matching.inference import choose_device
    from telewide.training.processes import joined_processes

    with joined_processes(choose_device("cpu")) as processes:
        return _prepare(captures_root, folder, recipe, observer, processes=processes)


def _choose_matcher(folder: RunFolder, options: DepthOptions) -> tuple[Callable[[PreparedSet], Matcher], str]:
    """Matcher and what tells it from others; say at once, before any photo is read, when there is none."""
    if options.method == "sgm":
        return lambda prepared: lambda ref, src: match_semiglobal(ref, src, window=prepared.window), "sgm"
    from telewide.matching.inference import choose_device, match_with_network
    from telewide.training.checkpoint import WEIGHTS_NAME, load_weights

    path = options.weights or folder.train / WEIGHTS_NAME
    if not path.is_file():
        missing = f"{path} does not exist" if options.weights else f"{folder.root} holds no trained network"
        raise UsageError(
            missing,
            hint="train one with: telewide train captures/  or match at once, untrained: telewide depth --method sgm",
        )
    network, card = load_weights(path, device=choose_device(options.device))
    key = fingerprint(path)
    return lambda _prepared: lambda ref, src: match_with_network(ref, src, network=network, window=card.window), key


def _depth_key(
    item: PreparedPair, prepared: PreparedSet, options: DepthOptions, *, matcher_key: str
) -> dict[str, object]:
    """What the files of one capture depend on; the pair's record names photos, facts and correction."""
    truth = item.source.truth_path
    return {
        "version": metadata.version("telewide"),
        "pair_sha256": fingerprint(item.capture.tele_path.with_name("pair.json")),
        "truth_sha256": None if truth is None else fingerprint(truth),
        "matcher": matcher_key,
        "window": prepared.window if options.method == "sgm" else None,  # a network brings its own
        "bokeh": None if options.bokeh is None else asdict(options.bokeh),
    }


def _depth_of(
    item: PreparedPair, facts: CaptureFacts, match: Matcher, *, bokeh: BokehOptions | None, folder: Path
) -> KeptDepth:
    """Match one pair, bring the result to the photo's own size and edges, and write it."""
    begun_s = time.monotonic()
    pair = read_pair(item.capture)
    working = match(pair.tele, pair.wide)
    matched_s = time.monotonic()
    photo = read_pair(item.source, facts=facts).tele
    disparity = _on_photo(working, photo)
    result = depth_result(item.source.name, disparity, facts=facts)
    written = write_depth(folder, result, image=photo)
    paths = list(written.paths)
    if bokeh is not None:
        paths.append(folder / "bokeh.jpg")
        write_image(paths[-1], bokeh_picture(photo, disparity, options=bokeh, baseline_m=facts.baseline_m))
    numbers = {"match_s": matched_s - begun_s, "total_s": time.monotonic() - begun_s}
    numbers |= summarise_errors(match_errors_px(working.disparity_px, item.held_out))
    truth_px = read_truth(item.source, hw=disparity.disparity_px.shape[:2])
    if truth_px is not None:
        numbers["3PE"] = three_pixel_error(disparity.disparity_px, truth_px)
        numbers["EPE_px"] = end_point_error_px(disparity.disparity_px, truth_px)
    return KeptDepth(tuple(path.name for path in paths), written.notes, numbers)


def _on_photo(working: DisparityMap, photo: FloatMap) -> DisparityMap:
    """Bring a map to the photo's size, and its edges to the photo's edges."""
    wh = (photo.shape[1], photo.shape[0])
    disparity_px, confidence, valid = working.disparity_px, working.confidence, working.valid
    if disparity_px.shape != photo.shape[:2]:
        rows, columns = (
            np.minimum(np.arange(size) * small // size, small - 1)
            for size, small in zip(photo.shape[:2], disparity_px.shape, strict=True)
        )
        disparity_px = resize_disparity(disparity_px, wh=wh)
        confidence, valid = confidence[np.ix_(rows, columns)], valid[np.ix_(rows, columns)]
    followed_px = follow_edges(disparity_px, photo, confidence=confidence, valid=valid)
    return DisparityMap(followed_px, confidence, valid)


def rank_and_world() -> tuple[int, int]:
    """This process among those ``torchrun`` started: (rank, world); (0, 1) without it."""
    return int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))


def is_writer() -> bool:
    """Whether this process writes what is written once."""
    return rank_and_world()[0] == 0


def _inputs(prepared: PreparedSet) -> list[Path]:
    return [path for item in prepared.pairs for path in (item.source.tele_path, item.source.wide_path)]
