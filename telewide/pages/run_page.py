"""The report page of a run: pictures of every capture, its numbers, the course of the training, and what to do next."""

from __future__ import annotations

import itertools
import logging
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

from telewide.bokeh.focus import Focus
from telewide.bokeh.picture import BokehOptions
from telewide.capture.images import read_image
from telewide.depth.formats.numpy_archive import NPZ_NAME, read_disparity
from telewide.depth.preview import disparity_panel, display_range_px
from telewide.depth.result import DepthResult
from telewide.drawing import upright
from telewide.errors import InputError, TelewideError
from telewide.files import is_file, read_regular
from telewide.geometry.arrays import FloatImage
from telewide.geometry.stereo import DisparityMap
from telewide.npz import read_npz
from telewide.pages.curves import Curve
from telewide.pages.report import (
    CaptureLink,
    NextStep,
    PageLink,
    Picture,
    ReportRow,
    thumbnail,
    thumbnail_wh,
    write_report,
)
from telewide.pages.viewed import DEFAULT_LIGHTS, Metric, Opening, framed, shown_wh, viewed_capture
from telewide.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from telewide.text import Invocation, command_line
from telewide.training.log import LogLine, read_log
from telewide.training.stages import plan_stages

_log = logging.getLogger("telewide")
CAPTURES_A_PAGE = 12
MOST_WITHOUT_INDEX = 8
"""Captures that the strip shows side by side on a screen; of more there is a list."""
PAGE_NAME = "report.html"
BOKEH_NAME = "bokeh.jpg"
_POLICY = b"default-src 'none'; img-src data:"  # stands in the head of every page of any version
_HEAD_BYTES = 1024
_MOST_PAGE_BYTES = 1 << 28


def report_row(
    name: str,
    read: Callable[[str], FloatImage],
    folder: Path,
    *,
    root: Path,
    numbers: Mapping[str, float],
    rotated_deg: int = 0,
    corrected: Path | None = None,
    bokeh_asked: BokehOptions | None = None,
) -> ReportRow:
    """The line of one capture: its photos, preview and bokeh, its numbers, and what a person can look at closely.

    Args:
        name: of the capture.
        read: reads the photo of a view, tele or wide; one is let go before the next, as they are large.
        folder: where its depth was written.
        root: folder of the report, which links lead from.
        numbers: as the pipeline gives them.
        rotated_deg: how far the photos were turned counter-clockwise; they are shown upright, as the results are.
        corrected: folder with the corrected pair; None where there is none.
        bokeh_asked: what the page opens with; None where none was asked for.
    """
    tele = upright(read("tele"), rotated_deg=rotated_deg)
    tele_hw, wh = tele.shape[:2], shown_wh((tele.shape[1], tele.shape[0]))
    of_tele, tele = _seen("tele", tele, wh=wh)
    of_wide, wide = _seen("wide", upright(read("wide"), rotated_deg=rotated_deg), wh=wh)
    pictures, last, others, viewed = [of_wide, of_tele], [], {"wide": wide}, None
    bokeh = folder / BOKEH_NAME
    if is_file(bokeh):
        of_bokeh, others["bokeh"] = _seen("bokeh", read_image(bokeh), wh=wh, link=_link(bokeh, root))
        last.append(of_bokeh)
    try:
        disparity = read_disparity(folder / NPZ_NAME)
        pictures.append(_disparity_picture(disparity, folder, root))
        others |= {} if corrected is None else _corrected_pictures(corrected, rotated_deg=rotated_deg)
        if disparity.disparity_px.shape == tele_hw and np.isfinite(disparity.disparity_px).any():
            metric, opening = _metric_of(folder / NPZ_NAME), _opening_of(bokeh_asked, numbers)
            viewed = viewed_capture(tele, disparity, others=others, metric=metric, name=name, opening=opening)
    except TelewideError as error:
        _log.warning("%s; the report goes without its picture: remove it, and it is made again", error.message)
    return ReportRow(name, (*pictures, *last), _table_line(numbers), viewed)


