"""Boards to photograph: what is printed on them, and where their corners are.

Board frame: x right along the columns, y down along the rows, z into the paper, corner 0 at the origin. Corner ids
count row by row; on an ArUco grid corner 4 i + k is corner k of marker i, clockwise from its top left.
Letters: N corners.
"""

from __future__ import annotations

import difflib
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from telewide.assets import find_asset, is_yaml, list_assets
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatArray
from telewide.options import Options, parse_options
from telewide.yaml_files import read_yaml

MAX_SQUARE_M = 0.2
"""Nobody prints larger squares; a larger number was meant in millimetres."""
MIN_SQUARE_M = 0.001
PAPER_WH_M = {"A4": (0.210, 0.297), "A3": (0.297, 0.420)}
"""Width and height of a sheet held upright (ISO 216)."""
_FOLDER = "boards/"


class Board(Options):
    """A flat pattern of known size."""

    format: Literal[1] = 1
    """Version of the file format."""
    description: str = ""
    """One line for people."""
    kind: Literal["chessboard", "charuco", "aruco_grid"]
    """chessboard: plain squares; charuco: markers in its white squares; aruco_grid: markers alone."""
    columns: Annotated[int, Field(ge=2, le=200)]
    """Along x: inner corners of a chessboard, squares of a charuco, markers of an aruco_grid."""
    rows: Annotated[int, Field(ge=2, le=200)]
    """Along y, counted like the columns."""
    square_m: Annotated[float, Field(ge=MIN_SQUARE_M, allow_inf_nan=False)]
    """Side of a square; of a marker on an aruco_grid."""
    marker_m: Annotated[float, Field(ge=MIN_SQUARE_M, allow_inf_nan=False)] | None = None
    """Side of a marker inside its square; charuco alone."""
    gap_m: Annotated[float, Field(ge=MIN_SQUARE_M, allow_inf_nan=False)] | None = None
    """White between two markers; aruco_grid alone."""
    dictionary: str | None = None
    """OpenCV's name of the markers, such as DICT_5X5_100; every kind but chessboard."""
    first_marker: Annotated[int, Field(ge=0)] = 0
    """Number of the top left marker; the others follow row by row."""
    legacy_pattern: bool = False
    """charuco with an even number of rows: a marker at the top left, as before OpenCV 4.6 and from calib.io."""
    paper: Literal["A4", "A3"] = "A4"
    """Sheet to print it on."""

    @model_validator(mode="after")
    def _is_a_board(self) -> Board:
        if self.square_m > MAX_SQUARE_M:
            raise ValueError(f"square_m of at most {MAX_SQUARE_M}: metres, not millimetres; found {self.square_m}")
        needed = {"chessboard": (), "charuco": ("marker_m", "dictionary"), "aruco_grid": ("gap_m", "dictionary")}
        for key in ("marker_m", "gap_m", "dictionary"):
            if (getattr(self, key) is not None) != (key in needed[self.kind]):
                raise ValueError(f"{key} {'for' if key in needed[self.kind] else 'not with'} kind: {self.kind}")
        if self.kind == "chessboard" and min(self.columns, self.rows) < 3:
            raise ValueError(f"3 inner corners a side or more; found {self.columns} x {self.rows}")
        if self.marker_m is not None and self.marker_m >= self.square_m:
            raise ValueError(f"marker_m below square_m ({self.square_m}); found {self.marker_m}")
        return self

    @property
    def n_corners(self) -> int:
        """Number of corners; ids run from 0 to this less 1."""
        if self.kind == "aruco_grid":
            return 4 * self.columns * self.rows
        inner = 0 if self.kind == "chessboard" else 1
        return (self.columns - inner) * (self.rows - inner)

    @property
    def n_markers(self) -> int:
        """Number of markers."""
        if self.kind == "aruco_grid":
            return self.columns * self.rows
        return 0 if self.kind == "chessboard" else len(marker_squares(self))

    @property
    def wh_m(self) -> tuple[float, float]:
        """Width and height of the printed pattern, without white around it."""
        if self.kind == "aruco_grid":
            gap_m = self.gap_m or 0.0
            pitch_m = self.square_m + gap_m
            return self.columns * pitch_m - gap_m, self.rows * pitch_m - gap_m
        outer = 1 if self.kind == "chessboard" else 0
        return (self.columns + outer) * self.square_m, (self.rows + outer) * self.square_m


