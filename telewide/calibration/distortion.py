"""A lens as numbers: projection with its derivatives, and the ladder of distortion models to choose from.

A lens is 12 numbers: f and aspect a (``fx = f (1 + a)``, ``fy = f (1 - a)``), cx, cy, and OpenCV's k1 k2 p1 p2 k3 k4
k5 k6. Pixel (0, 0) is the centre of the top-left pixel; camera x right, y down, z forward. Letters: as above.
"""

from __future__ import annotations

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera

N_LENS = 12
F, ASPECT, CX, CY = 0, 1, 2, 3
_K1, _K2, _P1, _P2, _K3, _K4, _K5, _K6 = range(4, 12)
_ALWAYS = (F, CX, CY)

LADDER: dict[str, tuple[int, ...]] = {
    "none": _ALWAYS,
    "k1": (*_ALWAYS, _K1),
    "k1k2": (*_ALWAYS, _K1, _K2),
    "k1k2p1p2": (*_ALWAYS, _K1, _K2, _P1, _P2),
    "k1k2p1p2k3": (*_ALWAYS, _K1, _K2, _P1, _P2, _K3),
    "rational": (*_ALWAYS, *range(_K1, N_LENS)),
}
"""Distortion models, simplest first, each with the numbers of a lens that it lets free."""
NARROW_LADDER = ("none", "k1", "k1k2", "k1k2p1p2")
"""Models for long lenses, whose rays stay so close to the axis that higher powers cannot be told apart."""


BELIEVED = LADDER["k1k2p1p2"]
"""Distortion that every lens has, told by photos or not: were it held at 0, the rest would seem surer than it is."""


