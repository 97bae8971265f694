"""Distortion, against OpenCV; derivatives, against difference quotients."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.calibration.distortion import (
    LADDER,
    N_LENS,
    camera_of,
    is_one_to_one,
    n_coefficients,
    prior_of_lens,
    project,
    project_with_derivatives,
)

LENS = np.array([1000, 0.01, 500, 400, 0.1, -0.05, 0.002, -0.003, 0.02, 0.05, 0.01, -0.02])


def points(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(30, 3)) * (0.6, 0.5, 0.2) + (0, 0, 2)


def test_projection_is_opencvs(rng: np.random.Generator) -> None:
    points_m = points(rng)
    fx, fy = LENS[0] * (1 + LENS[1]), LENS[0] * (1 - LENS[1])
    K = np.array([[fx, 0, LENS[2]], [0, fy, LENS[3]], [0, 0, 1]])
    expected = cv2.projectPoints(points_m[:, None], np.zeros(3), np.zeros(3), K, LENS[4:])[0][:, 0]
    np.testing.assert_allclose(project(points_m, LENS), expected, atol=1e-9)
    np.testing.assert_allclose(project_with_derivatives(points_m, LENS)[0], expected, atol=1e-9)
    np.testing.assert_allclose(camera_of(LENS, hw=(800, 1000)).project(points_m), expected, atol=1e-9)


@pytest.mark.parametrize("number", range(N_LENS))
def test_derivative_by_the_lens_is_the_difference_quotient(number: int, rng: np.random.Generator) -> None:
    points_m, step = points(rng), np.zeros(N_LENS)
    step[number] = 1e-6 * max(1.0, LENS[number])
    quotient = (project(points_m, LENS + step) - project(points_m, LENS - step)) / (2 * step[number])
    np.testing.assert_allclose(project_with_derivatives(points_m, LENS)[1][..., number], quotient, atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
def test_derivative_by_the_point_is_the_difference_quotient(axis: int, rng: np.random.Generator) -> None:
    points_m, step = points(rng), np.zeros(3)
    step[axis] = 1e-6
    quotient = (project(points_m + step, LENS) - project(points_m - step, LENS)) / 2e-6
    np.testing.assert_allclose(project_with_derivatives(points_m, LENS)[2][..., axis], quotient, atol=1e-5)


@pytest.mark.parametrize(("name", "n"), [("none", 0), ("k1", 4), ("k1k2p1p2", 4), ("k1k2p1p2k3", 5), ("rational", 8)])
def test_a_lens_is_written_with_as_many_coefficients_as_its_model_needs(name: str, n: int) -> None:
    lens = np.zeros(N_LENS)
    lens[list(LADDER[name])] = 1.0
    assert n_coefficients(lens) == n
    assert len(camera_of(lens, hw=(10, 10)).distortion) == n


def test_a_lens_that_folds_back_inside_the_photo_is_told() -> None:
    lens = prior_of_lens((3000, 4000), f_px=3000)[0]
    assert is_one_to_one(lens, hw=(3000, 4000))
    lens[4] = -1.0  # r (1 - r^2) turns back at r = 0.58, inside the corner's 0.83
    assert not is_one_to_one(lens, hw=(3000, 4000))
