"""A board on a sheet of paper at true scale, with a ruler to check the print by.

Page frame: metres, x right, y down, the origin at the top left of the sheet, which is turned to fit the board.
Letters: n rectangles.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.boards.board import PAPER_WH_M, Board
from telewide.boards.pattern import black_rectangles_m
from telewide.boards.pdf import Page, TextLine, pdf_from_page
from telewide.errors import UsageError
from telewide.files import replacing
from telewide.geometry.arrays import FloatArray

RULER_M = 0.1
_MARGIN_M = 0.008  # printers leave up to 6 mm of a sheet blank
_FOOT_M = 0.016  # for the ruler, with white between it and the board
_RULER_UP_M = 0.0115  # its base line, from the lower edge of the sheet
_LINE_M = 0.0002
_TICK_M = {10: 0.0035, 5: 0.0025, 1: 0.0015}  # length of the mark at every so many mm
_TYPE_M = 0.0026


def board_page(board: Board, *, name: str) -> Page:
    """Lay a board out on its paper.

    Args:
        board: the board; its paper and its size count.
        name: of the board, to be printed.

    Returns:
        The page: what is black of the board, then the ruler, with a line that names the board and its size.

    Raises:
        UsageError: the board does not fit on its paper.
    """
    width_m, height_m = board.wh_m
    page_wh_m = _page_wh_m(board)
    _check_fit(board, page_wh_m)
    free_m = page_wh_m[1] - _FOOT_M - _MARGIN_M - height_m
    # In the middle of the sheet where the ruler lets it.
    top_m = min((page_wh_m[1] - height_m) / 2, _MARGIN_M + free_m)
    origin_m = ((page_wh_m[0] - width_m) / 2, top_m)
    pattern_m = black_rectangles_m(board) + np.array([*origin_m, 0, 0])
    ruler_m, texts = _ruler(page_wh_m[1])
    told = TextLine(_description(board, name), (_MARGIN_M + RULER_M + 0.012, page_wh_m[1] - _RULER_UP_M), _TYPE_M)
    check = TextLine(
        f"Print at 100 %. The ruler is {RULER_M * 1000:.0f} mm long; if yours is not, measure a square.",
        (told.at_m[0], page_wh_m[1] - _RULER_UP_M + 1.5 * _TYPE_M),
        _TYPE_M,
    )
    return Page(page_wh_m, np.concatenate([pattern_m, ruler_m]), (*texts, told, check), f"telewide board {name}")


def write_board(path: Path, board: Board, *, name: str) -> None:
    """Write a board as a PDF to print.

    Args:
        path: the file.
        board: the board.
        name: of the board, to be printed.

    Raises:
        UsageError: the board does not fit on its paper, or the place cannot be written.
    """
    data = pdf_from_page(board_page(board, name=name))
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def largest_square_m(board: Board) -> float:
    """Largest side of a square, in whole tenths of a millimetre, with which a board fits on its paper.

    Args:
        board: the board; its proportions and its paper count.
    """
    page_wh_m = _page_wh_m(board)
    room_m = (page_wh_m[0] - 2 * _MARGIN_M, page_wh_m[1] - _MARGIN_M - _FOOT_M)
    scale = min(room / length for room, length in zip(room_m, board.wh_m, strict=True))
    return float(np.floor(board.square_m * scale * 1e4 + 1e-6) / 1e4)


def _page_wh_m(board: Board) -> tuple[float, float]:
    short_m, long_m = PAPER_WH_M[board.paper]
    width_m, height_m = board.wh_m
    return (long_m, short_m) if width_m >= height_m else (short_m, long_m)


def _check_fit(board: Board, page_wh_m: tuple[float, float]) -> None:
    width_m, height_m = board.wh_m
    if width_m > page_wh_m[0] - 2 * _MARGIN_M + 1e-9 or height_m > page_wh_m[1] - _MARGIN_M - _FOOT_M + 1e-9:
        larger = ", or a larger paper" if board.paper == "A4" else ""
        raise UsageError(
            f"with squares of {board.square_m * 1000:g} mm the board is {width_m * 1000:.0f} x {height_m * 1000:.0f} mm"
            f"; that does not fit on {board.paper}",
            hint=f"squares of at most {largest_square_m(board):g} m fit on {board.paper}{larger}",
        )


def _description(board: Board, name: str) -> str:
    counted = {"chessboard": "inner corners", "charuco": "squares", "aruco_grid": "markers"}[board.kind]
    sizes = [f"{'marker' if board.kind == 'aruco_grid' else 'square'} {board.square_m * 1000:.4g} mm"]
    if board.marker_m is not None:
        sizes.append(f"marker {board.marker_m * 1000:.4g} mm")
    if board.gap_m is not None:
        sizes.append(f"gap {board.gap_m * 1000:.4g} mm")
    if board.dictionary is not None:
        sizes.append(board.dictionary)
    return f"{name}: {board.columns} x {board.rows} {counted}, {', '.join(sizes)}, {board.paper}"


def _ruler(page_height_m: float) -> tuple[FloatArray, tuple[TextLine, ...]]:
    """A ruler at the lower left: the outer edges of its first and last mark are RULER_M apart."""
    x_m, y_m = _MARGIN_M + 0.002, page_height_m - _RULER_UP_M
    rectangles = [(x_m, y_m, RULER_M, _LINE_M)]
    texts = []
    n_mm = round(RULER_M * 1000)
    for mm in range(n_mm + 1):
        step = next(step for step in _TICK_M if mm % step == 0)
        # The first mark begins on its place, the last ends there, the others are centred.
        back_m = _LINE_M * mm / n_mm
        length_m = _TICK_M[step]
        rectangles.append((x_m + mm / 1000 - back_m, y_m + _LINE_M, _LINE_M, length_m))
        if step == 10:
            texts.append(TextLine(f"{mm}", (x_m + mm / 1000 - 0.0011, y_m + length_m + 0.0022), 0.0018))
    return np.array(rectangles), tuple(texts)
