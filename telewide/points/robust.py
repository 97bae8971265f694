"""Least squares that a fifth of wrong matches does not sway, with priors and standard deviations.

Minimises ``sum_i c^2 log(1 + r_i^2 / c^2) + s^2 sum_k ((x_k - m_k) / p_k)^2``: Cauchy's loss of N residuals, and
Gaussian priors of mean m and standard deviation p, s = 0.3 px being the spread a residual is expected to have. c is
0.7 px at first, then 2.4 times the spread that was found (95 % efficient for Gaussian noise), at most 0.7 px.
Every parameter has a prior; its width is also the scale on which the parameter is stepped.
Letters: N residuals, K parameters, S samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from telewide.geometry.arrays import FloatArray

Residuals = Callable[[FloatArray], FloatArray]
Jacobian = Callable[[FloatArray], FloatArray]

_LOSS_PX = 0.7
_SMALLEST_LOSS_PX = 0.1
_LOSS_PER_STD = 2.4
_NOISE_PX = 0.3
_CONSENSUS_PX = 1.5
_SAMPLES = 300
_STEP = 1e-3
_MEDIAN_OF_NORMAL = 0.6744897501960817  # of the sizes of normal numbers of deviation 1


@dataclass(frozen=True)
class RobustFit:
    """A solution with its uncertainty.

    Attributes:
        x: (K,) parameters.
        covariance: (K, K).
        residuals: (N,) at the solution.
        cost: the loss at the solution and what the priors add, with the first, fixed c; solutions compare by it.
    """

    x: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    cost: float

    @property
    def std(self) -> FloatArray:
        """(K,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True)
class _Problem:
    """Problem to be minimised: residuals and their derivative, priors in px, and the scale of the loss."""

    residuals: Residuals
    jacobian: Jacobian
    std: FloatArray
    noise_px: float

    def prior_px(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.noise_px * x / self.std)


def std_about_zero(residuals: FloatArray) -> float:
    """Standard deviation of normal residuals whose mean is 0, from their median size; outliers do not sway it.

    Args:
        residuals: (N,) of any sign, N > 0.
    """
    return float(np.median(np.abs(residuals)) / _MEDIAN_OF_NORMAL)


def std_about_median(values: FloatArray) -> FloatArray:
    """Standard deviation of normal values, from their median distance to their median; outliers do not sway it.

    Args:
        values: (N, ...), N > 0.

    Returns:
        (...), of each column.
    """
    return np.asarray(np.median(np.abs(values - np.median(values, axis=0)), axis=0) / _MEDIAN_OF_NORMAL)


def fit_robustly(
    residuals: Residuals,
    start: FloatArray,
    *,
    prior_std: FloatArray,
    jacobian: Jacobian | None = None,
    unit_px: float = 1.0,
) -> RobustFit:
    """Minimise robust residuals under priors.

    The covariance is Huber's for M-estimators, with the priors' information added:
    ``inv(J^T J mean(psi')^2 / mean(psi^2) + diag(1 / p^2))``.

    Args:
        residuals: (K,) parameters to (N,) residuals, px.
        start: (K,) where to begin.
        prior_std: (K,) standard deviations of the parameters about 0 before any match was seen.
        jacobian: (K,) parameters to the (N, K) derivative; None takes finite differences.
        unit_px: what one pixel of the loss is, px.

    Returns:
        The solution.
    """
    problem = _Problem(
        residuals=residuals,
        jacobian=jacobian or (lambda x: numeric_jacobian(residuals, x, step=_STEP * prior_std)),
        std=prior_std,
        noise_px=_NOISE_PX * unit_px,
    )
    first_loss_px = _LOSS_PX * unit_px
    rough = _minimised(problem, start, loss_px=first_loss_px)
    size_px = np.abs(residuals(rough))
    near_px = size_px[size_px <= 3 * first_loss_px]
    spread_px = std_about_zero(near_px) if len(near_px) else first_loss_px
    loss_px = float(np.clip(_LOSS_PER_STD * spread_px, _SMALLEST_LOSS_PX * unit_px, first_loss_px))
    x = _minimised(problem, rough, loss_px=loss_px)
    left = residuals(x)
    cost = first_loss_px**2 * np.log1p((left / first_loss_px) ** 2).sum() + (problem.prior_px(x) ** 2).sum()
    return RobustFit(x, _covariance(problem, x, residuals=left, loss_px=loss_px), left, float(cost))


