"""The page that shows a run: pictures, numbers, the training curve and what to do next.

Pictures are small JPEGs inside the page; each may link to the full file beside it.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from telewide.drawing import fitted_wh, scaled_image
from telewide.geometry.arrays import FloatMap
from telewide.pages.curves import Curve, curve_svg
from telewide.pages.numbers import Number, number_text
from telewide.pages.page import write_page
from telewide.text import with_options

_THUMBNAIL_QUALITY = 82


@dataclass(frozen=True)
class Picture:
    """A thumbnail, already a JPEG, so that a long report needs little memory.

    Attributes:
        label: what it shows.
        jpeg: the file's bytes.
        wh: its size, px.
        link: path of the full picture relative to the report, or None.
    """

    label: str
    jpeg: bytes
    wh: tuple[int, int]
    link: str | None = None


@dataclass(frozen=True)
class ReportRow:
    """One capture in the report.

    Attributes:
        name: of the capture.
        pictures: in the order they are shown, such as tele, wide, disparity, bokeh.
        numbers: its line in the table: heading, unit included, to value; None where there is none.
        viewed: what the viewer shows of it, as `telewide.pages.viewed` gathers it; None where it cannot be looked at.
        notes: sentences about it, doubts first; they name options as messages do.
        made_by: a sentence on what made its depth.
    """

    name: str
    pictures: tuple[Picture, ...] = ()
    numbers: Mapping[str, Number] = field(default_factory=dict)
    viewed: Mapping[str, object] | None = None
    notes: Sequence[str] = ()
    made_by: str = ""

    @property
    def photo(self) -> Picture:
        """The picture of tele, which the viewer opens; the first where none is called so."""
        return next((picture for picture in self.pictures if picture.label == "tele"), self.pictures[0])

    @property
    def is_upright(self) -> bool:
        """Whether its first picture is taller than wide."""
        return self.pictures[0].wh[1] > self.pictures[0].wh[0]


@dataclass(frozen=True)
class PageLink:
    """One of several pages of a report.

    Attributes:
        name: what it shows.
        link: its file, relative to the others.
        is_this: whether it is the page that shows the link.
    """

    name: str
    link: str
    is_this: bool


@dataclass(frozen=True)
class CaptureLink:
    """A capture in the index of all.

    Attributes:
        name: of the capture.
        file: of the page that shows it; empty for the page that shows the link.
    """

    name: str
    file: str = ""


@dataclass(frozen=True)
class NextStep:
    """Something worth doing now.

    Attributes:
        text: a sentence.
        command: what does it.
        by_capture: what does it for one capture alone, by its name; the page shows it beside that capture.
    """

    text: str
    command: str
    by_capture: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Scene:
    name: str
    thumbnail: Picture
    content: Mapping[str, object]


@dataclass(frozen=True)
class _Table:
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    foot: Sequence[str] | None


def thumbnail(label: str, image: FloatMap, *, longest_px: int = 480, link: str | None = None) -> Picture:
    """Make a small JPEG of an image.

    Args:
        label: what it shows.
        image: (H, W, 3) RGB in [0, 1].
        longest_px: longest side; a smaller image stays as it is.
        link: path of the full picture relative to the report.

    Returns:
        The picture.
    """
    wh = thumbnail_wh((image.shape[1], image.shape[0]), longest_px=longest_px)
    small = np.clip(np.nan_to_num(scaled_image(image, wh=wh)), 0, 1)
    bgr = np.ascontiguousarray(np.round(small * 255).astype(np.uint8)[..., ::-1])
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _THUMBNAIL_QUALITY])
    return Picture(label=label, jpeg=encoded.tobytes(), wh=wh, link=link)


def thumbnail_wh(wh: tuple[int, int], *, longest_px: int = 480) -> tuple[int, int]:
    """Tell the size of the thumbnail of an image of a size."""
    box_side = min(longest_px, max(wh))
    return fitted_wh(wh, box_wh=(box_side, box_side))


def write_report(
    path: Path,
    rows: Sequence[ReportRow],
    *,
    title: str,
    summary: str = "",
    curves: Sequence[Curve] = (),
    result: str = "",
    next_steps: Sequence[NextStep] = (),
    facts: Mapping[str, str] | None = None,
    others: Sequence[PageLink] = (),
    index: Sequence[CaptureLink] = (),
) -> Path:
    """Write the report as one HTML file.

    Args:
        path: of the file.
        rows: the captures.
        title: heading and name of the page.
        summary: a sentence or two below it.
        curves: of the training, each drawn on its own.
        result: a sentence on what the training led to.
        next_steps: what to do now.
        facts: where the page comes from: version, command, fingerprints.
        others: all pages of the report, where there are several.
        index: all captures, where they are many.

    Returns:
        The path.
    """
    return write_page(
        path,
        "run.html.j2",
        title=title,
        summary=summary,
        rows=rows,
        scenes=[_Scene(row.name, row.photo, _told(row, next_steps)) for row in rows if row.viewed is not None],
        others=others,
        index=index,
        table=_table(rows),
        curves=[curve_svg(curve) for curve in curves],
        result=result,
        next_steps=next_steps,
        facts=facts or {},
    )


def _told(row: ReportRow, next_steps: Sequence[NextStep]) -> dict[str, object]:
    return {
        **(row.viewed or {}),
        "notes": [with_options(note) for note in row.notes],
        "madeBy": row.made_by,
        "next": [step.by_capture.get(row.name, step.command) for step in next_steps],
    }


def _table(rows: Sequence[ReportRow]) -> _Table | None:
    """The numbers of all captures, with their medians; None where there are none."""
    headings = list(dict.fromkeys(heading for row in rows for heading in row.numbers))
    if not headings:
        return None
    body = [[row.name, *(number_text(row.numbers.get(heading)) for heading in headings)] for row in rows]
    medians = [_median([row.numbers.get(heading) for row in rows]) for heading in headings]
    has_foot = len(rows) > 1 and any(median is not None for median in medians)
    foot = ["median", *("" if median is None else number_text(median) for median in medians)] if has_foot else None
    return _Table(["capture", *headings], body, foot)


def _median(values: Sequence[Number]) -> float | None:
    known = [float(value) for value in values if isinstance(value, int | float) and math.isfinite(value)]
    return statistics.median(known) if known else None
