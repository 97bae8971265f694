"""Simulated room: solids with a painted surface, and lights.

World frame: x right, y down, z forward, level; the phone hangs near the origin and looks forward. A solid is a unit
shape and the transform that places it: ``cube`` fills -1 to 1, ``rectangle`` lies in its plane z = 0 from -1 to 1,
``disk`` and ``sphere`` have the radius 1, ``cylinder`` too, from z = 0 to 1; ``lathe`` turns a profile about its z.
Letters: h w texture; N points of a profile.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.geometry.rig import rigid_transform

Vector = tuple[float, float, float]

DOWN = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Solid:
    """One thing of one surface.

    Attributes:
        shape: cube, rectangle, disk, sphere, cylinder or lathe.
        world_from_solid: (4, 4) placement of the unit shape, m.
        texture: (h, w, 3) float32, sRGB in [0, 1]; one pixel for a plain surface.
        profile: (N, 2) radius and z of a lathe, in its own unit.
        is_shiny: lacquered instead of dull.
        has_hard_edges: pixels of the texture are squares, not blended into one another.
    """

    shape: str
    world_from_solid: FloatArray
    texture: FloatImage
    profile: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    is_shiny: bool = False
    has_hard_edges: bool = False


@dataclass(frozen=True)
class Light:
    """A shining rectangle, -1 to 1 in its own plane, towards its own +z.

    Attributes:
        world_from_light: (4, 4) placement, m.
        radiance: of R, G, B, any unit.
    """

    world_from_light: FloatArray
    radiance: Vector


@dataclass(frozen=True)
class Room:
    """A room that can be photographed.

    Attributes:
        solids: in any order.
        lights: at least one.
        ambient: what every white surface sends to everywhere, R, G, B, in the unit of the lights: what comes from the
            lights by way of the walls, the same for all places.
        world_from_tele: (4, 4) where the phone's tele lens is, m.
    """

    solids: tuple[Solid, ...]
    lights: tuple[Light, ...]
    ambient: Vector
    world_from_tele: FloatArray

    def with_solid(self, solid: Solid) -> Room:
        """The same room with one thing more."""
        return replace(self, solids=(*self.solids, solid))


def plain(colour: FloatImage | Vector) -> FloatImage:
    """A texture of one sRGB colour."""
    return np.asarray(colour, dtype=np.float32).reshape(1, 1, 3)


def box(centre_m: Vector, size_m: Vector, texture: FloatImage, *, yaw_rad: float = 0.0) -> Solid:
    """A box that stands upright.

    Args:
        centre_m: its middle.
        size_m: along its x, y and z.
        texture: of every side.
        yaw_rad: turn about the vertical.
    """
    placed = rigid_transform(rotation=np.array([0.0, yaw_rad, 0.0]), translation=np.array(centre_m))
    return Solid("cube", placed @ np.diag([*(np.array(size_m) / 2), 1.0]), texture)


def ball(centre_m: Vector, radius_m: float, texture: FloatImage) -> Solid:
    """A ball whose poles are above and below."""
    placed = rigid_transform(rotation=axis_to(DOWN), translation=np.array(centre_m))
    return Solid("sphere", placed @ np.diag([radius_m, radius_m, radius_m, 1.0]), texture, is_shiny=True)


def rod(start_m: FloatArray | Vector, end_m: FloatArray | Vector, *, radius_m: float, texture: FloatImage) -> Solid:
    """A round rod from one point to another, without lids."""
    along = np.asarray(end_m, np.float64) - np.asarray(start_m, np.float64)
    length_m = float(np.linalg.norm(along))
    placed = rigid_transform(rotation=axis_to(along / length_m), translation=np.asarray(start_m, np.float64))
    return Solid("cylinder", placed @ np.diag([radius_m, radius_m, length_m, 1.0]), texture)


def turned(foot_m: Vector, profile: FloatArray, texture: FloatImage, *, is_shiny: bool = True) -> Solid:
    """A vessel from the lathe that stands upright.

    Args:
        foot_m: middle of its base.
        profile: (N, 2) radius and height above the base, m, from below.
        texture: around it.
        is_shiny: glazed instead of dull.
    """
    placed = rigid_transform(rotation=axis_to((0.0, -1.0, 0.0)), translation=np.array(foot_m))
    return Solid("lathe", placed, texture, profile=profile, is_shiny=is_shiny)


def can(foot_m: Vector, *, radius_m: float, height_m: float, texture: FloatImage, lid: FloatImage) -> tuple[Solid, ...]:
    """A standing cylinder with a lid."""
    x, y, z = foot_m
    placed = rigid_transform(rotation=axis_to((0.0, -1.0, 0.0)), translation=np.array([x, y - height_m, z]))
    top = Solid("disk", placed @ np.diag([radius_m, radius_m, 1.0, 1.0]), lid)
    return rod(foot_m, (x, y - height_m, z), radius_m=radius_m, texture=texture), top


def panel(centre_m: Vector, normal: Vector, texture: FloatImage, *, half_size_m: tuple[float, float]) -> Solid:
    """A flat rectangle that faces a direction; its own y is as near to the vertical as can be."""
    return Solid("rectangle", facing(centre_m, normal, half_size_m=half_size_m), texture)


def light(centre_m: Vector, normal: Vector, *, half_size_m: tuple[float, float], radiance: Vector) -> Light:
    """A shining rectangle that faces a direction."""
    return Light(facing(centre_m, normal, half_size_m=half_size_m), radiance)


def facing(centre_m: Vector, normal: Vector, *, half_size_m: tuple[float, float]) -> FloatArray:
    """(4, 4) placement of a rectangle that faces a direction."""
    placed = rigid_transform(rotation=axis_to(normal), translation=np.array(centre_m))
    return np.asarray(placed @ np.diag([*half_size_m, 1.0, 1.0]))


def axis_to(direction: FloatArray | Vector) -> FloatArray:
    """(3, 3) rotation that turns z into a direction, y staying as near to the vertical as can be."""
    z = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    upright = np.array([0.0, 0.0, 1.0]) if abs(z[1]) > 0.99 else np.array(DOWN)
    x = np.cross(upright, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
