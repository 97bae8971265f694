"""A rig whose every number is known, and the corners it sees. Projection is written out here, without OpenCV."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from telewide.boards.detection import BoardView
from telewide.boards.shots import DetectedShot
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

SQUARE_M = 0.04


def board_points(columns: int = 9, rows: int = 6) -> FloatArray:
    ys, xs = np.mgrid[:rows, :columns] * SQUARE_M
    return np.stack([xs.ravel(), ys.ravel(), np.zeros(xs.size)], axis=1)


def camera(f_px: float, hw: tuple[int, int], off_px: tuple[float, float], distortion: tuple[float, ...]) -> Camera:
    centre = (np.array(hw[::-1]) - 1) / 2 + off_px
    return Camera(hw, np.array([[f_px, 0, centre[0]], [0, f_px, centre[1]], [0, 0, 1.0]]), np.array(distortion))


def phone() -> StereoRig:
    return StereoRig(
        tele=camera(9000, (3000, 4000), (25, -18), (0.12, -0.4, 0.0008, -0.0005)),
        wide=camera(3000, (3000, 4000), (-14, 22), (0.09, -0.16, -0.0006, 0.0004)),
        wide_from_tele=rigid_transform(
            rotation=np.radians([0.3, -0.5, 0.2]), translation=np.array([0.0098, 0.0015, -0.0012])
        ),
    )


def seen(camera: Camera, points_m: FloatArray) -> FloatArray:
    """Brown's model, spelled out."""
    k1, k2, p1, p2, k3 = (*camera.distortion, 0, 0, 0, 0, 0)[:5]
    x, y = points_m[:, 0] / points_m[:, 2], points_m[:, 1] / points_m[:, 2]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=1
    )
    return bent * np.diag(camera.K)[:2] + camera.K[:2, 2]


@dataclass(frozen=True)
class World:
    rig: StereoRig = field(default_factory=phone)
    board_m: FloatArray = field(default_factory=board_points)
    noise_px: float = 0.2
    tilt_deg: float = 45.0

    def view(self, camera: Camera, points_m: FloatArray, rng: np.random.Generator) -> BoardView | None:
        points_px = seen(camera, points_m)
        inside = np.all((points_px > 3) & (points_px < np.array(camera.hw[::-1]) - 4), axis=1)
        if inside.sum() < 12:
            return None
        noisy = points_px + self.noise_px * rng.normal(size=points_px.shape)
        return BoardView(np.flatnonzero(inside), noisy[inside], camera.hw)

    def pose(self, lens: Camera, distance_m: float, rng: np.random.Generator) -> FloatArray:
        """A board before a lens, its middle somewhere in the photo, tilted to any side."""
        side, angle = rng.uniform(0, 2 * np.pi), np.radians(self.tilt_deg) * np.sqrt(rng.uniform())
        turn = Rotation.from_rotvec(angle * np.array([np.cos(side), np.sin(side), 0]))
        turn = turn * Rotation.from_rotvec([0, 0, rng.normal() * 0.3])
        aim = rng.uniform(-0.25, 0.25, 2) * np.array(lens.hw[::-1]) / lens.f_px * distance_m
        middle = self.board_m.mean(axis=0)
        R = turn.as_matrix()
        return rigid_transform(rotation=R, translation=np.array([*aim, distance_m]) - R @ middle)

    def shots(
        self, rng: np.random.Generator, *, joint: int = 20, tele_close: int = 8, wide_close: int = 8
    ) -> tuple[DetectedShot, ...]:
        made = []
        for k in range(joint):
            tele_from_board = self.pose(self.rig.tele, (0.8, 1.1, 1.5)[k % 3] * rng.uniform(0.9, 1.1), rng)
            made.append(self.shot(f"joint{k:02d}", tele_from_board, rng))
        for k in range(tele_close):
            shot = self.shot(f"tele_close/{k:02d}", self.pose(self.rig.tele, rng.uniform(0.6, 0.8), rng), rng)
            made.append(replace(shot, wide=None))
        for k in range(wide_close):
            pose = self.pose(self.rig.wide, rng.uniform(0.3, 0.45), rng)
            shot = self.shot(f"wide_close/{k:02d}", np.linalg.inv(self.rig.wide_from_tele) @ pose, rng)
            made.append(replace(shot, tele=None))
        return tuple(made)

    def shot(self, name: str, tele_from_board: FloatArray, rng: np.random.Generator) -> DetectedShot:
        in_tele = self.board_m @ tele_from_board[:3, :3].T + tele_from_board[:3, 3]
        in_wide = in_tele @ self.rig.wide_from_tele[:3, :3].T + self.rig.wide_from_tele[:3, 3]
        return DetectedShot(name, self.view(self.rig.tele, in_tele, rng), self.view(self.rig.wide, in_wide, rng))


def rotation_error_rad(found: StereoRig, true: StereoRig) -> FloatArray:
    """Small turn about the wide camera's axes from the true to the found rig."""
    turn = found.wide_from_tele[:3, :3] @ true.wide_from_tele[:3, :3].T
    return Rotation.from_matrix(turn).as_rotvec()
