"""The report page of a call."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from telewide.bokeh.picture import BokehOptions
from telewide.capture.pair import read_photos
from telewide.pages.report import NextStep, ReportRow
from telewide.pages.run_page import PAGE_NAME, is_page, next_steps, report_row, steps_after_depth, write_run_page
from telewide.stages.call import Call
from telewide.stages.depth import DepthRun
from telewide.stages.kept_depth import KEPT_NAME
from telewide.stages.training_result import read_result


def report(call: Call, done: DepthRun, *, bokeh: BokehOptions | None = None) -> DepthRun:
    """Write the page about all captures of a training with its depths.

    Args:
        call: whose run folder the page lies in.
        done: the depths to show.
        bokeh: that was asked for, which the page opens with; None where none was.

    Returns:
        The same depths, with the page's path where this process wrote it.
    """
    trained = read_result(call.folder)
    is_box = trained is not None and trained.is_box
    steps = next_steps(call.folder.root, recipe=call.recipe, invocation=call.invocation, is_box=is_box)
    return _written(call, done, summary=call.recipe.description, steps=steps, bokeh=bokeh)


def report_depth(call: Call, done: DepthRun, *, bokeh: BokehOptions | None = None) -> DepthRun:
    """Write the page about depths that were asked for alone; as :func:`report`."""
    return _written(call, done, summary="", steps=steps_after_depth(call.invocation), bokeh=bokeh)


def _written(
    call: Call, done: DepthRun, *, summary: str, steps: tuple[NextStep, ...], bokeh: BokehOptions | None
) -> DepthRun:
    """Write the page beside the folder of the depths, or in it where its user named it; one process does."""
    if not call.processes.is_writer:
        return done
    root = call.folder.root if done.folder == call.folder.depth else done.folder
    if _is_trial(done, bokeh) and is_page(root / PAGE_NAME):
        return done
    trained = read_result(call.folder)
    page = write_run_page(
        root,
        _rows(call, done, root=root, bokeh=bokeh),
        names=[outcome.name for outcome in done.outcomes],
        log=call.folder.training_log,
        summary=summary,
        next_steps=steps,
        result="" if trained is None else f"Its result: {trained.told}.",
        facts={"captures": str(call.captures.root), "command": call.invocation.again()},
    )
    if page is None:
        call.observer.warned(f"{root / PAGE_NAME} is not a page of telewide's, so it is left as it is: no report")
    elif others := _others(done):
        call.observer.said(f"{page} shows what this call was given; {others} more lie in {done.folder}")
    return replace(done, report=page)


def _is_trial(done: DepthRun, bokeh: BokehOptions | None) -> bool:
    """Whether a call made previews alone, of depth that lay there; no page shows them."""
    is_preview = bokeh is not None and bokeh.is_preview
    return is_preview and all(outcome.is_kept or outcome.is_depth_kept for outcome in done.outcomes)


def _others(done: DepthRun) -> int:
    """Count captures of former calls whose depth lies beside that of this one."""
    names = {outcome.name for outcome in done.outcomes}
    return sum(record.parent.name not in names for record in done.folder.glob(f"*/{KEPT_NAME}"))


def _rows(call: Call, done: DepthRun, *, root: Path, bokeh: BokehOptions | None) -> Iterator[ReportRow]:
    captures = {capture.name: capture for capture in call.captures.captures}
    for outcome in done.outcomes:
        yield report_row(
            read_photos(captures[outcome.name], read=call.photos.read),
            done.folder / outcome.name,
            root=root,
            numbers=outcome.numbers,
            rotated_deg=0 if call.rig is not None else call.captures.facts.rotated_deg,  # a rig's photos are not turned
            corrected=call.folder.pairs / outcome.name,
            bokeh_asked=bokeh,
        )
