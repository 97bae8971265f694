"""Detected shots as arrays, and why a view cannot take part.

Letters: S shots; V views of a lens; N corners of the board.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from telewide.boards.detection import BoardView
from telewide.boards.shots import DetectedShot
from telewide.calibration.problem import Sightings
from telewide.calibration.result import Lens
from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray

LENSES: tuple[Lens, Lens] = ("tele", "wide")
MIN_CORNERS = 6
"""A pose has six numbers; four corners give eight, which would say nothing about their error."""
MIN_VIEWS = 3
_MIN_WIDTH = 0.1
"""Corners whose spread across is below this share of their spread along lie in a line."""


@dataclass(frozen=True)
class Gathered:
    """All views that can take part, and the reasons of those that cannot.

    Attributes:
        views: of tele and wide.
        unfit: reason by shot index and lens index.
    """

    views: tuple[Sightings, Sightings]
    unfit: dict[tuple[int, int], str]


def gather(
    shots: Sequence[DetectedShot], *, board_points_m: FloatArray, set_aside: Mapping[tuple[int, int], str] | None = None
) -> Gathered:
    """Sort the detected views into arrays, lens by lens.

    Args:
        shots: S detected shots.
        board_points_m: (N, 3) corners by id.
        set_aside: views that are not to take part: reason by shot index and lens index.

    Returns:
        The views that can take part.

    Raises:
        InputError: a lens has fewer than three views.
        ValueError: a corner id that the board does not have.
    """
    unfit: dict[tuple[int, int], str] = dict(set_aside or {})
    sizes = _sizes(shots)
    gathered = []
    for lens, name in enumerate(LENSES):
        seen = [(index, view) for index, shot in enumerate(shots) if (view := view_of(shot, lens)) is not None]
        fit = []
        hw = sizes[lens]
        for index, view in seen:
            if (index, lens) in unfit:
                continue
            reason = _unfit_reason(view, hw=hw, board_points_m=board_points_m, name=name)
            if reason:
                unfit[index, lens] = reason
            else:
                fit.append((index, view))
        if len(fit) < MIN_VIEWS:
            raise InputError(
                f"the board was found in {len(fit)} usable {name} photo{'' if len(fit) == 1 else 's'}; "
                f"at least {MIN_VIEWS} are needed, 10 or more are better" + _first_reason(unfit, lens),
                hint=f"photograph the whole board with the {name} lens, sharp, filling the frame, tilted to all sides",
            )
        gathered.append(_stacked(fit, n_corners=len(board_points_m), hw=hw))
    return Gathered((gathered[0], gathered[1]), unfit)


def _sizes(shots: Sequence[DetectedShot]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Sizes of the photos of tele and wide that take part: those of most joint shots, so that both lenses have one."""
    joint = Counter((shot.tele.hw, shot.wide.hw) for shot in shots if shot.tele is not None and shot.wide is not None)
    if joint:
        return joint.most_common(1)[0][0]
    tele, wide = (Counter(view.hw for shot in shots if (view := view_of(shot, lens)) is not None) for lens in (0, 1))
    return tele.most_common(1)[0][0] if tele else (0, 0), wide.most_common(1)[0][0] if wide else (0, 0)


def view_of(shot: DetectedShot, lens: int) -> BoardView | None:
    """A shot's view by lens index: 0 tele, 1 wide."""
    return shot.wide if lens else shot.tele


def square_px(points_px: FloatArray) -> float:
    """Median distance of each corner (N, 2) to its nearest neighbour."""
    return float(np.median(cKDTree(points_px).query(points_px, k=2)[0][:, 1]))


def _unfit_reason(view: BoardView, *, hw: tuple[int, int], board_points_m: FloatArray, name: str) -> str:
    if len(view.ids) and not (view.ids.min() >= 0 and view.ids.max() < len(board_points_m)):
        raise ValueError(f"corner ids reach {view.ids.max()}; the board has {len(board_points_m)} corners")
    if view.hw != hw:
        sizes = f"{view.hw[1]} x {view.hw[0]} px, but most {name} photos are {hw[1]} x {hw[0]}"
        how = "hold the phone alike for all board photos, and turn the board instead"
        return f"the photo is turned: {sizes}; {how}" if view.hw == hw[::-1] else sizes
    if len(view.ids) < MIN_CORNERS:
        return f"only {len(view.ids)} corners were found, {MIN_CORNERS} are needed"
    for points in (board_points_m[view.ids, :2], view.points_px):
        spreads = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spreads[1] < _MIN_WIDTH * spreads[0]:
            return "its corners lie nearly in one line"
    return ""


def _first_reason(unfit: dict[tuple[int, int], str], lens: int) -> str:
    reasons = [reason for (_, which), reason in unfit.items() if which == lens]
    return f" ({len(reasons)} more could not be used: {reasons[0]})" if reasons else ""


def _stacked(fit: Sequence[tuple[int, BoardView]], *, n_corners: int, hw: tuple[int, int]) -> Sightings:
    points_px = np.zeros((len(fit), n_corners, 2))
    is_seen = np.zeros((len(fit), n_corners), dtype=bool)
    for row, (_, view) in enumerate(fit):
        points_px[row, view.ids], is_seen[row, view.ids] = view.points_px, True
    return Sightings(np.array([index for index, _ in fit]), points_px, is_seen, hw)
