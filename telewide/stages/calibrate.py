"""Board photos in, a rig and a page about it out.

    boards/ ── find ── which board ── corners of every photo ── solve ── rig.yaml + rig_report.html

Progress is reported to an :class:`Observer`. A rig that is not good enough is written too, and marked; refusing it is
up to the caller.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from telewide.boards.board import Board, board_points_m, load_board, resized_board
from telewide.boards.kept_photos import KeptPhotos
from telewide.boards.photo_facts import with_checked_facts
from telewide.boards.recognition import recognise_board
from telewide.boards.shots import BoardShot, detect_shots, find_board_shots
from telewide.calibration.exchanged_lenses import refuse_exchanged
from telewide.calibration.result import Calibration
from telewide.calibration.rig_file import RIG_FILE, RigFacts, stored_rig, write_stored_rig
from telewide.calibration.solver import calibrate_rig
from telewide.capture.exif import UPRIGHT_DEG, common_pipeline, read_photo_facts
from telewide.capture.pair import Capture, read_photos
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import is_folder
from telewide.pages.board_rig import board_rig_page
from telewide.pages.report import NextStep
from telewide.pages.rig_page import write_rig_page
from telewide.stages.observer import Observer
from telewide.stages.rig_run import (
    CAPTURES_FOLDER,
    CalibrationRun,
    RectifiedPreview,
    rectified_preview,
    report_facts,
    report_path,
    stated_rig,
    steps_with_rig,
)
from telewide.text import Invocation, command_line, counted


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of a calibration from photos of a board.

    Attributes:
        board: name or file of the board; None looks for the known ones.
        square_m: measured side of a square, m; None takes the board's nominal one.
        out: the file to write; the report lies beside it.
        seed: of the choice of photos that are held out.
        processes: how many to work with; None takes one per core.
    """

    board: str | None = None
    square_m: float | None = None
    out: Path = RIG_FILE
    seed: int = 0
    processes: int | None = None


@dataclass(frozen=True)
class ChosenBoard:
    """The board that the photos show.

    Attributes:
        name: its name or file.
        board: at the size of the print.
        is_measured: whether somebody measured that size.
        notes: what a person should know.
    """

    name: str
    board: Board
    is_measured: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class SolvedBoards:
    """A calibration and the photos it was made from.

    Attributes:
        shots: the photos.
        calibration: the rig and all that is known about it.
        board: what the photos show.
        facts: how the rig was made.
        notes: what a person should know, one sentence each.
        photos: those that were decoded first, for the page.
    """

    shots: tuple[BoardShot, ...]
    calibration: Calibration
    board: ChosenBoard
    facts: RigFacts
    notes: tuple[str, ...]
    photos: KeptPhotos


def calibrate_boards(boards: Path, *, options: CalibrateOptions, observer: Observer) -> CalibrationRun:
    """Calibrate two lenses from photos of a board, and write the rig and its report.

    Args:
        boards: folder of the photos, in one of the layouts of `telewide.boards.shots`.
        options: board, size, output.
        observer: is told of the progress.

    Returns:
        The calibration, of any verdict, with the files written.

    Raises:
        UsageError: no such folder or board, or a size no board has.
        InputError: no photo shows the board, the two lenses are exchanged, or no rig explains the photos.
    """
    solved = calibrate_shots(boards, options=options, observer=observer)
    stored = stored_rig(solved.calibration, facts=solved.facts)
    write_stored_rig(options.out, stored)
    report = _write_report(boards, solved, options=options)
    return CalibrationRun(stored, options.out, report, solved.notes)


