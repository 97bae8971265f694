"""Stated deviations against the true errors of a known rig: corners with noise of their own, and boards that bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration.known_rig import World

from telewide.boards.shots import DetectedShot
from telewide.calibration.bundle import solve_bundle, solve_poses
from telewide.calibration.distortion import N_LENS, prior_of_lens
from telewide.calibration.problem import N_SHARED, RIG, Problem, State
from telewide.calibration.sightings import gather
from telewide.calibration.uncertainty import Uncertainty, uncertainty
from telewide.geometry.arrays import FloatArray

FREE = np.zeros(N_SHARED, dtype=bool)
FREE[[0, 2, 3, 4, 5, 6, 7, N_LENS, *(N_LENS + k for k in range(2, 8))]] = True
FREE[RIG] = True


def bent_shots(
    world: World, rng: np.random.Generator, *, bend_m: float, count: int = 24
) -> tuple[list[DetectedShot], FloatArray]:
    """Joint shots of a paper board that bends anew in each, by so much at its edges; its true poses, (S, 4, 4)."""
    shots, poses = [], []
    across = world.board_m[:, :2] - world.board_m[:, :2].mean(axis=0)
    across /= np.abs(across).max(axis=0)
    for k in range(count):
        a, b, c = rng.normal(size=3)
        height_m = bend_m * (a * across[:, 0] ** 2 + b * across[:, 1] ** 2 + c * across[:, 0] * across[:, 1])
        bent = replace(world, board_m=world.board_m + np.column_stack([np.zeros((len(across), 2)), height_m]))
        pose = world.pose(world.rig.tele, (0.8, 1.1, 1.5)[k % 3] * rng.uniform(0.9, 1.1), rng)
        shots.append(bent.shot(f"joint{k:02d}", pose, rng))
        poses.append(pose)
    return shots, np.array(poses)


def solved(world: World, rng: np.random.Generator, *, bend_m: float) -> tuple[State, Uncertainty]:
    """The solution nearest to the truth, and what is said of it."""
    shots, poses = bent_shots(world, rng, bend_m=bend_m)
    gathered = gather(shots, board_points_m=world.board_m)
    lenses = (world.rig.tele, world.rig.wide)
    priors = [prior_of_lens(views.hw, f_px=lens.f_px) for views, lens in zip(gathered.views, lenses, strict=True)]
    prior, prior_std = (np.stack([each[k] for each in priors]) for k in (0, 1))
    problem = Problem(world.board_m, gathered.views, (0.2, 0.2), prior, prior_std)
    rig = world.rig.wide_from_tele
    start = solve_poses(problem, State(prior.copy(), rig[:3, :3], rig[:3, 3], poses[:, :3, :3], poses[:, :3, 3]))
    found = solve_bundle(problem, start, free=FREE)
    return found, uncertainty(problem, found, free=FREE)


def normalised_errors(world: World, *, bend_m: float, seeds: range) -> tuple[FloatArray, FloatArray]:
    """(seeds, 5) errors of both focal lengths and the translation over their stated deviations; (seeds,) excess."""
    truth = np.array([9000, 3000, *world.rig.wide_from_tele[:3, 3]])
    errors, excess = [], []
    for seed in seeds:
        found, sure = solved(world, np.random.default_rng(seed), bend_m=bend_m)
        std = np.sqrt(np.diag(sure.covariance))
        errors.append((np.array([*found.lenses[:, 0], *found.rig_t]) - truth) / [std[0], std[N_LENS], *std[RIG][3:]])
        excess.append(sure.excess)
    return np.array(errors), np.array(excess)


def test_noise_of_the_corners_alone_has_no_excess() -> None:
    errors, excess = normalised_errors(World(), bend_m=0.0, seeds=range(10))
    assert 1.0 <= excess.min() <= excess.max() < 1.4
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.4


def test_deviations_grow_by_what_bent_boards_pull_together() -> None:
    """Half a millimetre of bend moves all corners of a view alike: by corner noise alone four deviations were usual."""
    errors, excess = normalised_errors(World(), bend_m=0.0005, seeds=range(10))
    assert 5 < excess.min() <= excess.max() < 20
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.7


def test_held_numbers_have_no_deviation_and_noise_is_that_of_the_corners() -> None:
    world = World(noise_px=0.35)
    _, sure = solved(world, np.random.default_rng(0), bend_m=0.0)
    assert not sure.covariance[~FREE].any()
    assert not sure.covariance[:, ~FREE].any()
    assert (np.diag(sure.covariance)[FREE] > 0).all()
    assert sure.noise_px == pytest.approx((0.35, 0.35), rel=0.05)
