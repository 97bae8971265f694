"""The whole method, top to bottom: captures in, weights, depth and bokeh out.

    captures ── prepare (correct each shot) ── train (rehearsal ► photometric ► feature-metric stages) ── weights
                         └────────────────────── match ── follow tele's edges ── depth ── bokeh ── files

Here is the order alone; what a stage checks, keeps and records is in `telewide.stages`. Progress goes to an
:class:`Observer`. Started by ``torchrun``, every process prepares and matches its share of the captures, all train
together, and each comes to know the results of all.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

from telewide.cores import Device
from telewide.errors import UsageError
from telewide.recipe import Recipe
from telewide.stages.call import begun
from telewide.stages.depth import DepthOptions, DepthRun, compute_depth, refuse_what_cannot_be, results_folder
from telewide.stages.match import choose_matcher
from telewide.stages.observer import Observer
from telewide.stages.prepare import prepare
from telewide.stages.report import report, report_depth
from telewide.stages.run_folder import locate_run_of_depth

if TYPE_CHECKING:
    from telewide.stages.train import TrainOutcome


def train_captures(
    captures_root: Path,
    *,
    run: Path | None,
    recipe: Recipe,
    fresh: bool,
    device: Device,
    observer: Observer,
    rig: Path | None = None,
    minutes: float | None = None,
) -> TrainOutcome:
    """Train on a folder of captures, or continue.

    Args:
        captures_root: folder of the captures; a recipe of ``train.worlds`` needs none.
        run: run folder, or None for the one that belongs to the captures.
        recipe: resolved recipe.
        fresh: start over where a training lies in the run folder.
        device: auto, cpu or cuda.
        observer: is told of the progress.
        rig: rig file, or None for the one that lies by the captures.
        minutes: stop after so many, with a checkpoint; None for no such end.

    Returns:
        What was reached, and where the weights are.

    Raises:
        UsageError: the minutes are not above 0.
        TelewideError: see `prepare` and `telewide.stages.train.train`.
        KeyboardInterrupt: stopped by hand; a checkpoint is left.
    """
    from telewide.stages.box import train_box
    from telewide.stages.train import train

    if minutes is not None and not minutes > 0:
        raise UsageError(f"a training of {minutes:g} minutes; a number above 0 was expected")
    deadline_s = math.inf if minutes is None else time.monotonic() + 60 * minutes
    if recipe.train.worlds:
        return train_box(recipe, run=run, fresh=fresh, device=device, observer=observer, deadline_s=deadline_s)
    with begun(
        captures_root, run=run, recipe=recipe, device=device, observer=observer, rig=rig, deadline_s=deadline_s
    ) as call:
        pairs = prepare(call)
        return train(call, pairs, fresh=fresh)


def depth_captures(
    captures_root: Path, *, run: Path | None, recipe: Recipe, options: DepthOptions, observer: Observer
) -> DepthRun:
    """Compute depth, and bokeh if asked, of every capture of a folder, and write a page to look at it.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: what is corrected, where no weights file says it.
        options: method, weights, bokeh, place.
        observer: is told of the progress.

    Returns:
        What was written; bad captures are among its problems.

    Raises:
        InputError: no capture could be used.
        UsageError: no trained run, or a bokeh that needs a baseline.
    """
    device = "cpu" if options.method == "sgm" else options.device
    with begun(
        captures_root,
        run=locate_run_of_depth(run, captures_root, out=options.out),
        recipe=recipe,
        device=device,
        observer=observer,
        rig=options.rig,
        only=options.only,
    ) as call:
        refuse_what_cannot_be(call, options)
        out = options.out or call.folder.depth
        matcher = choose_matcher(call, method=options.method, weights=options.weights, out=out)
        with results_folder(call, options):
            pairs = prepare(call)
            return report_depth(call, compute_depth(call, pairs, matcher, options=options), bokeh=options.bokeh)


def run_captures(
    captures_root: Path, *, run: Path | None, recipe: Recipe, options: DepthOptions, observer: Observer
) -> DepthRun:
    """Do what is still to do: train where a network matches, compute depth and bokeh, write the report page.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: resolved recipe.
        options: of the depth.
        observer: is told of the progress.

    Returns:
        What was written, with its report.

    Raises:
        TelewideError: see `train_captures` and `depth_captures`.
    """
    from telewide.stages.train import train

    trains = options.method == "network"
    device = options.device if trains else "cpu"
    with begun(captures_root, run=run, recipe=recipe, device=device, observer=observer, rig=options.rig) as call:
        refuse_what_cannot_be(call, options)
        pairs = prepare(call)
        if trains:
            train(call, pairs, fresh=False)
        out = options.out or call.folder.depth
        matcher = choose_matcher(call, method=options.method, weights=options.weights, out=out)
        depths = compute_depth(call, pairs, matcher, options=options)
        return (report if trains else report_depth)(call, depths, bokeh=options.bokeh)
