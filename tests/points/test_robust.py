"""Robust fits against closed forms: least squares with a prior, their stated deviations, and wrong matches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import median_abs_deviation

from telewide.points.robust import RobustFit, consensus_start, fit_robustly, std_about_median, std_about_zero

FloatArray = NDArray[np.float64]


def fit_line(y: FloatArray, x: FloatArray, *, prior_std: tuple[float, float]) -> RobustFit:
    """``y = a + b x``."""
    design = np.column_stack([np.ones_like(x), x])
    return fit_robustly(lambda law: design @ law - y, np.zeros(2), prior_std=np.array(prior_std))


def noisy_line(rng: np.random.Generator, *, n: int = 200, std: float = 0.2) -> tuple[FloatArray, FloatArray]:
    x = rng.uniform(-1, 1, n)
    return 1.5 - 0.7 * x + rng.normal(0, std, n), x


def test_without_wrong_matches_it_is_least_squares(rng: np.random.Generator) -> None:
    y, x = noisy_line(rng)
    fit = fit_line(y, x, prior_std=(100.0, 100.0))
    np.testing.assert_allclose(fit.x, np.polynomial.polynomial.polyfit(x, y, 1), atol=0.02)
    np.testing.assert_allclose(fit.residuals, fit.x[0] + fit.x[1] * x - y)


def test_a_fifth_of_wrong_matches_does_not_sway_it(rng: np.random.Generator) -> None:
    y, x = noisy_line(rng)
    y[::5] += rng.uniform(3, 20, len(y[::5]))
    fit = fit_line(y, x, prior_std=(100.0, 100.0))
    assert np.abs(fit.x - (1.5, -0.7)).max() < 0.1


def test_stated_deviations_are_those_of_the_errors() -> None:
    """Over 60 draws of noise errors over stated deviations have a spread of one."""
    errors = []
    for seed in range(60):
        y, x = noisy_line(np.random.default_rng(seed))
        fit = fit_line(y, x, prior_std=(100.0, 100.0))
        errors.append((fit.x - (1.5, -0.7)) / fit.std)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2


def test_priors_pull_as_much_as_they_say(rng: np.random.Generator) -> None:
    """A measurement of 0.3 px against a prior of the same deviation about 0: half of it; a tight prior holds."""
    alone = fit_robustly(lambda law: law - 0.4, np.zeros(1), prior_std=np.array([0.3]))
    assert float(alone.x[0]) == pytest.approx(0.2, abs=0.05)
    y, x = noisy_line(rng)
    held = fit_line(y, x, prior_std=(100.0, 1e-4))
    assert abs(held.x[1]) < 1e-3
    assert held.std[1] <= 1e-4


def test_most_residuals_say_where_to_begin(rng: np.random.Generator) -> None:
    y, x = noisy_line(rng, std=0.3)
    y[: len(y) // 3] = rng.uniform(-50, 50, len(y) // 3)
    start = consensus_start(-y, np.column_stack([np.ones_like(x), x]), prior_std=np.array([100.0, 100.0]))
    assert np.abs(start - (1.5, -0.7)).max() < 1.0


def test_deviations_by_medians_are_those_of_scipy(rng: np.random.Generator) -> None:
    values = rng.normal(3.0, 2.0, (501, 2))
    np.testing.assert_allclose(std_about_median(values), median_abs_deviation(values, axis=0, scale="normal"))
    about_zero = median_abs_deviation(values[:, 0], center=lambda of, axis: np.float64(0), scale="normal")
    assert std_about_zero(values[:, 0]) == pytest.approx(about_zero)
