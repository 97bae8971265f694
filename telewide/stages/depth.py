"""Depth of every capture: asked for, checked, computed in shares, told and recorded."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path

from telewide.bokeh.picture import BokehOptions, check_bokeh
from telewide.capture.exif import read_photo_facts
from telewide.capture.pair import Problem
from telewide.cores import Device
from telewide.depth.pin import KnownDistance, focused_at
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint, is_file, is_folder, is_there
from telewide.folders import made_folder
from telewide.matching.matcher import Matcher
from telewide.matching.methods import Method
from telewide.matching.window import Window, joined_window
from telewide.options import parse_options
from telewide.recipe import DEFAULT_RECIPE, OF_THE_PAIRS, Recipe, load_recipe
from telewide.stages.align import shot_precision
from telewide.stages.call import Call, alone, record
from telewide.stages.capture_depth import DepthFailure, DepthOutcome, depth_of_capture
from telewide.stages.kept_depth import OF_SET, of_set
from telewide.stages.observer import Observer
from telewide.stages.pair_record import RECORD_NAME
from telewide.stages.pairs import PreparedPair, PreparedSet
from telewide.stages.photo_depth import ShotGeometry
from telewide.stages.rig import how_to_calibrate
from telewide.stages.run_folder import locate_run
from telewide.stages.training_record import read_training
from telewide.text import command_line, counted


@dataclass(frozen=True)
class DepthOptions:
    """Options of the depth of captures.

    Attributes:
        method: how to match.
        weights: a weights file, or None for the run's newest.
        bokeh: None for no bokeh picture.
        out: folder for the results, or None for ``depth/`` of the run.
        device: auto, cpu or cuda.
        rig: rig file, or None for the one that lies by the captures.
        known: a point of known distance, or None.
        trusts_focus: whether the distance that EXIF states for the focus is that of the photo's middle.
        only: names of the captures to take; empty for all.
        formats: of the depth files, the npz among them; None for those that lie there, the usual ones where none do.
        is_stripped: whether the depth files are to say nothing of the photo; the bokeh has an option of its own.
    """

    method: Method = "network"
    weights: Path | None = None
    bokeh: BokehOptions | None = None
    out: Path | None = None
    device: Device = "auto"
    rig: Path | None = None
    known: KnownDistance | None = None
    trusts_focus: bool = False
    only: tuple[str, ...] = ()
    formats: tuple[str, ...] | None = None
    is_stripped: bool = False


@dataclass(frozen=True)
class DepthRun:
    """Depths of a set, by all processes together.

    Attributes:
        folder: where it lies.
        outcomes: one a capture, sorted by name.
        problems: captures left out, and why.
        has_rig: whether the photos were rectified with a rig.
        report: the report page, where this process wrote one.
    """

    folder: Path
    outcomes: tuple[DepthOutcome, ...]
    problems: tuple[Problem, ...]
    has_rig: bool = True
    report: Path | None = None


def recipe_of_depth(run: Path | None, captures_root: Path, *, weights: Path | None = None) -> Recipe:
    """Return the recipe to prepare pairs by: the run's, else the default, with what weights state of their pairs.

    Args:
        run: run folder, or None for the one that belongs to the captures.
        captures_root: folder of the captures.
        weights: a weights file; its size, window and correction of the pairs take precedence over the run's.

    Raises:
        InputError: the run's record or the weights file is corrupt.
    """
    recipe = _recipe_of_run(run, captures_root)
    if weights is None or not is_file(weights):
        return recipe
    from telewide.training.weights_card import read_card

    # Of its training nothing matters, whose options were others in earlier versions.
    stated = {name: value for name, value in read_card(weights).recipe.items() if name in OF_THE_PAIRS}
    taught = parse_options(Recipe, stated, source=str(weights), error=InputError)
    return recipe.model_copy(update={name: getattr(taught, name) for name in OF_THE_PAIRS})


def _recipe_of_run(run: Path | None, captures_root: Path) -> Recipe:
    folder = locate_run(run, captures_root)
    try:
        record = read_training(folder)
    except InputError as error:
        anew = command_line("train", captures_root, out=run, fresh=True)
        raise InputError(error.message, hint=f"train again: {anew}") from error
    if record is None:
        return load_recipe(DEFAULT_RECIPE)
    return parse_options(Recipe, record.recipe, source=str(folder.training_record), error=InputError)


def refuse_what_cannot_be(call: Call, options: DepthOptions) -> None:
    """Refuse, before any pair is made, what these captures and their rig cannot give.

    Args:
        call: captures and rig.
        options: what was asked for.

    Raises:
        UsageError: a bokeh in millimetres without a baseline, a distance without a rig or outside of the photo, or
            results that would lie among the photos.
    """
    _refuse_the_photos_folder(call, options)
    _check_distance(call, options)
    rig = None if call.rig is None else call.rig.rig
    baseline_m = rig.baseline_m if rig and rig.is_scale_known else None
    is_pinned = rig is not None and (options.known is not None or options.trusts_focus)
    check_bokeh(options.bokeh, call.captures, baseline_m=baseline_m, has_rig=rig is not None, is_pinned=is_pinned)


def _elsewhere(call: Call, options: DepthOptions) -> str:
    """Name the option that puts the results elsewhere: the one that the call states, or that its command has."""
    states_run = call.invocation.command == "depth" and "run" in call.invocation.options
    return "--run" if states_run and options.out is None else "--out"


def _refuse_the_photos_folder(call: Call, options: DepthOptions) -> None:
    """Refuse results among the photos, which would be taken for captures."""
    out = options.out or call.folder.depth
    photos = {call.captures.root, *(capture.tele_path.parent for capture in call.captures.captures)}
    places = {out, *(out / capture.name for capture in call.captures.captures)}
    if {os.path.realpath(path) for path in photos} & {os.path.realpath(path) for path in places}:
        hint = f"name one with {_elsewhere(call, options)}"
        raise UsageError(f"{out} holds the captures; the results need another folder", hint=hint)


def _check_distance(call: Call, options: DepthOptions) -> None:
    if (options.known is not None or options.trusts_focus) and call.rig is None:
        # A rig is no use to photos that are stated to be rectified: it would be refused.
        is_rectified = call.captures.facts.rectified is True
        by_facts = "captures.yaml states that these photos are rectified: state baseline_m, f_px and doffs_px there"
        raise UsageError(
            "--distance pins a rig to what was measured, and these captures have none",
            hint=by_facts if is_rectified else how_to_calibrate(call.captures.root),
        )
    if options.known is not None and len(call.captures.captures) > 1:
        stated = call.invocation.options.get("distance", "X,Y,M")
        one = call.invocation.instead("depth", only=call.captures.captures[0].name, distance=stated)
        raise UsageError(
            f"--distance is of a point in one photo; {call.captures.root} holds {len(call.captures.captures)} captures",
            hint=f"name one: {one}",
        )
    if options.known is not None:
        with suppress(InputError):  # a photo that cannot be read is a problem of its capture, said where it is read
            _refuse_outside(options.known, hw=read_photo_facts(call.captures.captures[0].tele_path).hw)


def _refuse_outside(known: KnownDistance, *, hw: tuple[int, int] | None) -> None:
    if hw is not None and not (0 <= known.x_px <= hw[1] - 1 and 0 <= known.y_px <= hw[0] - 1):
        raise UsageError(
            f"--distance: the point {known.x_px:g},{known.y_px:g} lies outside the tele photo of {hw[1]} x {hw[0]} px",
            hint=f"x runs from 0 to {hw[1] - 1}, y from 0 to {hw[0] - 1}",
        )


@contextmanager
def results_folder(call: Call, options: DepthOptions) -> Iterator[None]:
    """Make the folder for the results, before anything is computed; it does not stay where nothing is written.

    Args:
        call: its run folder is the usual place.
        options: which may name another.

    Raises:
        UsageError: it cannot be made.
    """
    folder = options.out or call.folder.depth
    hint = f"name another folder with {_elsewhere(call, options)}"
    if is_there(folder) and not is_folder(folder):
        raise UsageError(f"{folder} is a file; a folder for the results was expected", hint=hint)
    with ExitStack() as made:
        try:
            made.enter_context(made_folder(folder))
        except OSError as error:
            raise UsageError(f"{folder} cannot be made: {error.strerror or error}", hint=hint) from error
        yield


def compute_depth(call: Call, prepared: PreparedSet, matcher: Matcher, *, options: DepthOptions) -> DepthRun:
    """Compute this process' share of the depths, reporting each; the writer then reports the others'.

    Args:
        call: run folder and observer.
        prepared: the pairs.
        matcher: what makes disparity of them.
        options: what was asked for.

    Returns:
        The results of all processes.

    Raises:
        InputError: none of the captures could be used.
    """
    processes, begun_s = call.processes, time.monotonic()
    window = _searched(call, prepared, matcher)
    call.observer.matching(len(prepared.pairs), method=options.method)
    mine: list[DepthOutcome | DepthFailure] = []
    with alone(processes, options.out or call.folder.depth, observer=call.observer):
        for item in processes.share(prepared.pairs):
            mine.append(_depth_of(item, call, prepared, matcher=matcher, window=window, options=options))
            _tell(call.observer, mine[-1])
        results = processes.gathered(tuple(mine))
    for index, result in enumerate(results):
        if processes.is_writer and index % processes.world != processes.rank:
            _tell(call.observer, result)
    outcomes = tuple(result for result in results if isinstance(result, DepthOutcome))
    failures = [result for result in results if isinstance(result, DepthFailure)]
    if not outcomes:
        raise failures[-1].of_all(call.captures.root, elsewhere=_elsewhere(call, options))
    n_kept = sum(outcome.is_kept for outcome in outcomes)
    if n_kept:
        same = "same photos, same weights, same options"
        call.observer.said(f"kept as they were: {n_kept} of {counted(len(outcomes), 'capture')}, {same}")
    n_reused = sum(outcome.is_depth_kept for outcome in outcomes)
    if n_reused:
        of_all = f"{n_reused} of {counted(len(outcomes), 'capture')}"
        call.observer.said(f"not matched again: {of_all}, same photos, same matcher; only files asked for were made")
    asked = {**asdict(options), "matcher": matcher.name}
    if options.trusts_focus:
        asked["trusts_focus"] = [item.capture.name for item in prepared.pairs if _stated_focus(item) is not None]
    record(call, prepared, command="depth", options=asked, timings={"depth": time.monotonic() - begun_s})
    problems = (*prepared.problems, *(failure.problem for failure in failures))
    return DepthRun(options.out or call.folder.depth, outcomes, problems, has_rig=call.rig is not None)


def _searched(call: Call, prepared: PreparedSet, matcher: Matcher) -> Window:
    """Return the disparities to search, and say them; a network that was trained for fewer is named."""
    window = prepared.window_with(matcher.window)
    call.observer.searching(window)
    if matcher.window is not None and joined_window((window, matcher.window)) != matcher.window:
        call.observer.said(
            f"searched at {window[0]} to {window[1]} px, as these captures need; the network was trained at "
            f"{matcher.window[0]} to {matcher.window[1]} px"
        )
    return window


def _depth_of(
    item: PreparedPair,
    call: Call,
    prepared: PreparedSet,
    *,
    matcher: Matcher,
    window: Window,
    options: DepthOptions,
) -> DepthOutcome | DepthFailure:
    """Match one pair, bring the result to the photo's own size and edges, and write it."""
    known = _stated_focus(item) if options.trusts_focus else options.known
    if options.trusts_focus and known is None:
        told = "EXIF states no distance of the focus (SubjectDistance), so none is used"
        call.observer.warned(f"{item.capture.name}: {told}")
    shot = shot_geometry(item, prepared, matcher=matcher, known=known)
    return depth_of_capture(
        item.source,
        item.held_out,
        (options.out or call.folder.depth) / item.capture.name,
        facts=prepared.facts.model_copy(update={"wide_side": item.wide_side}),
        match=matcher.match,
        window=window,
        bokeh=options.bokeh,
        key={
            **_depth_key(item, prepared, matcher, options=options, shot=shot),
            OF_SET: _of_set(prepared, window=window, shot=shot),
        },
        shot=shot,
        photos=call.photos,
        formats=options.formats,
        is_stripped=options.is_stripped,
    )


