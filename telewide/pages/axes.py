"""Axes of charts: where values lie in a drawing, and the round values written along it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from telewide.drawing import number_labels, rounded_ticks
from telewide.geometry.arrays import FloatArray


@dataclass(frozen=True)
class Axis:
    """One direction of a chart.

    Attributes:
        label: what is drawn along it, with its unit.
        low: value at its beginning.
        high: value at its end, larger.
        is_log: equal steps are equal ratios; low is then above 0.
        n_ticks: about how many round values are written along it.
    """

    label: str
    low: float
    high: float
    is_log: bool = False
    n_ticks: int = 5

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
            return rounded_ticks(self.low, self.high, n_wanted=self.n_ticks)
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        values = (factor * 10.0**power for power in powers for factor in (1, 2, 5))
        return [value for value in values if self.low <= value * (1 + 1e-9) and value <= self.high * (1 + 1e-9)]

    def labelled(self) -> list[tuple[float, str]]:
        """Round values along it, and how they are written."""
        ticks = self.ticks()
        labels = [f"{tick:g}" for tick in ticks] if self.is_log else number_labels(ticks)
        return list(zip(ticks, labels, strict=True))


@dataclass(frozen=True)
class Plot:
    """Two axes in a drawing.

    Attributes:
        x: along the bottom.
        y: along the left side.
        wh: size of the drawing, px.
        margins: left, top, right and bottom, px.
    """

    x: Axis
    y: Axis
    wh: tuple[int, int] = (640, 300)
    margins: tuple[int, int, int, int] = (58, 14, 14, 44)

    @property
    def left(self) -> int:
        """Where x begins, px."""
        return self.margins[0]

    @property
    def right(self) -> int:
        """Where x ends, px."""
        return self.wh[0] - self.margins[2]

    @property
    def top(self) -> int:
        """Where y ends, px."""
        return self.margins[1]

    @property
    def bottom(self) -> int:
        """Where y begins, px."""
        return self.wh[1] - self.margins[3]

    def place(self, point: Sequence[float] | FloatArray) -> tuple[float, float]:
        """Place a value of x and one of y in the drawing, px; values outside are put on the border."""
        across, up = self.x.share(float(point[0])), self.y.share(float(point[1]))
        return self.left + across * (self.right - self.left), self.bottom - up * (self.bottom - self.top)

    def path(self, points: Sequence[Sequence[float]] | FloatArray) -> str:
        """Write points as SVG does, placed."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.place, points))

    def x_ticks(self) -> list[tuple[float, str]]:
        """Places and words of the round values along x."""
        return [(self.place((value, self.y.low))[0], label) for value, label in self.x.labelled()]

    def y_ticks(self) -> list[tuple[float, str]]:
        """Places and words of the round values along y."""
        return [(self.place((self.x.low, value))[1], label) for value, label in self.y.labelled()]

    def legend_y(self, number: int) -> int:
        """Height of a line of the legend, px."""
        return self.top + 14 + 18 * number


def axis_over(values: Sequence[float], *, label: str, starts_at_zero: bool = True) -> Axis:
    """Find an axis that holds all finite values, with some room; from 0 to 1 where there are none."""
    finite = [value for value in values if math.isfinite(value)]
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    room = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return Axis(label, 0.0 if starts_at_zero and low >= 0 else low - room, high + room)