def project_with_derivatives(points_m: FloatArray, lens: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project points and differentiate the pixels by the lens and by the points.

    Args:
        points_m: (..., 3) in the camera's frame, z > 0.
        lens: (12,) the lens.

    Returns:
        (..., 2) px; (..., 2, 12) their derivatives by the lens; (..., 2, 3) their derivatives by the points.
    """
    f, aspect, cx, cy = lens[:4]
    k1, k2, p1, p2, k3, k4, k5, k6 = lens[4:]
    inverse_z = 1.0 / points_m[..., 2]
    x, y = points_m[..., 0] * inverse_z, points_m[..., 1] * inverse_z
    r2 = x * x + y * y
    r4, r6 = r2 * r2, r2 * r2 * r2
    above, below = 1 + k1 * r2 + k2 * r4 + k3 * r6, 1 + k4 * r2 + k5 * r4 + k6 * r6
    radial = above / below
    radial_by_r2 = (k1 + 2 * k2 * r2 + 3 * k3 * r4 - radial * (k4 + 2 * k5 * r2 + 3 * k6 * r4)) / below
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy = f * (1 + aspect), f * (1 - aspect)
    pixels = np.stack([fx * bent_x + cx, fy * bent_y + cy], axis=-1)

    by_lens = np.zeros((*pixels.shape, N_LENS))
    by_lens[..., 0, F], by_lens[..., 1, F] = (1 + aspect) * bent_x, (1 - aspect) * bent_y
    by_lens[..., 0, ASPECT], by_lens[..., 1, ASPECT] = f * bent_x, -f * bent_y
    by_lens[..., 0, CX], by_lens[..., 1, CY] = 1.0, 1.0
    powers = {_K1: r2, _K2: r4, _K3: r6, _K4: -radial * r2, _K5: -radial * r4, _K6: -radial * r6}
    for index, power in powers.items():
        by_lens[..., 0, index], by_lens[..., 1, index] = fx * x * power / below, fy * y * power / below
    by_lens[..., 0, _P1], by_lens[..., 1, _P1] = fx * 2 * x * y, fy * (r2 + 2 * y * y)
    by_lens[..., 0, _P2], by_lens[..., 1, _P2] = fx * (r2 + 2 * x * x), fy * 2 * x * y

    across = 2 * x * y * radial_by_r2 + 2 * p1 * x + 2 * p2 * y
    x_by_x = radial + 2 * x * x * radial_by_r2 + 2 * p1 * y + 6 * p2 * x
    y_by_y = radial + 2 * y * y * radial_by_r2 + 6 * p1 * y + 2 * p2 * x
    by_point = np.empty((*pixels.shape, 3))
    by_point[..., 0, 0], by_point[..., 0, 1] = fx * x_by_x * inverse_z, fx * across * inverse_z
    by_point[..., 1, 0], by_point[..., 1, 1] = fy * across * inverse_z, fy * y_by_y * inverse_z
    by_point[..., 0, 2] = -(by_point[..., 0, 0] * x + by_point[..., 0, 1] * y)
    by_point[..., 1, 2] = -(by_point[..., 1, 0] * x + by_point[..., 1, 1] * y)
    return pixels, by_lens, by_point


def project(points_m: FloatArray, lens: FloatArray) -> FloatArray:
    """Project points (..., 3) in the camera's frame to (..., 2) px."""
    k1, k2, p1, p2, k3, k4, k5, k6 = lens[4:]
    xy = points_m[..., :2] / points_m[..., 2:]
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy = lens[F] * (1 + lens[ASPECT]), lens[F] * (1 - lens[ASPECT])
    return np.stack([fx * bent_x + lens[CX], fy * bent_y + lens[CY]], axis=-1)


def camera_of(lens: FloatArray, *, hw: tuple[int, int]) -> Camera:
    """The camera a lens is, with as many coefficients as are needed: none, four, five or eight."""
    f, aspect, cx, cy = lens[:4]
    K = np.array([[f * (1 + aspect), 0.0, cx], [0.0, f * (1 - aspect), cy], [0.0, 0.0, 1.0]])
    return Camera(hw=hw, K=K, distortion=lens[4 : 4 + n_coefficients(lens)].copy())


def n_coefficients(lens: FloatArray) -> int:
    """Number of OpenCV's coefficients that are needed to write a lens down: 0, 4, 5 or 8."""
    used = np.flatnonzero(lens[4:])
    return 0 if not len(used) else next(n for n in (4, 5, 8) if used[-1] < n)


def is_one_to_one(lens: FloatArray, *, hw: tuple[int, int]) -> bool:
    """Whether the image grows outwards along every radius up to its corner, so that no two rays meet in a pixel."""
    far = 1.05 * float(np.hypot(*hw)) / 2 / lens[F]
    angles, radii = np.linspace(0, 2 * np.pi, 16, endpoint=False)[:, None], np.linspace(0, far, 60)
    rays = np.stack([radii * np.cos(angles), radii * np.sin(angles), np.ones((16, 60))], axis=-1)
    outwards_px = np.linalg.norm(project(rays, lens) - lens[[CX, CY]], axis=-1)
    return bool(np.all(np.diff(outwards_px, axis=1) > 0))


def prior_of_lens(hw: tuple[int, int], *, f_px: float) -> tuple[FloatArray, FloatArray]:
    """Prior of a lens before any photo: centre and standard deviation of a wide normal distribution.

    The principal point lies within a few hundredths of the width of the centre, pixels are nearly square, no radial
    coefficient alone moves the image's corner by much more than a tenth of its distance from the centre, and no
    tangential one by much more than a hundredth.

    Args:
        hw: height and width of the photos.
        f_px: first guess of the focal length.

    Returns:
        (12,) centre and (12,) standard deviation.
    """
    corner = float(np.hypot(*hw)) / 2 / f_px
    centre = np.zeros(N_LENS)
    centre[[F, CX, CY]] = f_px, (hw[1] - 1) / 2, (hw[0] - 1) / 2
    spread = np.empty(N_LENS)
    spread[[F, ASPECT, CX, CY]] = f_px, 0.01, 0.05 * max(hw), 0.05 * max(hw)
    powers = {_K1: 2, _K2: 4, _K3: 6, _K4: 2, _K5: 4, _K6: 6}
    for index, power in powers.items():
        spread[index] = 0.2 / corner**power
    spread[[_P1, _P2]] = 0.005 / corner
    return centre, spread
