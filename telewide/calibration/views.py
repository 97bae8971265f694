"""What every photo had to do with a calibration, for the report.

Letters: S shots; N corners seen in a view.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.detect import BoardView
from telewide.calibration.distortion import project
from telewide.calibration.extrinsics import Agreement
from telewide.calibration.problem import State
from telewide.calibration.result import ViewResult
from telewide.calibration.shots import DetectedShot
from telewide.calibration.sightings import LENSES, Gathered, square_px, view_of

FloatArray = NDArray[np.float64]


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
    typical = agreed.alone_px[lens][agreed.is_used(lens)]
    usual_px = float(np.median(typical)) if len(typical) else float("nan")
    if not agreed.alone[lens][index]:
        return (
            f"the corners do not fit a board: off by {agreed.alone_px[lens][index]:.2f} px, others by {usual_px:.2f}; "
            "blurred, moved during the exposure, taken with the other lens, or another board"
        )
    pair = [agreed.together_px[k][index] for k in (0, 1)]
    return (
        "its tele and wide photo disagree about where the board is: off by "
        f"{pair[0]:.2f} px in tele and {pair[1]:.2f} px in wide; they do not belong together, or something moved"
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
    )