def _seen(
    label: str, picture: FloatImage, *, wh: tuple[int, int], link: str | None = None
) -> tuple[Picture, FloatImage]:
    """A picture as small as it is listed, and as it fills the frame in which a capture is looked at."""
    return thumbnail(label, picture, link=link), framed(picture, wh=wh)


def _opening_of(asked: BokehOptions | None, numbers: Mapping[str, float]) -> Opening | None:
    """Return what the page opens with: the bokeh that was made, as its numbers tell; None where there is none."""
    if asked is None or not {"focus_px", "focus_x_px", "focus_y_px", "blur_per_px"} <= numbers.keys():
        return None
    x_px, y_px = (round(numbers[f"focus_{axis}_px"]) for axis in "xy")
    sharp_px = (numbers["sharp_far_px"], numbers["sharp_near_px"]) if "sharp_far_px" in numbers else None
    return Opening(
        Focus(numbers["focus_px"], x_px, y_px, sharp_px=sharp_px),
        numbers["blur_per_px"],
        f_number=asked.f_number,
        aperture=asked.aperture,
        lights=asked.highlights or DEFAULT_LIGHTS,
    )


def _metric_of(npz: Path) -> Metric | None:
    try:
        K, baseline_m, doffs_px, _ = read_npz(npz, ("K", "baseline_m", "doffs_px", "depth_m"))
    except InputError:  # it lacks them: metres are not known
        return None
    return Metric(float(K[0, 0]) * float(baseline_m), float(doffs_px), float(baseline_m))


def _corrected_pictures(folder: Path, *, rotated_deg: int) -> dict[str, FloatImage]:
    """The corrected views, grey where their photos do not reach."""
    pictures = {}
    for view in ("tele", "wide"):
        if not is_file(folder / f"{view}.png"):
            continue
        picture = read_image(folder / f"{view}.png")
        valid = folder / f"{view}_valid.png"
        if is_file(valid) and (mask := read_image(valid)).shape == picture.shape:
            picture = np.where(mask > 0.5, picture, np.float32(0.5))
        pictures[f"{view}, corrected"] = upright(picture, rotated_deg=rotated_deg)
    return pictures


def write_run_page(
    root: Path,
    rows: Iterable[ReportRow],
    *,
    names: Sequence[str],
    log: Path,
    summary: str,
    next_steps: Sequence[NextStep],
    facts: Mapping[str, str],
    result: str = "",
) -> Path | None:
    """Write ``report.html`` of a run, and ``report-2.html`` and so on where it shows more than a dozen captures.

    Args:
        root: the run folder.
        rows: the captures, one after the other.
        names: of all of them.
        log: of the training; need not be there.
        summary: a sentence or two.
        next_steps: what to do now.
        facts: where the results come from.
        result: a sentence on what the training led to.

    Returns:
        Path of the first page; None where a file of somebody else's lies there.
    """
    starts = range(0, max(len(names), 1), CAPTURES_A_PAGE)
    files = [root / (f"report-{at + 1}.html" if at else PAGE_NAME) for at in range(len(starts))]
    if any(not is_own_page(file) for file in files):
        return None
    known = iter(rows)
    shown = [names[start : start + CAPTURES_A_PAGE] for start in starts]
    for at, start in enumerate(starts):
        write_report(
            files[at],
            tuple(itertools.islice(known, CAPTURES_A_PAGE)),
            title="Depth and bokeh from a wide and a tele lens",
            summary=summary,
            curves=training_curves(log) if start == 0 else (),
            result=result if start == 0 else "",
            next_steps=next_steps,
            facts={"telewide": metadata.version("telewide"), **facts},
            others=_pages(shown, files, page=files[at]) if len(files) > 1 else (),
            index=_index(shown, files, page=files[at]) if len(names) > MOST_WITHOUT_INDEX else (),
        )
    return files[0]


def _pages(shown: Sequence[Sequence[str]], files: Sequence[Path], *, page: Path) -> list[PageLink]:
    """Links of one page to all, by the captures on them."""
    return [
        PageLink(f"{names[0]} to {names[-1]}", file.name, file == page)
        for names, file in zip(shown, files, strict=True)
    ]


