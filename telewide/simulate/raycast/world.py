"""Ray-cast world: solids with materials, a light, two cameras side by side.

The cameras look along z, x right, y down; ref stands at the origin, src at ``(baseline_m, 0, 0)``, its principal point
``offset_px`` further to the left. A point at depth Z has the disparity
``x_ref - x_src = focal_px baseline_m / Z + offset_px``. The background stands at about a metre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.simulate.raycast.hits import Kind


@dataclass(frozen=True)
class Material:
    """Paint of a surface.

    Attributes:
        texture: which fine texture of the palette.
        macro: which texture, ten times coarser, varies its brightness.
        texels_per_unit: of the fine texture.
        texel_shift: (2,) where the texture begins.
        contrast: of the fine texture about its mean.
        macro_contrast: of the coarse one.
        tint: (3,) factors of R, G, B.
        gloss: weight of what it mirrors, 0 for none.
    """

    texture: int
    macro: int
    texels_per_unit: float
    texel_shift: tuple[float, float]
    contrast: float
    macro_contrast: float
    tint: tuple[float, float, float]
    gloss: float = 0.0


@dataclass(frozen=True)
class Solid:
    """One solid.

    Attributes:
        kind: which.
        turn: (3, 3) rotation ``world_from_local``.
        centre: (3,) world.
        half_size: (3,) world length of a local unit along each local axis.
        material: how it is painted.
        taper: of a CONE.
        outline: of a SHEET, index into the palette; None for the whole square.
        waves: (n, 4) relief of a SHEET or PLANE in local units, see `hits.relief`; None for none.
        casts_shadow: whether it shades others.
    """

    kind: Kind
    turn: FloatArray
    centre: FloatArray
    half_size: FloatArray
    material: Material
    taper: float = 0.0
    outline: int | None = None
    waves: FloatArray | None = None
    casts_shadow: bool = False

    @property
    def local_from_world(self) -> FloatArray:
        """(3, 3) linear part of the way into local coordinates."""
        return np.asarray(self.turn.T / self.half_size[:, None])


@dataclass(frozen=True)
class Light:
    """Directed light and what comes from everywhere.

    Attributes:
        towards: (3,) unit vector from a surface to the light.
        ambient: share of light without direction.
        colour: (3,) of the directed light.
    """

    towards: FloatArray
    ambient: float
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """One of the two cameras.

    Attributes:
        x: where it stands on the baseline_m, world.
        focal_px: focal length.
        centre_px: (x, y) principal point.
        hw: height and width of its view, px.
    """

    x: float
    focal_px: float
    centre_px: tuple[float, float]
    hw: tuple[int, int]


@dataclass(frozen=True)
class World:
    """A scene before two cameras.

    Attributes:
        hw: height and width of the views, px.
        focal_px: of both cameras.
        centre_px: (x, y) principal point of ref.
        baseline_m: distance of the cameras.
        offset_px: disparity of what is infinitely far.
        solids: in any order.
        light: one for the whole scene.
        sky: material of what no ray meets.
    """

    hw: tuple[int, int]
    focal_px: float
    centre_px: tuple[float, float]
    baseline_m: float
    offset_px: float
    solids: tuple[Solid, ...]
    light: Light
    sky: Material

    @property
    def ref(self) -> Camera:
        """The camera of the sharp view."""
        return Camera(0.0, self.focal_px, self.centre_px, self.hw)

    @property
    def src(self) -> Camera:
        """The camera of the other view."""
        centre_px = (self.centre_px[0] - self.offset_px, self.centre_px[1])
        return Camera(self.baseline_m, self.focal_px, centre_px, self.hw)
