"""Photos and boards that are turned: both lenses of a phone look the same way, whichever end of a board is up.

A direction is an angle in the photo, from x towards y. Letters: N corners.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from telewide.boards.board import Board, board_points_m
from telewide.boards.chessboard import symmetric_ids
from telewide.boards.detection import BoardView

MAX_TURN_DEG = 20.0
"""Lenses of one phone are turned to each other by a degree or two; by more where a photo is not upright."""


def direction_deg(view: BoardView, *, board: Board) -> float:
    """Direction of the board's x axis in a photo.

    Args:
        view: the corners.
        board: what they belong to.

    Returns:
        Degrees from -180 to 180, of the best affine map from the board to the photo.
    """
    x_y_1 = np.column_stack([board_points_m(board)[view.ids, :2], np.ones(len(view.ids))])
    px_per_m = np.linalg.lstsq(x_y_1, view.points_px, rcond=None)[0]
    return float(np.degrees(np.arctan2(px_per_m[0, 1], px_per_m[0, 0])))


def turned_view(view: BoardView, clockwise_deg: int) -> BoardView:
    """Turn the corners found in a photo as the photo would be turned.

    Args:
        view: the corners.
        clockwise_deg: a multiple of 90.

    Returns:
        The corners of the turned photo.
    """
    for _ in range(clockwise_deg // 90 % 4):
        height, width = view.hw
        points_px = np.stack([height - 1 - view.points_px[:, 1], view.points_px[:, 0]], axis=1)
        view = replace(view, points_px=points_px, hw=(width, height))
    return view


def alike_numbered(tele: BoardView, wide: BoardView, *, board: Board) -> tuple[BoardView, str | None]:
    """Number the corners of the wide view as the tele view does.

    Args:
        tele: corners in the tele photo.
        wide: corners in the wide photo of the same shot.
        board: what both show.

    Returns:
        The wide view with the numbering, of those that the print cannot tell apart, which turns it least against tele;
        and a note where it still is turned by more than two lenses of one phone are.
    """
    tele_deg = direction_deg(tele, board=board)
    candidates = [_renumbered(wide, ids) for ids in symmetric_ids(board)]
    turns_deg = [_wrapped_deg(direction_deg(view, board=board) - tele_deg) for view in candidates]
    least = int(np.argmin(np.abs(turns_deg)))
    note = None
    if abs(turns_deg[least]) > MAX_TURN_DEG:
        note = f"the board is turned by {turns_deg[least]:.0f} degrees in wide against tele: is one photo not upright?"
    return candidates[least], note


def _renumbered(view: BoardView, new_ids: np.ndarray[tuple[int], np.dtype[np.int64]]) -> BoardView:
    ids = new_ids[view.ids]
    order = np.argsort(ids)
    return replace(view, ids=ids[order], points_px=view.points_px[order])


def _wrapped_deg(angle_deg: float) -> float:
    return (angle_deg + 180) % 360 - 180