def _minimised(problem: _Problem, start: FloatArray, *, loss_px: float) -> FloatArray:
    n_priors = len(start)

    def rows(x: FloatArray) -> FloatArray:
        return np.concatenate([problem.residuals(x), problem.prior_px(x)]) / loss_px

    def slopes(x: FloatArray) -> FloatArray:
        return np.vstack([problem.jacobian(x), np.diag(problem.noise_px / problem.std)]) / loss_px

    def loss(squared: FloatArray) -> FloatArray:
        rho = np.stack([np.log1p(squared), 1 / (1 + squared), -1 / (1 + squared) ** 2])
        rho[:, -n_priors:] = np.stack([squared[-n_priors:], np.ones(n_priors), np.zeros(n_priors)])
        return rho

    solved = least_squares(rows, start, jac=slopes, loss=loss, x_scale=problem.std, max_nfev=30, ftol=1e-7, xtol=1e-7)
    return np.asarray(solved.x, dtype=np.float64)


def _covariance(problem: _Problem, x: FloatArray, *, residuals: FloatArray, loss_px: float) -> FloatArray:
    ratio = (residuals / loss_px) ** 2
    influence = float(np.mean(residuals**2 / (1 + ratio) ** 2))
    sharpness = max(float(np.mean((1 - ratio) / (1 + ratio) ** 2)), 1e-3)
    J = problem.jacobian(x)
    information = J.T @ J * sharpness**2 / max(influence, 1e-12) + np.diag(1 / problem.std**2)
    return np.asarray(np.linalg.inv(information), dtype=np.float64)


def consensus_start(
    residuals: FloatArray, jacobian: FloatArray, *, prior_std: FloatArray, seed: int = 0, unit_px: float = 1.0
) -> FloatArray:
    """Find the parameters most residuals agree with, to begin from (RANSAC on the linearised residuals).

    Args:
        residuals: (N,) at parameters 0, px.
        jacobian: (N, K) there.
        prior_std: (K,) standard deviations of the parameters.
        seed: seed of the samples.
        unit_px: what one pixel of the tolerance is, px.

    Returns:
        (K,) parameters.
    """
    n_parameters = jacobian.shape[1]
    sample = np.random.default_rng(seed).integers(0, len(residuals), size=(_SAMPLES, n_parameters))
    weight = 1 / (_NOISE_PX * unit_px) ** 2
    J = jacobian[sample]
    normal = np.einsum("snk,snl->skl", J, J) * weight + np.diag(1 / prior_std**2)
    right = -np.einsum("snk,sn->sk", J, residuals[sample]) * weight
    tried = np.vstack([np.zeros(n_parameters), np.linalg.solve(normal, right[:, :, None])[:, :, 0]])
    left = residuals[None] + tried @ jacobian.T
    agreeing = (np.abs(left) <= _CONSENSUS_PX * unit_px).sum(axis=1)
    return np.asarray(tried[agreeing.argmax()])


def numeric_jacobian(residuals: Residuals, x: FloatArray, *, step: FloatArray) -> FloatArray:
    """Differentiate residuals about x by central differences, with one step for each of the K parameters: (N, K)."""
    columns = [
        (residuals(x + move) - residuals(x - move)) / (2 * size) for move, size in zip(np.diag(step), step, strict=True)
    ]
    return np.column_stack(columns)
