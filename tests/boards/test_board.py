"""Boards: the files that ship, what a board may be, and where OpenCV puts the same corners and markers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.boards.board import (
    PAPER_WH_M,
    Board,
    board_points_m,
    list_boards,
    load_board,
    marker_squares,
    on_paper,
    resized_board,
)
from telewide.boards.chessboard import symmetric_ids
from telewide.boards.pattern import aruco_dictionary, black_rectangles_m, marker_cells, marker_origins_m
from telewide.errors import InputError, UsageError


def charuco(columns: int, rows: int, *, legacy: bool = False) -> Board:
    return Board(
        kind="charuco",
        columns=columns,
        rows=rows,
        square_m=0.03,
        marker_m=0.021,
        dictionary="DICT_5X5_100",
        legacy_pattern=legacy,
    )


def opencv_board(board: Board) -> cv2.aruco.CharucoBoard:
    size = (board.columns, board.rows)
    theirs = cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, aruco_dictionary(board))
    theirs.setLegacyPattern(board.legacy_pattern)
    return theirs


def test_every_shipped_board_loads_and_fits_its_paper() -> None:
    assert {"chessboard_9x6", "charuco_a4", "charuco_a3", "aruco_grid_a4"} <= set(list_boards())
    for name in list_boards():
        board = load_board(name)
        assert len(board_points_m(board)) == board.n_corners
        assert max(board.wh_m) < max(PAPER_WH_M[board.paper])
        assert min(board.wh_m) < min(PAPER_WH_M[board.paper])
        assert board.description


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (5, 7), (6, 4), (4, 5)])
def test_charuco_is_opencvs(columns: int, rows: int, *, legacy: bool) -> None:
    board = charuco(columns, rows, legacy=legacy)
    theirs = opencv_board(board)
    corners_m = np.asarray(theirs.getChessboardCorners()).reshape(-1, 3)
    np.testing.assert_allclose(board_points_m(board), corners_m - corners_m[0], atol=1e-7)
    markers_m = np.array([marker[0][:2] for marker in theirs.getObjPoints()])
    np.testing.assert_allclose(marker_origins_m(board), markers_m, atol=1e-7)
    assert board.n_markers == len(marker_squares(board)) == len(markers_m)


def test_aruco_grid_is_opencvs() -> None:
    board = load_board("aruco_grid_a4")
    theirs = cv2.aruco.GridBoard((board.columns, board.rows), board.square_m, board.gap_m, aruco_dictionary(board))
    np.testing.assert_allclose(board_points_m(board), np.concatenate(theirs.getObjPoints()), atol=1e-7)


@pytest.mark.parametrize("legacy", [False, True])
def test_what_is_black_is_what_opencv_draws(*, legacy: bool) -> None:
    board = charuco(6, 4, legacy=legacy)
    px_per_m = 60 / board.square_m  # 42 px a marker, 6 px a cell, 9 px around it
    drawn = opencv_board(board).generateImage((360, 240), marginSize=0, borderBits=1)
    ours = np.full((240, 360), 255, np.uint8)
    for x, y, w, h in np.rint(black_rectangles_m(board) * px_per_m).astype(int):
        assert (ours[y : y + h, x : x + w] == 255).all(), "two rectangles overlap"
        ours[y : y + h, x : x + w] = 0
    np.testing.assert_array_equal(ours, drawn)


def test_marker_cells_are_opencvs() -> None:
    board = load_board("aruco_grid_a4")
    dictionary = aruco_dictionary(board)
    for marker in range(board.n_markers):
        cells = marker_cells(board, marker=marker)
        drawn = cv2.aruco.generateImageMarker(dictionary, marker, 10 * len(cells)) < 128
        np.testing.assert_array_equal(np.kron(cells, np.ones((10, 10), bool)), drawn)


def test_resized_board_keeps_its_proportions() -> None:
    board = load_board("charuco_a4")
    larger = resized_board(board, square_m=0.05)
    assert larger.marker_m == pytest.approx(0.036)
    np.testing.assert_allclose(board_points_m(larger), 2 * board_points_m(board))
    assert on_paper(board, paper="a3").paper == "A3"
    with pytest.raises(UsageError, match="A4 or A3"):
        on_paper(board, paper="letter")


@pytest.mark.parametrize("square_m", [24, 0.21, 0.0, -0.02, float("nan"), float("inf")])
def test_sizes_no_square_has_are_refused(square_m: float) -> None:
    with pytest.raises(UsageError, match="square of"):
        resized_board(load_board("chessboard_9x6"), square_m=square_m)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("kind: chessboard\ncolumns: 9\nrows: 6\nsquare_m: 25", "metres, not millimetres"),
        ("kind: chessboard\ncolumns: 9\nrows: 6", "square_m is missing"),
        ("kind: chessboard\ncolumns: 9\nrows: 2\nsquare_m: 0.02", "3 inner corners"),
        ("kind: charuco\ncolumns: 9\nrows: 6\nsquare_m: 0.02", "marker_m for kind: charuco"),
        ("kind: charuco\ncolumns: 9\nrows: 6\nsquare_m: 0.02\nmarker_m: 0.02\ndictionary: DICT_4X4_50", "below"),
        ("kind: chessboard\ncolumns: 9\nrows: 6\nsquare_m: 0.02\ngap_m: 0.01", "gap_m not with"),
        ("kind: chessboard\ncolums: 9\nrows: 6\nsquare_m: 0.02", "did you mean columns"),
        ("kind: dots\ncolumns: 9\nrows: 6\nsquare_m: 0.02", "chessboard"),
        ("- 1", "keys and values"),
        ("a: [", "YAML"),
    ],
)
def test_files_that_are_no_board_say_why(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=told) as caught:
        load_board(str(path))
    assert "mine.yaml" in caught.value.message


def test_unknown_boards_and_markers_are_named() -> None:
    with pytest.raises(UsageError, match="chessboard_9x6") as caught:
        load_board("chesboard_9x6")
    assert "chessboard_9x6" in (caught.value.hint or "")
    with pytest.raises(InputError, match="DICT_9X9"):
        aruco_dictionary(charuco(5, 4).model_copy(update={"dictionary": "DICT_9X9_50"}))
    with pytest.raises(InputError, match="has 100 markers"):
        aruco_dictionary(charuco(15, 15))


@pytest.mark.parametrize(("columns", "rows", "n"), [(9, 6, 1), (9, 7, 2), (8, 6, 2), (7, 7, 2), (6, 6, 4)])
def test_symmetric_boards_have_as_many_numberings_as_ways_to_turn_them(columns: int, rows: int, n: int) -> None:
    board = Board(kind="chessboard", columns=columns, rows=rows, square_m=0.02)
    numberings = symmetric_ids(board)
    assert len(numberings) == n
    # Turned about its middle the print stays as it is: distances between corners, and what is black.
    points_m = board_points_m(board)
    for numbers in numberings:
        assert sorted(numbers) == list(range(board.n_corners))
        apart_m = np.linalg.norm(points_m[numbers][:, None] - points_m[numbers][None], axis=-1)
        np.testing.assert_allclose(apart_m, np.linalg.norm(points_m[:, None] - points_m[None], axis=-1), atol=1e-12)
