"""A rig of unequal lenses, points it sees, and photos of a plane, all with exact truth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray
from telewide.geometry.grids import dense_map
from telewide.geometry.resample import resample
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.points.matches import Matches

BASELINE_M = 0.012


def phone_rig(*, is_vertical: bool = False, has_distortion: bool = True, width_px: int = 1600) -> StereoRig:
    """Tele and wide, three to one, a little turned against each other; 12 mm apart."""
    scale = width_px / 1600
    hw = (round(1200 * scale), width_px)
    tele_K = np.array([[3600 * scale, 0, 804 * scale], [0, 3600 * scale, 596 * scale], [0, 0, 1]])
    wide_K = np.array([[1200 * scale, 0, 794 * scale], [0, 1200 * scale, 606 * scale], [0, 0, 1]])
    tele_bend, wide_bend = (np.array([0.05, -0.1, 0, 0]), np.array([0.08, -0.15, 0.0005, -0.0003]))
    rotation = rigid_transform(rotation=np.radians([0.3, -0.4, 0.5]), translation=np.zeros(3))[:3, :3]
    centre_m = np.array([0.0005, BASELINE_M, 0.0003]) if is_vertical else np.array([BASELINE_M, 0.0004, 0.0003])
    none = np.zeros(0)
    return StereoRig(
        tele=Camera(hw, tele_K, tele_bend if has_distortion else none),
        wide=Camera(hw, wide_K, wide_bend if has_distortion else none),
        wide_from_tele=rigid_transform(rotation=rotation, translation=-rotation @ centre_m),
    )


def seen_points(
    rig: StereoRig, rng: np.random.Generator, *, n: int = 500, nearest_m: float = 0.5, farthest_m: float = 4.0
) -> Matches:
    """Exact matches of points all over the tele photo, evenly spread in disparity."""
    height, width = rig.tele.hw
    tele_px = rng.uniform([5.0, 5.0], [width - 6.0, height - 6.0], (n, 2))
    depth_m = 1 / rng.uniform(1 / farthest_m, 1 / nearest_m, n)
    points = np.column_stack([rig.tele.normalised(tele_px), np.ones(n)]) * depth_m[:, None]
    wide_px = rig.wide.project(points @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3])
    return Matches(tele_px, wide_px)


def measured(
    exact: Matches, rng: np.random.Generator, *, noise_px: float = 0.3, wrong_share: float = 0.2, asymmetry: float = 3.0
) -> Matches:
    """The matches with noise (tele px) in both photos, a share of them wrong by up to 40 px."""
    tele_px = exact.ref_px + rng.normal(0, noise_px, exact.ref_px.shape)
    wide_px = exact.src_px + rng.normal(0, noise_px / asymmetry, exact.src_px.shape)
    is_wrong = rng.random(len(exact)) < wrong_share
    wide_px[is_wrong] += rng.uniform(-40, 40, (int(is_wrong.sum()), 2)) / asymmetry
    return Matches(tele_px, wide_px)


def wide_centre(rig: StereoRig) -> FloatArray:
    """Unit vector from tele to wide, in tele's frame."""
    centre = -rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3]
    return np.asarray(centre / np.linalg.norm(centre))


def angle_deg(first: FloatArray, second: FloatArray) -> float:
    """Angle between two unit vectors."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def photos_of_a_plane(
    rig: StereoRig, rng: np.random.Generator, *, depth_m: float = 1.5
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What both lenses see of a textured plane across tele's optical axis: every point on it is 1 px of tele large."""
    size_px = 2 * max(rig.tele.hw)
    texture = np.zeros((size_px, size_px), dtype=np.float32)
    for sigma_px in (2.0, 4.0, 8.0):
        noise = cv2.GaussianBlur(rng.standard_normal((size_px, size_px)).astype(np.float32), (0, 0), sigma_px)
        texture += 0.12 * noise / noise.std()
    texture = np.clip(0.5 + texture, 0, 1)
    return _seen(texture, rig.tele, np.eye(4), rig, depth_m), _seen(texture, rig.wide, rig.wide_from_tele, rig, depth_m)


def _seen(
    texture: NDArray[np.float32], camera: Camera, camera_from_tele: FloatArray, rig: StereoRig, depth_m: float
) -> NDArray[np.float32]:
    tele_from_camera = np.linalg.inv(camera_from_tele)
    origin = tele_from_camera[:3, 3]
    middle = (np.array(texture.shape[::-1]) - 1) / 2

    def texture_px(photo_px: FloatArray) -> FloatArray:
        rays = np.column_stack([camera.normalised(photo_px), np.ones(len(photo_px))]) @ tele_from_camera[:3, :3].T
        points = origin + rays * ((depth_m - origin[2]) / rays[:, 2])[:, None]
        return np.asarray(points[:, :2] * rig.tele.f_px / depth_m + middle)

    map_x, map_y = dense_map(texture_px, hw=camera.hw, max_error_px=0.02)
    return resample(texture, map_x, map_y, shrink=rig.tele.f_px / camera.f_px)
