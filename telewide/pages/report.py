"""One HTML page that shows a run: pictures, numbers, the training curve and what to do next.

A single file without scripts: it opens from a disk or a mail, offline, in the reader's dark or light colours. Pictures
are small JPEGs inside the page; each may link to the full file beside it.
"""

from __future__ import annotations

import base64
import html
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np

from telewide.drawing import fitted_wh, number_labels, rounded_ticks, scaled_image
from telewide.files import write_text
from telewide.geometry.arrays import FloatMap

Number = float | int | str | None

_CONTENT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_THUMBNAIL_QUALITY = 82
_CURVE_WH = (640, 240)
_CURVE_MARGINS = (58, 22, 12, 30)  # left, top, right, bottom
_CURVE_POINTS = 300  # more would not be seen at this width
_SPIKE = 1.5  # a value that stands so many times higher than all others does not set the scale

_STYLE = """
:root { color-scheme: light dark;
  --ink: #1c1c1e; --faint: #6b6b70; --ground: #fbfbfa; --line: #dcdcd8; --curve: #b4470f; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #ececec; --faint: #9d9da2; --ground: #161618; --line: #343438; --curve: #ff9a5c; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1560px; padding: 24px 20px 48px; background: var(--ground); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p { margin: .3rem 0; max-width: 75ch; } .faint, figcaption, dt { color: var(--faint); }
.captures { display: flex; flex-wrap: wrap; gap: 20px; }
.capture { flex: 1 1 100%; } .capture.tall { flex: 0 1 690px; } .capture h3 { font-size: 1rem; margin: 0 0 .3rem; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 200px), 1fr)); gap: 8px; }
.tall .pictures { grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); }
figure { margin: 0; } figcaption { font-size: .82rem; } img { display: block; width: 100%; height: auto; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; }
th, td { padding: .28rem .9rem .28rem 0; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } thead th, tfoot th { font-weight: 600; }
.curves { display: flex; flex-wrap: wrap; gap: 20px; } .curves figure { flex: 1 1 420px; max-width: 700px; }
svg { width: 100%; height: auto; display: block; }
svg text { fill: var(--faint); font: 12px system-ui, sans-serif; } svg .grid { stroke: var(--line); }
svg .curve { fill: none; stroke: var(--curve); stroke-width: 1.8; stroke-linejoin: round; }
svg .stage { stroke: var(--faint); stroke-dasharray: 3 4; }
pre { margin: .2rem 0 .9rem; padding: .6rem .8rem; overflow-x: auto;
  border: 1px solid var(--line); border-radius: 6px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; font-size: .9rem; } dd { margin: 0;
  overflow-wrap: anywhere; }
@media print { body { max-width: none; } .capture { break-inside: avoid; } }
"""


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
    """

    name: str
    pictures: tuple[Picture, ...] = ()
    numbers: Mapping[str, Number] = field(default_factory=dict)


@dataclass(frozen=True)
class Curve:
    """A quantity over the steps of a training.

    Attributes:
        label: what it is, with its unit.
        steps: ascending.
        values: as many; values that are not finite are left out.
        stages: first step and name of each stage, drawn as upright lines.
    """

    label: str
    steps: Sequence[float]
    values: Sequence[float]
    stages: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True)
class NextStep:
    """Something worth doing now: a sentence, and the command that does it."""

    text: str
    command: str


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
    next_steps: Sequence[NextStep] = (),
    facts: Mapping[str, str] | None = None,
) -> Path:
    """Write the report as one HTML file.

    Args:
        path: of the file.
        rows: the captures.
        title: heading and name of the page.
        summary: a sentence or two below it.
        curves: of the training, each drawn on its own.
        next_steps: what to do now.
        facts: where the page comes from: version, command, fingerprints.

    Returns:
        The path.
    """
    write_text(
        path, report_html(rows, title=title, summary=summary, curves=curves, next_steps=next_steps, facts=facts or {})
    )
    return path


def report_html(
    rows: Sequence[ReportRow],
    *,
    title: str,
    summary: str,
    curves: Sequence[Curve],
    next_steps: Sequence[NextStep],
    facts: Mapping[str, str],
) -> str:
    """Compose the page of :func:`write_report`; every word given is escaped."""
    sections = [
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{html.escape(summary)}</p>" if summary else "",
        section_html("Pictures", "".join(_capture_html(row) for row in rows if row.pictures), css_class="captures"),
        section_html("Numbers", _table_html(rows)),
        section_html("Training", "".join(curve_svg(curve) for curve in curves), css_class="curves"),
        section_html("What next", "".join(next_step_html(step) for step in next_steps)),
        section_html("Made by", facts_html(facts)),
    ]
    return page_html(title, sections)


def page_html(title: str, sections: Sequence[str], *, extra_style: str = "") -> str:
    """Compose one page that opens offline: no script, nothing fetched, the reader's dark or light colours.

    Args:
        title: name of the page; escaped here.
        sections: HTML, one below the other; empty ones are left out.
        extra_style: further CSS.

    Returns:
        The file's text.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_CONTENT_POLICY}">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}{extra_style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )


def curve_svg(curve: Curve) -> str:
    """Draw a curve as inline SVG in the page's own colours.

    Args:
        curve: at least two finite values, else nothing is drawn.

    Returns:
        A figure element, or an empty string.
    """
    points = [
        (float(step), float(value))
        for step, value in zip(curve.steps, curve.values, strict=True)
        if math.isfinite(step) and math.isfinite(value)
    ]
    if len(points) < 2 or points[0][0] >= points[-1][0]:
        return ""
    x_range = points[0][0], points[-1][0]
    points = _thinned(points)
    y_range = _shown_range([value for _, value in points])
    path = " ".join(_point_text(point, x_range=x_range, y_range=y_range) for point in points)
    label = html.escape(curve.label)
    parts = [
        *_grid_svg(x_range, y_range),
        *_stages_svg(curve.stages, x_range=x_range, y_range=y_range),
        f'<polyline class="curve" points="{path}"/>',
    ]
    width, height = _CURVE_WH
    caption = f"{label}: {number_text(points[-1][1])} at step {points[-1][0]:.10g}"
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def section_html(heading: str, content: str, *, css_class: str = "") -> str:
    """A heading with HTML below it, in a box of a class if one is given; nothing where there is no content."""
    if not content:
        return ""
    inner = f'<div class="{css_class}">{content}</div>' if css_class else content
    return f"<section>\n<h2>{heading}</h2>\n{inner}\n</section>"


def _capture_html(row: ReportRow) -> str:
    is_tall = row.pictures[0].wh[1] > row.pictures[0].wh[0]
    figures = "".join(picture_html(picture, row.name) for picture in row.pictures)
    shape = "capture tall" if is_tall else "capture"
    return f'<div class="{shape}"><h3>{html.escape(row.name)}</h3><div class="pictures">{figures}</div></div>\n'


def picture_html(picture: Picture, name: str) -> str:
    """A figure with its caption; the name is what the picture is of."""
    data = base64.b64encode(picture.jpeg).decode("ascii")
    label = html.escape(picture.label)
    shown = (
        f'<img src="data:image/jpeg;base64,{data}" width="{picture.wh[0]}" height="{picture.wh[1]}" '
        f'alt="{label} of {html.escape(name)}">'
    )
    if picture.link is not None:
        shown = f'<a href="{html.escape(quote(picture.link))}">{shown}</a>'
    return f"<figure>{shown}<figcaption>{label}</figcaption></figure>"


def _table_html(rows: Sequence[ReportRow]) -> str:
    headings = list(dict.fromkeys(heading for row in rows for heading in row.numbers))
    if not headings:
        return ""
    head = "".join(f'<th scope="col">{html.escape(heading)}</th>' for heading in ("capture", *headings))
    body = "".join(
        f'<tr><th scope="row">{html.escape(row.name)}</th>'
        + "".join(f"<td>{number_text(row.numbers.get(heading))}</td>" for heading in headings)
        + "</tr>\n"
        for row in rows
    )
    medians = [_median([row.numbers.get(heading) for row in rows]) for heading in headings]
    foot = ""
    if len(rows) > 1 and any(median is not None for median in medians):
        cells = "".join(f"<td>{'' if median is None else number_text(median)}</td>" for median in medians)
        foot = f'<tfoot><tr><th scope="row">median</th>{cells}</tr></tfoot>'
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody>\n{foot}</table></div>'


