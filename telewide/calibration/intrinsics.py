"""One lens from its own views: focal length, principal point, distortion, and which views do not agree.

Letters: V views; N corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from telewide.calibration.bundle import solve_bundle
from telewide.calibration.distortion import LADDER, N_LENS, F, prior_of_lens
from telewide.calibration.model_selection import best_model, free_numbers, ladder
from telewide.calibration.poses import noise_px, placed, unplaced, view_scale_px
from telewide.calibration.problem import Problem, Sightings, State
from telewide.geometry.arrays import BoolArray, FloatArray

DISAGREES = 2.5
"""A view whose typical error is less than this many times the others' agrees with them."""
NEGLIGIBLE_PX = 0.1
"""So does one whose typical error is less than this: no corner of a photo is found better for sure."""
_DEVIATIONS = 4.0
_MOST = 4.0
_ROUNDS = 8


@dataclass(frozen=True)
class LensFit:
    """A lens as its own views tell it.

    Attributes:
        lens: (12,) the lens.
        free: (12,) bool, which numbers were fitted.
        sigma_px: noise of a corner along x or y.
        prior: (12,) and (12,): centre and standard deviation of what was believed before.
        is_used: (V,) the views that agree.
        state: the fit, with the lens as its tele lens.
    """

    lens: FloatArray
    free: BoolArray
    sigma_px: float
    prior: tuple[FloatArray, FloatArray]
    is_used: BoolArray
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
    chosen = replace(problem, views=(views.only(is_used), None))
    free = best_model(chosen, state, names=names, rng=rng)
    state = solve_bundle(chosen, state.held(free), free=free)
    state = _placed_left_out(problem, state, is_used=is_used)
    return LensFit(
        lens=state.lenses[0],
        free=free[:N_LENS],
        sigma_px=problem.sigma_px[0],
        prior=prior,
        is_used=is_used,
        state=state,
    )


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


def _first_noise_px(hw: tuple[int, int]) -> float:
    return max(hw) / 1000


def _agreeing(problem: Problem, state: State) -> tuple[Problem, State, BoolArray]:
    """Fit and leave out in turns until the views that agree stay the same; noise is measured on the way."""
    views = problem.seen_by(0)
    is_used = np.ones(len(views.shot), dtype=bool)
    for turn in range(_ROUNDS):
        state = placed(problem, state)
        before, is_used = is_used, agrees(view_scale_px(problem, state, lens=0))
        if turn > 2 and np.array_equal(before, is_used):
            break
        chosen = replace(problem, views=(views.only(is_used), None))
        numbers = (F,) if turn == 0 else LADDER["k1"] if turn == 1 else LADDER["k1k2p1p2"]
        state = solve_bundle(chosen, state, free=free_numbers(numbers, lens=0))
        sigma_px = noise_px(chosen, state, lens=0)
        problem = replace(problem, sigma_px=(sigma_px, 1.0))
    return problem, state, is_used


def agrees(scale_px: FloatArray) -> BoolArray:
    """Tell which views agree with most of the others; see `largest_agreeing_px`.

    Args:
        scale_px: (V,) typical errors.

    Returns:
        (V,) bool.
    """
    return np.asarray(scale_px <= largest_agreeing_px(scale_px))


def largest_agreeing_px(scale_px: FloatArray) -> float:
    """Return the largest typical error with which a view agrees with most of the others.

    Two and a half times that of the better views; up to four times where those differ from each other by much, as near
    and far boards do: four standard deviations of their logarithm. A third of the views may be ruined, so the better
    ones are the better two thirds, and their spread is taken below their median.

    Args:
        scale_px: (V,) typical errors, not finite where there is none.

    Returns:
        px, 0.1 at least; 0 without a view.
    """
    finite = scale_px[np.isfinite(scale_px)]
    if not len(finite):
        return 0.0
    typical_px = max(float(np.percentile(finite, 100 / 3)), 1e-9)
    better = np.log(np.maximum(finite[finite <= typical_px], 1e-9) / typical_px)
    # The lower half of a normal distribution about its middle: its mean square is the variance.
    spread = float(np.sqrt(np.mean(better**2)))
    return max(typical_px * float(np.clip(np.exp(_DEVIATIONS * spread), DISAGREES, _MOST)), NEGLIGIBLE_PX)


def _placed_left_out(problem: Problem, state: State, *, is_used: BoolArray) -> State:
    """Boards of the views left out, placed as well as this lens allows."""
    if is_used.all():
        return state
    views = problem.seen_by(0)
    anew = placed(problem, state)
    used = np.zeros(len(state.pose_t), dtype=bool)
    used[views.shot[is_used]] = True
    return replace(
        state,
        pose_R=np.where(used[:, None, None], state.pose_R, anew.pose_R),
        pose_t=np.where(used[:, None], state.pose_t, anew.pose_t),
    )
