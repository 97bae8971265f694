"""The report page of a call."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from telewide.bokeh.picture import BokehOptions
from telewide.capture.pair import Capture
from telewide.capture.photo_store import PhotoStore
from telewide.geometry.arrays import FloatImage
from telewide.pages.report import NextStep, ReportRow
from telewide.pages.run_page import (
    CAPTURES_A_PAGE,
    PAGE_NAME,
    is_page,
    next_steps,
    report_row,
    steps_after_depth,
    write_run_page,
)
from telewide.stages.call import Call
from telewide.stages.depth import DepthRun
from telewide.stages.lying_depth import LyingDepth, depth_of_call, lying_depths, names_lying
from telewide.stages.provenance import facts_of_call, made_by, notes_of
from telewide.stages.training_result import read_result
from telewide.text import Invocation

_OF_ONE = {"preview": None, "distance": None}
"""Options of a call that are not for other captures."""
_OF_ITS_BOKEH = dict.fromkeys(
    ("bokeh", "focus", "f_number", "equiv_focal", "strength", "blades", "highlights", "picture")
)
"""Options that are not for captures of former calls, whose bokeh stays as it is."""


def report(call: Call, done: DepthRun, *, bokeh: BokehOptions | None = None) -> DepthRun:
    """Write the page about all captures of a training with its depths.

    Args:
        call: whose run folder the page lies in.
        done: the depths to show.
        bokeh: that was asked for; previews of depth that lay there leave the page as it is.

    Returns:
        The same depths, with the page's path where this process wrote it.
    """
    trained = read_result(call.folder)
    is_box = trained is not None and trained.is_box
    steps = partial(next_steps, call.folder.root, recipe=call.recipe, invocation=call.invocation, is_box=is_box)
    return _written(call, done, summary=call.recipe.description, steps=steps, bokeh=bokeh)


def report_depth(call: Call, done: DepthRun, *, bokeh: BokehOptions | None = None) -> DepthRun:
    """Write the page about depths that were asked for alone; as :func:`report`."""
    return _written(call, done, summary="", steps=partial(steps_after_depth, call.invocation), bokeh=bokeh)


def _written(
    call: Call, done: DepthRun, *, summary: str, steps: Callable[..., tuple[NextStep, ...]], bokeh: BokehOptions | None
) -> DepthRun:
    """Write the page beside the folder of the depths, or in it where its user named it; one process does."""
    if not call.processes.is_writer:
        return done
    root = call.folder.root if done.folder == call.folder.depth else done.folder
    if _is_trial(done, bokeh) and is_page(root / PAGE_NAME):
        return done
    trained = read_result(call.folder)
    others = _others(call, done)
    names = sorted([*(outcome.name for outcome in done.outcomes), *(other.capture.name for other in others)])
    page = write_run_page(
        root,
        _rows(call, done, others, root=root),
        names=names,
        log=call.folder.training_log,
        summary=summary,
        next_steps=steps(calls=_calls_on_one(call, names)),
        result="" if trained is None else f"Its result: {trained.told}.",
        facts=facts_of_call(call),
    )
    if page is None:
        call.observer.warned(f"{root / PAGE_NAME} is not a page of telewide's, so it is left as it is: no report")
    elif n_more := len(_names_of_others(done)) - len(others):
        shown = "what this call was given" + (f" and {len(others)} of former calls" if others else "")
        call.observer.said(f"{page} shows {shown}; {n_more} more lie in {done.folder}{_how_to_show_all(call)}")
    return replace(done, report=page)


def _is_trial(done: DepthRun, bokeh: BokehOptions | None) -> bool:
    """Whether a call made previews alone, of depth that lay there; no page shows them."""
    is_preview = bokeh is not None and bokeh.is_preview
    return is_preview and all(outcome.is_kept or outcome.is_depth_kept for outcome in done.outcomes)


def _names_of_others(done: DepthRun) -> frozenset[str]:
    """Names of captures of former calls whose depth lies beside that of this one."""
    return names_lying(done.folder).difference(outcome.name for outcome in done.outcomes)


def _others(call: Call, done: DepthRun) -> tuple[LyingDepth, ...]:
    """Depth of former calls that the page goes on to show; none where all would not fit on one page: they take time."""
    names = _names_of_others(done)
    if len(names) + len(done.outcomes) > CAPTURES_A_PAGE:
        return ()
    names = names.difference(problem.name for problem in done.problems if problem.is_skipped)
    return lying_depths(done.folder, names, pairs=call.folder.pairs, captures_root=call.captures.root)


def _how_to_show_all(call: Call) -> str:
    """Name the call on the whole folder, where this one was on a part of it."""
    if call.invocation.options.get("only"):
        return f"; to see all: {call.invocation.again(only=None, **_OF_ONE)}"
    if _is_on_its_folder(call):
        return f"; to see all: {call.invocation.instead(call.invocation.command, call.captures.root.parent, **_OF_ONE)}"
    return ""


def _is_on_its_folder(call: Call) -> bool:
    """Whether a call was on the folder of a capture, which lies among others."""
    captures = call.captures.captures
    return len(captures) == 1 and captures[0].name == call.captures.root.absolute().name


def _calls_on_one(call: Call, names: Sequence[str]) -> dict[str, Invocation]:
    """Tell by which calls each of some captures is made alone; none of a single one, which the call was on."""
    if len(names) < 2:
        return {}
    typed, is_alone = call.invocation, _is_on_its_folder(call)
    words = (call.captures.root.parent,) if is_alone else typed.words
    own = [capture.name for capture in call.captures.captures]

    def options(name: str) -> dict[str, object]:
        return {**typed.options, "only": name, **_OF_ONE, **({} if name in own else _OF_ITS_BOKEH)}

    calls = {name: replace(typed, words=words, options=options(name)) for name in names}
    if len(own) == 1:
        calls[own[0]] = typed
    return calls


def _rows(call: Call, done: DepthRun, others: Sequence[LyingDepth], *, root: Path) -> Iterator[ReportRow]:
    """Make the lines of a page one by one, by name: those of a call, and of depth that lies there."""
    captures = {capture.name: capture for capture in call.captures.captures}
    rotated_deg = 0 if call.rig is not None else call.captures.facts.rotated_deg  # a rig's photos are not turned
    made = [depth_of_call(captures[one.name], done.folder, rotated_deg=rotated_deg) for one in done.outcomes]
    for shown in sorted((*made, *others), key=lambda one: one.capture.name):
        name = shown.capture.name
        row = report_row(
            name,
            partial(_photo, shown.capture, call.photos if name in captures else PhotoStore(max_bytes=0)),
            done.folder / name,
            root=root,
            numbers=shown.numbers,
            rotated_deg=shown.rotated_deg,
            corrected=call.folder.pairs / name,
            bokeh_asked=shown.bokeh,
        )
        yield replace(
            row,
            notes=notes_of(name, depth=done.folder / name, pair=call.folder.pairs / name),
            made_by=made_by(done.folder / name, run_weights=call.folder.weights),
        )


def _photo(capture: Capture, photos: PhotoStore, view: str) -> FloatImage:
    """Read the photo of a view, tele or wide."""
    return photos.read(capture.tele_path if view == "tele" else capture.wide_path)
