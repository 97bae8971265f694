"""Figures about a rig that its report draws: how two solves differ over the photo, what depth costs with distance.

Maps are coarse grids over a photo, row 0 at the top. Letters: R C rows and columns of such a grid, N points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.validation import difference_px
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera, StereoRig

_LONGER_SIDE_CELLS = 32


def camera_difference_px(first: Camera, second: Camera) -> FloatArray:
    """Difference between two solves of one lens, over its photo.

    A turn of the whole camera is taken out first: the boards' poses would absorb it, so it is no difference. The rays
    of both solves are turned onto each other (W. Kabsch, "A solution for the best rotation to relate two sets of
    vectors", 1976); what is left is measured in the photo.

    Args:
        first: one solve.
        second: another one, of photos of the same size.

    Returns:
        (R, C) px; NaN where a distortion that no board showed folds the photo's corners over.
    """
    grid_px = _grid_px(first.hw)
    rays, other_rays = _unit_rays(first, grid_px), _unit_rays(second, grid_px)
    is_seen = np.asarray(np.isfinite(np.hstack([rays, other_rays])).all(axis=1))
    rays = np.where(is_seen[:, None], rays, np.nan)
    u, _, vt = np.linalg.svd(other_rays[is_seen].T @ rays[is_seen])
    second_from_first = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    difference_px = second.project(rays @ second_from_first.T) - grid_px
    return np.asarray(np.linalg.norm(difference_px, axis=1).reshape(_grid_shape(first.hw)))


def transfer_difference_px(first: StereoRig, second: StereoRig, *, distance_m: float) -> FloatArray:
    """Difference in how two rigs carry a point from the tele photo to the wide photo, over the tele photo.

    Args:
        first: one solve.
        second: another one, of photos of the same sizes.
        distance_m: the point's depth in the tele camera's frame, m.

    Returns:
        (R, C) tele px: distances in the wide photo times ``f_tele / f_wide``.
    """
    grid_hw = _grid_shape(first.tele.hw)
    return np.asarray(np.linalg.norm(difference_px(first, second, distance_m=distance_m, grid_hw=grid_hw), axis=-1))


def tele_outline_px(rig: StereoRig) -> FloatArray:
    """Outline, in the wide photo, of what tele sees of far things.

    Args:
        rig: the two cameras.

    Returns:
        (N, 2) px of the wide photo, once around the tele photo's border.
    """
    height, width = rig.tele.hw
    along = np.linspace(0, 1, 9)[:-1, None]
    corners_px = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]) - 0.5
    ends_px = np.roll(corners_px, -1, axis=0)
    border_px = np.concatenate([a + along * (b - a) for a, b in zip(corners_px, ends_px, strict=True)])
    rays = np.column_stack([rig.tele.normalised(border_px), np.ones(len(border_px))])
    return rig.wide.project(rays @ rig.wide_from_tele[:3, :3].T)


def depth_error_m(depth_m: FloatArray, rig: StereoRig, *, disparity_std_px: float) -> FloatArray:
    """Error of depth from an error of disparity: ``sigma_z = z^2 sigma_d / (f B)``.

    Args:
        depth_m: distances, m.
        rig: its tele's focal length and its baseline are taken.
        disparity_std_px: standard deviation of the disparity, tele px.

    Returns:
        Standard deviations of depth, m, of the same shape.
    """
    return np.asarray(depth_m**2 * disparity_std_px / (rig.tele.f_px * rig.baseline_m), dtype=np.float64)


def cell_counts(points_px: FloatArray, *, hw: tuple[int, int], cells: tuple[int, int]) -> NDArray[np.int64]:
    """Count points in the cells of a photo.

    Args:
        points_px: (N, 2) x and y.
        hw: size of the photo.
        cells: rows and columns.

    Returns:
        (R, C) counts; points outside the photo are in none.
    """
    edges = (np.linspace(0, hw[0], cells[0] + 1) - 0.5, np.linspace(0, hw[1], cells[1] + 1) - 0.5)
    counts, _, _ = np.histogram2d(points_px[:, 1], points_px[:, 0], bins=edges)
    return counts.astype(np.int64)


def _unit_rays(camera: Camera, points_px: FloatArray) -> FloatArray:
    rays = np.column_stack([camera.normalised(points_px), np.ones(len(points_px))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), dtype=np.float64)


def _grid_shape(hw: tuple[int, int]) -> tuple[int, int]:
    cell_px = max(hw) / _LONGER_SIDE_CELLS
    return max(1, round(hw[0] / cell_px)), max(1, round(hw[1] / cell_px))


def _grid_px(hw: tuple[int, int]) -> FloatArray:
    """(R C, 2) centres of the cells, px."""
    rows, columns = _grid_shape(hw)
    y, x = np.mgrid[:rows, :columns] + 0.5
    return np.column_stack([x.ravel() * hw[1] / columns, y.ravel() * hw[0] / rows]) - 0.5
