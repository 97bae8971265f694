"""The opening of a lens: a disk, or a polygon of blades, cut into quarters, and the spots of light it draws.

A point of light off the focus appears as a picture of the opening; behind the focus it stands as it is described here,
in front of it upside down. Letters: K rows and columns of a spot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from telewide.errors import UsageError
from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap

MIN_BLADES, MAX_BLADES = 5, 16
QUARTERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))  # signs of y and x
_SUPERSAMPLING = 8


@dataclass(frozen=True)
class Aperture:
    """Shape of the opening; its area is that of a disk whatever its shape, as f-numbers count it.

    Attributes:
        blades: how many, 5 to 16; None for a disk.
        curvature: of the blades' edges: 0 straight, 1 a disk.
        rotation_deg: how far a corner is turned clockwise from the top of the picture.
    """

    blades: int | None = None
    curvature: float = 0.0
    rotation_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.blades is not None and not MIN_BLADES <= self.blades <= MAX_BLADES:
            raise UsageError(f"{self.blades} blades: {MIN_BLADES} to {MAX_BLADES} were expected")
        if not 0 <= self.curvature <= 1:
            raise UsageError(f"curvature {self.curvature} of the blades: 0 (straight) to 1 (a disk) was expected")
        if not math.isfinite(self.rotation_deg):
            raise UsageError(f"rotation {self.rotation_deg} of the blades: a number of degrees was expected")

    @property
    def reach(self) -> float:
        """Distance of a corner from the middle, in radii of the disk of the same area."""
        return 1.0 if self.blades is None else self._scale()

    def contains(self, y: FloatArray, x: FloatArray) -> BoolMap:
        """Tell which points lie in the opening, in radii of the disk of the same area; y points down."""
        if self.blades is None:
            return np.asarray(y**2 + x**2 <= 1)
        clockwise_from_top = np.arctan2(x, -y) - math.radians(self.rotation_deg)
        return np.asarray(np.hypot(y, x) <= self._scale() * self._outline(clockwise_from_top))

    def share_of(self, quarter: tuple[int, int]) -> float:
        """Share of the opening's area that lies in a quarter of `QUARTERS`."""
        if self.blades is None:
            return 1 / len(QUARTERS)
        side = (np.arange(512) + 0.5) / 512 * self.reach
        areas = {q: int(self.contains(-q[0] * side[:, None], -q[1] * side[None]).sum()) for q in QUARTERS}
        return areas[quarter] / sum(areas.values())

    def _outline(self, angle_rad: FloatArray) -> FloatArray:
        """Distance of the edge from the middle where a corner lies at 1 and at angle 0."""
        half_rad = math.pi / (self.blades or 1)
        from_middle_of_blade = np.mod(angle_rad, 2 * half_rad) - half_rad
        straight = math.cos(half_rad) / np.cos(from_middle_of_blade)
        return np.asarray((1 - self.curvature) * straight + self.curvature)

    def _scale(self) -> float:
        angle_rad = (np.arange(4096) + 0.5) / 4096 * 2 * math.pi
        return float(1 / np.sqrt(np.mean(self._outline(angle_rad) ** 2)))


DISK = Aperture()


@dataclass(frozen=True)
class Spot:
    """Part of the spot of a point of light, as a filter that correlates.

    Attributes:
        kernel: (K, K) float32, summing to 1.
        anchor_xy: column and row of the kernel that lies on the pixel itself.
    """

    kernel: FloatMap
    anchor_xy: tuple[int, int]


@lru_cache(maxsize=1024)
def spot_of(radius_px: float, quarter: tuple[int, int] | None, *, aperture: Aperture) -> Spot:
    """Draw what the opening, or one quarter of it, makes of a point.

    Args:
        radius_px: signed, positive in front of the focus, px of the picture drawn into; not 0.
        quarter: signs of y and x of the points of the opening; None for the whole.
        aperture: the opening.
    """
    # Through the point u of the opening a pixel lights what lies radius * u beside it. The opening is described by its
    # spots behind the focus, where the radius is negative: as -u. A filter that correlates asks where light comes from.
    size = math.ceil(abs(radius_px) * aperture.reach + 0.5)
    offset = (np.arange((2 * size + 1) * _SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5 - size
    inside = aperture.contains(offset[:, None] / radius_px, offset[None] / radius_px)
    top = left = 0
    if quarter is not None:
        sign_y, sign_x = (-sign * (1 if radius_px > 0 else -1) for sign in quarter)
        inside &= (offset[:, None] * sign_y > 0) & (offset[None] * sign_x > 0)
        top, left = (size if sign > 0 else 0 for sign in (sign_y, sign_x))
    covered = inside.reshape(2 * size + 1, _SUPERSAMPLING, 2 * size + 1, _SUPERSAMPLING).sum(axis=(1, 3))
    if quarter is not None:
        covered = covered[top : top + size + 1, left : left + size + 1]
    kernel = (covered / covered.sum()).astype(np.float32)
    return Spot(np.ascontiguousarray(kernel), (size - left, size - top))
