"""Charts as inline SVG, in the colours of the page that holds them: axes, lines, dots, bars, and drawings over a photo.

A chart is a figure element with a caption. Numbers are placed by an :class:`Axis`; drawings over a photo use the
photo's own pixels, (0, 0) the centre of the top left one. Letters: N points.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.drawing import number_labels, painted, rounded_ticks
from telewide.geometry.arrays import FloatArray, FloatMap

CHART_STYLE = """
:root { --good: #23803f; --warn: #a86a00; --bad: #c0302b; --second: #2f6fb7; --cell: #b4470f; }
@media (prefers-color-scheme: dark) {
  :root { --good: #5dc57c; --warn: #e3a63a; --bad: #ff6b62; --second: #7fb4f0; --cell: #ff9a5c; } }
.charts { display: flex; flex-wrap: wrap; gap: 20px; } .charts figure { flex: 1 1 380px; max-width: 720px; }
svg .frame { fill: none; stroke: var(--line); } svg .dots { fill: none; stroke-linecap: round; stroke: var(--curve); }
svg .series0 { stroke: var(--curve); } svg .series1 { stroke: var(--second); } svg .limit { stroke: var(--warn);
  stroke-dasharray: 5 4; } svg text.name { fill: var(--ink); } svg .bar { fill: var(--second); }
svg .bar.out { fill: var(--bad); } svg .cell { fill: var(--cell); } svg .arrow { stroke: var(--second); fill: none; }
svg line.curve { stroke-width: 2; } svg .outline { fill: none; stroke: var(--second); stroke-width: 2; }
"""

_WH = (640, 300)
_MARGINS = (58, 14, 14, 44)  # left, top, right, bottom
_ROW_PX = 17
_NAME_PX = 150
_PHOTO_WIDTH = 640
_COLOUR_BAR_PX = 38


@dataclass(frozen=True)
class Axis:
    """One direction of a chart.

    Attributes:
        label: what is drawn along it, with its unit.
        low: value at its beginning.
        high: value at its end, larger.
        is_log: equal steps are equal ratios; low is then above 0.
    """

    label: str
    low: float
    high: float
    is_log: bool = False

    def share(self, value: float) -> float:
        """Where a value lies: 0 at the beginning, 1 at the end; values outside are put on the border."""
        if self.is_log:
            value = max(value, self.low)
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return min(max(share, 0.0), 1.0)

    def ticks(self) -> list[float]:
        """Round values along it."""
        if not self.is_log:
            return rounded_ticks(self.low, self.high, n_wanted=5)
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        values = (factor * 10.0**power for power in powers for factor in (1, 2, 5))
        return [value for value in values if self.low <= value * (1 + 1e-9) and value <= self.high * (1 + 1e-9)]


@dataclass(frozen=True)
class Line:
    """A curve or a group of dots: its name in the legend, and (N, 2) x and y."""

    label: str
    points: FloatArray


@dataclass(frozen=True)
class Bar:
    """One bar of a list.

    Attributes:
        name: of what it measures.
        value: its length, >= 0; NaN for none.
        is_out: left out of the result; drawn in another colour.
    """

    name: str
    value: float
    is_out: bool = False


def axis_over(values: Sequence[float], *, label: str, starts_at_zero: bool = True) -> Axis:
    """Find an axis that holds all finite values, with some room; from 0 to 1 where there are none."""
    finite = [value for value in values if math.isfinite(value)]
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    room = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return Axis(label, 0.0 if starts_at_zero and low >= 0 else low - room, high + room)


def line_chart(lines: Sequence[Line], *, x: Axis, y: Axis, caption: str) -> str:
    """Draw curves over two axes, each with its name at its end.

    Args:
        lines: at most two; points that are not finite are left out.
        x: along the bottom.
        y: along the left side.
        caption: the sentence below, and what a screen reader says.

    Returns:
        A figure element.
    """
    parts = _axes(x, y)
    for number, line in enumerate(lines):
        points = line.points[np.isfinite(line.points).all(axis=1)]
        path = " ".join(f"{a:.1f},{b:.1f}" for a, b in (_placed(point, x, y) for point in points))
        parts.append(f'<polyline class="curve series{number}" points="{path}"/>')
        top, left = _legend_place(number)
        parts.append(f'<line class="curve series{number}" x1="{left}" y1="{top}" x2="{left + 22}" y2="{top}"/>')
        parts.append(f'<text class="name" x="{left + 30}" y="{top + 4}">{html.escape(line.label)}</text>')
    return figure_svg("".join(parts), wh=_WH, caption=caption)


def dot_chart(groups: Sequence[Line], *, x: Axis, y: Axis, caption: str) -> str:
    """Draw groups of points over two axes, each in its colour and with its name; at most two groups.

    Args:
        groups: the second is drawn smaller, so that points of both at one place are seen.
        x: along the bottom.
        y: along the left side.
        caption: the sentence below, and what a screen reader says.

    Returns:
        A figure element.
    """
    parts = _axes(x, y)
    for number, group in enumerate(groups):
        placed = np.array([_placed(point, x, y) for point in group.points]).reshape(-1, 2)
        width = 11 - 5 * number
        parts.append(f'<path class="dots series{number}" stroke-width="{width}" d="{_dots_path(placed)}"/>')
        top, left = _legend_place(number)
        parts.append(f'<path class="dots series{number}" stroke-width="{width}" d="M{left + 11} {top}h0"/>')
        parts.append(f'<text class="name" x="{left + 30}" y="{top + 4}">{html.escape(group.label)}</text>')
    return figure_svg("".join(parts), wh=_WH, caption=caption)


def bar_list(bars: Sequence[Bar], *, unit: str, caption: str, limit: float | None = None) -> str:
    """Draw one horizontal bar below the other, each with its name and number; overlong ones end at the border.

    Args:
        bars: what to draw.
        unit: of the numbers.
        caption: the sentence below.
        limit: drawn as an upright line.

    Returns:
        A figure element.
    """
    used = [bar.value for bar in bars if not bar.is_out and math.isfinite(bar.value)]
    longest = max([*used, limit or 0.0, 1e-9]) * 1.6
    room = _PHOTO_WIDTH - _NAME_PX - 140
    parts = []
    for row, bar in enumerate(bars):
        top = row * _ROW_PX + 4
        length = room * min(bar.value / longest, 1.0) if math.isfinite(bar.value) else 0.0
        number = f"{bar.value:.2f} {unit}" if math.isfinite(bar.value) else "-"
        css_class = "bar out" if bar.is_out else "bar"
        parts.append(
            f'<text class="name" x="{_NAME_PX - 8}" y="{top + 11}" text-anchor="end">{html.escape(_short(bar.name))}'
            f"</text>"
        )
        parts.append(
            f'<rect class="{css_class}" x="{_NAME_PX}" y="{top + 2}" '
            f'width="{max(length, 1):.1f}" height="{_ROW_PX - 5}"/>'
        )
        parts.append(
            f'<text x="{_NAME_PX + length + 6:.1f}" y="{top + 11}">{number}{" (left out)" if bar.is_out else ""}</text>'
        )
    height = len(bars) * _ROW_PX + 8
    if limit is not None:
        at = _NAME_PX + room * limit / longest
        parts.append(f'<line class="limit" x1="{at:.1f}" y1="0" x2="{at:.1f}" y2="{height}"/>')
    return figure_svg("".join(parts), wh=(_PHOTO_WIDTH, height), caption=caption)


def coverage_chart(
    points_px: FloatArray,
    cell_counts: NDArray[np.int64],
    *,
    hw: tuple[int, int],
    caption: str,
    outline_px: FloatArray | None = None,
) -> str:
    """Draw where points lie in a photo, over cells shaded by how many they hold.

    Args:
        points_px: (N, 2) x and y, px of the photo.
        cell_counts: (rows, columns) points in each cell.
        hw: size of the photo, px.
        caption: the sentence below.
        outline_px: (M, 2) corners of a closed outline to draw into it.

    Returns:
        A figure element.
    """
    scale = _PHOTO_WIDTH / hw[1]
    height = hw[0] * scale
    rows, columns = cell_counts.shape
    cell_w, cell_h = _PHOTO_WIDTH / columns, height / rows
    most = max(int(cell_counts.max(initial=0)), 1)
    parts = [
        f'<rect class="cell" x="{column * cell_w:.1f}" y="{row * cell_h:.1f}" width="{cell_w:.1f}" '
        f'height="{cell_h:.1f}" opacity="{0.06 + 0.34 * math.sqrt(count / most):.2f}"/>'
        for (row, column), count in np.ndenumerate(cell_counts)
        if count
    ]
    parts.append(f'<path class="dots" stroke-width="2.6" d="{_dots_path((points_px + 0.5) * scale)}"/>')
    if outline_px is not None:
        outline = " ".join(f"{x:.1f},{y:.1f}" for x, y in (outline_px + 0.5) * scale)
        parts.append(f'<polygon class="outline" points="{outline}"/>')
    return figure_svg(_framed(parts, height=height), wh=(_PHOTO_WIDTH, round(height)), caption=caption)


def arrow_chart(
    points_px: FloatArray, vectors_px: FloatArray, *, hw: tuple[int, int], magnified: float, caption: str
) -> str:
    """Draw vectors at their places in a photo, enlarged.

    Args:
        points_px: (N, 2) where they begin, px of the photo.
        vectors_px: (N, 2) px of the photo.
        hw: size of the photo, px.
        magnified: how many times longer than true they are drawn.
        caption: the sentence below.

    Returns:
        A figure element.
    """
    scale = _PHOTO_WIDTH / hw[1]
    starts = (points_px + 0.5) * scale
    steps = vectors_px * scale * magnified
    path = "".join(f"M{a:.1f} {b:.1f}l{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(starts, steps, strict=True))
    parts = [
        f'<path class="arrow" d="{path}"/>',
        f'<path class="dots" stroke-width="2.2" d="{_dots_path(starts)}"/>',
    ]
    height = hw[0] * scale
    return figure_svg(_framed(parts, height=height), wh=(_PHOTO_WIDTH, round(height)), caption=caption)


def heat_chart(
    values: FloatMap, *, hw: tuple[int, int], value_range: tuple[float, float], unit: str, caption: str
) -> str:
    """Paint a coarse map of values over a photo's frame, with its colour bar.

    Args:
        values: (rows, columns); NaN where nothing is known.
        hw: size of the photo, px.
        value_range: what the first and the last colour stand for.
        unit: of the values.
        caption: the sentence below.

    Returns:
        A figure element.
    """
    height = _PHOTO_WIDTH * hw[0] / hw[1]
    ramp = np.linspace(0, 1, 256, dtype=np.float32)[None]
    bar_top = height + 6
    parts = [
        _image(painted(values, value_range=value_range, table="inferno"), y=0, height=height),
        _image(painted(ramp, value_range=(0, 1), table="inferno"), y=bar_top, height=10),
    ]
    axis = Axis(unit, *value_range)
    ticks = axis.ticks()
    for tick, label in zip(ticks, number_labels(ticks), strict=True):
        x = axis.share(tick) * _PHOTO_WIDTH
        anchor = "start" if x < 12 else "end" if x > _PHOTO_WIDTH - 24 else "middle"
        parts.append(f'<text x="{x:.1f}" y="{bar_top + 24:.1f}" text-anchor="{anchor}">{label} {unit}</text>')
    return figure_svg(_framed(parts, height=height), wh=(_PHOTO_WIDTH, round(height + _COLOUR_BAR_PX)), caption=caption)


def figure_svg(content: str, *, wh: tuple[int, int], caption: str) -> str:
    """Wrap SVG elements in a figure with a caption; the caption is escaped here, the elements are not."""
    label = html.escape(caption)
    return (
        f'<figure><svg viewBox="0 0 {wh[0]} {wh[1]}" role="img" aria-label="{label}">{content}</svg>'
        f"<figcaption>{label}</figcaption></figure>"
    )


def _axes(x: Axis, y: Axis) -> list[str]:
    left, top, right, bottom = _plot_box()
    parts = []
    y_ticks, x_ticks = y.ticks(), x.ticks()
    for value, label in zip(y_ticks, _tick_labels(y, y_ticks), strict=True):
        at = _placed((x.low, value), x, y)[1]
        parts.append(f'<line class="grid" x1="{left}" y1="{at:.1f}" x2="{right}" y2="{at:.1f}"/>')
        parts.append(f'<text x="{left - 8}" y="{at + 4:.1f}" text-anchor="end">{label}</text>')
    for value, label in zip(x_ticks, _tick_labels(x, x_ticks), strict=True):
        at = _placed((value, y.low), x, y)[0]
        parts.append(f'<line class="grid" x1="{at:.1f}" y1="{top}" x2="{at:.1f}" y2="{bottom}"/>')
        parts.append(f'<text x="{at:.1f}" y="{bottom + 17}" text-anchor="middle">{label}</text>')
    parts.append(f'<text x="{(left + right) / 2}" y="{bottom + 36}" text-anchor="middle">{html.escape(x.label)}</text>')
    middle = (top + bottom) / 2
    parts.append(
        f'<text x="14" y="{middle}" text-anchor="middle" transform="rotate(-90 14 {middle})">'
        f"{html.escape(y.label)}</text>"
    )
    return parts


def _legend_place(number: int) -> tuple[int, int]:
    return _MARGINS[1] + 14 + 18 * number, _MARGINS[0] + 12


def _tick_labels(axis: Axis, ticks: Sequence[float]) -> list[str]:
    return [f"{tick:g}" for tick in ticks] if axis.is_log else number_labels(ticks)


def _plot_box() -> tuple[int, int, int, int]:
    return _MARGINS[0], _MARGINS[1], _WH[0] - _MARGINS[2], _WH[1] - _MARGINS[3]


def _placed(point: Sequence[float] | FloatArray, x: Axis, y: Axis) -> tuple[float, float]:
    left, top, right, bottom = _plot_box()
    return left + x.share(float(point[0])) * (right - left), bottom - y.share(float(point[1])) * (bottom - top)


def _dots_path(points: FloatArray) -> str:
    """Points as strokes of no length: round line ends make them dots, in a tenth of the text of circles."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)


def _framed(parts: Sequence[str], *, height: float) -> str:
    return (
        "".join(parts) + f'<rect class="frame" x="0.5" y="0.5" width="{_PHOTO_WIDTH - 1}" height="{height - 1:.1f}"/>'
    )


def _image(image: FloatMap, *, y: float, height: float) -> str:
    bgr = np.ascontiguousarray(np.round(image * 255).astype(np.uint8)[..., ::-1])
    _, encoded = cv2.imencode(".png", bgr)
    data = base64.b64encode(encoded.tobytes()).decode("ascii")
    return (
        f'<image x="0" y="{y:.1f}" width="{_PHOTO_WIDTH}" height="{height:.1f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{data}"/>'
    )


def _short(name: str) -> str:
    return name if len(name) <= 22 else f"{name[:10]}…{name[-10:]}"
