"""Pose of two known lenses to each other, and which of their photos contradict that.

Letters: S shots; V views of a lens; J joint shots, seen by both lenses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from telewide.calibration.bundle import shot_costs, solve_bundle
from telewide.calibration.distortion import camera_of
from telewide.calibration.intrinsics import agrees
from telewide.calibration.poses import noise_px, placed, view_scale_px
from telewide.calibration.problem import N_SHARED, RIG, Problem, Sightings, State
from telewide.geometry.arrays import BoolArray, FloatArray

_GUESSES = 40
_ROUNDS = 4


@dataclass(frozen=True)
class Agreement:
    """Views that agree with a state.

    Attributes:
        alone: for tele and wide, (S,) whether the view fits its lens alone; False without a view.
        together: (S,) whether both views fit one place of the board.
        alone_px: for tele and wide, (S,) typical error of the view alone; NaN without a view.
        together_px: for tele and wide, (S,) typical error with the board placed for both; NaN unless joint.
        state: the state with every board placed for all views that count, or alone where they contradict each other.
    """

    alone: tuple[BoolArray, BoolArray]
    together: BoolArray
    alone_px: tuple[FloatArray, FloatArray]
    together_px: tuple[FloatArray, FloatArray]
    state: State

    def is_used(self, lens: int) -> BoolArray:
        """(S,) whether a lens's view takes part: it fits, and does not contradict a fitting view of the other lens."""
        return self.alone[lens] & (self.together | ~self.alone[1 - lens])


def joint_shots(problem: Problem) -> BoolArray:
    """(S,) up to the last shot seen: which shots both lenses saw."""
    tele, wide = problem.both
    seen = np.zeros((2, 1 + max(tele.shot.max(), wide.shot.max())), dtype=bool)
    seen[0, tele.shot], seen[1, wide.shot] = True, True
    return np.asarray(seen[0] & seen[1])


def first_rig(problem: Problem, poses_in_tele: State, poses_in_wide: State) -> State:
    """Guess the rig: of the relative poses that single shots suggest, the one that suits most shots.

    Args:
        problem: the views of both lenses.
        poses_in_tele: the tele lens alone and its boards.
        poses_in_wide: the wide lens alone, as the first lens of its state, and its boards.

    Returns:
        Both lenses, the rig that suits most, and the boards as tele sees them, as wide does where tele does not.
    """
    joint = np.flatnonzero(joint_shots(problem))
    turns = poses_in_wide.pose_R[joint] @ poses_in_tele.pose_R[joint].transpose(0, 2, 1)
    shifts = poses_in_wide.pose_t[joint] - np.einsum("sij,sj->si", turns, poses_in_tele.pose_t[joint])
    lenses = np.stack([poses_in_tele.lenses[0], poses_in_wide.lenses[0]])
    seen_by_both = problem.of_shots(np.isin(np.arange(len(poses_in_tele.pose_t)), joint))
    guesses = [
        replace(poses_in_tele, lenses=lenses, rig_R=turns[k], rig_t=shifts[k])
        for k in np.unique(np.linspace(0, len(joint) - 1, min(len(joint), _GUESSES)).astype(int))
    ]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        best = min(guesses, key=lambda guess: float(np.median(view_scale_px(seen_by_both, guess, lens=1))))
    return _with_wide_poses(problem, best, poses_in_wide)


def _with_wide_poses(problem: Problem, state: State, poses_in_wide: State) -> State:
    tele, wide = problem.both
    alone = np.setdiff1d(wide.shot, tele.shot)
    pose_R, pose_t = state.pose_R.copy(), state.pose_t.copy()
    pose_R[alone] = state.rig_R.T @ poses_in_wide.pose_R[alone]
    pose_t[alone] = (poses_in_wide.pose_t[alone] - state.rig_t) @ state.rig_R
    return replace(state, pose_R=pose_R, pose_t=pose_t)


def settled_rig(problem: Problem, start: State) -> State:
    """Refine the rig alone, lenses held, on the better half of the joint shots, again and again.

    Args:
        problem: the views of both lenses.
        start: lenses and a first rig.

    Returns:
        The state with a rig on which at least half of the joint shots agree as well as they can.
    """
    joint = joint_shots(problem)
    joint = np.concatenate([joint, np.zeros(len(start.pose_t) - len(joint), dtype=bool)])
    free = np.zeros(N_SHARED, dtype=bool)
    free[RIG] = True
    state, better = start, joint
    for _ in range(_ROUNDS):
        state = placed(problem.of_shots(joint), state)
        with np.errstate(over="ignore", invalid="ignore"):
            costs = np.where(joint, shot_costs(problem.of_shots(joint), state) / _corners(problem, joint), np.inf)
        before, better = better, costs <= np.median(costs[joint])
        if np.array_equal(before, better):
            break
        state = solve_bundle(problem.of_shots(better), state, free=free)
    return state