def calibrate_shots(boards: Path, *, options: CalibrateOptions, observer: Observer) -> SolvedBoards:
    """Calibrate two lenses from photos of a board; nothing is written.

    Args:
        boards: folder of the photos, in one of the layouts of `telewide.boards.shots`.
        options: board and size.
        observer: is told of the progress.

    Returns:
        The calibration, of any verdict.

    Raises:
        UsageError: no such folder or board, or a size no board has.
        InputError: no photo shows the board, the two lenses are exchanged, or no rig explains the photos.
    """
    shots = with_checked_facts(_found_shots(boards))
    observer.said(f"{counted(len(shots), 'shot')} in {boards}")
    pipeline = common_pipeline(_paths(shots))
    photos = _first_photos(shots)
    chosen = _chosen_board(shots, options, photos=photos, observer=observer)
    tick = observer.detecting(len(shots))
    detected = detect_shots(
        shots, board=chosen.board, tick=lambda _: tick(), processes=options.processes, photos=photos
    )
    n_tele = sum(shot.tele is not None for shot in detected)
    n_wide = sum(shot.wide is not None for shot in detected)
    observer.said(f"board found in {n_tele} tele and {n_wide} wide photos; calibrating")
    refuse_exchanged(shots, detected)
    calibration = calibrate_rig(detected, board_points_m=board_points_m(chosen.board), seed=options.seed)
    notes = (
        *chosen.notes,
        *(f"{shot.name}: {note}" for shot in detected for note in shot.notes),
        *(f"left out: {v.shot}, {v.camera}: {v.reason}" for v in calibration.views if not v.is_used),
    )
    facts = RigFacts(
        image_pipeline=pipeline,
        orientations=_orientations(shots),
        focus_distance_m=_focus_distance_m(shots),
        scale_verified=chosen.is_measured,
        board=chosen.name,
        notes=chosen.notes,
    )
    return SolvedBoards(shots=shots, calibration=calibration, board=chosen, facts=facts, notes=notes, photos=photos)


def _found_shots(boards: Path) -> tuple[BoardShot, ...]:
    try:
        return find_board_shots(boards)
    except UsageError as error:
        scenes = command_line("calibrate", CAPTURES_FOLDER, from_scenes=True)
        hint = (
            f"print a board ({command_line('board')} lists them), photograph it with both lenses into "
            f"{boards}/1/tele.jpg and wide.jpg, and so on; or go without one, from captures of scenes: {scenes}"
        )
        raise UsageError(error.message, hint=hint) from error


def _orientations(shots: Sequence[BoardShot]) -> tuple[int, int] | None:
    """Find how the phone was held, in EXIF's words, in the shots others are turned to; None where none says it."""
    for shot in shots:
        if shot.tele_path is None or shot.wide_path is None or shot.tele_turn_deg or shot.wide_turn_deg:
            continue
        with suppress(InputError):
            tele, wide = (read_photo_facts(path).orientation for path in (shot.tele_path, shot.wide_path))
            if {tele, wide} <= UPRIGHT_DEG.keys():
                return tele, wide
    return None


def _focus_distance_m(shots: Sequence[BoardShot]) -> float | None:
    """Where the tele lens was focused in the joint shots, by its photos; None where they do not say."""
    stated = []
    for shot in shots:
        if shot.tele_path is not None and shot.wide_path is not None:
            with suppress(InputError):
                stated.append(read_photo_facts(shot.tele_path).subject_distance_m)
    known = [distance_m for distance_m in stated if distance_m is not None and math.isfinite(distance_m)]
    return statistics.median(known) if known else None


def _paths(shots: Sequence[BoardShot]) -> list[Path]:
    return [path for shot in shots for path in (shot.tele_path, shot.wide_path) if path is not None]


