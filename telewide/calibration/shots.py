"""Board photos in a folder, and the corners found in them.

<shot>/tele.*           <shot>/wide.*           a folder per shot; one of the two may be missing
tele/<shot>.*           wide/<shot>.*           a folder per lens
tele_close/<photo>.*    wide_close/<photo>.*    photos of one lens alone
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from telewide.calibration.boards import Board
from telewide.calibration.detect import BoardView


@dataclass(frozen=True)
class BoardShot:
    """Photos of a board taken at once, or of one lens alone.

    Attributes:
        name: unique in its folder; ``tele_close/<photo>`` for a photo of one lens alone.
        tele_path: photo of the tele camera, if there is one.
        wide_path: photo of the wide camera, if there is one.
        notes: what was chosen or left aside, for people.
    """

    name: str
    tele_path: Path | None
    wide_path: Path | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class DetectedShot:
    """The corners found in a shot; a corner has the same id in both views.

    Attributes:
        name: of the shot.
        tele: corners in the tele photo, or None where there is no photo or no board in it.
        wide: corners in the wide photo, likewise.
        notes: what went wrong, for people.
    """

    name: str
    tele: BoardView | None
    wide: BoardView | None
    notes: tuple[str, ...] = ()


Tick = Callable[[DetectedShot], None]


def find_board_shots(folder: Path) -> tuple[BoardShot, ...]:
    """Find the board photos in a folder, in any of the layouts above, also mixed.

    Args:
        folder: holds the photos.

    Returns:
        The shots, sorted by name, never empty.

    Raises:
        UsageError: there is no such folder.
        InputError: it holds no board photos.
    """
    raise NotImplementedError


def detect_shots(
    shots: Sequence[BoardShot], *, board: Board, tick: Tick | None = None, processes: int | None = None
) -> tuple[DetectedShot, ...]:
    """Find the board in every photo, several at a time.

    Args:
        shots: the photos.
        board: what they show.
        tick: called with each shot when it is done, in the order of the shots.
        processes: how many to work with; None takes one per core. The result does not depend on it.

    Returns:
        One for each shot, in their order; a photo that cannot be used is a note.

    Raises:
        InputError: the board is in none of the photos.
    """
    raise NotImplementedError
