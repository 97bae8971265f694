"""Selection of a lens's distortion model: the one that explains held-out views best, not the one that is usual.

Letters: S shots; G = 30 shared numbers, see `problem`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.bundle import SOFT, residuals_px, solve_bundle, solve_poses
from telewide.calibration.distortion import (
    ASPECT,
    BELIEVED,
    LADDER,
    N_LENS,
    NARROW_LADDER,
    is_one_to_one,
)
from telewide.calibration.problem import N_SHARED, Problem, State
from telewide.geometry.arrays import BoolArray, FloatArray

NARROW = 0.35
"""Tangent of the half diagonal angle below which a lens counts as long."""
_FOLDS = 4
_RARE = 2.0
"""Standard errors by which what few lenses have must help: higher powers, pixels that are not square."""


def ladder(hw: tuple[int, int], *, f_px: float) -> tuple[str, ...]:
    """Distortion models worth trying for a lens, simplest first."""
    is_narrow = float(np.hypot(*hw)) / 2 / f_px < NARROW
    return NARROW_LADDER if is_narrow else tuple(LADDER)


def free_numbers(numbers: Sequence[int], *, lens: int) -> BoolArray:
    """(30,) bool: some of the 12 numbers of a lens, 0 tele or 1 wide."""
    free = np.zeros(N_SHARED, dtype=bool)
    free[lens * N_LENS + np.array(numbers)] = True
    return free


def best_model(problem: Problem, state: State, *, names: Sequence[str], rng: np.random.Generator) -> BoolArray:
    """Climb the ladder for a lens alone as long as held-out views are explained better.

    Args:
        problem: the lens's views, as tele views.
        state: a fit of any model.
        names: models to try, simplest first.
        rng: deals the shots into four parts.

    Returns:
        (30,) bool, the numbers of the best model. What is rare must help by two standard errors.
    """
    folds = _folds(problem, state, rng=rng)
    best = free_numbers(LADDER[names[0]], lens=0)
    errors = _held_out_errors(problem, state, free=best, folds=folds)
    for name in names[1:]:
        candidate = free_numbers(LADDER[name], lens=0)
        by = _RARE if len(LADDER[name]) > len(BELIEVED) else 0.0
        best, errors = _better(problem, state, candidate, best=best, errors=errors, folds=folds, by=by)
    candidate = best | free_numbers([ASPECT], lens=0)
    return _better(problem, state, candidate, best=best, errors=errors, folds=folds, by=_RARE)[0]


def raised_models(problem: Problem, state: State, *, free: BoolArray, rng: np.random.Generator) -> BoolArray:
    """Let free what a lens alone could not tell and both together can: the boards are now placed by both.

    Args:
        problem: the views of both lenses.
        state: the solution with the models of the lenses alone.
        free: (30,) the numbers of those models and the rig.
        rng: deals the shots into four parts.

    Returns:
        (30,) bool: the numbers, with the usual coefficients of a lens added where held-out shots want them.
    """
    folds = _folds(problem, state, rng=rng)
    best, errors = free, _held_out_errors(problem, state, free=free, folds=folds)
    for lens in (1, 0):
        candidate = best | free_numbers(BELIEVED, lens=lens)
        if not np.array_equal(candidate, best):
            best, errors = _better(problem, state, candidate, best=best, errors=errors, folds=folds, by=0.0)
    return best


def _better(
    problem: Problem,
    state: State,
    candidate: BoolArray,
    *,
    best: BoolArray,
    errors: FloatArray,
    folds: NDArray[np.int64],
    by: float,
) -> tuple[BoolArray, FloatArray]:
    """The candidate and its errors if it beats the best by some standard errors, or else the best."""
    candidate_errors = _held_out_errors(problem, state, free=candidate, folds=folds)
    seen = folds >= 0
    if not np.isfinite(candidate_errors[seen]).all():
        return best, errors
    gains = errors[seen] - candidate_errors[seen]
    if not np.isfinite(gains).all() or gains.mean() > by * gains.std() / np.sqrt(max(len(gains) - 1, 1)):
        return candidate, candidate_errors
    return best, errors


def _folds(problem: Problem, state: State, *, rng: np.random.Generator) -> NDArray[np.int64]:
    """(S,) part of each shot that was seen; -1 for the others."""
    seen = np.unique(np.concatenate([views.shot for views in problem.views if views is not None]))
    folds = np.full(len(state.pose_t), -1)
    folds[seen] = rng.permutation(len(seen)) % min(_FOLDS, len(seen))
    return folds


def _held_out_errors(problem: Problem, state: State, *, free: BoolArray, folds: NDArray[np.int64]) -> FloatArray:
    """Mean squared held-out error of every shot, in units of the noise, linear when far off; NaN of a shot not seen."""
    errors, counts = np.zeros(len(folds)), np.zeros(len(folds))
    for fold in range(folds.max() + 1):
        solved = solve_bundle(problem.of_shots((folds >= 0) & (folds != fold)), state.held(free), free=free)
        held_out = problem.of_shots(folds == fold)
        settled = solve_poses(held_out, solved)
        for lens, views in enumerate(held_out.views):
            if views is None:
                continue
            squared = np.sum(residuals_px(held_out, settled, lens=lens) ** 2, axis=-1) / problem.sigma_px[lens] ** 2
            soft = 2 * SOFT**2 * (np.sqrt(1 + squared / SOFT**2) - 1)
            is_usable = is_one_to_one(settled.lenses[lens], hw=views.hw)
            np.add.at(errors, views.shot, soft.sum(axis=1) if is_usable else np.inf)
            np.add.at(counts, views.shot, views.is_seen.sum(axis=1))
    return np.asarray(np.where(folds >= 0, errors / np.maximum(counts, 1), np.nan))
