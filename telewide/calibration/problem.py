"""Sightings of a board, and a guess of everything behind them.

The numbers all shots share are two lenses (12 numbers each, see `distortion`) and the rig: a turn about the wide
camera's axes and a translation. Letters: S shots; V views of a lens; N corners of the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from telewide.calibration.distortion import CX, CY, N_LENS, F
from telewide.geometry.arrays import BoolArray, FloatArray

N_SHARED = 2 * N_LENS + 6
RIG = slice(2 * N_LENS, N_SHARED)


@dataclass(frozen=True)
class Sightings:
    """All views of one lens.

    Attributes:
        shot: (V,) index of each view's shot, ascending.
        points_px: (V, N, 2) corners by id; 0 where unseen.
        is_seen: (V, N) which corners a view shows.
        hw: height and width of the photos.
    """

    shot: NDArray[np.int64]
    points_px: FloatArray
    is_seen: NDArray[np.bool_]
    hw: tuple[int, int]

    def only(self, chosen: NDArray[np.bool_]) -> Sightings:
        """The views chosen by a (V,) mask."""
        return replace(self, shot=self.shot[chosen], points_px=self.points_px[chosen], is_seen=self.is_seen[chosen])


@dataclass(frozen=True)
class State:
    """A guess of everything.

    Attributes:
        lenses: (2, 12) tele, wide.
        rig_R: (3, 3) of ``wide_from_tele``.
        rig_t: (3,) of ``wide_from_tele``.
        pose_R: (S, 3, 3) of ``tele_from_board``.
        pose_t: (S, 3) of ``tele_from_board``.
    """

    lenses: FloatArray
    rig_R: FloatArray
    rig_t: FloatArray
    pose_R: FloatArray
    pose_t: FloatArray

    def points_m(self, board_m: FloatArray, *, lens: int, shot: NDArray[np.int64]) -> FloatArray:
        """Corners (N, 3) of the board in a lens's frame, (V, N, 3) for V shots."""
        in_tele = board_m @ self.pose_R[shot].transpose(0, 2, 1) + self.pose_t[shot][:, None]
        return in_tele if lens == 0 else in_tele @ self.rig_R.T + self.rig_t

    def held(self, free: BoolArray) -> State:
        """This state with what is not free, (30,), at what no photo told: no distortion, square pixels."""
        lenses = self.lenses.copy()
        for lens in (0, 1):
            nothing = ~free[lens * N_LENS : (lens + 1) * N_LENS]
            nothing[[F, CX, CY]] = False
            lenses[lens, nothing] = 0.0
        return replace(self, lenses=lenses)

    def moved(self, shared: FloatArray, poses: FloatArray) -> State:
        """This state after a step: (30,) shared numbers, (S, 6) turns and shifts of the poses in the tele frame."""
        rig_step = shared[RIG]
        return State(
            lenses=self.lenses + shared[: 2 * N_LENS].reshape(2, N_LENS),
            rig_R=Rotation.from_rotvec(rig_step[:3]).as_matrix() @ self.rig_R,
            rig_t=self.rig_t + rig_step[3:],
            pose_R=Rotation.from_rotvec(poses[:, :3]).as_matrix() @ self.pose_R,
            pose_t=self.pose_t + poses[:, 3:],
        )


@dataclass(frozen=True)
class Problem:
    """Sightings, how exact they are, and what is believed beforehand.

    Attributes:
        board_m: (N, 3) corners by id.
        views: sightings of tele and wide; None for a lens that is not there.
        sigma_px: noise of a corner along x or y, tele and wide, px.
        prior: (2, 12) centre of the lenses' prior.
        prior_std: (2, 12) its standard deviation.
    """

    board_m: FloatArray
    views: tuple[Sightings | None, Sightings | None]
    sigma_px: tuple[float, float]
    prior: FloatArray
    prior_std: FloatArray

    @property
    def both(self) -> tuple[Sightings, Sightings]:
        """The sightings of a problem that has both lenses."""
        tele, wide = self.views
        if tele is None or wide is None:
            raise ValueError("this problem has one lens")
        return tele, wide

    def seen_by(self, lens: int) -> Sightings:
        """Sightings of a lens, 0 for tele and 1 for wide, that this problem has."""
        views = self.views[lens]
        if views is None:
            raise ValueError(f"lens {lens} is not part of this problem")
        return views

    def of_shots(self, shots: BoolArray) -> Problem:
        """The part that some shots, (S,) bool, are."""
        parts = [None if views is None else views.only(shots[views.shot]) for views in self.views]
        return replace(self, views=(parts[0], parts[1]))
