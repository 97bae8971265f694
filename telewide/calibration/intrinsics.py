"""One lens from its own views: focal length, principal point, distortion, and which views do not agree.

Letters: V views; N corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.calibration.bundle import N_SHARED, Problem, Sightings, State, residuals_px, solve_bundle, solve_poses
from telewide.calibration.distortion import (
    ASPECT,
    BELIEVED,
    CX,
    CY,
    LADDER,
    N_LENS,
    NARROW_LADDER,
    F,
    is_one_to_one,
    prior_of_lens,
)
from telewide.calibration.poses import noise_px, placed, unplaced, view_scale_px

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NARROW = 0.35
"""Tangent of the half diagonal angle below which a lens counts as long."""
DISAGREES = 3.0
"""A view whose typical error is this many times the others' does not agree with them."""
_NEGLIGIBLE_PX = 0.05
_ROUNDS = 8
_FOLDS = 4
_RARE = 2.0
"""Standard errors by which what few lenses have must help: higher powers, pixels that are not square."""


@dataclass(frozen=True)
class LensFit:
    """A lens as its own views tell it.

    Attributes:
        lens: (12,) the lens.
        free: (12,) bool, which numbers were fitted.
        model: name of the distortion model.
        sigma_px: noise of a corner along x or y.
        prior: (12,) and (12,): centre and standard deviation of what was believed before.
        is_used: (V,) the views that agree.
        scale_px: (V,) typical error of every view along x or y.
        problem: the views, as tele views.
        state: the fit.
    """

    lens: FloatArray
    free: BoolArray
    model: str
    sigma_px: float
    prior: tuple[FloatArray, FloatArray]
    is_used: BoolArray
    scale_px: FloatArray
    problem: Problem
    state: State


def fit_lens(views: Sightings, *, board_m: FloatArray, n_shots: int, rng: np.random.Generator) -> LensFit:
    """Fit one lens to its views, leaving out those that contradict the others.

    Args:
        views: V views of at least 6 corners each.
        board_m: (N, 3) corners by id.
        n_shots: how many shots there are; the views name theirs.
        rng: chooses what is held out.

    Returns:
        The fit, with the distortion model of least held-out error.
    """
    prior = prior_of_lens(views.hw, f_px=first_focal_px(views, board_m=board_m))
    problem = Problem(board_m, (views, None), (_first_noise_px(views.hw), 1.0), *(np.stack([p, p]) for p in prior))
    extent_m = float(np.ptp(board_m, axis=0).max())
    problem, state, is_used = _agreeing(problem, unplaced(problem.prior, n_shots=n_shots, distance_m=3 * extent_m))
    names = ladder(views.hw, f_px=float(state.lenses[0, F]))
    model, free = _best_model(_restricted(problem, is_used), state, names=names, rng=rng)
    state = solve_bundle(_restricted(problem, is_used), reset(state, free=free), free=_shared(free))
    state = _placed_left_out(problem, state, is_used=is_used)
    scale_px = view_scale_px(problem, state, lens=0)
    return LensFit(state.lenses[0], free, model, problem.sigma_px[0], prior, is_used, scale_px, problem, state)


def first_focal_px(views: Sightings, *, board_m: FloatArray) -> float:
    """Guess a focal length from the tilted views, each on its own, and take their weighted median.

    With the principal point in the centre, a homography ``[h1 h2 h3]`` of a flat board gives two equations linear in
    ``1 / f^2`` (Zhang, PAMI 2000). Views that lie flat say nothing and weigh nothing.

    Args:
        views: V views.
        board_m: (N, 3) corners by id.

    Returns:
        Focal length, px; 1.2 times the longer side where no view tells.
    """
    centre_px = (np.array(views.hw[::-1]) - 1) / 2
    long_px = max(views.hw)
    guesses, weights = [], []
    for points_px, seen in zip(views.points_px, views.is_seen, strict=True):
        plane, image = board_m[seen, :2], (points_px[seen] - centre_px) / long_px
        spread = np.ptp(plane, axis=0).max()
        H = cv2.findHomography((plane - plane.mean(axis=0)) / spread, image)[0]
        if H is None:
            continue
        (a1, a2), (b1, b2) = _focal_equations(H / np.cbrt(np.linalg.det(H)))
        inverse_square = -(a1 * b1 + a2 * b2) / (a1 * a1 + a2 * a2)
        if 1 / 20**2 < inverse_square < 1 / 0.2**2:
            guesses.append(long_px / np.sqrt(inverse_square))
            weights.append(float(np.hypot(b1, b2)))
    return _weighted_median(guesses, weights) if guesses else 1.2 * long_px