def _median(values: Sequence[Number]) -> float | None:
    known = [float(value) for value in values if isinstance(value, int | float) and math.isfinite(value)]
    return statistics.median(known) if known else None


def number_text(value: Number) -> str:
    """Three figures are what such measurements carry; whole numbers stay whole."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, str):
        return html.escape(value)
    if isinstance(value, int) or math.isinf(value) or abs(value) >= 1000:
        return f"{value:.0f}"
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.2e}"
    decimals = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:.{min(decimals, 4)}f}"


def next_step_html(step: NextStep) -> str:
    """A sentence and its command."""
    return f"<p>{html.escape(step.text)}</p><pre><code>{html.escape(step.command)}</code></pre>"


def facts_html(facts: Mapping[str, str]) -> str:
    """Words and their values, one below the other."""
    if not facts:
        return ""
    lines = "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(value)}</dd>" for key, value in facts.items())
    return f"<dl>{lines}</dl>"


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Average neighbouring points where there are more than can be seen; the last one stays what it is."""
    size = -(-len(points) // _CURVE_POINTS)
    if size == 1:
        return list(points)
    groups = [points[start : start + size] for start in range(0, len(points) - 1, size)]
    means = [(statistics.fmean(x for x, _ in group), statistics.fmean(y for _, y in group)) for group in groups]
    return [*means, points[-1]]


def _shown_range(values: Sequence[float]) -> tuple[float, float]:
    """Lowest to highest value but for a few spikes, such as the first steps of a training, and a margin."""
    falling = sorted(values, reverse=True)
    low, n_spikes = falling[-1], 0
    for n in range(1 + len(values) // 100):
        if n + 2 < len(values) and falling[n] - low > _SPIKE * (falling[n + 1] - low):
            n_spikes = n + 1
    high = falling[n_spikes]
    margin = (high - low) * 0.05 or abs(low) * 0.05 or 1.0
    return low - margin, high + margin


def _place(value: float, value_range: tuple[float, float], *, start: float, end: float) -> float:
    share = (value - value_range[0]) / (value_range[1] - value_range[0])
    return start + min(max(share, 0.0), 1.0) * (end - start)


def _x_px(value: float, x_range: tuple[float, float]) -> float:
    return _place(value, x_range, start=_CURVE_MARGINS[0], end=_CURVE_WH[0] - _CURVE_MARGINS[2])


def _y_px(value: float, y_range: tuple[float, float]) -> float:
    return _place(value, y_range, start=_CURVE_WH[1] - _CURVE_MARGINS[3], end=_CURVE_MARGINS[1])


def _point_text(point: tuple[float, float], *, x_range: tuple[float, float], y_range: tuple[float, float]) -> str:
    return f"{_x_px(point[0], x_range):.1f},{_y_px(point[1], y_range):.1f}"


def _grid_svg(x_range: tuple[float, float], y_range: tuple[float, float]) -> list[str]:
    left, right = _CURVE_MARGINS[0], _CURVE_WH[0] - _CURVE_MARGINS[2]
    bottom = _CURVE_WH[1] - _CURVE_MARGINS[3]
    parts = []
    y_ticks = rounded_ticks(*y_range, n_wanted=4)
    for value, label in zip(y_ticks, number_labels(y_ticks), strict=True):
        y = _y_px(value, y_range)
        parts.append(f'<line class="grid" x1="{left}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
    x_ticks = rounded_ticks(*x_range, n_wanted=6)
    for value, label in zip(x_ticks, number_labels(x_ticks), strict=True):
        x = _x_px(value, x_range)
        parts.append(f'<text x="{x:.1f}" y="{bottom + 20}" text-anchor="middle">{label}</text>')
    return parts


def _stages_svg(
    stages: Sequence[tuple[float, str]], *, x_range: tuple[float, float], y_range: tuple[float, float]
) -> list[str]:
    top, bottom = _y_px(y_range[1], y_range), _y_px(y_range[0], y_range)
    parts = []
    for step, name in stages:
        x = _x_px(step, x_range)
        parts.append(f'<line class="stage" x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{bottom}"/>')
        parts.append(f'<text x="{x:.1f}" y="{top - 8}">{html.escape(name)}</text>')
    return parts