def load_board(name: str) -> Board:
    """Read a board by its name or path.

    Args:
        name: a name in ``calib/boards/`` such as ``chessboard_9x6``, or the path of a YAML file.

    Returns:
        The board at its nominal size.

    Raises:
        UsageError: there is no such file; the message lists the known boards.
        InputError: the file says something a board cannot have.
    """
    is_file = is_yaml(name)
    if not is_file and name not in list_boards():
        known = list_boards()
        nearest = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {nearest[0]}?" if nearest else "give one of the known boards or the path of a YAML file"
        raise UsageError(f"{name}: no such board; known: {', '.join(known) or 'none'}", hint=hint)
    path = find_asset("calib", name if is_file else _FOLDER + name)
    return parse_options(Board, read_yaml(path), source=str(path), error=InputError)


def list_boards() -> tuple[str, ...]:
    """Names that :func:`load_board` knows, sorted."""
    return tuple(name.removeprefix(_FOLDER) for name in list_assets("calib") if name.startswith(_FOLDER))


def resized_board(board: Board, *, square_m: float) -> Board:
    """The same board printed at another size: markers and gaps grow with its squares.

    Args:
        board: the board.
        square_m: measured side of a square (of a marker on an aruco_grid), m.

    Raises:
        UsageError: no board has squares of that size; over 0.2 m it was meant in millimetres.
    """
    if not MIN_SQUARE_M <= square_m <= MAX_SQUARE_M:
        raise UsageError(
            f"a square of {square_m:g} m: {MIN_SQUARE_M} to {MAX_SQUARE_M} m was expected",
            hint="give metres: 0.024 for squares of 24 mm",
        )
    scale = square_m / board.square_m
    sizes = {key: value * scale for key in ("marker_m", "gap_m") if (value := getattr(board, key)) is not None}
    return parse_options(
        Board, {**board.model_dump(), **sizes, "square_m": square_m}, source="square size", error=UsageError
    )


def on_paper(board: Board, *, paper: str) -> Board:
    """The same board for another sheet.

    Args:
        board: the board.
        paper: A4 or A3, in any case.

    Raises:
        UsageError: no such paper.
    """
    if paper.upper() not in PAPER_WH_M:
        raise UsageError(f"paper {paper}: expected {' or '.join(PAPER_WH_M)}")
    return Board.model_validate({**board.model_dump(), "paper": paper.upper()})


def board_points_m(board: Board) -> FloatArray:
    """Corners in the board's frame, by id.

    Args:
        board: the board.

    Returns:
        (N, 3) m, x right, y down, z = 0; row i is the corner with id i.
    """
    if board.kind == "aruco_grid":
        pitch_m = board.square_m + (board.gap_m or 0.0)
        corners_m = board.square_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
        points_m = (_grid(board.columns, board.rows)[:, None] * pitch_m + corners_m).reshape(-1, 2)
    else:
        inner = 0 if board.kind == "chessboard" else 1
        points_m = _grid(board.columns - inner, board.rows - inner) * board.square_m
    return np.column_stack([points_m, np.zeros(len(points_m))])


def marker_squares(board: Board) -> NDArray[np.int64]:
    """Squares of a charuco that hold a marker, in the order of the markers' numbers.

    Args:
        board: of kind charuco.

    Returns:
        (n, 2) column and row of the square, from 0.
    """
    # The top left square is black, but for the legacy pattern with an even number of rows, which begins white.
    white = 0 if board.legacy_pattern and board.rows % 2 == 0 else 1
    squares: NDArray[np.int64] = _grid(board.columns, board.rows).astype(np.int64)
    return np.asarray(squares[squares.sum(axis=1) % 2 == white], dtype=np.int64)


def _grid(columns: int, rows: int) -> FloatArray:
    """(columns * rows, 2) whole x and y, row by row."""
    y, x = np.mgrid[:rows, :columns]
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
