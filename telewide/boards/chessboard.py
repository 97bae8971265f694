"""Find a chessboard in a photo, which end is up, and its corners to a fraction of a pixel.

A grid is (rows, columns, 2) px: x right along the columns and y down along the rows as on the board, never mirrored.
The square whose top left corner is (0, 0) is black, where the pattern can tell its ends apart at all.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.boards.board import Board
from telewide.boards.pyramid import Level
from telewide.boards.subpixel import refine_saddles
from telewide.geometry.arrays import ByteImage, FloatArray

_WINDOW_SHARE = 0.5  # radius of a refinement window over the distance to the next edge
_MIN_SHARE_FOUND = 0.6  # of the corners; a grid of which the fit refuses more was no chessboard
_COLLINEAR = 0.05  # |sin| of the angle of two edges below which they are no crossing


@dataclass(frozen=True)
class FoundCorners:
    """Corners by id.

    Attributes:
        ids: (N,) int64, ascending.
        points_px: (N, 2) px of the photo.
    """

    ids: NDArray[np.int64]
    points_px: FloatArray


def find_chessboard(grey_u8: ByteImage, levels: Iterable[Level], *, board: Board) -> FoundCorners | None:
    """Find a chessboard that is wholly visible.

    Args:
        grey_u8: (H, W) uint8, the photo.
        levels: its pyramid, the smallest first; no more of it is made than is needed.
        board: of kind chessboard.

    Returns:
        The corners, or None where there is no such board.
    """
    for level in levels:
        for find in (_find_by_sectors, _find_by_quads):
            grid_px = find(level.grey_u8, board)
            if grid_px is None:
                continue
            grid_px = _upright(grid_px, level.grey_u8)
            found = _refined(grey_u8, level.to_photo_px(grid_px))
            if found is not None:
                return found
    return None


def symmetric_ids(board: Board) -> tuple[NDArray[np.int64], ...]:
    """The ways to number the corners of a board that its print cannot tell apart.

    Args:
        board: the board; markers always tell.

    Returns:
        Arrays (n_corners,) of new id by id, first the identity, then by quarter turns.
    """
    ids = np.arange(board.n_corners).reshape(-1, board.columns if board.kind == "chessboard" else 1)
    if board.kind != "chessboard":
        return (ids.ravel(),)
    turned = (np.rot90(ids, quarter) for quarter in range(4))
    # Numbers may change places where the grid keeps its form and the square at corner (0, 0) its colour.
    is_same = (True, *((_is_turnable(board, quarter)) for quarter in (1, 2, 3)))
    return tuple(numbers.ravel() for numbers, same in zip(turned, is_same, strict=True) if same)


def _is_turnable(board: Board, quarter: int) -> bool:
    if quarter % 2 == 1 and board.columns != board.rows:
        return False
    # The colour of the square that comes to (0, 0): x + y of its place decides.
    across, down = board.columns - 2, board.rows - 2
    return {1: across, 2: across + down, 3: down}[quarter] % 2 == 0


def _find_by_sectors(grey_u8: ByteImage, board: Board) -> FloatArray | None:
    size = (board.columns, board.rows)
    is_found, corners = cv2.findChessboardCornersSB(grey_u8, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return _grid(np.asarray(corners, dtype=np.float64), board) if is_found else None


def _find_by_quads(grey_u8: ByteImage, board: Board) -> FloatArray | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners = cv2.findChessboardCorners(grey_u8, (board.columns, board.rows), flags=flags)
    return _grid(np.asarray(corners, dtype=np.float64), board) if is_found else None


def _grid(corners: FloatArray, board: Board) -> FloatArray:
    return corners.reshape(board.rows, board.columns, 2)


def _upright(grid_px: FloatArray, grey_u8: ByteImage) -> FloatArray:
    """Turn a grid so that nothing is mirrored, a black square comes first, and x points right as far as that allows."""
    across, down = _along(grid_px, axis=1).mean(axis=(0, 1)), _along(grid_px, axis=0).mean(axis=(0, 1))
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid_px = grid_px[::-1]
    turned = [np.rot90(grid_px, quarter) for quarter in range(4)]
    candidates = [grid for grid in turned if grid.shape == grid_px.shape]
    black_first = [grid for grid in candidates if _is_first_black(grid, grey_u8)]
    return max(black_first or candidates, key=lambda grid: float(_cosine_to_x(grid)))


def _cosine_to_x(grid_px: FloatArray) -> float:
    across = _along(grid_px, axis=1).mean(axis=(0, 1))
    return float(across[0] / np.linalg.norm(across))


def _is_first_black(grid_px: FloatArray, grey_u8: ByteImage) -> bool:
    """Whether the square right and below of corner (0, 0) is black, judged by all squares between the corners."""
    middles = (grid_px[:-1, :-1] + grid_px[1:, :-1] + grid_px[:-1, 1:] + grid_px[1:, 1:]) / 4
    x, y = np.clip(np.rint(middles), 0, np.array(grey_u8.shape)[::-1] - 1).astype(np.int64).transpose(2, 0, 1)
    levels = grey_u8[y, x].astype(np.float64)
    rows, columns = np.indices(levels.shape)
    is_like_first = (rows + columns) % 2 == 0
    return bool(np.median(levels[is_like_first]) < np.median(levels[~is_like_first]))


def _along(grid: FloatArray, *, axis: int) -> FloatArray:
    """Step to the next corner, central where there are two neighbours."""
    return np.asarray(np.gradient(grid, axis=axis), dtype=np.float64)


def _refined(grey_u8: ByteImage, grid_px: FloatArray) -> FoundCorners | None:
    across, down = _along(grid_px, axis=1).reshape(-1, 2), _along(grid_px, axis=0).reshape(-1, 2)
    half_px = _WINDOW_SHARE * distance_to_next_edge_px(across, down)
    edges_rad = np.column_stack([np.arctan2(step[:, 1], step[:, 0]) for step in (across, down)])
    refined = refine_saddles(grey_u8, grid_px.reshape(-1, 2), edges_rad=edges_rad, half_px=half_px)
    if refined.is_good.mean() < _MIN_SHARE_FOUND:
        return None
    ids = np.flatnonzero(refined.is_good).astype(np.int64)
    return FoundCorners(ids, refined.points_px[ids])


def distance_to_next_edge_px(across: FloatArray, down: FloatArray) -> FloatArray:
    """Distance from a corner to the nearest edge of its squares that does not pass through it.

    Args:
        across: (N, 2) step to the next corner along x, px.
        down: (N, 2) step to the next corner along y, px.

    Returns:
        (N,) px; ``|a x b| / max(|a|, |b|)``, 0 where the steps are parallel.
    """
    area = np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
    lengths = np.maximum(np.linalg.norm(across, axis=1), np.linalg.norm(down, axis=1))
    is_crossing = area > _COLLINEAR * np.linalg.norm(across, axis=1) * np.linalg.norm(down, axis=1)
    return np.asarray(np.where(is_crossing, area / np.maximum(lengths, 1e-9), 0.0), dtype=np.float64)
