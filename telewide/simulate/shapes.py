"""Outlines and reliefs of simulated objects.

An outline is an (N, 2) polygon of (x, y) within the unit circle, about the origin; a relief is a height over unit
coordinates (u, v) with slopes of at most about 2 per unit. Letters: N points, h w window.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray, FloatMap

Box = tuple[int, int, int, int]

_SUBPIXEL_BITS = 4
_SUPERSAMPLING = 4


def random_outline(rng: np.random.Generator) -> FloatArray:
    """Draw the outline of some object: a blob, a stone, a box, a disk, a pot.

    Args:
        rng: source of the draw.

    Returns:
        (N, 2) polygon in the unit circle.
    """
    draw = _OUTLINES[int(rng.integers(len(_OUTLINES)))]
    return draw(rng)


def leaf_outline(rng: np.random.Generator) -> FloatArray:
    """Draw a pointed, bent leaf from (0, 0) to about (1, 0), its width 5 to 25 % of its length.

    Args:
        rng: source of the draw.

    Returns:
        (N, 2) polygon.
    """
    t = np.linspace(0.0, 1.0, 16)
    width = rng.uniform(0.025, 0.12) * np.sin(math.pi * t ** rng.uniform(0.5, 1.2)) ** rng.uniform(0.6, 1.2)
    bend = rng.uniform(-0.35, 0.35) * t**2
    upper = np.stack([t, bend + width], axis=1)
    lower = np.stack([t, bend - width], axis=1)
    return np.concatenate([upper, lower[::-1]])


def placed(
    outline: FloatArray, *, centre_xy: tuple[float, float], radii_px: tuple[float, float], angle_rad: float
) -> FloatArray:
    """Scale, turn and move an outline.

    Args:
        outline: (N, 2) polygon in unit coordinates.
        centre_xy: where its origin goes, px.
        radii_px: px per unit along its x and its y.
        angle_rad: from x towards y.

    Returns:
        (N, 2) polygon in px.
    """
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    scaled = outline * np.asarray(radii_px)
    turned = scaled @ np.array([[cos, sin], [-sin, cos]])
    return np.asarray(turned + np.asarray(centre_xy), dtype=np.float64)


def box_of(polygon: FloatArray, *, limits: Box) -> Box | None:
    """Find the window a polygon needs, with a margin of two pixels.

    Args:
        polygon: (N, 2) px.
        limits: (x0, y0, x1, y1) that the window is cut to.

    Returns:
        (x0, y0, x1, y1), or None when less than two pixels are left.
    """
    low = np.floor(polygon.min(axis=0)).astype(int) - 2
    high = np.ceil(polygon.max(axis=0)).astype(int) + 3
    x0, y0 = max(int(low[0]), limits[0]), max(int(low[1]), limits[1])
    x1, y1 = min(int(high[0]), limits[2]), min(int(high[1]), limits[3])
    return (x0, y0, x1, y1) if x1 - x0 >= 2 and y1 - y0 >= 2 else None


def filled(polygon: FloatArray, *, box: Box, holes: tuple[FloatArray, ...] = ()) -> FloatMap:
    """Fill a polygon, antialiased.

    Args:
        polygon: (N, 2) px.
        box: (x0, y0, x1, y1) window that is drawn.
        holes: polygons left open.

    Returns:
        (h, w) float32 coverage in [0, 1].
    """
    wh = (box[2] - box[0], box[3] - box[1])
    canvas = np.zeros((_SUPERSAMPLING * wh[1], _SUPERSAMPLING * wh[0]), np.uint8)
    for shape, value in ((polygon, 255), *((hole, 0) for hole in holes)):
        fine = (shape - np.array(box[:2]) + 0.5) * _SUPERSAMPLING - 0.5
        points = np.rint(fine * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.fillPoly(canvas, [points], value, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
    coverage = cv2.resize(canvas, wh, interpolation=cv2.INTER_AREA)
    return np.asarray(coverage, dtype=np.float32) / np.float32(255.0)


def bar(
    *, box: Box, through_xy: tuple[float, float], angle_rad: float, width_px: float, curvature_per_px: float = 0.0
) -> FloatMap:
    """Cover a long thin bar, exactly antialiased.

    Args:
        box: (x0, y0, x1, y1) window that is drawn.
        through_xy: a point on its middle line.
        angle_rad: its direction, from x towards y.
        width_px: its width.
        curvature_per_px: how much it bends.

    Returns:
        (h, w) float32 coverage in [0, 1].
    """
    along, across = turned_grid(box=box, centre_xy=through_xy, angle_rad=angle_rad)
    distance_px = np.abs(across - np.float32(0.5 * curvature_per_px) * along * along)
    return np.asarray(np.clip(np.float32(0.5 * width_px + 0.5) - distance_px, 0.0, min(1.0, width_px)), np.float32)


def turned_grid(*, box: Box, centre_xy: tuple[float, float], angle_rad: float) -> tuple[FloatMap, FloatMap]:
    """Coordinates of the pixels of a window along and across a direction.

    Args:
        box: (x0, y0, x1, y1).
        centre_xy: the origin, px.
        angle_rad: the direction, from x towards y.

    Returns:
        Two (h, w) float32 maps, px: along, across.
    """
    x = np.arange(box[0], box[2], dtype=np.float32)[None, :] - np.float32(centre_xy[0])
    y = np.arange(box[1], box[3], dtype=np.float32)[:, None] - np.float32(centre_xy[1])
    cos, sin = np.float32(math.cos(angle_rad)), np.float32(math.sin(angle_rad))
    return np.asarray(x * cos + y * sin, np.float32), np.asarray(y * cos - x * sin, np.float32)


def dome(u: FloatMap, v: FloatMap) -> FloatMap:
    """A round cap: 1 in the middle, 0 at the unit circle, level beyond a little outside."""
    return np.asarray(1 - np.minimum(u * u + v * v, np.float32(1.2)), np.float32)


def cylinder(u: FloatMap, v: FloatMap) -> FloatMap:
    """A column along v."""
    return np.asarray(1 - np.minimum(u * u, np.float32(1.2)) + 0 * v, np.float32)


def fold(u: FloatMap, v: FloatMap) -> FloatMap:
    """The edge of a box or a roof along v."""
    return np.asarray(1 - np.abs(u) + 0 * v, np.float32)


def ripple(u: FloatMap, v: FloatMap) -> FloatMap:
    """Folds of cloth that run along v."""
    return np.asarray(np.float32(0.4) * np.sin(np.float32(4.0) * u + np.float32(0.7) * np.sin(2 * v)), np.float32)


RELIEFS: tuple[Callable[[FloatMap, FloatMap], FloatMap], ...] = (dome, dome, cylinder, cylinder, fold, ripple)


def _around(count: int) -> NDArray[np.float64]:
    return np.linspace(0.0, 2 * math.pi, count, endpoint=False)


def _from_polar(radius: NDArray[np.float64], angle_rad: NDArray[np.float64]) -> FloatArray:
    polygon = np.stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad)], axis=1)
    return np.asarray(polygon / np.abs(polygon).max(), dtype=np.float64)


def _blob(rng: np.random.Generator) -> FloatArray:
    angle_rad = _around(48)
    radius = np.ones(48)
    for harmonic in range(2, 7):
        wave = np.cos(harmonic * angle_rad + rng.uniform(0, 2 * math.pi))
        radius = radius + rng.normal(0.0, 0.35 / harmonic) * wave
    return _from_polar(np.maximum(radius, 0.15), angle_rad)


def _stone(rng: np.random.Generator) -> FloatArray:
    count = int(rng.integers(3, 9))
    angle_rad = _around(count) + rng.uniform(-0.35, 0.35, count) * 2 * math.pi / count
    return _from_polar(rng.uniform(0.65, 1.0, count), angle_rad)


def _box(rng: np.random.Generator) -> FloatArray:
    skew, taper = rng.uniform(-0.25, 0.25), rng.uniform(0.7, 1.0)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    if rng.random() < 0.5:
        return corners * 0.8
    corners[:2, 0] *= taper
    corners[:2, 0] += skew
    return np.asarray(corners * 0.8, dtype=np.float64)


def _disk(rng: np.random.Generator) -> FloatArray:
    return _from_polar(np.ones(64), _around(64) + rng.uniform(0, 0.1))


def _pot(rng: np.random.Generator) -> FloatArray:
    """A body of revolution seen from the side, upright."""
    t = np.linspace(-1.0, 1.0, 20)
    half_width = 0.5 + rng.uniform(-0.3, 0.3) * t
    for harmonic in (1, 2, 3):
        half_width = half_width + rng.normal(0.0, 0.15 / harmonic) * np.cos(harmonic * math.pi * t + rng.uniform(0, 6))
    half_width = np.clip(half_width, 0.1, 0.95)
    outline_x = np.concatenate([half_width, -half_width[::-1]])
    outline_y = np.concatenate([t, t[::-1]])
    return np.stack([outline_x, outline_y], axis=1) * 0.95


_OUTLINES: tuple[Callable[[np.random.Generator], FloatArray], ...] = (
    _blob,
    _blob,
    _stone,
    _stone,
    _box,
    _box,
    _disk,
    _pot,
    _pot,
)
