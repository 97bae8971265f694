"""A camera against OpenCV and against its own inverse; a rig against what its numbers say."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rigs import TELE_DISTORTION, WIDE_DISTORTION, camera, in_wide, phone, points_in_view

from telewide.geometry.arrays import FloatArray
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


def turned_points(points_px: FloatArray, *, hw: tuple[int, int], turn_deg: int) -> FloatArray:
    """Where the pixels of a photo are after it was turned clockwise, by numpy's own turn of their places."""
    places = np.rot90(np.arange(hw[0] * hw[1]).reshape(hw), -turn_deg // 90)
    order = np.argsort(places, axis=None)
    rows, columns = np.unravel_index(order, places.shape)
    found = points_px[:, 1] * hw[1] + points_px[:, 0]
    return np.column_stack([columns[found], rows[found]]).astype(np.float64)


@pytest.mark.parametrize("turn_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("distortion", [(), TELE_DISTORTION, WIDE_DISTORTION])
def test_a_turned_rig_sees_a_point_where_the_turned_photos_have_it(
    turn_deg: int, distortion: tuple[float, ...], rng: np.random.Generator
) -> None:
    lens = camera((60, 80), f_px=70, off_centre_px=(4, -9), distortion=distortion)
    lens = replace(lens, K=lens.K * [[1.02], [1], [1]])
    pixels = rng.integers([0, 0], [80, 60], (50, 2))
    rays = np.column_stack([lens.normalised(pixels.astype(np.float64)), np.ones(50)])
    turned = replace(phone(), tele=lens, wide=lens).turned(tele_deg=turn_deg, wide_deg=(turn_deg + 90) % 360)
    assert turned.tele.hw == np.rot90(np.zeros(lens.hw), -turn_deg // 90).shape
    radians = np.radians(turn_deg)
    frame = np.array([[np.cos(radians), -np.sin(radians), 0], [np.sin(radians), np.cos(radians), 0], [0, 0, 1]])
    expected_px = turned_points(pixels, hw=lens.hw, turn_deg=turn_deg)
    np.testing.assert_allclose(turned.tele.project(rays @ frame.T), expected_px, atol=1e-6)


@pytest.mark.parametrize(("tele_deg", "wide_deg"), [(180, 180), (90, 90), (270, 0)])
def test_turning_a_rig_moves_no_point_of_the_world(tele_deg: int, wide_deg: int, rng: np.random.Generator) -> None:
    rig = phone("oblique")
    turned = rig.turned(tele_deg=tele_deg, wide_deg=wide_deg)
    points_m = points_in_view(rig, rng, n=40)
    wide_px = rig.wide.project(in_wide(rig, points_m))
    alone = rig.turned(tele_deg=tele_deg, wide_deg=0)
    tele_turn = alone.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, :3]
    found_px = turned.wide.project(in_wide(turned, points_m @ tele_turn.T))
    back = turned.turned(tele_deg=-tele_deg, wide_deg=-wide_deg)
    np.testing.assert_allclose(back.wide_from_tele, rig.wide_from_tele, atol=1e-15)
    np.testing.assert_allclose(back.wide.K, rig.wide.K, atol=1e-9)
    height, width = rig.wide.hw
    x, y = wide_px.T
    expected = {0: (x, y), 90: (height - 1 - y, x), 180: (width - 1 - x, height - 1 - y)}[wide_deg]
    np.testing.assert_allclose(found_px, np.column_stack(expected), atol=1e-6)


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
