"""Bundle adjustment of two lenses and the boards they photographed: robust, with analytic derivatives.

Unknowns are two lenses (12 numbers each, see `distortion`), the rig (a turn about the wide camera's axes and a
translation) and one board pose per shot. A pose touches its own shot alone, so each step eliminates the poses first
(Schur complement) and solves for at most 30 numbers; 100 shots take milliseconds a step.
scipy's least_squares, told which residual depends on what, takes 20 to 40 times as long (12 and 30 shots).
Cost per corner: ``c^2 (sqrt(1 + r^2 / c^2) - 1)`` (soft L1), r its distance in standard deviations, c = 3.
Letters: S shots; V views of a lens; N corners of the board; G = 30 numbers that all shots share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from telewide.calibration.distortion import N_LENS, project, project_with_derivatives
from telewide.calibration.problem import N_SHARED, RIG, Problem, Sightings, State
from telewide.geometry.arrays import FloatArray

SOFT = 3.0
"""Standard deviations from which on a corner's pull no longer grows."""
_STEPS = 60
_FLAT = 1e-8
_DAMPING_MAX = 1e12
_DAMPING_MAX_POSES = 1e4


@dataclass(frozen=True)
class Normal:
    """Normal equations, poses apart: ``[[shared, cross], [cross^T, pose]]``.

    Attributes:
        shared: (G, G).
        cross: (S, G, 6).
        pose: (S, 6, 6).
        shared_pull: (G,) descent direction.
        pose_pull: (S, 6).
        shot_pull: (S, G) part of each shot in `shared_pull`.
        shot_shared: (S, G, G) part of each shot in `shared`.
    """

    shared: FloatArray
    cross: FloatArray
    pose: FloatArray
    shared_pull: FloatArray
    pose_pull: FloatArray
    shot_pull: FloatArray
    shot_shared: FloatArray


def residuals_px(problem: Problem, state: State, *, lens: int) -> FloatArray:
    """Detected less reprojected corners of one lens, (V, N, 2), 0 where unseen; inf behind the camera."""
    views = problem.views[lens]
    if views is None:
        return np.zeros((0, len(problem.board_m), 2))
    points_m = state.points_m(problem.board_m, lens=lens, shot=views.shot)
    is_behind = points_m[..., 2] <= 0
    points_m[is_behind] = (0.0, 0.0, 1.0)
    residuals = views.points_px - project(points_m, state.lenses[lens])
    residuals[is_behind] = np.inf
    residuals[~views.is_seen] = 0.0
    return residuals


def shot_costs(problem: Problem, state: State) -> FloatArray:
    """Robust cost of each shot, (S,), without the prior's."""
    costs = np.zeros(len(state.pose_t))
    for lens, views in enumerate(problem.views):
        if views is not None:
            squared = np.sum(residuals_px(problem, state, lens=lens) ** 2, axis=-1) / problem.sigma_px[lens] ** 2
            np.add.at(costs, views.shot, np.sum(SOFT**2 * (np.sqrt(1 + squared / SOFT**2) - 1), axis=1))
    return costs


def normal_equations(problem: Problem, state: State, *, is_robust: bool = True) -> Normal:
    """Normal equations at a state, each corner weighted by its robust weight.

    Args:
        problem: what was seen.
        state: where to linearise.
        is_robust: False gives every corner weight 1, for covariances.

    Returns:
        The equations of all 30 shared numbers, without the prior.
    """
    n_shots = len(state.pose_t)
    shot_shared = np.zeros((n_shots, N_SHARED, N_SHARED))
    cross, pose = np.zeros((n_shots, N_SHARED, 6)), np.zeros((n_shots, 6, 6))
    shot_pull, pose_pull = np.zeros((n_shots, N_SHARED)), np.zeros((n_shots, 6))
    for lens, views in enumerate(problem.views):
        if views is None or not len(views.shot):
            continue
        columns = _columns(lens)
        squares = _squares(problem, state, lens=lens, is_robust=is_robust)
        n = len(columns)
        # A lens sees a shot once, so plain indexing adds every view exactly once.
        shot_shared[np.ix_(views.shot, columns, columns)] += squares[:, :n, :n]
        cross[np.ix_(views.shot, columns)] += squares[:, :n, n:-1]
        pose[views.shot] += squares[:, n:-1, n:-1]
        shot_pull[np.ix_(views.shot, columns)] += squares[:, :n, -1]
        pose_pull[views.shot] += squares[:, n:-1, -1]
    return Normal(
        shared=shot_shared.sum(0),
        cross=cross,
        pose=pose,
        shared_pull=shot_pull.sum(0),
        pose_pull=pose_pull,
        shot_pull=shot_pull,
        shot_shared=shot_shared,
    )


