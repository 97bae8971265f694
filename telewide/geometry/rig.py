"""Two cameras and how they stand to each other.

``wide_from_tele @ p_tele = p_wide`` in homogeneous metres; camera x right, y down, z forward. Distortion is OpenCV's:
k1 k2 p1 p2 k3 k4 k5 k6, as many as there are. Points are (x, y), pixel (0, 0) is the centre of the top-left pixel.
Letters: N points; K camera matrix, px.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.camera import scaled_intrinsics

_INVERSE_ITERATIONS = 10


@dataclass(frozen=True)
class Camera:
    """One lens at one photo size.

    Attributes:
        hw: height and width of its photos, as they stand upright.
        K: (3, 3) camera matrix, px.
        distortion: (n,) OpenCV coefficients, n = 0, 4, 5 or 8.
    """

    hw: tuple[int, int]
    K: FloatArray
    distortion: FloatArray

    @property
    def f_px(self) -> float:
        """Mean of the focal lengths along x and y."""
        return float((self.K[0, 0] + self.K[1, 1]) / 2)

    def resized(self, hw: tuple[int, int]) -> Camera:
        """The same lens for photos of another size; cx and cy move by the half-pixel rule."""
        scale_xy = (hw[1] / self.hw[1], hw[0] / self.hw[0])
        return replace(self, hw=hw, K=scaled_intrinsics(self.K, scale_xy=scale_xy))

    def turned(self, turn_deg: int) -> Camera:
        """The same lens for photos that lie turned clockwise by a multiple of 90 degrees, its frame turned with them.

        The tangential distortion is ``2 (p . x) x + r^2 p`` of the vector ``p = (p2, p1)``, which turns as points do.
        """
        turn = _turn_of_frame(turn_deg)
        height, width = self.hw
        hw = (width, height) if turn_deg % 180 else self.hw
        middle_px, turned_middle_px = (np.array(size[::-1]) / 2 - 0.5 for size in (self.hw, hw))
        K = np.diag([*np.abs(turn @ np.diag(self.K)[:2]), 1.0])
        K[:2, 2] = turn @ (self.K[:2, 2] - middle_px) + turned_middle_px
        distortion = self.distortion.copy()
        if len(distortion):
            distortion[[3, 2]] = turn @ distortion[[3, 2]]
        return Camera(hw, K, distortion)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Points (N, 3) in this camera's frame to (N, 2) px, distortion included."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 1, 3)
        if len(points) == 0:
            return np.zeros((0, 2))
        zero = np.zeros(3)
        projected, _ = cv2.projectPoints(points, zero, zero, self.K, self._coefficients())
        return np.asarray(projected, dtype=np.float64).reshape(-1, 2)

    def normalised(self, points_px: FloatArray) -> FloatArray:
        """Pixels (N, 2) of a photo to (N, 2) x/z and y/z of their rays, distortion taken out."""
        points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
        if len(points) == 0:
            return points
        rays = cv2.undistortPoints(points[:, None], self.K, self._coefficients())
        normalised = np.asarray(rays, dtype=np.float64).reshape(-1, 2)
        # OpenCV stops after five iterations, not exact for wide lenses; its versions differ in how to ask for more.
        for _ in range(_INVERSE_ITERATIONS):
            again_px = self.project(np.column_stack([normalised, np.ones(len(normalised))]))
            normalised += (points - again_px) / np.diag(self.K)[:2]
        return normalised

    def _coefficients(self) -> FloatArray:
        return self.distortion if len(self.distortion) else np.zeros(4)


@dataclass(frozen=True)
class StereoRig:
    """A tele and a wide lens in one phone.

    Attributes:
        tele: the lens with the longer focal length.
        wide: the other one.
        wide_from_tele: (4, 4) rigid transform, m.
        is_scale_known: False where the translation is known up to a factor only, so that no depth is metric.
    """

    tele: Camera
    wide: Camera
    wide_from_tele: FloatArray
    is_scale_known: bool = True

    @property
    def baseline_m(self) -> float:
        """Distance between the two lenses."""
        return float(np.linalg.norm(self.wide_from_tele[:3, 3]))

    @property
    def asymmetry(self) -> float:
        """``f_tele_px / f_wide_px`` of the photos as captured."""
        return self.tele.f_px / self.wide.f_px

    @property
    def turn_deg(self) -> float:
        """Angle by which the two lenses are turned against each other."""
        return math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(self.wide_from_tele[:3, :3])) - 1) / 2))))

    def turned(self, *, tele_deg: int, wide_deg: int) -> StereoRig:
        """The same rig for photos turned clockwise by multiples of 90 degrees, their frames with them."""
        from_tele, from_wide = np.eye(4), np.eye(4)
        from_tele[:2, :2], from_wide[:2, :2] = _turn_of_frame(tele_deg), _turn_of_frame(wide_deg)
        return replace(
            self,
            tele=self.tele.turned(tele_deg),
            wide=self.wide.turned(wide_deg),
            wide_from_tele=from_wide @ self.wide_from_tele @ from_tele.T,
        )

    def with_baseline(self, baseline_m: float) -> StereoRig:
        """The same rig with its lenses a known distance apart."""
        wide_from_tele = self.wide_from_tele.copy()
        wide_from_tele[:3, 3] *= baseline_m / self.baseline_m
        return replace(self, wide_from_tele=wide_from_tele, is_scale_known=True)


def _turn_of_frame(turn_deg: int) -> FloatArray:
    """(2, 2) what a clockwise turn of the picture, x right and y down, makes of x and y; exact."""
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(np.linalg.matrix_power(quarter, turn_deg // 90 % 4))


def rigid_transform(*, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """(4, 4) transform from a (3, 3) rotation, or a (3,) rotation vector in radians, and a (3,) translation."""
    turned = np.asarray(rotation, dtype=np.float64)
    if turned.size == 3:
        turned = np.asarray(cv2.Rodrigues(turned.reshape(3, 1))[0], dtype=np.float64)
    transform = np.eye(4)
    transform[:3, :3] = turned.reshape(3, 3)
    transform[:3, 3] = np.asarray(translation, dtype=np.float64).ravel()
    return transform
