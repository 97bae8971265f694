"""Board photos in a folder, and the corners found in them.

    <shot>/tele.*           <shot>/wide.*           a folder per shot; one of the two may be missing
    tele/<shot>.*           wide/<shot>.*           a folder per lens
    tele_close/<photo>.*    wide_close/<photo>.*    photos of one lens alone

Which file of several is taken: `telewide.capture.view_files`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from telewide.boards.board import Board
from telewide.boards.detection import BoardView
from telewide.boards.kept_photos import KeptPhotos
from telewide.boards.orientation import alike_numbered, turned_view
from telewide.boards.pattern import aruco_dictionary
from telewide.boards.photo_detection import PhotoResult, detect_photos
from telewide.capture.formats import READ_KINDS
from telewide.capture.view_files import (
    VIEWS,
    best_photos,
    is_picture,
    is_same_file,
    joined_by_case,
    listed,
    one_spelling,
    passed_over,
    visible_entries,
)
from telewide.errors import InputError
from telewide.files import is_folder, refuse_other_than_folder

_CLOSE_UPS = {"tele_close": "tele", "wide_close": "wide"}
_MAX_LISTED = 5
_LAYOUTS = "<shot>/tele.* with <shot>/wide.*, or tele/<shot>.* with wide/<shot>.*; tele_close/ and wide_close/ alone"


@dataclass(frozen=True)
class BoardShot:
    """Photos of a board taken at once, or of one lens alone.

    Attributes:
        name: unique in its folder; ``tele_close/<photo>`` for a photo of one lens alone.
        tele_path: photo of the tele camera, if there is one.
        wide_path: photo of the wide camera, if there is one.
        notes: what was chosen or left aside, for people.
        tele_turn_deg: how far clockwise the tele photo is to be turned to be held like most, a multiple of 90.
        wide_turn_deg: likewise of the wide photo.
    """

    name: str
    tele_path: Path | None
    wide_path: Path | None
    notes: tuple[str, ...] = ()
    tele_turn_deg: int = 0
    wide_turn_deg: int = 0


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
# name of a shot -> tele or wide -> the files that could be it
_Candidates = dict[str, dict[str, list[Path]]]


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
    refuse_other_than_folder(folder, expected="a folder with photos of a board")
    candidates: _Candidates = defaultdict(lambda: defaultdict(list))
    closed: list[BoardShot] = []
    for entry in filter(is_folder, visible_entries(folder)):
        try:
            _add_folder(candidates, entry)
        except InputError as error:
            closed.append(BoardShot(entry.name, None, None, (error.message,)))
    shots = (*(_shot(name, views) for name, views in sorted(joined_by_case(candidates).items())), *closed)
    if not shots:
        entries = visible_entries(folder)
        inside = f"it holds {listed(entries)}" if entries else "it is empty"
        raise InputError(f"{folder} holds no photos of a board: {inside}", hint=f"expected {_LAYOUTS}")
    return shots


def detect_shots(
    shots: Sequence[BoardShot],
    *,
    board: Board,
    tick: Tick | None = None,
    processes: int | None = None,
    photos: KeptPhotos | None = None,
) -> tuple[DetectedShot, ...]:
    """Find the board in every photo, several at a time.

    Args:
        shots: the photos.
        board: what they show.
        tick: called with each shot when it is done, in the order of the shots.
        processes: how many to work with; None takes one per core. The result does not depend on it.
        photos: those that are kept are not decoded again; None for none.

    Returns:
        One for each shot, in their order; a photo that cannot be used is a note.

    Raises:
        InputError: the board is in none of the photos, or it names markers that OpenCV does not have.
        MissingPartError: a photo needs a reader that is not installed.
    """
    if board.kind != "chessboard":
        aruco_dictionary(board)  # its mistakes are the board's, not the photos'
    paths = [path for shot in shots for path in (shot.tele_path, shot.wide_path) if path is not None]
    results = detect_photos(paths, board=board, processes=processes, photos=photos)
    detected: list[DetectedShot] = []
    for shot in shots:
        found = {
            view: next(results)
            for view, path in (("tele", shot.tele_path), ("wide", shot.wide_path))
            if path is not None
        }
        detected.append(_detected(shot, found, board))
        if tick is not None:
            tick(detected[-1])
    if not any(shot.tele or shot.wide for shot in detected):
        raise _nothing_found(detected, board, n_photos=len(paths))
    return tuple(detected)


def _add_folder(candidates: _Candidates, folder: Path) -> None:
    role = folder.name.casefold().replace("-", "_").replace(" ", "_")
    for file in visible_entries(folder):
        if not is_picture(file):
            continue
        stem = one_spelling(file.stem)
        if role in _CLOSE_UPS:
            candidates[f"{role}/{stem}"][_CLOSE_UPS[role]].append(file)
        elif role in VIEWS:
            candidates[stem][role].append(file)
        elif stem.casefold() in VIEWS:
            candidates[one_spelling(folder.name)][stem.casefold()].append(file)


def _shot(name: str, views: dict[str, list[Path]]) -> BoardShot:
    chosen, notes = best_photos(views), []
    for view, files in views.items():
        if view not in chosen:
            notes.append(f"{view}: {files[0]} cannot be read; {READ_KINDS} are read")
        elif passed_over(chosen[view], files):
            notes.append(f"several files for {view}: {chosen[view]} is taken")
    if len(chosen) == 2 and is_same_file(chosen["tele"], chosen["wide"]):
        notes.append("tele and wide are the same picture; it is left out")
        chosen = {}
    return BoardShot(name, chosen.get("tele"), chosen.get("wide"), tuple(notes))


def _detected(shot: BoardShot, found: dict[str, PhotoResult], board: Board) -> DetectedShot:
    notes = [*shot.notes, *(f"{view}: {result.note}" for view, result in found.items() if result.note)]
    turns_deg = {"tele": shot.tele_turn_deg, "wide": shot.wide_turn_deg}
    tele, wide = (
        turned_view(result, turns_deg[view]) if view in found and (result := found[view].view) else None
        for view in VIEWS
    )
    if tele is not None and wide is not None:
        wide, turned_note = alike_numbered(tele, wide, board=board)
        notes += [turned_note] if turned_note else []
    return DetectedShot(shot.name, tele, wide, tuple(notes))


def _nothing_found(detected: Iterable[DetectedShot], board: Board, *, n_photos: int) -> InputError:
    notes = [f"\n  {shot.name}: {note}" for shot in detected for note in shot.notes]
    more = f"\n  and {len(notes) - _MAX_LISTED} more" if len(notes) > _MAX_LISTED else ""
    counted = {"chessboard": "inner corners", "charuco": "squares", "aruco_grid": "markers"}[board.kind]
    hint = "name the board that was photographed with `board`; it must be flat, sharp and, as chessboard, whole"
    if board.kind == "charuco" and board.rows % 2 == 0:
        hint = f"{hint}; legacy_pattern: true is for boards with a marker at the top left, false for the others"
    return InputError(
        f"no {board.kind} of {board.columns} x {board.rows} {counted} in any of {n_photos} photos"
        + "".join(notes[:_MAX_LISTED])
        + more,
        hint=hint,
    )
