"""Curves of a training over its steps, as inline SVG."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from telewide.pages.axes import Axis, Plot
from telewide.pages.numbers import number_text
from telewide.pages.page import chart_svg

_WH = (640, 240)
_MARGINS = (58, 22, 12, 30)  # left, top, right, bottom
_MOST_POINTS = 300  # more would not be seen at this width
_SPIKE = 1.5  # a value that stands so many times higher than all others does not set the scale


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


def curve_svg(curve: Curve) -> Markup:
    """Draw a curve in the page's own colours.

    Args:
        curve: at least two finite values, else nothing is drawn.

    Returns:
        A figure element, or nothing.
    """
    points = [
        (float(step), float(value))
        for step, value in zip(curve.steps, curve.values, strict=True)
        if math.isfinite(step) and math.isfinite(value)
    ]
    if len(points) < 2 or points[0][0] >= points[-1][0]:
        return Markup()
    x = Axis("step", points[0][0], points[-1][0], n_ticks=6)
    points = _thinned(points)
    y = Axis(curve.label, *_shown_range([value for _, value in points]), n_ticks=4)
    plot = Plot(x, y, wh=_WH, margins=_MARGINS)
    last_step, last_value = points[-1]
    return chart_svg(
        "training_curve",
        plot=plot,
        points=plot.path(points),
        stages=[(plot.place((step, y.low))[0], name) for step, name in curve.stages],
        label=curve.label,
        caption=f"{curve.label}: {number_text(last_value)} at step {last_step:.10g}",
    )


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Average neighbouring points where there are more than can be seen; the last one stays what it is."""
    size = -(-len(points) // _MOST_POINTS)
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
