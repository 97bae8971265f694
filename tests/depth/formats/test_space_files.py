"""Points and meshes, read by trimesh: they lie where the camera sees them, and no triangle bridges two surfaces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from depth.formats.made_depth import BASELINE_M, BOX, F_PX, HW, depth_m, made_photo, made_result, turned, turned_result
from rigs import phone

from telewide.capture.facts import CaptureFacts
from telewide.depth.export import write_depth
from telewide.depth.result import depth_result, depth_result_of_rig
from telewide.geometry.stereo import DisparityMap

trimesh = pytest.importorskip("trimesh", reason="the extra mesh is not installed")


def read_mesh(path: Path) -> Any:
    (mesh,) = trimesh.load(path).geometry.values()
    return mesh


def test_points_project_onto_their_pixels_with_their_colours(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("ply",))
    cloud = trimesh.load(tmp_path / "points.ply")
    known = np.isfinite(depth_m())
    assert len(cloud.vertices) == known.sum()
    at = np.asarray(cloud.vertices) @ np.asarray(made_result().K).T
    y, x = np.nonzero(known)
    np.testing.assert_allclose(at[:, :2] / at[:, 2:], np.column_stack([x, y]), atol=1e-3)
    np.testing.assert_allclose(at[:, 2], depth_m()[known], rtol=1e-5)
    np.testing.assert_allclose(cloud.colors[:, :3] / 255, made_photo()[known], atol=0.003)


def test_points_of_a_distorted_lens_project_onto_their_pixels(tmp_path: Path) -> None:
    rig = phone(shrink=72)
    hw = rig.tele.hw
    disparity = DisparityMap(np.full(hw, 3.0, np.float32), np.ones(hw, np.float32), np.ones(hw, np.bool_))
    result = depth_result_of_rig("shot", disparity, rig=rig)
    assert np.abs(rig.tele.distortion).max() > 0.01
    write_depth(tmp_path, result, formats=("ply",))
    cloud = trimesh.load(tmp_path / "points.ply")
    seen, _ = cv2.projectPoints(
        np.asarray(cloud.vertices, np.float64), np.zeros(3), np.zeros(3), rig.tele.K, rig.tele.distortion
    )
    y, x = np.mgrid[: hw[0], : hw[1]]
    np.testing.assert_allclose(seen[:, 0], np.column_stack([x.ravel(), y.ravel()]), atol=0.01)


@pytest.mark.parametrize("rotated_deg", [90, 180, 270])
def test_points_and_mesh_of_turned_photos_are_those_of_upright_ones(tmp_path: Path, rotated_deg: int) -> None:
    write_depth(tmp_path / "upright", made_result(), image=made_photo(), formats=("ply", "glb"))
    photo = turned(made_photo(), rotated_deg)
    write_depth(tmp_path / "turned", turned_result(rotated_deg), image=photo, formats=("ply", "glb"))
    expected, found = (trimesh.load(tmp_path / name / "points.ply") for name in ("upright", "turned"))
    np.testing.assert_allclose(found.vertices, expected.vertices, atol=1e-5)
    np.testing.assert_array_equal(found.colors, expected.colors)
    expected, found = (read_mesh(tmp_path / name / "mesh.glb") for name in ("upright", "turned"))
    np.testing.assert_allclose(found.vertices, expected.vertices, atol=1e-5)
    np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_allclose(found.visual.uv, expected.visual.uv, atol=1e-6)
    textures = (np.asarray(mesh.visual.material.baseColorTexture, dtype=int) for mesh in (found, expected))
    np.testing.assert_allclose(*textures, atol=4)


def test_mesh_is_cut_at_depth_edges_and_faces_the_camera(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("glb",))
    mesh = read_mesh(tmp_path / "mesh.glb")
    corners_m = -np.asarray(mesh.vertices)[mesh.faces][..., 2]  # glTF looks along -z
    assert (corners_m > 0).all()
    near_m, far_m = corners_m.min(axis=1), corners_m.max(axis=1)
    apart_px = F_PX * BASELINE_M * (1 / near_m - 1 / far_m)
    assert not ((far_m > 1.0401 * near_m) & (apart_px > 0.251)).any()
    box_m = depth_m()[BOX].min()
    near = np.isclose(corners_m, box_m, rtol=1e-4).all(axis=1)
    height, width = depth_m()[BOX].shape
    assert near.sum() == 2 * (height - 1) * (width - 1)
    towards_camera = (np.asarray(mesh.face_normals) * -np.asarray(mesh.triangles_center)).sum(axis=1)
    assert (towards_camera > 0).all()


def test_far_surfaces_are_in_the_mesh_as_in_the_points(tmp_path: Path, rng: np.random.Generator) -> None:
    """Noise of a few hundredths of a px is a share of a far depth larger than that of many an edge near by."""
    disparity_px = np.full(HW, 0.5, np.float32) + rng.normal(0, 0.04, HW).astype(np.float32)
    maps = DisparityMap(disparity_px, np.ones(HW, np.float32), np.ones(HW, np.bool_))
    result = depth_result("far", maps, facts=CaptureFacts(f_px=F_PX, baseline_m=BASELINE_M))
    write_depth(tmp_path, result, image=made_photo(), formats=("glb", "ply"))
    mesh, cloud = read_mesh(tmp_path / "mesh.glb"), trimesh.load(tmp_path / "points.ply")
    assert len(mesh.faces) > 0.99 * 2 * (HW[0] - 1) * (HW[1] - 1)
    assert -mesh.vertices[:, 2].min() == pytest.approx(cloud.vertices[:, 2].max(), rel=1e-4)


def test_texture_lies_on_its_pixels(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("glb",))
    mesh = read_mesh(tmp_path / "mesh.glb")
    at = (np.asarray(mesh.vertices) * [1, -1, -1]) @ np.asarray(made_result().K).T
    at_px = at[:, :2] / at[:, 2:]
    u, v = np.asarray(mesh.visual.uv).T
    expected = np.column_stack([(at_px[:, 0] + 0.5) / HW[1], 1 - (at_px[:, 1] + 0.5) / HW[0]])
    np.testing.assert_allclose(np.column_stack([u, v]), expected, atol=1e-4)
    assert mesh.visual.material.baseColorTexture.size == HW[::-1]


@pytest.mark.parametrize(("kind", "name"), [("ply", "points.ply"), ("glb", "mesh.glb")])
def test_without_metres_there_is_none(kind: str, name: str, tmp_path: Path) -> None:
    written = write_depth(tmp_path, made_result(has_metres=False), image=made_photo(), formats=(kind,))
    assert [path.name for path in written.paths] == ["preview.png"]
    assert f"no {name}, its depth in metres is not known" in written.notes[0]
