"""A camera against OpenCV and against its own inverse; a rig against what its numbers say."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rigs import TELE_DISTORTION, WIDE_DISTORTION, camera, phone

from telewide.geometry.camera import scaled_points
from telewide.geometry.rig import rigid_transform


@pytest.mark.parametrize("turn_deg", [0.0, 0.4, 12.0, 180.0])
def test_the_turn_is_the_angle_it_was_made_with(turn_deg: float, rng: np.random.Generator) -> None:
    axis = rng.normal(size=3)
    turned = rigid_transform(
        rotation=np.radians(turn_deg) * axis / np.linalg.norm(axis), translation=np.array([0.01, 0, 0])
    )
    assert replace(phone(), wide_from_tele=turned).turn_deg == pytest.approx(turn_deg, abs=1e-5)


@pytest.mark.parametrize("distortion", [(), (0.1, -0.05, 0.001, 0.0), TELE_DISTORTION, WIDE_DISTORTION])
def test_project_is_opencvs(distortion: tuple[float, ...], rng: np.random.Generator) -> None:
    lens = camera((600, 800), f_px=700, off_centre_px=(4, -9), distortion=distortion)
    points_m = rng.uniform([-0.6, -0.5, 0.9], [0.6, 0.5, 3.0], (50, 3))
    by_opencv, _ = cv2.projectPoints(
        points_m, np.zeros(3), np.zeros(3), lens.K, np.array([*distortion, 0, 0, 0, 0], dtype=np.float64)[:8]
    )
    np.testing.assert_allclose(lens.project(points_m), by_opencv[:, 0], atol=1e-9)


@pytest.mark.parametrize("distortion", [(), (-0.3, 0.1, 0.002, -0.001), TELE_DISTORTION, WIDE_DISTORTION])
def test_normalised_undoes_project_over_the_whole_photo(distortion: tuple[float, ...]) -> None:
    lens = camera((600, 800), f_px=760, off_centre_px=(4, -9), distortion=distortion)
    points_px = np.stack(np.meshgrid(np.linspace(0, 799, 21), np.linspace(0, 599, 17)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([lens.normalised(points_px), np.ones(len(points_px))])
    np.testing.assert_allclose(lens.project(2.5 * rays), points_px, atol=1e-4)
    assert lens.normalised(np.empty((0, 2))).shape == (0, 2)


def test_resized_camera_sees_the_resized_photo(rng: np.random.Generator) -> None:
    lens = camera((600, 800), f_px=700, off_centre_px=(4, -9), distortion=TELE_DISTORTION)
    points_m = rng.uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 3.0], (50, 3))
    expected = scaled_points(lens.project(points_m), scale_xy=(0.25, 0.25))
    np.testing.assert_allclose(lens.resized((150, 200)).project(points_m), expected, atol=1e-9)


def test_rig_knows_its_baseline_and_factor() -> None:
    rig = phone("oblique")
    assert rig.baseline_m == pytest.approx(np.linalg.norm([0.009, 0.006, 0.0005]))
    assert rig.asymmetry == pytest.approx(3.0)
    swapped = replace(rig, tele=rig.wide, wide=rig.tele)
    assert swapped.asymmetry == pytest.approx(1 / 3)


def test_rigid_transform_takes_vectors_and_matrices(rng: np.random.Generator) -> None:
    vector = rng.normal(size=3)
    by_vector = rigid_transform(rotation=vector, translation=np.array([1.0, 2.0, 3.0]))
    by_matrix = rigid_transform(rotation=cv2.Rodrigues(vector)[0], translation=np.array([[1.0], [2.0], [3.0]]))
    np.testing.assert_allclose(by_vector, by_matrix, atol=1e-12)
    np.testing.assert_allclose(by_vector[:3, :3] @ by_vector[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(by_vector[:, 3], [1, 2, 3, 1])
