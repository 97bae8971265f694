"""The report page of a call."""

from __future__ import annotations

from dataclasses import replace

from telewide.capture.pair import read_photos
from telewide.pages.run_page import report_row, write_run_page
from telewide.stages.call import Call
from telewide.stages.depth import DepthRun


def report(call: Call, done: DepthRun) -> DepthRun:
    """Write the page about all captures of a call; one of several processes writes it.

    Args:
        call: whose run folder the page lies in.
        done: the depths to show.

    Returns:
        The same depths, with the page's path where this process wrote it.
    """
    if not call.processes.is_writer:
        return done
    captures = {capture.name: capture for capture in call.captures.captures}
    rows = (
        report_row(
            read_photos(captures[outcome.name], read=call.photos.read),
            done.folder / outcome.name,
            root=call.folder.root,
            numbers=outcome.numbers,
            rotated_deg=0 if call.rig is not None else call.captures.facts.rotated_deg,  # a rig's photos are not turned
        )
        for outcome in done.outcomes
    )
    page = write_run_page(
        call.folder.root,
        rows,
        log=call.folder.training_log,
        recipe=call.recipe,
        captures=call.captures.root,
        invocation=call.invocation,
    )
    return replace(done, report=page)