def _stated_focus(item: PreparedPair) -> KnownDistance | None:
    """Where EXIF says the tele lens was focused; None where it says nothing or infinity."""
    facts = read_photo_facts(item.source.tele_path)
    if facts.hw is None or facts.subject_distance_m is None or not math.isfinite(facts.subject_distance_m):
        return None
    return focused_at(facts.subject_distance_m, hw=facts.hw)


def shot_geometry(
    item: PreparedPair, prepared: PreparedSet, *, matcher: Matcher, known: KnownDistance | None = None
) -> ShotGeometry | None:
    """Sum up how a pair lies to its photos, and how precise its depths are; None where it was rectified when it came.

    Args:
        item: the pair.
        prepared: all pairs of its set, which show how far the lens moves.
        matcher: what makes its disparities.
        known: a point of known distance; None without.
    """
    if item.alignment is None or prepared.rig is None:
        return None
    aligned = [pair.alignment for pair in prepared.pairs if pair.alignment is not None]
    precision = shot_precision(item.alignment, of_set=aligned, rig=prepared.rig)
    precision = replace(precision, confidence_std=matcher.confidence_std)
    return ShotGeometry(item.alignment.geometry, precision, item.alignment.moved, known)


def _depth_key(
    item: PreparedPair,
    prepared: PreparedSet,
    matcher: Matcher,
    *,
    options: DepthOptions,
    shot: ShotGeometry | None,
) -> dict[str, object]:
    """Key of all that the files of one capture alone depend on; the pair's record names photos, facts, correction."""
    return {
        "version": metadata.version("telewide"),
        "pair_sha256": fingerprint(item.capture.tele_path.with_name(RECORD_NAME)),
        "matcher": matcher.name,
        "window_px": prepared.stated_window,
        "bokeh": None if options.bokeh is None else asdict(options.bokeh),
        "formats": options.formats,
        "is_stripped": options.is_stripped,
        "precision": _own_precision(item, prepared, shot),
        "known": None if shot is None or shot.known is None else asdict(shot.known),
    }


def _own_precision(item: PreparedPair, prepared: PreparedSet, shot: ShotGeometry | None) -> dict[str, object] | None:
    """Precision of a shot but for what other shots show of it: how far the lens moves."""
    if shot is None or item.alignment is None or prepared.rig is None:
        return None
    alone_px = shot_precision(item.alignment, of_set=(), rig=prepared.rig).lens_shift_std_px
    return asdict(replace(shot.precision, lens_shift_std_px=alone_px))


def _of_set(prepared: PreparedSet, *, window: Window, shot: ShotGeometry | None) -> dict[str, object]:
    """Facts for the depth of one capture that come from all of them."""
    shift_px = None if shot is None else shot.precision.lens_shift_std_px
    return of_set([pair.capture.name for pair in prepared.pairs], {"window": window, "lens_shift_std_px": shift_px})


def _tell(observer: Observer, result: DepthOutcome | DepthFailure) -> None:
    if isinstance(result, DepthOutcome):
        observer.depth_written(result)
    else:
        observer.depth_failed(result.problem)
