"""Plots of a few systems over a few values of x, each with its dots and its name beside the drawing, as inline SVG.

Letters: N points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from telewide.geometry.arrays import FloatArray
from telewide.pages.axes import Axis, Plot
from telewide.pages.charts import dots_path
from telewide.pages.page import chart_svg

MOST_COLOURS = 10
_WH = (860, 360)
_MARGINS = (58, 14, 290, 44)


@dataclass(frozen=True)
class Series:
    """One line of a plot.

    Attributes:
        label: beside the drawing.
        points: (N, 2) x and y, from left to right; what is not finite is left out.
        colour: 0 to `MOST_COLOURS` - 1, further ones begin anew.
        is_dashed: for what was not measured here.
    """

    label: str
    points: FloatArray
    colour: int
    is_dashed: bool = False


def series_plot(series: Sequence[Series], *, x: Axis, y: Axis, caption: str) -> Markup:
    """Draw lines with dots at their points.

    Args:
        series: what to draw.
        x: along the bottom.
        y: along the left side.
        caption: the sentence below, and what a screen reader says.

    Returns:
        A figure element.
    """
    plot = Plot(x, y, wh=(_WH[0], max(_WH[1], 18 * len(series) + 72)), margins=_MARGINS)
    lines = []
    for each in series:
        finite = each.points[np.isfinite(each.points).all(axis=1)]
        placed = np.array([plot.place(point) for point in finite]).reshape(-1, 2)
        css = f"series{each.colour % MOST_COLOURS}{' dashed' if each.is_dashed else ''}"
        lines.append((each.label, css, plot.path(finite), dots_path(placed)))
    return chart_svg("series_plot", plot=plot, lines=lines, caption=caption)
