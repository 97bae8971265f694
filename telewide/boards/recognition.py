"""Recognition of the known board that photos show.

A few photos are enough, and reduced ones: only the pattern is asked for, not its exact place. Boards that differ in
the size of their squares alone look the same in every photo, so all of them are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from telewide.boards.board import Board, board_points_m, list_boards, load_board
from telewide.boards.detection import BoardView, detect_board
from telewide.boards.kept_photos import KeptPhotos
from telewide.boards.shots import BoardShot
from telewide.errors import InputError
from telewide.geometry.arrays import ByteImage

_MAX_SHOTS = 6
_ENOUGH_PHOTOS = 2
_LONGEST_PX = 1600
_FEWEST_CORNERS = 8
_FLATNESS = 0.02  # of the board's extent in the photo: more than a lens bends it, less than a wrong board is off


@dataclass(frozen=True)
class RecognisedBoard:
    """The known board that photos show.

    Attributes:
        name: of the board that explains most of them.
        board: that board at its nominal size.
        same_pattern: names of the other boards that look the same and differ in size alone.
    """

    name: str
    board: Board
    same_pattern: tuple[str, ...] = ()


def recognise_board(shots: Sequence[BoardShot], *, photos: KeptPhotos | None = None) -> RecognisedBoard:
    """Find the shipped board that a few of the photos show.

    Args:
        shots: the board photos; a few are looked at, spread over all.
        photos: keeps those that were looked at; None for none.

    Returns:
        The board with most corners found.

    Raises:
        InputError: none of them shows a known board; the message lists those that were tried.
    """
    boards = {name: load_board(name) for name in list_boards()}
    patterns = _patterns(boards)
    corners = dict.fromkeys(patterns, 0)
    photos = photos or KeptPhotos(max_bytes=0)
    n_seen = 0
    for path in _sample_paths(shots):
        try:
            grey_u8 = _reduced(photos.read_grey(path))
        except InputError:  # the detection says what is wrong with it
            continue
        found = {pattern: _count_corners(grey_u8, boards[names[0]]) for pattern, names in patterns.items()}
        for pattern, count in found.items():
            corners[pattern] += count
        n_seen += any(found.values())
        if n_seen == _ENOUGH_PHOTOS:
            break
    best = max(corners, key=lambda pattern: corners[pattern], default="")
    if not corners.get(best):
        raise InputError(
            f"no known board was found in {len(shots)} shots; tried: {', '.join(boards)}",
            hint="name yours with `board` (a name above or a YAML file), or photograph one that telewide printed",
        )
    name, *others = patterns[best]
    return RecognisedBoard(name, boards[name], tuple(others))


def _patterns(boards: dict[str, Board]) -> dict[str, list[str]]:
    """Names by what a photo can tell: all but the size and the paper."""
    grouped: dict[str, list[str]] = {}
    for name, board in boards.items():
        pattern = repr((board.kind, board.columns, board.rows, board.dictionary, board.first_marker))
        legacy = repr(board.legacy_pattern)
        grouped.setdefault(f"{pattern}{legacy}", []).append(name)
    return grouped


def _sample_paths(shots: Sequence[BoardShot]) -> list[Path]:
    chosen = np.unique(np.linspace(0, len(shots) - 1, min(_MAX_SHOTS, len(shots))).round().astype(int))
    # The middle of a series shows the board best; its ends are often a slip.
    middle_first = sorted(chosen, key=lambda index: abs(index - (len(shots) - 1) / 2))
    paths = [(shots[index].tele_path, shots[index].wide_path) for index in middle_first]
    return [path for both in paths for path in both if path is not None]


def _count_corners(grey_u8: ByteImage, board: Board) -> int:
    view = detect_board(grey_u8, board=board)
    return len(view.ids) if view is not None and _is_flat(view, board) else 0


def _is_flat(view: BoardView, board: Board) -> bool:
    """Whether one homography carries the board to the photo: boards that share their markers place them differently."""
    if len(view.ids) < _FEWEST_CORNERS:
        return False
    board_m = board_points_m(board)[view.ids][:, :2]
    photo_from_board, _ = cv2.findHomography(board_m, view.points_px, 0)
    if photo_from_board is None:
        return False
    carried = cv2.perspectiveTransform(board_m[:, None], photo_from_board)[:, 0]
    off_px = np.linalg.norm(carried - view.points_px, axis=1)
    return bool(np.median(off_px) < _FLATNESS * np.ptp(view.points_px, axis=0).max())


def _reduced(grey_u8: ByteImage) -> ByteImage:
    scale = _LONGEST_PX / max(grey_u8.shape)
    if scale >= 1:
        return grey_u8
    return np.asarray(cv2.resize(grey_u8, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