def _columns(lens: int) -> NDArray[np.int64]:
    own = np.arange(lens * N_LENS, (lens + 1) * N_LENS)
    return own if lens == 0 else np.concatenate([own, np.arange(RIG.start, RIG.stop)])


def _squares(
    problem: Problem, state: State, *, lens: int, is_robust: bool, is_shared_needed: bool = True
) -> FloatArray:
    """``[J r]^T W [J r]`` of each view, (V, n + 7, n + 7): the lens's columns, the pose's six, the residual."""
    views = problem.seen_by(lens)
    turned = problem.board_m @ state.pose_R[views.shot].transpose(0, 2, 1)
    in_tele = turned + state.pose_t[views.shot][:, None]
    points_m = in_tele if lens == 0 else in_tele @ state.rig_R.T + state.rig_t
    points_m = np.where(views.is_seen[..., None], points_m, (0.0, 0.0, 1.0))
    pixels, by_lens, by_point = project_with_derivatives(points_m, state.lenses[lens])
    by_tele_point = by_point if lens == 0 else by_point @ state.rig_R
    blocks = [by_lens] if is_shared_needed else []
    if lens == 1 and is_shared_needed:
        blocks += [_by_turn(by_point, points_m - state.rig_t), by_point]
    residuals = views.points_px - pixels
    blocks += [_by_turn(by_tele_point, turned), by_tele_point, residuals[..., None]]
    stacked = np.concatenate(blocks, axis=-1) / problem.sigma_px[lens]
    weight = views.is_seen.astype(np.float64)
    if is_robust:
        squared = np.sum(residuals**2, axis=-1) / problem.sigma_px[lens] ** 2
        weight /= np.sqrt(1 + squared / SOFT**2)
    stacked *= np.sqrt(weight)[..., None, None]
    flat = stacked.reshape(len(views.shot), -1, stacked.shape[-1])
    return np.asarray(flat.transpose(0, 2, 1) @ flat)


def _by_turn(by_point: FloatArray, arms: FloatArray) -> FloatArray:
    """Derivatives by a small turn w that moves points by ``w x arm``: each row b becomes ``arm x b``."""
    return np.cross(arms[..., None, :], by_point)


def solve_bundle(problem: Problem, start: State, *, free: NDArray[np.bool_]) -> State:
    """Find the most likely state by Levenberg-Marquardt steps on the robust cost.

    Args:
        problem: what was seen.
        start: where to begin; its poses must lie in front of the cameras.
        free: (30,) which shared numbers may change; poses always do.

    Returns:
        The state at the minimum.
    """
    state, cost = start, _cost(problem, start, free=free)
    damping = 1e-3
    for _ in range(_STEPS):
        equations = with_prior(normal_equations(problem, state), problem, state)
        while damping < _DAMPING_MAX:
            shared, poses = _step(equations, free=free, damping=damping)
            expected = (shared[free] @ equations.shared_pull[free] + np.sum(poses * equations.pose_pull)) / 2
            trial = state.moved(shared, poses)
            trial_cost = _cost(problem, trial, free=free)
            if trial_cost <= cost or expected <= _FLAT * cost:
                break
            damping *= 8
        else:
            return state
        if trial_cost <= cost:
            state, cost = trial, trial_cost
        if expected <= _FLAT * cost and damping < 1:
            return state
        damping = max(damping / 10, 1e-9)
    return state


def with_prior(equations: Normal, problem: Problem, state: State) -> Normal:
    """The equations with the lenses' prior added."""
    information = np.zeros(N_SHARED)
    information[: 2 * N_LENS] = (1 / problem.prior_std**2).ravel()
    pull = equations.shared_pull.copy()
    pull[: 2 * N_LENS] += ((problem.prior - state.lenses) / problem.prior_std**2).ravel()
    return replace(equations, shared=equations.shared + np.diag(information), shared_pull=pull)


def _cost(problem: Problem, state: State, *, free: NDArray[np.bool_]) -> float:
    off = ((state.lenses - problem.prior) / problem.prior_std).ravel()[free[: 2 * N_LENS]]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        cost = float(np.sum(shot_costs(problem, state)) + off @ off / 2)
    return cost if np.isfinite(cost) else np.inf