def _focal_equations(H: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    h1, h2 = H[:, 0], H[:, 1]
    a = (h1[0] * h2[0] + h1[1] * h2[1], h1[0] ** 2 + h1[1] ** 2 - h2[0] ** 2 - h2[1] ** 2)
    return a, (h1[2] * h2[2], h1[2] ** 2 - h2[2] ** 2)


def _weighted_median(values: Sequence[float], weights: Sequence[float]) -> float:
    order = np.argsort(values)
    total = np.cumsum(np.asarray(weights)[order])
    return float(np.asarray(values)[order][np.searchsorted(total, total[-1] / 2)])


def ladder(hw: tuple[int, int], *, f_px: float) -> tuple[str, ...]:
    """Distortion models worth trying for a lens, simplest first."""
    is_narrow = float(np.hypot(*hw)) / 2 / f_px < NARROW
    return NARROW_LADDER if is_narrow else tuple(LADDER)


def _first_noise_px(hw: tuple[int, int]) -> float:
    return max(hw) / 1000


def _agreeing(problem: Problem, state: State) -> tuple[Problem, State, BoolArray]:
    """Fit and leave out in turns until the views that agree stay the same; noise is measured on the way."""
    views = problem.views[0]
    assert views is not None
    is_used = np.ones(len(views.shot), dtype=bool)
    for turn in range(_ROUNDS):
        state = placed(problem, state)
        before, is_used = is_used, agrees(view_scale_px(problem, state, lens=0))
        if turn > 2 and np.array_equal(before, is_used):
            break
        chosen = _restricted(problem, is_used)
        model = ("none", "k1", "k1k2p1p2")[min(turn, 2)]
        free = mask_of(model) if turn else _only(F)
        state = solve_bundle(chosen, state, free=_shared(free))
        sigma_px = noise_px(chosen, state, lens=0)
        problem = replace(problem, sigma_px=(sigma_px, 1.0))
    return problem, state, is_used


def agrees(scale_px: FloatArray) -> BoolArray:
    """Which views agree with most of the others: typical error at most three times that of the better ones.

    Args:
        scale_px: (V,) typical errors.

    Returns:
        (V,) bool; errors below 0.05 px always agree.
    """
    finite = scale_px[np.isfinite(scale_px)]
    if not len(finite):
        return np.zeros(len(scale_px), dtype=bool)
    # The median of the better two thirds: a third of the views may be ruined.
    return np.asarray(scale_px <= max(DISAGREES * float(np.percentile(finite, 100 / 3)), _NEGLIGIBLE_PX))


def mask_of(model: str) -> BoolArray:
    """(12,) bool: the numbers of a lens that a distortion model lets free."""
    return _only(*LADDER[model])


def _only(*numbers: int) -> BoolArray:
    free = np.zeros(N_LENS, dtype=bool)
    free[list(numbers)] = True
    return free


def _shared(free: BoolArray) -> BoolArray:
    shared = np.zeros(N_SHARED, dtype=bool)
    shared[:N_LENS] = free
    return shared


def _restricted(problem: Problem, chosen: BoolArray) -> Problem:
    views = problem.views[0]
    assert views is not None
    return replace(problem, views=(views.only(chosen), None))


def reset(state: State, *, free: BoolArray) -> State:
    """The state with the tele lens's numbers that are not free at what no photo told: no distortion, square pixels."""
    lenses = state.lenses.copy()
    held = ~free
    held[[F, CX, CY]] = False
    lenses[0, held] = 0.0
    return replace(state, lenses=lenses)


def _placed_left_out(problem: Problem, state: State, *, is_used: BoolArray) -> State:
    """Boards of the views left out, placed as well as this lens allows."""
    if is_used.all():
        return state
    views = problem.views[0]
    assert views is not None
    anew = placed(problem, state)
    used = np.zeros(len(state.pose_t), dtype=bool)
    used[views.shot[is_used]] = True
    return replace(
        state,
        pose_R=np.where(used[:, None, None], state.pose_R, anew.pose_R),
        pose_t=np.where(used[:, None], state.pose_t, anew.pose_t),
    )


def _best_model(
    problem: Problem, state: State, *, names: Sequence[str], rng: np.random.Generator
) -> tuple[str, BoolArray]:
    """Climb the ladder as long as held-out views are explained better, by a standard error or, where rare, by two."""
    views = problem.views[0]
    assert views is not None
    folds = rng.permutation(len(views.shot)) % min(_FOLDS, len(views.shot))
    best, best_free = names[0], mask_of(names[0])
    best_errors = _held_out_errors(problem, state, free=best_free, folds=folds)
    candidates = [(name, mask_of(name)) for name in names[1:]]
    while candidates:
        name, free = candidates.pop(0)
        errors = _held_out_errors(problem, state, free=free, folds=folds)
        if _is_better(errors, best_errors, by=_RARE if len(LADDER[name]) > len(BELIEVED) else 1.0):
            best, best_free, best_errors = name, free, errors
    with_aspect = best_free.copy()
    with_aspect[ASPECT] = True
    if _is_better(_held_out_errors(problem, state, free=with_aspect, folds=folds), best_errors, by=_RARE):
        best, best_free = f"{best}+aspect", with_aspect
    return best, best_free


def _is_better(errors: FloatArray, best: FloatArray, *, by: float) -> bool:
    gains = best - errors
    if not np.isfinite(gains).all() or len(gains) < 2:
        return False
    return bool(gains.mean() > by * gains.std(ddof=1) / np.sqrt(len(gains)))


def _held_out_errors(problem: Problem, state: State, *, free: BoolArray, folds: NDArray[np.int64]) -> FloatArray:
    """Mean squared held-out error of every view, in units of the noise, growing only linearly when far off."""
    views = problem.views[0]
    assert views is not None
    errors = np.full(len(views.shot), np.inf)
    for fold in range(folds.max() + 1):
        out = folds == fold
        fitted = solve_bundle(_restricted(problem, ~out), reset(state, free=free), free=_shared(free))
        if not is_one_to_one(fitted.lenses[0], hw=views.hw):
            continue
        held_out = _restricted(problem, out)
        settled = solve_poses(held_out, fitted)
        squared = np.sum(residuals_px(held_out, settled, lens=0) ** 2, axis=-1) / problem.sigma_px[0] ** 2
        soft = 18 * (np.sqrt(1 + squared / 9) - 1)
        errors[out] = soft.sum(axis=1) / views.is_seen[out].sum(axis=1)
    return errors
