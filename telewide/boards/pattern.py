"""Pattern of a board, the black of it: rectangles in metres, for printing and for drawing.

Pattern frame: x right, y down, the origin at the top left of the printed pattern (not at corner 0).
Letters: n rectangles or cells.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.boards.board import Board, marker_squares
from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray


def aruco_dictionary(board: Board) -> cv2.aruco.Dictionary:
    """The markers a board is made of.

    Args:
        board: of kind charuco or aruco_grid.

    Returns:
        OpenCV's dictionary.

    Raises:
        InputError: OpenCV knows no such dictionary, or it has fewer markers than the board.
    """
    number = getattr(cv2.aruco, board.dictionary or "", None)
    if not isinstance(number, int) or not (board.dictionary or "").startswith("DICT_"):
        raise InputError(
            f"dictionary is {board.dictionary!r}; a name of OpenCV's was expected", hint="such as DICT_5X5_100"
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    n_known = len(dictionary.bytesList)
    if board.first_marker + board.n_markers > n_known:
        raise InputError(
            f"{board.dictionary} has {n_known} markers; the board needs {board.n_markers} from {board.first_marker} on",
            hint="name a larger dictionary",
        )
    return dictionary


def marker_cells(board: Board, *, marker: int) -> NDArray[np.bool_]:
    """Cells of one marker, its black border of one cell included.

    Args:
        board: of kind charuco or aruco_grid.
        marker: from 0, in the order of the board.

    Returns:
        (n, n) True where black.
    """
    dictionary = aruco_dictionary(board)
    n = dictionary.markerSize + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, board.first_marker + marker, n) < 128)


def marker_origins_m(board: Board) -> FloatArray:
    """Where the markers are printed.

    Args:
        board: of kind charuco or aruco_grid.

    Returns:
        (n_markers, 2) top left corners, pattern frame, m.
    """
    if board.kind == "charuco":
        margin_m = (board.square_m - (board.marker_m or 0.0)) / 2
        return np.asarray(marker_squares(board) * board.square_m + margin_m, dtype=np.float64)
    pitch_m = board.square_m + (board.gap_m or 0.0)
    y, x = np.divmod(np.arange(board.n_markers), board.columns)
    return np.column_stack([x, y]) * pitch_m


def black_rectangles_m(board: Board) -> FloatArray:
    """Everything that is black on a board.

    Args:
        board: the board.

    Returns:
        (n, 4) x, y, width, height, pattern frame, m; they may touch but do not overlap.
    """
    squares = _black_squares_m(board)
    if board.kind == "chessboard":
        return squares
    side_m = board.square_m if board.kind == "aruco_grid" else (board.marker_m or 0.0)
    markers = [
        _runs(marker_cells(board, marker=marker), side_m) + np.array([*origin_m, 0, 0])
        for marker, origin_m in enumerate(marker_origins_m(board))
    ]
    return np.concatenate([squares, *markers])


def _black_squares_m(board: Board) -> FloatArray:
    if board.kind == "aruco_grid":
        return np.zeros((0, 4))
    outer = 1 if board.kind == "chessboard" else 0
    y, x = np.mgrid[: board.rows + outer, : board.columns + outer].reshape(2, -1)
    first_black = 1 if board.legacy_pattern and board.rows % 2 == 0 else 0
    is_black = (x + y) % 2 == first_black
    side_m = np.full(is_black.sum(), board.square_m)
    return np.column_stack([x[is_black] * board.square_m, y[is_black] * board.square_m, side_m, side_m])


def _runs(is_black: NDArray[np.bool_], side_m: float) -> FloatArray:
    """Black cells of a square grid as (n, 4) rectangles, neighbours in a row joined."""
    cell_m = side_m / len(is_black)
    edges = np.diff(np.pad(is_black.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(edges == 1)
    ends = np.nonzero(edges == -1)[1]
    return np.column_stack([starts, rows, ends - starts, np.ones(len(rows))]) * cell_m