def _step(equations: Normal, *, free: NDArray[np.bool_], damping: float) -> tuple[FloatArray, FloatArray]:
    pose = equations.pose + damping * _diagonals(equations.pose)
    pose += 1e-12 * np.eye(6)  # shots without a view stay where they are
    cross = equations.cross[:, free]
    solved = np.linalg.solve(pose, np.concatenate([cross.transpose(0, 2, 1), equations.pose_pull[..., None]], axis=-1))
    shared = np.zeros(N_SHARED)
    if free.any():
        own = equations.shared[np.ix_(free, free)]
        reduced = own + damping * np.diag(np.diag(own)) - np.einsum("sgi,sih->gh", cross, solved[..., :-1])
        pull = equations.shared_pull[free] - np.einsum("sgi,si->g", cross, solved[..., -1])
        shared[free] = _solved(reduced, pull)
    poses = solved[..., -1] - np.einsum("sig,g->si", solved[..., :-1], shared[free])
    return shared, poses


def _solved(matrix: FloatArray, pull: FloatArray) -> FloatArray:
    """Solve a positive definite system, scaled to a unit diagonal first since pixels and metres are far apart."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(scale, scale)
    try:
        return np.asarray(scale * cho_solve(cho_factor(scaled), scale * pull))
    except np.linalg.LinAlgError:
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * pull, rcond=1e-12)[0])


def _diagonals(blocks: FloatArray) -> FloatArray:
    return np.asarray(blocks * np.eye(blocks.shape[-1]))


def solve_poses(problem: Problem, start: State, *, steps: int = _STEPS) -> State:
    """Place every board as well as can be, lenses and rig held; each shot is stepped on its own until it rests.

    Args:
        problem: what was seen.
        start: where to begin.
        steps: how many to take at most.

    Returns:
        The state with the poses at their minimum.
    """
    pose_R, pose_t = start.pose_R.copy(), start.pose_t.copy()
    moving = np.unique(np.concatenate([views.shot for views in problem.views if views is not None]))
    damping = np.full(len(pose_t), 1e-3)
    part, state = _renumbered(problem, start, shots=moving)
    costs = shot_costs(part, state)
    for _ in range(steps):
        pose, pull = _pose_equations(part, state)
        blocks = pose + damping[moving, None, None] * _diagonals(pose) + 1e-12 * np.eye(6)
        moves: FloatArray = np.linalg.solve(blocks, pull[..., None])[..., 0].astype(np.float64)
        trial = state.moved(np.zeros(N_SHARED), moves)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            trial_costs = np.nan_to_num(shot_costs(part, trial), nan=np.inf)
        is_better = trial_costs <= costs
        pose_R[moving[is_better]], pose_t[moving[is_better]] = trial.pose_R[is_better], trial.pose_t[is_better]
        expected = np.sum(moves * pull, axis=1) / 2
        rests = (expected <= _FLAT * costs) | (damping[moving] > _DAMPING_MAX_POSES)
        damping[moving] = np.where(is_better, damping[moving] / 10, damping[moving] * 8)
        if rests.all():
            break
        costs = np.where(is_better, trial_costs, costs)[~rests]
        moving = moving[~rests]
        part, state = _renumbered(problem, replace(start, pose_R=pose_R, pose_t=pose_t), shots=moving)
    return replace(start, pose_R=pose_R, pose_t=pose_t)


def _renumbered(problem: Problem, state: State, *, shots: NDArray[np.int64]) -> tuple[Problem, State]:
    """The part of a problem that some shots are, renumbered from 0."""
    parts: list[Sightings | None] = []
    for views in problem.views:
        part = None if views is None else views.only(np.isin(views.shot, shots))
        parts.append(None if part is None else replace(part, shot=np.searchsorted(shots, part.shot)))
    return (
        replace(problem, views=(parts[0], parts[1])),
        replace(state, pose_R=state.pose_R[shots], pose_t=state.pose_t[shots]),
    )


def _pose_equations(problem: Problem, state: State) -> tuple[FloatArray, FloatArray]:
    """Normal equations of the poses alone: (S, 6, 6) and (S, 6)."""
    pose, pull = np.zeros((len(state.pose_t), 6, 6)), np.zeros((len(state.pose_t), 6))
    for lens, views in enumerate(problem.views):
        if views is not None and len(views.shot):
            squares = _squares(problem, state, lens=lens, is_robust=True, is_shared_needed=False)
            pose[views.shot] += squares[:, :-1, :-1]
            pull[views.shot] += squares[:, :-1, -1]
    return pose, pull
