"""Part of every photo in a calibration, for the report.

Letters: S shots; N corners seen in a view.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from telewide.boards.detection import BoardView
from telewide.boards.shots import DetectedShot
from telewide.calibration.distortion import project
from telewide.calibration.extrinsics import Agreement
from telewide.calibration.intrinsics import largest_agreeing_px
from telewide.calibration.problem import State
from telewide.calibration.result import ViewResult
from telewide.calibration.sightings import LENSES, Gathered, square_px, view_of
from telewide.geometry.arrays import FloatArray

_SLIGHTLY_PX = 1.0
"""Another lens or another board is off by more."""


def view_results(
    shots: Sequence[DetectedShot], gathered: Gathered, agreed: Agreement, *, state: State, board_m: FloatArray
) -> tuple[ViewResult, ...]:
    """Describe every view in which the board was found.

    Args:
        shots: S detected shots.
        gathered: which of their views could take part.
        agreed: which of those did, and where the boards of the others are best placed.
        state: the solution.
        board_m: (N, 3) corners by id.

    Returns:
        The views in the order of the shots, tele before wide.
    """
    results = []
    for index, shot in enumerate(shots):
        for lens in (0, 1):
            view = view_of(shot, lens)
            if view is None:
                continue
            reason = gathered.unfit.get((index, lens))
            if reason is not None:
                results.append(_unfit(shot.name, view, lens=lens, reason=reason))
                continue
            is_used = bool(agreed.is_used(lens)[index])
            placed = state if is_used else agreed.state
            reason = "" if is_used else _reason(agreed, index, lens)
            points_m = placed.points_m(board_m[view.ids], lens=lens, shot=np.array([index]))[0]
            results.append(_result(shot.name, view, points_m, lens=lens, reason=reason, numbers=placed.lenses[lens]))
    return tuple(results)


def _reason(agreed: Agreement, index: int, lens: int) -> str:
    """Say what the figure is, what it is held against, and what may have caused it."""
    name = LENSES[lens]
    if not agreed.alone[lens][index]:
        off_px = agreed.alone_px[lens][index]
        usual_px = float(np.median(agreed.alone_px[lens][agreed.alone[lens]])) if agreed.alone[lens].any() else np.nan
        causes = "blurred, or board or phone moved during the exposure"
        if off_px > _SLIGHTLY_PX:
            causes += "; or taken with another lens, or of another board"
        return (
            f"its corners do not fit a board: their typical error along x or y is {off_px:.2f} px, in the other {name} "
            f"photos {usual_px:.2f} px, and {largest_agreeing_px(agreed.alone_px[lens]):.2f} px would agree; {causes}"
        )
    candidates = agreed.alone[0] & agreed.alone[1]
    tele_px, wide_px = (float(errors_px[index]) for errors_px in agreed.together_px)
    most_tele_px, most_wide_px = (largest_agreeing_px(errors_px[candidates]) for errors_px in agreed.together_px)
    causes = "something moved between the two photos"
    if max(tele_px, wide_px) > _SLIGHTLY_PX:
        causes += ", or they do not belong together"
    return (
        "its tele and wide photo disagree about where the board is: with one place for both, the typical error along x "
        f"or y is {tele_px:.2f} px in tele and {wide_px:.2f} px in wide, and {most_tele_px:.2f} and "
        f"{most_wide_px:.2f} px would agree; {causes}"
    )


def _result(
    name: str, view: BoardView, points_m: FloatArray, *, lens: int, reason: str, numbers: FloatArray
) -> ViewResult:
    is_in_front = bool(np.all(points_m[:, 2] > 0))
    residuals_px = view.points_px - project(points_m, numbers) if is_in_front else np.full(view.points_px.shape, np.nan)
    sides = np.linalg.svd(points_m - points_m.mean(axis=0))[2]
    return ViewResult(
        shot=name,
        camera=LENSES[lens],
        rms_px=float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1)))),
        n=len(view.ids),
        is_used=not reason,
        reason=reason,
        ids=view.ids,
        points_px=view.points_px,
        residuals_px=residuals_px,
        tilt_deg=float(np.degrees(np.arccos(min(abs(sides[2, 2]), 1.0)))),
        distance_m=float(points_m[:, 2].mean()),
        square_px=square_px(view.points_px),
    )


def _unfit(name: str, view: BoardView, *, lens: int, reason: str) -> ViewResult:
    nan = float("nan")
    return ViewResult(
        shot=name,
        camera=LENSES[lens],
        rms_px=nan,
        n=len(view.ids),
        is_used=False,
        reason=reason,
        ids=view.ids,
        points_px=view.points_px,
        residuals_px=np.full(view.points_px.shape, np.nan),
        tilt_deg=nan,
        distance_m=nan,
        square_px=square_px(view.points_px) if len(view.ids) > 1 else nan,
        is_fit=False,
    )
