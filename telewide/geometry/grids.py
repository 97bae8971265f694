"""Dense pixel maps from coarse grids: where every pixel of one image lies in another, without asking for every pixel.

A smooth mapping is asked at the nodes of a grid, and what lies between is interpolated linearly. The grid is refined
until its own second differences say that this errs by no more than was allowed.
Letters: H W image; N points.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from telewide.geometry.arrays import FloatArray, FloatMap

Mapping = Callable[[FloatArray], FloatArray]

MAX_ERROR_PX = 0.004
_FIRST_STEP_PX = 32


def dense_map(
    mapping: Mapping, *, hw: tuple[int, int], max_error_px: float = MAX_ERROR_PX
) -> tuple[FloatMap, FloatMap]:
    """Tabulate a smooth mapping of points for all pixels of an image.

    Linear interpolation between nodes ``h`` apart errs by at most ``h^2 / 8 (|f_xx| + |f_yy|)``.

    Args:
        mapping: (N, 2) px of this image to (N, 2) px of another; smooth, also a step outside the image.
        hw: height and width of this image.
        max_error_px: largest error of the interpolation, px of the other image.

    Returns:
        Two (H, W) float32: x and y in the other image.
    """
    step_px = _FIRST_STEP_PX
    grid = _at_nodes(mapping, hw=hw, step_px=step_px)
    while step_px > 1 and _interpolation_error_px(grid) > max_error_px:
        step_px //= 2
        grid = _at_nodes(mapping, hw=hw, step_px=step_px)
    map_x, map_y = (_between_nodes(grid[..., axis], hw=hw, step_px=step_px) for axis in (0, 1))
    return map_x, map_y


def _at_nodes(mapping: Mapping, *, hw: tuple[int, int], step_px: int) -> FloatArray:
    # Where a resize by a whole factor puts the pixels of the small image; one more node on every side, since it
    # does not extrapolate.
    y_px, x_px = ((np.arange(-1, -(-size // step_px) + 1) + 0.5) * step_px - 0.5 for size in hw)
    nodes = np.stack(np.meshgrid(x_px, y_px), axis=-1)
    return mapping(nodes.reshape(-1, 2)).reshape(nodes.shape)


def _interpolation_error_px(grid: FloatArray) -> float:
    along_y, along_x = (np.abs(np.diff(grid, n=2, axis=axis)).max(initial=0.0) for axis in (0, 1))
    return float(along_x + along_y) / 8


def _between_nodes(values: FloatArray, *, hw: tuple[int, int], step_px: int) -> FloatMap:
    rows, columns = values.shape
    wh = (columns * step_px, rows * step_px)
    full = cv2.resize(values.astype(np.float32), wh, interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(full[step_px : step_px + hw[0], step_px : step_px + hw[1]])
