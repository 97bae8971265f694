"""Where a flat board is, seen by lenses that are known.

A flat board seen from far has two poses that fit nearly equally well, mirror images in its tilt; both are tried, from
either lens, and the better kept. Letters: S shots, V views of a lens, N corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from telewide.calibration.bundle import residuals_px, shot_costs, solve_poses
from telewide.calibration.distortion import camera_of
from telewide.calibration.problem import Problem, Sightings, State
from telewide.geometry.arrays import FloatArray

RAYLEIGH_MEDIAN = 1.1774
"""Median length of a plane normal vector of standard deviation 1."""
_RAYLEIGH_P75 = 1.6651
_STEPS = 12
"""Enough for the right pose of two, which is near; the wrong one creeps."""


@dataclass(frozen=True)
class _Poses:
    R: FloatArray
    t: FloatArray


def placed(problem: Problem, state: State) -> State:
    """Place every board anew, lenses and rig held.

    Args:
        problem: what was seen.
        state: lenses and rig to hold; its poses are one more guess.

    Returns:
        The state with the best pose found for every shot.
    """
    guesses = [state]
    for lens, views in enumerate(problem.views):
        if views is None or not len(views.shot):
            continue
        for poses in _two_poses(problem.board_m, views, state.lenses[lens]):
            in_tele = poses if lens == 0 else _poses_in_tele(poses, state)
            guess_R, guess_t = state.pose_R.copy(), state.pose_t.copy()
            guess_R[views.shot], guess_t[views.shot] = in_tele.R, in_tele.t
            guesses.append(replace(state, pose_R=guess_R, pose_t=guess_t))
    settled = [solve_poses(problem, guess, steps=_STEPS) for guess in guesses]
    costs = np.stack([np.nan_to_num(_quiet_costs(problem, each), nan=np.inf) for each in settled])
    best = np.argmin(costs, axis=0)
    shots = np.arange(len(best))
    return replace(
        state,
        pose_R=np.stack([each.pose_R for each in settled])[best, shots],
        pose_t=np.stack([each.pose_t for each in settled])[best, shots],
    )


def unplaced(lenses: FloatArray, *, n_shots: int, distance_m: float) -> State:
    """A state that knows the lenses alone: every board straight ahead, both lenses in one place."""
    pose_t = np.tile([0.0, 0.0, distance_m], (n_shots, 1))
    return State(
        lenses=lenses, rig_R=np.eye(3), rig_t=np.zeros(3), pose_R=np.tile(np.eye(3), (n_shots, 1, 1)), pose_t=pose_t
    )


def view_scale_px(problem: Problem, state: State, *, lens: int) -> FloatArray:
    """Typical error of each view, (V,) px along x or y, from the 75th percentile of its corners' distances."""
    views = problem.views[lens]
    if views is None:
        return np.zeros(0)
    with np.errstate(over="ignore", invalid="ignore"):
        distances = np.linalg.norm(residuals_px(problem, state, lens=lens), axis=-1)
    scales = [
        np.percentile(distance[seen], 75) if np.isfinite(distance[seen]).all() else np.inf
        for distance, seen in zip(distances, views.is_seen, strict=True)
    ]
    return np.asarray(scales, dtype=np.float64) / _RAYLEIGH_P75


def noise_px(problem: Problem, state: State, *, lens: int) -> float:
    """Noise of a corner along x or y, px, from the median over all corners of a lens; at least 0.005 px."""
    views = problem.views[lens]
    if views is None or not views.is_seen.any():
        return 1.0
    distances = np.linalg.norm(residuals_px(problem, state, lens=lens), axis=-1)[views.is_seen]
    return max(float(np.median(distances)) / RAYLEIGH_MEDIAN, 0.005)


def _quiet_costs(problem: Problem, state: State) -> FloatArray:
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return shot_costs(problem, state)


def _two_poses(board_m: FloatArray, views: Sightings, lens: FloatArray) -> tuple[_Poses, _Poses]:
    camera = camera_of(lens, hw=views.hw)
    both = [
        _two_of_view(board_m[seen], camera.normalised(points_px[seen]))
        for points_px, seen in zip(views.points_px, views.is_seen, strict=True)
    ]
    first, second = ([pair[which] for pair in both] for which in (0, 1))
    return (
        _Poses(np.stack([pose.R for pose in first]), np.stack([pose.t for pose in first])),
        _Poses(np.stack([pose.R for pose in second]), np.stack([pose.t for pose in second])),
    )


def _two_of_view(board_m: FloatArray, normalised: FloatArray) -> tuple[_Poses, _Poses]:
    """The two poses of one view (Collins and Bartoli, IPPE, IJCV 2014), in front of the lens."""
    turns, shifts = cv2.solvePnPGeneric(board_m, normalised, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE)[1:3]
    poses = [
        _Poses(Rotation.from_rotvec(np.ravel(turn)).as_matrix(), np.ravel(shift).astype(np.float64))
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return poses[0], poses[-1]


def _poses_in_tele(poses: _Poses, state: State) -> _Poses:
    """``tele_from_board`` from ``wide_from_board``."""
    return _Poses(state.rig_R.T @ poses.R, (poses.t - state.rig_t) @ state.rig_R)
