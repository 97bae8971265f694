"""Charts as inline SVG, in the colours of the page that holds them: lines, dots and bars.

A chart is a figure element with a caption; its elements stand in ``templates/charts.svg.j2``. Letters: N points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from telewide.geometry.arrays import FloatArray
from telewide.pages.axes import Axis, Plot
from telewide.pages.page import chart_svg

_WIDTH = 640
_ROW_PX = 17
_NAME_PX = 150


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


def line_chart(lines: Sequence[Line], *, x: Axis, y: Axis, caption: str) -> Markup:
    """Draw curves over two axes, each with its name.

    Args:
        lines: at most two; points that are not finite are left out.
        x: along the bottom.
        y: along the left side.
        caption: the sentence below, and what a screen reader says.

    Returns:
        A figure element.
    """
    plot = Plot(x, y)
    finite = [(line.label, line.points[np.isfinite(line.points).all(axis=1)]) for line in lines]
    named = [(label, plot.path(points)) for label, points in finite]
    return chart_svg("line_chart", plot=plot, lines=named, caption=caption)


def dot_chart(groups: Sequence[Line], *, x: Axis, y: Axis, caption: str) -> Markup:
    """Draw groups of points over two axes, each in its colour and with its name; at most two groups.

    Args:
        groups: the second is drawn smaller, so that points of both at one place are seen.
        x: along the bottom.
        y: along the left side.
        caption: the sentence below, and what a screen reader says.

    Returns:
        A figure element.
    """
    plot = Plot(x, y)
    placed = [np.array([plot.place(point) for point in group.points]).reshape(-1, 2) for group in groups]
    named = [(group.label, dots_path(points)) for group, points in zip(groups, placed, strict=True)]
    return chart_svg("dot_chart", plot=plot, groups=named, caption=caption)


def bar_list(bars: Sequence[Bar], *, unit: str, caption: str, limit: float | None = None) -> Markup:
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
    room = _WIDTH - _NAME_PX - 140
    rows = []
    for number, bar in enumerate(bars):
        is_known = math.isfinite(bar.value)
        length = room * min(bar.value / longest, 1.0) if is_known else 0.0
        text = (f"{bar.value:.2f} {unit}" if is_known else "-") + (" (left out)" if bar.is_out else "")
        rows.append(
            {
                "name": _short(bar.name),
                "is_out": bar.is_out,
                "top": number * _ROW_PX + 4,
                "width": max(length, 1),
                "height": _ROW_PX - 5,
                "text": text,
                "text_x": _NAME_PX + length + 6,
            }
        )
    at = None if limit is None else _NAME_PX + room * limit / longest
    wh = (_WIDTH, len(bars) * _ROW_PX + 8)
    return chart_svg("bar_list", wh=wh, rows=rows, start=_NAME_PX, limit=at, caption=caption)


def dots_path(points: FloatArray) -> str:
    """Write points as strokes of no length: round line ends make them dots, in a tenth of the text of circles."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points)


def _short(name: str) -> str:
    return name if len(name) <= 22 else f"{name[:10]}…{name[-10:]}"
