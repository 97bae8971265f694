"""The bundle adjustment, against scipy's least_squares and corners without noise."""

from __future__ import annotations

import numpy as np
import pytest
from calibration.known_rig import World
from scipy.optimize import least_squares

from telewide.calibration.bundle import (
    SOFT,
    normal_equations,
    residuals_px,
    shot_costs,
    solve_bundle,
    solve_poses,
)
from telewide.calibration.distortion import N_LENS, prior_of_lens
from telewide.calibration.problem import N_SHARED, RIG, Problem, State
from telewide.calibration.sightings import gather

FREE = np.zeros(N_SHARED, dtype=bool)
FREE[[0, 2, 3, 4, N_LENS, N_LENS + 2, N_LENS + 3, N_LENS + 4]] = True
FREE[RIG] = True


@pytest.fixture(scope="module")
def case() -> tuple[Problem, State]:
    """Four joint shots and one of each lens alone, and a state a little beside the truth."""
    rng = np.random.default_rng(5)
    world = World()
    shots = world.shots(rng, joint=4, tele_close=1, wide_close=1)
    gathered = gather(shots, board_points_m=world.board_m)
    priors = [prior_of_lens(views.hw, f_px=f) for views, f in zip(gathered.views, (9000, 3000), strict=True)]
    prior, prior_std = (np.stack([each[k] for each in priors]) for k in (0, 1))
    problem = Problem(world.board_m, gathered.views, (0.2, 0.2), prior, prior_std)
    rig = world.rig.wide_from_tele
    poses = np.tile(np.eye(4), (len(shots), 1, 1))
    poses[:, :3, 3] = (-0.1, -0.1, 1.0)
    start = State(prior.copy(), rig[:3, :3], rig[:3, 3], poses[:, :3, :3], poses[:, :3, 3])
    return problem, solve_poses(problem, start)


def total_cost(problem: Problem, state: State) -> float:
    return float(shot_costs(problem, state).sum())


def test_pull_is_the_slope_of_the_cost(case: tuple[Problem, State], rng: np.random.Generator) -> None:
    problem, state = case
    equations = normal_equations(problem, state)
    sizes = np.r_[np.full(2 * N_LENS, 1e-6), np.full(6, 1e-8)]
    for _ in range(4):
        shared = rng.normal(size=N_SHARED) * sizes
        poses = rng.normal(size=(len(state.pose_t), 6)) * 1e-8
        slope = (
            total_cost(problem, state.moved(shared, poses)) - total_cost(problem, state.moved(-shared, -poses))
        ) / 2
        expected = -(equations.shared_pull @ shared + np.sum(equations.pose_pull * poses))
        assert slope == pytest.approx(expected, rel=1e-4)


def test_solution_is_scipys(case: tuple[Problem, State]) -> None:
    """The same robust cost, minimised by another solver from the same start, has its minimum in the same place."""
    problem, start = case
    found = solve_bundle(problem, start, free=FREE)
    n_free, n_poses = int(FREE.sum()), start.pose_t.size * 2

    def state_at(numbers: np.ndarray) -> State:
        shared = np.zeros(N_SHARED)
        shared[FREE] = numbers[:n_free] * np.where(np.flatnonzero(FREE) < 2 * N_LENS, 1.0, 1e-3)
        return found.moved(shared, numbers[n_free:].reshape(-1, 6) * 1e-3)

    def root_costs(numbers: np.ndarray) -> np.ndarray:
        state = state_at(numbers)
        off = ((state.lenses - problem.prior) / problem.prior_std).ravel()[FREE[: 2 * N_LENS]]
        parts = [off]
        for lens in (0, 1):
            squared = np.sum(residuals_px(problem, state, lens=lens) ** 2, axis=-1) / problem.sigma_px[lens] ** 2
            parts.append(np.sqrt(2 * SOFT**2 * (np.sqrt(1 + squared / SOFT**2) - 1)).ravel())
        return np.concatenate(parts)

    at_minimum = root_costs(np.zeros(n_free + n_poses))
    beside = np.random.default_rng(1).normal(size=n_free + n_poses) * 0.01
    other = least_squares(root_costs, beside, x_scale="jac", max_nfev=40)
    minimum = float(at_minimum @ at_minimum)
    assert minimum * (1 - 1e-9) <= 2 * other.cost <= minimum * (1 + 1e-3)


def test_noise_free_corners_give_the_lenses_back(case: tuple[Problem, State]) -> None:
    rng = np.random.default_rng(6)
    world = World(noise_px=0.0)
    gathered = gather(world.shots(rng, joint=6, tele_close=0, wide_close=0), board_points_m=world.board_m)
    problem, start = case
    problem = Problem(world.board_m, gathered.views, (0.01, 0.01), problem.prior, problem.prior_std)
    free = np.ones(N_SHARED, dtype=bool)
    free[[1, N_LENS + 1, *range(8, 12), *range(N_LENS + 8, N_LENS + 12)]] = False
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :3, 3] = (-0.1, -0.1, 1.0)
    begun = solve_poses(problem, State(start.lenses, start.rig_R, start.rig_t, poses[:, :3, :3], poses[:, :3, 3]))
    found = solve_bundle(problem, begun, free=free)
    np.testing.assert_allclose(found.lenses[:, 0], (9000, 3000), rtol=1e-5)
    np.testing.assert_allclose(found.rig_t, world.rig.wide_from_tele[:3, 3], atol=1e-6)