def _index(shown: Sequence[Sequence[str]], files: Sequence[Path], *, page: Path) -> list[CaptureLink]:
    """Links of one page to the captures of all."""
    return [
        CaptureLink(name, "" if file == page else file.name)
        for names, file in zip(shown, files, strict=True)
        for name in names
    ]


def is_own_page(path: Path) -> bool:
    """Whether nothing lies there, or a page that telewide wrote."""
    return not os.path.lexists(path) or is_page(path)


def is_page(path: Path) -> bool:
    """Whether a page that telewide wrote lies there."""
    try:
        return _POLICY in read_regular(path, most_bytes=_MOST_PAGE_BYTES)[:_HEAD_BYTES]
    except TelewideError:
        return False


def steps_after_depth(invocation: Invocation, *, calls: Mapping[str, Invocation]) -> tuple[NextStep, ...]:
    """Steps to take after depth alone.

    Args:
        invocation: the command that was typed.
        calls: the same on one capture, by its name.
    """

    def near(call: Invocation) -> str:
        return call.again(bokeh=True, focus="near")

    def files(call: Invocation) -> str:
        return call.again(format="all")

    focus = "Bokeh as a file, focused on the nearest thing or on a point (--focus 120,80):"
    return _step(focus, near, invocation, calls), _step("Depth for other programs:", files, invocation, calls)


def next_steps(
    root: Path,
    *,
    recipe: Recipe,
    invocation: Invocation,
    calls: Mapping[str, Invocation],
    is_box: bool = False,
) -> tuple[NextStep, ...]:
    """Steps to take after a run, each with a command that can be pasted into a shell.

    Args:
        root: the run folder.
        recipe: it was trained with; a longer training is advised where the default recipe has more steps.
        invocation: the command that was typed.
        calls: the same on one capture, by its name.
        is_box: whether the training has made nothing better than the network that comes with telewide.
    """

    def near(call: Invocation) -> str:
        return call.instead("depth", run=root, only=call.options.get("only"), bokeh=True, focus="near")

    steps = []
    if _training_steps(recipe) < _training_steps(load_recipe(DEFAULT_RECIPE)):
        longer = invocation.instead("run", out=f"{root}-{DEFAULT_RECIPE}", recipe=None, set=None)
        more = "; so may more captures" if is_box else ""
        steps.append(NextStep(f"Train longer, which may help{more}:", longer))
    focus = "Focus on the nearest thing, or on a point of the tele photo (--focus 120,80):"
    steps.append(_step(focus, near, invocation, calls))
    own = command_line("run", "my-captures/")
    steps.append(NextStep("Your own photos, once telewide calibrate has made a rig of your lenses:", own))
    return tuple(steps)


def _step(
    text: str, command: Callable[[Invocation], str], typed: Invocation, calls: Mapping[str, Invocation]
) -> NextStep:
    return NextStep(text, command(typed), {name: command(call) for name, call in calls.items()})


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

    def answers(name: str, *, times: float) -> list[tuple[float, float]]:
        judged = [line for line in lines if name in line.judgement]
        return [(float(starts[line.stage] + line.step), times * line.judgement[name]) for line in judged]

    named = (
        ("loss", losses),
        ("judged, px off: this decides which weights are kept", answers("clipped_px", times=1)),
        ("held-out matches off by more than 1 px, %", answers("off_1px", times=100)),
    )
    return tuple(curve(label, points) for label, points in named if points)


def _training_steps(recipe: Recipe) -> int:
    return sum(stage.options.steps for stage in plan_stages(recipe.train))


def _disparity_picture(disparity: DisparityMap, folder: Path, root: Path) -> Picture:
    """The map alone, as large as the photos beside it; it leads to the preview with its scale."""
    height, width = disparity.disparity_px.shape
    # Hatched at the size it is seen at: made smaller, thin lines vanish, and guesses look measured.
    panel = disparity_panel(DepthResult(name=folder.name, disparity=disparity), wh=thumbnail_wh((width, height)))
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
