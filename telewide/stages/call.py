"""One call: what its stages share, and its record in the run folder."""

from __future__ import annotations

import difflib
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from telewide.calibration.rig_file import StoredRig
from telewide.capture.pair import CaptureSet, find_captures
from telewide.capture.photo_store import PhotoStore
from telewide.cores import Device
from telewide.errors import UsageError
from telewide.folders import alone_in, refuse_links
from telewide.recipe import Recipe
from telewide.stages.observer import Observer
from telewide.stages.pairs import PreparedSet
from telewide.stages.rig import locate_rig, refuse_without_rig
from telewide.stages.run_folder import RunFolder, locate_run, write_run_record
from telewide.text import Invocation
from telewide.training.processes import Processes, joined_processes

MOST_NAMED = 12
"""Captures that a message names, those most like what was asked for."""


@dataclass(frozen=True)
class Call:
    """Context that the stages of one call share.

    Attributes:
        captures: what was found.
        folder: the run folder.
        recipe: the resolved recipe.
        device: auto, cpu or cuda.
        processes: this process among all.
        observer: is told of the progress.
        rig: what to rectify with; None for captures that are rectified.
        rig_file: the rig file as its user named it, or None.
        invocation: the command that was typed, or one that does the same; advised commands take it up.
        photos: decoded for their pairs, needed again for depth and report.
        begun_s: when the call began, on the monotonic clock.
        deadline_s: when a training is to stop, on that clock.
    """

    captures: CaptureSet
    folder: RunFolder
    recipe: Recipe
    device: Device
    processes: Processes
    observer: Observer
    rig: StoredRig | None
    rig_file: Path | None
    invocation: Invocation
    photos: PhotoStore = field(default_factory=PhotoStore)
    begun_s: float = field(default_factory=time.monotonic)
    deadline_s: float = math.inf


@contextmanager
def begun(
    captures_root: Path,
    *,
    run: Path | None,
    recipe: Recipe,
    device: Device,
    observer: Observer,
    rig: Path | None,
    only: Sequence[str] = (),
    deadline_s: float = math.inf,
) -> Iterator[Call]:
    """Find captures, run folder and rig, and join the processes.

    Args:
        captures_root: folder of the captures.
        run: run folder, or None for the one that belongs to the captures.
        recipe: the resolved recipe.
        device: auto, cpu or cuda.
        observer: is told of the progress.
        rig: rig file, or None for the one that lies by the captures.
        only: names of the captures to take; empty for all.
        deadline_s: as of `Call`.

    Yields:
        What the stages share.

    Raises:
        UsageError: a folder, file or capture that is not there.
        InputError: photos straight from a phone have no rig; a folder in the run folder is a link.
    """
    folder = locate_run(run, captures_root)
    invocation = observer.invocation or Invocation("train", (captures_root,), {"out": run, "rig": rig})
    captures = _chosen(_found(captures_root, folder, invocation), only)
    found_rig = locate_rig(rig, captures)
    refuse_without_rig(captures, rig=found_rig)
    for place in (folder.pairs, folder.train, folder.depth):
        refuse_links(folder.root, place)
    with joined_processes(device) as processes:
        yield Call(
            captures=captures,
            folder=folder,
            recipe=recipe,
            device=device,
            processes=processes,
            observer=observer,
            rig=found_rig,
            rig_file=rig,
            invocation=invocation,
            deadline_s=deadline_s,
        )


def _refuse_captures_as_run(captures_root: Path, folder: RunFolder) -> None:
    if os.path.realpath(folder.root) == os.path.realpath(captures_root):
        raise UsageError(
            f"{captures_root} holds the captures; a run needs a folder of its own", hint="name another one"
        )


def _found(captures_root: Path, folder: RunFolder, invocation: Invocation) -> CaptureSet:
    captures = find_captures(captures_root, advised=lambda other: invocation.instead(invocation.command, other))
    _refuse_captures_as_run(captures_root, folder)
    return captures


def _chosen(captures: CaptureSet, only: Sequence[str]) -> CaptureSet:
    if not only:
        return captures
    known = [capture.name for capture in captures.captures]
    for name in only:
        if name not in known:
            raise UsageError(f"{captures.root} holds no capture {name}", hint=_names_known(name, known))
    chosen = tuple(capture for capture in captures.captures if capture.name in only)
    problems = tuple(problem for problem in captures.problems if problem.name in only)
    return replace(captures, captures=chosen, problems=problems)


def _names_known(name: str, known: Sequence[str]) -> str:
    """Say what captures are called, or how several are named where a comma stands between them."""
    several = name.split(",")
    if set(several) <= set(known):
        return f"each takes the option once more: {', '.join(several)}"
    near = sorted(difflib.get_close_matches(name, known, n=MOST_NAMED, cutoff=0.0))
    return f"known ones: {', '.join(near)}{' ...' if len(known) > len(near) else ''}"


@contextmanager
def alone(processes: Processes, place: Path, *, observer: Observer) -> Iterator[None]:
    """Hold a place of the run folder alone; wait for another call that holds it.

    One place, not the whole folder, so that depth can take the newest weights while training goes on.

    Args:
        processes: of a call; one of them writes there.
        place: a folder of the run folder, or that of the results.
        observer: is told where there is something to wait for.
    """
    with ExitStack() as held:
        if processes.is_writer:
            held.enter_context(alone_in(place, waiting=observer.said))
        processes.wait()
        yield


def record(
    call: Call, prepared: PreparedSet, *, command: str, options: Mapping[str, object], timings: Mapping[str, float]
) -> None:
    """Note in ``run.json`` what was done; one of several processes writes it.

    Args:
        call: whose captures were worked on.
        prepared: the pairs, whose photos are the inputs.
        command: its name.
        options: as resolved.
        timings: seconds by stage.
    """
    if call.processes.is_writer:
        inputs = [path for item in prepared.pairs for path in (item.source.tele_path, item.source.wide_path)]
        write_run_record(call.folder, command=command, options=options, inputs=inputs, timings=timings)
