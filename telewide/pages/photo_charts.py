"""Charts over the frame of a photo: where points lie, vectors, and a map of values.

Places are the photo's own pixels, (0, 0) the centre of the top left one. Letters: N points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from telewide.drawing import painted
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.pages.axes import Axis
from telewide.pages.charts import dots_path
from telewide.pages.page import chart_svg

_PHOTO_WIDTH = 640
_COLOUR_BAR_PX = 38


def coverage_chart(
    points_px: FloatArray,
    cell_counts: NDArray[np.int64],
    *,
    hw: tuple[int, int],
    caption: str,
    outline_px: FloatArray | None = None,
) -> Markup:
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
    photo = _Photo(hw)
    rows, columns = cell_counts.shape
    cell_w, cell_h = _PHOTO_WIDTH / columns, photo.exact_wh[1] / rows
    most = max(int(cell_counts.max(initial=0)), 1)
    cells = [
        {
            "x": column * cell_w,
            "y": row * cell_h,
            "w": cell_w,
            "h": cell_h,
            "opacity": 0.06 + 0.34 * math.sqrt(count / most),
        }
        for (row, column), count in np.ndenumerate(cell_counts)
        if count
    ]
    path = dots_path(photo.place(points_px))
    outline = "" if outline_px is None else _corners(photo.place(outline_px))
    return chart_svg("coverage_chart", photo=photo, cells=cells, path=path, outline=outline, caption=caption)


def arrow_chart(
    points_px: FloatArray, vectors_px: FloatArray, *, hw: tuple[int, int], magnified: float, caption: str
) -> Markup:
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
    photo = _Photo(hw)
    starts, steps = photo.place(points_px), vectors_px * photo.scale * magnified
    arrows = "".join(f"M{a:.1f} {b:.1f}l{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(starts, steps, strict=True))
    return chart_svg("arrow_chart", photo=photo, arrows=arrows, starts=dots_path(starts), caption=caption)


def heat_chart(
    values: FloatMap, *, hw: tuple[int, int], value_range: tuple[float, float], unit: str, caption: str
) -> Markup:
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
    photo = _Photo(hw)
    width, height = photo.exact_wh
    axis, ticks = Axis(unit, *value_range), []
    for value, label in axis.labelled():
        x = axis.share(value) * width
        anchor = "start" if x < 12 else "end" if x > width - 24 else "middle"
        ticks.append({"x": x, "anchor": anchor, "text": f"{label} {unit}"})
    return chart_svg(
        "heat_chart",
        photo=photo,
        wh=(width, round(height + _COLOUR_BAR_PX)),
        map=_png(painted(values, value_range=value_range, table="inferno")),
        ramp=_png(painted(np.linspace(0, 1, 256, dtype=np.float32)[None], value_range=(0, 1), table="inferno")),
        ticks=ticks,
        caption=caption,
    )


@dataclass(frozen=True)
class _Photo:
    """The frame of a photo of a size, ``hw``, px, drawn as wide as the charts that show one."""

    hw: tuple[int, int]

    @property
    def scale(self) -> float:
        return _PHOTO_WIDTH / self.hw[1]

    @property
    def exact_wh(self) -> tuple[int, float]:
        return _PHOTO_WIDTH, self.hw[0] * self.scale

    @property
    def wh(self) -> tuple[int, int]:
        return _PHOTO_WIDTH, round(self.exact_wh[1])

    def place(self, points_px: FloatArray) -> FloatArray:
        return (points_px + 0.5) * self.scale


def _corners(points: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def _png(image: FloatMap) -> bytes:
    bgr = np.ascontiguousarray(np.round(image * 255).astype(np.uint8)[..., ::-1])
    _, encoded = cv2.imencode(".png", bgr)
    return encoded.tobytes()
