"""Uncertainty of every shared number after a bundle adjustment.

The covariance is the inverse of the normal equations, board poses eliminated, at the noise that the robust fit saw.
Real corners are not independent: a bent board or a blurred photo shifts all corners of a view together. How much more
the views pull on the solution than independent noise would let them is measured, and the covariance grows by it.
Letters: S shots; G shared numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.bundle import SOFT, normal_equations, residuals_px, with_prior
from telewide.calibration.problem import Problem, State
from telewide.geometry.arrays import FloatArray

_SOFT_SHARE = 0.72
"""Variance of a corner's pull under soft L1 at three standard deviations, over that of least squares, normal noise."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the shared numbers.

    Attributes:
        covariance: (30, 30), 0 for numbers that were held.
        noise_px: standard deviation of a corner along x or y, tele and wide.
        excess: how many times the views' pull exceeds that of independent noise, as a variance; 1 at least.
    """

    covariance: FloatArray
    noise_px: tuple[float, float]
    excess: float


def uncertainty(problem: Problem, state: State, *, free: NDArray[np.bool_]) -> Uncertainty:
    """State how sure the solution of a bundle adjustment is.

    Args:
        problem: the views that took part.
        state: the solution.
        free: (30,) which shared numbers were fitted.

    Returns:
        The covariance, noise and excess.
    """
    noise_px = (_noise_px(problem, state, lens=0, free=free), _noise_px(problem, state, lens=1, free=free))
    measured = replace(problem, sigma_px=noise_px)
    equations = with_prior(normal_equations(measured, state, is_robust=False), measured, state)
    shot_information, carry = _without_poses(equations.cross, equations.pose, equations.shot_shared)
    eliminated = np.einsum("sgi,shi->gh", equations.cross, carry)
    free_free = np.ix_(free, free)
    inverse = _inverse((equations.shared - eliminated)[free_free])
    robust = normal_equations(measured, state)
    pulls = (robust.shot_pull - np.einsum("sgi,si->sg", carry, robust.pose_pull))[:, free]
    excess = _excess(pulls, shot_information[:, free][:, :, free], inverse)
    covariance = np.zeros_like(equations.shared)
    covariance[free_free] = inverse * excess
    return Uncertainty(covariance, noise_px, excess)


def _without_poses(cross: FloatArray, pose: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information of each shot on the shared numbers, its pose unknown, (S, G, G); ``cross pose^-1``, (S, G, 6)."""
    is_seen = np.abs(pose).sum(axis=(1, 2)) > 0
    carry = np.zeros_like(cross)
    carry[is_seen] = np.linalg.solve(pose[is_seen], cross[is_seen].transpose(0, 2, 1)).transpose(0, 2, 1)
    return shared - np.einsum("sgi,shi->sgh", cross, carry), carry


def _noise_px(problem: Problem, state: State, *, lens: int, free: NDArray[np.bool_]) -> float:
    """Noise behind a soft-L1 fit: ``E psi^2 / (E psi')^2`` (Huber 1981), for the degrees of freedom left."""
    views = problem.seen_by(lens)
    sigma_px = problem.sigma_px[lens]
    squared = np.sum(residuals_px(problem, state, lens=lens)[views.is_seen] ** 2, axis=-1) / sigma_px**2
    weight = 1 / np.sqrt(1 + squared / SOFT**2)
    slope = weight - squared / SOFT**2 * weight**3 / 2
    n_numbers = 2 * len(squared)
    other = problem.views[1 - lens]
    shared_shots = 0 if other is None else np.isin(views.shot, other.shot).sum()
    fitted = 6 * len(views.shot) - 3 * shared_shots + free[lens * 12 : lens * 12 + 12].sum()
    share = n_numbers / max(n_numbers - fitted, 1)
    return float(sigma_px * np.sqrt(share * np.mean(weight**2 * squared) / 2) / np.mean(slope))


def _excess(pulls: FloatArray, information: FloatArray, inverse: FloatArray) -> float:
    """Spread of the shots' pulls over what independent noise gives, both measured by the covariance."""
    found = float(np.einsum("sg,gh,sh->", pulls, inverse, pulls)) / _SOFT_SHARE
    shares = information @ inverse
    expected = float(np.trace(shares.sum(axis=0)) - np.einsum("sgh,shg->", shares, shares))
    return max(found / expected, 1.0) if expected > 0.5 else 1.0


def _inverse(matrix: FloatArray) -> FloatArray:
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-14, hermitian=True)) * np.outer(
        scale, scale
    )
