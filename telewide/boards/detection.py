"""Find a board in one photo.

Points are (x, y) in px of the photo, pixel (0, 0) is the centre of the top-left pixel; ids as in `boards`.
Letters: H W photo; N corners found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.boards.board import Board
from telewide.boards.chessboard import find_chessboard
from telewide.boards.markers import find_marker_board
from telewide.boards.pyramid import pyramid
from telewide.geometry.arrays import FloatArray

MIN_CORNERS = 4
"""A view with fewer says nothing of where the board is."""
MIN_PHOTO_PX = 64
"""Shorter side of the smallest picture that can show a board; OpenCV fails on much smaller ones."""


@dataclass(frozen=True)
class BoardView:
    """A board as one photo shows it.

    Attributes:
        ids: (N,) int64 corner ids, ascending, no id twice.
        points_px: (N, 2) float64 where those corners are.
        hw: height and width of the photo.
    """

    ids: NDArray[np.int64]
    points_px: FloatArray
    hw: tuple[int, int]


def detect_board(grey_u8: NDArray[np.uint8], *, board: Board) -> BoardView | None:
    """Find a board's corners in a photo, sub-pixel exact at the photo's own size.

    Args:
        grey_u8: (H, W) uint8, sRGB-encoded.
        board: what to look for; a chessboard must be wholly visible, markers may be partly out of the photo.

    Returns:
        The corners, or None where the photo shows no such board or less than four corners of it.

    Raises:
        InputError: the board names markers that OpenCV does not have.
    """
    height, width = grey_u8.shape
    if min(height, width) < MIN_PHOTO_PX:
        return None
    if board.kind == "chessboard":
        found = find_chessboard(grey_u8, pyramid(grey_u8), board=board)
    else:
        found = find_marker_board(grey_u8, pyramid(grey_u8), board=board)
    if found is None or len(found.ids) < MIN_CORNERS:
        return None
    return BoardView(found.ids, found.points_px, (height, width))
