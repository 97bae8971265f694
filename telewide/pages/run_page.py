"""The report page of a run: pictures of every capture, its numbers, the course of the training, and what to do next."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

from telewide.capture.images import read_image
from telewide.capture.pair import PhotoPair
from telewide.depth.formats.numpy_archive import NPZ_NAME, read_disparity
from telewide.depth.preview import disparity_panel, display_range_px
from telewide.depth.result import DepthResult
from telewide.drawing import upright
from telewide.errors import TelewideError
from telewide.files import is_file
from telewide.pages.curves import Curve
from telewide.pages.report import NextStep, Picture, ReportRow, thumbnail, thumbnail_wh, write_report
from telewide.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from telewide.text import Invocation, command_line
from telewide.training.log import LogLine, read_log
from telewide.training.stages import plan_stages

_log = logging.getLogger("telewide")


def report_row(
    pair: PhotoPair, folder: Path, *, root: Path, numbers: Mapping[str, float], rotated_deg: int = 0
) -> ReportRow:
    """The line of one capture: its photos, preview and bokeh, and its numbers.

    Args:
        pair: the two photos.
        folder: where its depth was written.
        root: folder of the report, which links lead from.
        numbers: as the pipeline gives them.
        rotated_deg: how far the photos were turned counter-clockwise; they are shown upright, as the results are.
    """
    views = (("wide", pair.wide), ("tele", pair.tele))
    pictures = [thumbnail(label, upright(photo, rotated_deg=rotated_deg)) for label, photo in views]
    try:
        pictures.append(_disparity_picture(folder, root))
    except TelewideError as error:
        _log.warning("%s; the report goes without its picture: remove it, and it is made again", error.message)
    bokeh = folder / "bokeh.jpg"
    if is_file(bokeh):
        pictures.append(thumbnail("bokeh", read_image(bokeh), link=_link(bokeh, root)))
    return ReportRow(pair.name, tuple(pictures), _table_line(numbers))


def write_run_page(
    root: Path, rows: Iterable[ReportRow], *, log: Path, recipe: Recipe, captures: Path, invocation: Invocation
) -> Path:
    """Write ``report.html`` of a run.

    Args:
        root: the run folder.
        rows: the captures.
        log: of the training; need not be there.
        recipe: it was trained with.
        captures: folder of the captures.
        invocation: the command that was typed, which the commands it names take up.

    Returns:
        Path of the page.
    """
    return write_report(
        root / "report.html",
        tuple(rows),
        title="Depth and bokeh from a wide and a tele lens",
        summary=recipe.description,
        curves=training_curves(log),
        next_steps=next_steps(root, recipe=recipe, invocation=invocation),
        facts={"telewide": metadata.version("telewide"), "captures": str(captures)},
    )


def next_steps(root: Path, *, recipe: Recipe, invocation: Invocation) -> tuple[NextStep, ...]:
    """Steps to take after a run, each with a command that can be pasted into a shell.

    Args:
        root: the run folder.
        recipe: it was trained with; a longer training is advised where the default recipe has more steps.
        invocation: the command that was typed.
    """
    steps = []
    if _training_steps(recipe) < _training_steps(load_recipe(DEFAULT_RECIPE)):
        longer = invocation.instead("run", out=f"{root}-{DEFAULT_RECIPE}", recipe=None, set=None)
        steps.append(NextStep("Train longer, for better depth:", longer))
    near = invocation.instead("depth", run=root, bokeh=True, focus="near")
    steps.append(NextStep("Focus on the nearest thing, or on a point of the tele photo (--focus 120,80):", near))
    own = command_line("run", "my-captures/")
    steps.append(NextStep("Your own photos, once telewide calibrate has made a rig of your lenses:", own))
    return tuple(steps)


def training_curves(log: Path) -> tuple[Curve, ...]:
    """Curves of the loss and of the judge, read from a training log; none where there is no log."""
    lines = read_log(log)
    starts = _stage_starts(lines)
    marks = [(float(start), name) for name, start in starts.items()]

    def curve(label: str, points: list[tuple[float, float]]) -> Curve:
        return Curve(label, [x for x, _ in points], [y for _, y in points], marks)

    losses = [
        (float(starts[line.stage] + line.step), sum(line.losses.values(), start=0.0)) for line in lines if line.losses
    ]
    answers = [
        (float(starts[line.stage] + line.step), 100 * line.judgement["off_1px"])
        for line in lines
        if "off_1px" in line.judgement
    ]
    named = (("loss", losses), ("held-out matches off by more than 1 px, %", answers))
    return tuple(curve(label, points) for label, points in named if points)


def _training_steps(recipe: Recipe) -> int:
    return sum(stage.options.steps for stage in plan_stages(recipe.train))


def _disparity_picture(folder: Path, root: Path) -> Picture:
    """The map alone, as large as the photos beside it; it leads to the preview with its scale."""
    disparity = read_disparity(folder / NPZ_NAME)
    height, width = disparity.disparity_px.shape
    result = DepthResult(name=folder.name, disparity=disparity)
    # Hatched at the size it is seen at: made smaller, thin lines vanish, and guesses look measured.
    panel = disparity_panel(result, wh=thumbnail_wh((width, height)))
    low_px, high_px = display_range_px(disparity.disparity_px, valid=disparity.valid)
    label = f"disparity, {round(low_px)} to {round(high_px)} px; hatched: filled in"
    return thumbnail(label, panel, link=_link(folder / "preview.png", root))


def _stage_starts(lines: Sequence[LogLine]) -> dict[str, int]:
    """First step of each stage, counted from the first stage's."""
    starts: dict[str, int] = {}
    begun, last = 0, 0
    for line in lines:
        if line.stage not in starts:
            begun = begun + last if starts else 0
            starts[line.stage] = begun
        last = line.step
    return starts


def _table_line(numbers: Mapping[str, float]) -> dict[str, float | None]:
    headings = {
        "off_1px": ("matches off by > 1 px of the matched size, %", 100.0),
        "off_3px": ("> 3 px, %", 100.0),
        "matches": ("held-out matches", 1.0),
        "3PE": ("3PE, %", 100.0),
        "EPE_px": ("EPE, px of the photo", 1.0),
        "match_s": ("matching, s", 1.0),
    }
    line: dict[str, float | None] = {
        heading: numbers[name] * factor if math.isfinite(numbers[name]) else None
        for name, (heading, factor) in headings.items()
        if name in numbers
    }
    if "matches" in numbers:
        line["held-out matches"] = int(numbers["matches"])
    return line


def _link(path: Path, root: Path) -> str | None:
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else None