def _first_photos(shots: Sequence[BoardShot]) -> KeptPhotos:
    """Decode the joint shot in the middle of the series, which the page is to show, and keep it."""
    photos = KeptPhotos()
    joint = [(shot.tele_path, shot.wide_path) for shot in shots if shot.tele_path and shot.wide_path]
    for path in joint[len(joint) // 2] if joint else ():
        with suppress(TelewideError):  # the detection says what is wrong with it
            photos.read_grey(path)
    return photos


def _chosen_board(
    shots: Sequence[BoardShot], options: CalibrateOptions, *, photos: KeptPhotos, observer: Observer
) -> ChosenBoard:
    others: tuple[str, ...] = ()
    if options.board is not None:
        name, board = options.board, load_board(options.board)
    else:
        recognised = recognise_board(shots, photos=photos)
        name, board, others = recognised.name, recognised.board, recognised.same_pattern
        observer.said(f"the photos show the board {name}")
    if options.square_m is not None:
        return ChosenBoard(name, resized_board(board, square_m=options.square_m), True, ())
    also = "".join(f"; {other} looks the same with {load_board(other).square_m * 1e3:g} mm" for other in others)
    note = (
        f"the squares are taken as {board.square_m * 1e3:g} mm, the nominal size of {name}{also}: metres are only as "
        "true as that; measure a square of your print and give --square-m"
    )
    return ChosenBoard(name, board, False, (note,))


def _write_report(boards: Path, solved: SolvedBoards, *, options: CalibrateOptions) -> Path:
    calibration, chosen = solved.calibration, solved.board
    square = "measured" if chosen.is_measured else "nominal, not measured"
    facts = {
        "board": f"{chosen.name}, squares of {chosen.board.square_m * 1e3:g} mm ({square})",
        "photos": str(boards),
    }
    rectified = _rectified_shot(solved)
    steps = _next_steps(boards, calibration, options)
    page = board_rig_page(calibration, facts=report_facts(options.out, facts), next_steps=steps, rectified=rectified)
    return write_rig_page(report_path(options.out), page)


def calibrate_call(boards: Path, options: CalibrateOptions) -> Invocation:
    """The call that makes this rig from these photos, for the calls advised after it."""
    stated = {"board": options.board, "square_m": options.square_m, "seed": options.seed or None}
    return Invocation("calibrate", (boards,), {**stated, "out": stated_rig(options.out)})


def captures_beside(boards: Path) -> Path:
    """Find the captures beside a folder of board photos; where there are none, name the folder they usually lie in."""
    beside = boards.parent / CAPTURES_FOLDER
    return beside if is_folder(beside) else CAPTURES_FOLDER


def _next_steps(boards: Path, calibration: Calibration, options: CalibrateOptions) -> tuple[NextStep, ...]:
    call = calibrate_call(boards, options)
    steps = []
    if calibration.quality.verdict != "good":
        steps.append(NextStep("Add such photos to the folder and calibrate again:", call.again()))
    if options.square_m is None:
        told = "Measure ten squares of your print with a ruler and give a tenth, in metres:"
        steps.append(NextStep(told, call.again(square_m="M")))
    if calibration.quality.verdict != "insufficient":
        steps += steps_with_rig(captures_beside(boards), options.out)
    return tuple(steps)


def _rectified_shot(solved: SolvedBoards) -> RectifiedPreview | None:
    """The joint shot whose board is at the middle distance, of those still decoded if any, rectified; None for none."""
    used = {(view.shot, view.camera): view for view in solved.calibration.views if view.is_used}
    by_name = {shot.name: shot for shot in solved.shots if not (shot.tele_turn_deg or shot.wide_turn_deg)}
    joint = [name for name, lens in used if lens == "tele" and (name, "wide") in used and name in by_name]
    if not joint:
        return None
    kept = [name for name in joint if {by_name[name].tele_path, by_name[name].wide_path} <= solved.photos.paths]
    far_first = sorted(kept or joint, key=lambda name: -_finite(used[name, "tele"].distance_m))
    shot = by_name[far_first[len(far_first) // 2]]
    if shot.tele_path is None or shot.wide_path is None:
        return None
    try:
        photos = read_photos(Capture(shot.name, shot.tele_path, shot.wide_path), read=solved.photos.read_colour)
    except TelewideError:
        return None
    return rectified_preview(photos, rig=solved.calibration.rig)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0
