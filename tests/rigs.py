"""Rigs of known numbers, for tests: unequal lenses, unequal photos, any way the phone may be held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

PLACES_OF_WIDE_M = {
    "horizontal": (0.012, 0.0004, -0.0003),
    "reversed": (-0.012, 0.0005, 0.0002),
    "vertical": (0.0003, 0.012, 0.0004),
    "vertical, reversed": (-0.0004, -0.012, 0.0001),
    "oblique": (0.009, -0.006, 0.0005),
    "one farther back": (0.012, 0.0, -0.004),
}
TELE_DISTORTION = (0.05, -0.2, 0.0006, -0.0004, 0.1)
WIDE_DISTORTION = (-0.11, 0.06, 0.0005, 0.0003, -0.01, 0.02, -0.01, 0.001)


def camera(
    hw: tuple[int, int], *, f_px: float, off_centre_px: tuple[float, float], distortion: Sequence[float]
) -> Camera:
    """A lens whose pixels are not quite square."""
    cx, cy = (hw[1] - 1) / 2 + off_centre_px[0], (hw[0] - 1) / 2 + off_centre_px[1]
    return Camera(hw, np.array([[f_px, 0, cx], [0, 1.002 * f_px, cy], [0, 0, 1]]), np.array(distortion))


def phone(
    place_of_wide: str = "horizontal",
    *,
    shrink: float = 1.0,
    rotation: Sequence[float] = (0.004, -0.007, 0.011),
    is_distorted: bool = True,
) -> StereoRig:
    """A phone with focal lengths 9000 and 3000 px and photos of 12 and 8 megapixels, all divided by ``shrink``."""
    tele_hw, wide_hw = (round(3024 / shrink), round(4032 / shrink)), (round(2448 / shrink), round(3264 / shrink))
    tele = camera(
        tele_hw,
        f_px=9000 / shrink,
        off_centre_px=(21 / shrink, -34 / shrink),
        distortion=TELE_DISTORTION if is_distorted else (),
    )
    wide = camera(
        wide_hw,
        f_px=3000 / shrink,
        off_centre_px=(-13 / shrink, 17 / shrink),
        distortion=WIDE_DISTORTION if is_distorted else (),
    )
    turned = rigid_transform(rotation=np.array(rotation), translation=np.zeros(3))
    turned[:3, 3] = -turned[:3, :3] @ np.array(PLACES_OF_WIDE_M[place_of_wide])
    return StereoRig(tele, wide, turned)


def points_in_view(rig: StereoRig, rng: np.random.Generator, *, n: int = 200) -> FloatArray:
    """(n, 3) points in tele's frame, m, anywhere in the tele photo and 0.4 to 8 m away."""
    height, width = rig.tele.hw
    rays = rig.tele.normalised(rng.uniform([-0.5, -0.5], [width - 0.5, height - 0.5], (n, 2)))
    return np.column_stack([rays, np.ones(n)]) * rng.uniform(0.4, 8.0, (n, 1))


def in_wide(rig: StereoRig, points_m: FloatArray) -> FloatArray:
    """Points of tele's frame in wide's."""
    return points_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3]
