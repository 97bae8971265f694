"""Outlines that flat solids are cut out by, as signed distance maps over [-1, 1]^2, positive inside.

Leaves, stones, pots, frames with holes, slats, fences, trellises, wheels, twigs with leaves, cables, letters.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import ByteImage, FloatMap
from telewide.simulate.shapes import leaf_outline, random_outline

_FINE = 4
"""Outlines are drawn so many times finer than their distance map."""


def draw_outline(rng: np.random.Generator, *, side_px: int) -> FloatMap:
    """Draw an outline of a random family.

    Args:
        rng: source of all draws.
        side_px: h.

    Returns:
        (h, h) float32 signed distance, texels.
    """
    side = side_px * _FINE
    canvas: ByteImage = np.zeros((side, side), np.uint8)
    _FAMILIES[int(rng.integers(len(_FAMILIES)))](rng, canvas)
    # A border stays free, so that no outline ends at the square's own side.
    canvas[:_FINE], canvas[-_FINE:], canvas[:, :_FINE], canvas[:, -_FINE:] = 0, 0, 0, 0
    inside = cv2.distanceTransform(canvas, cv2.DIST_L2, 5)
    outside = cv2.distanceTransform(255 - canvas, cv2.DIST_L2, 5)
    distance = (inside - outside) / _FINE
    return np.asarray(cv2.resize(distance, (side_px, side_px), interpolation=cv2.INTER_AREA), np.float32)


def _fill(canvas: ByteImage, polygon: NDArray[np.float64], value: int = 255) -> None:
    cv2.fillPoly(canvas, [np.rint((polygon + 1) * canvas.shape[0] / 2 * 16).astype(np.int32)], value, cv2.LINE_8, 4)


def _blob(rng: np.random.Generator, canvas: ByteImage) -> None:
    _fill(canvas, random_outline(rng) * 0.95)


def _leaf(rng: np.random.Generator, canvas: ByteImage) -> None:
    leaf = leaf_outline(rng)
    _fill(canvas, (leaf - [0.5, 0]) * [1.9, rng.uniform(1.9, 3.5)])


def _frame(rng: np.random.Generator, canvas: ByteImage) -> None:
    """A plate with holes: window, picture frame, chair back."""
    _fill(canvas, random_outline(rng) * 0.95 if rng.random() < 0.4 else _rectangle(-0.95, -0.95, 0.95, 0.95))
    columns, rows = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    rim = rng.uniform(0.03, 0.14)
    for i in range(columns):
        for j in range(rows):
            x, y = -0.9 + 1.8 * i / columns, -0.9 + 1.8 * j / rows
            _fill(canvas, _rectangle(x + rim, y + rim, x + 1.8 / columns - rim, y + 1.8 / rows - rim), 0)


def _slats(rng: np.random.Generator, canvas: ByteImage) -> None:
    """Bars side by side: fence, railing, blinds."""
    count = int(rng.integers(3, 14))
    share = rng.uniform(0.12, 0.65)
    for i in range(count):
        x = -0.95 + 1.9 * i / count
        _fill(canvas, _rectangle(x, -0.95, x + 1.9 / count * share, 0.95))
    for y in rng.uniform(-0.9, 0.9, int(rng.integers(0, 3))):
        _fill(canvas, _rectangle(-0.95, y, 0.95, y + rng.uniform(0.02, 0.1)))
    if rng.random() < 0.5:
        canvas[:] = canvas.T


def _twig(rng: np.random.Generator, canvas: ByteImage) -> None:
    """A branch that forks, with or without leaves."""
    side = canvas.shape[0]
    has_leaves = rng.random() < 0.7
    stack = [(np.array([rng.uniform(-0.3, 0.3), 0.95]), -math.pi / 2, rng.uniform(0.015, 0.05), 0)]
    while stack:
        start, angle, width, depth = stack.pop()
        end = start + rng.uniform(0.25, 0.5) * 0.85**depth * np.array([math.cos(angle), math.sin(angle)])
        points = [tuple(int(v) for v in np.rint((p + 1) * side / 2 * 16)) for p in (start, end)]
        cv2.line(canvas, points[0], points[1], 255, max(1, round(width * side / 2)), cv2.LINE_8, 4)
        if has_leaves:
            for _ in range(int(rng.integers(1, 4))):
                _place_leaf(rng, canvas, start + rng.random() * (end - start), angle + rng.normal(0, 1.0))
        if depth < 4:
            forks = int(rng.integers(1, 4))
            stack += [(end, angle + rng.normal(0, 0.6), width * 0.7, depth + 1) for _ in range(forks)]


def _place_leaf(rng: np.random.Generator, canvas: ByteImage, at: NDArray[np.float64], angle_rad: float) -> None:
    turn = np.array([[math.cos(angle_rad), math.sin(angle_rad)], [-math.sin(angle_rad), math.cos(angle_rad)]])
    _fill(canvas, leaf_outline(rng) * [1, 2.0] * rng.uniform(0.12, 0.4) @ turn + at)


def _cable(rng: np.random.Generator, canvas: ByteImage) -> None:
    """Hanging lines and curls, thin."""
    side = canvas.shape[0]
    for _ in range(int(rng.integers(1, 5))):
        t = np.linspace(-0.95, 0.95, 80)
        curve = rng.uniform(-0.7, 0.7) + rng.normal(0, 0.3) * t + rng.normal(0, 0.4) * t**2
        curve = curve + rng.uniform(0, 0.25) * np.sin(rng.uniform(1, 9) * t + rng.uniform(0, 6))
        points = np.stack([t, np.clip(curve, -0.95, 0.95)], axis=1)
        points = points[:, ::-1] if rng.random() < 0.5 else points
        fixed = np.rint((points + 1) * side / 2 * 16).astype(np.int32)
        cv2.polylines(canvas, [fixed], False, 255, int(rng.integers(5, 22)), cv2.LINE_8, 4)


def _mesh(rng: np.random.Generator, canvas: ByteImage) -> None:
    """Crossed bars: grid, trellis, net."""
    for _ in range(2):
        count, share = int(rng.integers(3, 10)), rng.uniform(0.08, 0.3)
        for i in range(count):
            x = -0.95 + 1.9 * i / count
            _fill(canvas, _rectangle(x, -0.95, x + 1.9 / count * share, 0.95))
        canvas[:] = canvas.T.copy()


def _wheel(rng: np.random.Generator, canvas: ByteImage) -> None:
    """A rim, a hub and spokes, straight or in pairs."""
    side = canvas.shape[0]
    middle, rim = (side // 2, side // 2), rng.uniform(0.03, 0.2)
    cv2.circle(canvas, middle, round(0.47 * side), 255, -1)
    cv2.circle(canvas, middle, round((0.47 - rim) * side), 0, -1)
    cv2.circle(canvas, middle, round(rng.uniform(0.02, 0.12) * side), 255, -1)
    count, width, lean = int(rng.integers(3, 15)), max(1, round(rng.uniform(0.01, 0.06) * side)), rng.uniform(0, 0.3)
    for i in range(count):
        angle = 2 * math.pi * i / count + lean * (i % 2)
        end = (round(side * (0.5 + 0.46 * math.cos(angle))), round(side * (0.5 + 0.46 * math.sin(angle))))
        cv2.line(canvas, middle, end, 255, width)


def _trellis(rng: np.random.Generator, canvas: ByteImage) -> None:
    """Slanting bars that cross, in a frame or without: benches, gates, scaffolds, spars."""
    side = canvas.shape[0]
    for _ in range(int(rng.integers(2, 9))):
        (x0, x1), width = rng.uniform(-0.2, 1.2, 2) * side, max(1, round(rng.uniform(0.01, 0.07) * side))
        ends = ((round(x0), 0), (round(x1), side))
        if rng.random() < 0.5:
            ends = ((0, round(x0)), (side, round(x1)))
        cv2.line(canvas, *ends, 255, width)
    if rng.random() < 0.6:
        rim = round(rng.uniform(0.02, 0.08) * side)
        cv2.rectangle(canvas, (rim, rim), (side - rim, side - rim), 255, 2 * rim)


def _letters(rng: np.random.Generator, canvas: ByteImage) -> None:
    side = canvas.shape[0]
    text = "".join(chr(int(c)) for c in rng.integers(65, 91, int(rng.integers(1, 4))))
    scale = side / 30 / len(text)
    origin = (round(side * 0.08), round(side * (0.5 + 0.35 / len(text))))
    cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, round(side * rng.uniform(0.03, 0.1)))


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> NDArray[np.float64]:
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


_FAMILIES: tuple[Callable[[np.random.Generator, ByteImage], None], ...] = (
    _blob,
    _blob,
    _blob,
    _leaf,
    _leaf,
    _frame,
    _frame,
    _slats,
    _slats,
    _twig,
    _twig,
    _cable,
    _mesh,
    _wheel,
    _trellis,
    _trellis,
    _letters,
)