def agreement(problem: Problem, state: State) -> Agreement:
    """Sort all views into those that agree with a rig and those that do not.

    Args:
        problem: all views of both lenses.
        state: lenses and rig.

    Returns:
        The sorted views.
    """
    n_shots = len(state.pose_t)
    views = problem.both
    both = placed(problem, state)
    apart = [placed(replace(problem, views=one), both) for one in ((views[0], None), (None, views[1]))]
    alone_px = tuple(_by_shot(view_scale_px(problem, apart[k], lens=k), views[k], n_shots) for k in (0, 1))
    together_px = tuple(_by_shot(view_scale_px(problem, both, lens=k), views[k], n_shots) for k in (0, 1))
    alone = tuple(_agrees_by_shot(scales) for scales in alone_px)
    candidates = alone[0] & alone[1]
    together = candidates.copy()
    for scales in together_px:
        together[candidates] &= agrees(scales[candidates])
    keep = (together | ~(alone[0] | alone[1]))[:, None]
    tele_alone = (alone[0] & ~together)[:, None]
    pose_t = np.where(keep, both.pose_t, np.where(tele_alone, apart[0].pose_t, apart[1].pose_t))
    pose_R = np.where(keep[..., None], both.pose_R, np.where(tele_alone[..., None], apart[0].pose_R, apart[1].pose_R))
    is_joint = np.isfinite(alone_px[0]) & np.isfinite(alone_px[1])
    return Agreement(
        alone=(alone[0], alone[1]),
        together=together,
        alone_px=(alone_px[0], alone_px[1]),
        together_px=(np.where(is_joint, together_px[0], np.nan), np.where(is_joint, together_px[1], np.nan)),
        state=replace(both, pose_R=pose_R, pose_t=pose_t),
    )


def solve_together(problem: Problem, start: State, *, free: BoolArray) -> tuple[Problem, State]:
    """Adjust everything at once, measuring each lens's noise on the way.

    Args:
        problem: the views that take part.
        start: where to begin.
        free: (30,) which shared numbers may change.

    Returns:
        The problem with its noise, and the state.
    """
    state = start
    for _ in range(2):
        state = solve_bundle(problem, state, free=free)
        sigma_px = (noise_px(problem, state, lens=0), noise_px(problem, state, lens=1))
        problem = replace(problem, sigma_px=sigma_px)
    return problem, solve_bundle(problem, state, free=free)


def used_views(problem: Problem, agreed: Agreement) -> Problem:
    """The part of a problem that agrees."""
    tele, wide = problem.both
    return replace(problem, views=(tele.only(agreed.is_used(0)[tele.shot]), wide.only(agreed.is_used(1)[wide.shot])))


def epipolar_errors_px(problem: Problem, state: State) -> FloatArray:
    """Distance in the tele photo of every common corner from the line its wide view allows.

    ``x_tele^T E^T x_wide = 0`` with ``E = [t]x R`` of ``wide_from_tele``; the distance is taken on the plane z = 1 and
    multiplied by the tele focal length.

    Args:
        problem: views of both lenses.
        state: lenses and rig; no board pose is used.

    Returns:
        (n,) distances, tele px, of all corners that both views of a shot show.
    """
    tele, wide = problem.both
    t = state.rig_t
    cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    E = cross @ state.rig_R
    cameras = [camera_of(state.lenses[k], hw=views.hw) for k, views in enumerate((tele, wide))]
    errors = [np.zeros(0)]
    for i, shot in enumerate(tele.shot):
        for j in np.flatnonzero(wide.shot == shot):
            common = tele.is_seen[i] & wide.is_seen[j]
            if not common.any():
                continue
            ray_tele = _rays(cameras[0].normalised(tele.points_px[i, common]))
            lines = _rays(cameras[1].normalised(wide.points_px[j, common])) @ E
            distances = np.abs(np.sum(lines * ray_tele, axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
            errors.append(distances * cameras[0].f_px)
    return np.concatenate(errors)


def _rays(normalised: FloatArray) -> FloatArray:
    return np.column_stack([normalised, np.ones(len(normalised))])


def _corners(problem: Problem, shots: BoolArray) -> FloatArray:
    counts = np.zeros(len(shots))
    for views in problem.both:
        np.add.at(counts, views.shot, views.is_seen.sum(axis=1))
    return np.maximum(counts, 1.0)


def _by_shot(values: FloatArray, views: Sightings, n_shots: int) -> FloatArray:
    spread = np.full(n_shots, np.nan)
    spread[views.shot] = values
    return spread


def _agrees_by_shot(scales: FloatArray) -> BoolArray:
    is_there = ~np.isnan(scales)
    result = np.zeros(len(scales), dtype=bool)
    result[is_there] = agrees(scales[is_there])
    return result
