"""Where rays meet solids.

A solid lives in local coordinates ``p = local_from_world (P - centre)`` in which it has unit size; a ray is
``o + t d`` there. Rays of a pinhole camera have ``d_z = 1`` in the world, so that t is the depth. Every function returns
t of the first hit, inf where there is none, and broadcasts over the maps of the ray's direction.
"""

from __future__ import annotations

from enum import IntEnum

import torch
from torch import Tensor

NEAREST = 1e-3
RELIEF_STEPS = 6
Ray = tuple[Tensor, Tensor, Tensor]


class Kind(IntEnum):
    """Kinds of solids.

    ELLIPSOID is the unit ball; CONE has its axis along z in [-1, 1] and the radius ``1 - taper (1 + z) / 2``; BOX is
    [-1, 1]^3; SHEET is the square [-1, 1]^2 at z = relief, cut out by a mask; PLANE is SHEET without end; ROOM is BOX
    seen from inside.
    """

    ELLIPSOID = 0
    CONE = 1
    BOX = 2
    SHEET = 3
    PLANE = 4
    ROOM = 5


def hit_ellipsoid(origin: Ray, direction: Ray) -> Tensor:
    """Solve ``|o + t d| = 1`` for the nearer t."""
    a, b, c = _dot(direction, direction), _dot(origin, direction), _dot(origin, origin) - 1
    return _nearer_root(a, b, c)


def hit_cone(origin: Ray, direction: Ray, *, taper: float) -> Tensor:
    """First hit of the mantle or of the end that faces the camera."""
    (ox, oy, oz), (dx, dy, dz) = origin, direction
    slope = taper / 2
    radius = 1 - slope - slope * oz
    a = dx * dx + dy * dy - slope * slope * dz * dz
    b = ox * dx + oy * dy + slope * dz * radius
    c = ox * ox + oy * oy - radius * radius
    mantle = _nearer_root(a.clamp(min=1e-12), b, c)
    mantle = torch.where((oz + mantle * dz).abs() <= 1, mantle, torch.inf)
    end = (-torch.sign(dz) - oz) / dz
    x, y, z = ox + end * dx, oy + end * dy, -torch.sign(dz)
    is_on_end = (x * x + y * y <= (1 - slope - slope * z) ** 2) & (end > NEAREST)
    return torch.minimum(mantle, torch.where(is_on_end, end, torch.inf))


def hit_box(origin: Ray, direction: Ray) -> Tensor:
    """Slab method: enter the last slab before leaving the first."""
    enter, leave = _slabs(origin, direction)
    return torch.where((enter <= leave) & (enter > NEAREST), enter, torch.inf)


def hit_room(origin: Ray, direction: Ray) -> Tensor:
    """Leave the box that the camera stands in."""
    return _slabs(origin, direction)[1]


def hit_plane(origin: Ray, direction: Ray, *, waves: Tensor | None) -> Tensor:
    """Meet ``z = relief(x, y)``: exact without waves, by fixed-point steps with them (their slopes are gentle)."""
    t = _onto_level(origin, direction, torch.zeros(()))
    if waves is not None:
        for _ in range(RELIEF_STEPS):
            t = _onto_level(origin, direction, relief(origin[0] + t * direction[0], origin[1] + t * direction[1], waves))
    return torch.where(t > NEAREST, t, torch.inf)


def relief(x: Tensor, y: Tensor, waves: Tensor) -> Tensor:
    """Add up sines: rows of ``waves`` are (height, wave number along x, along y, phase)."""
    total = torch.zeros_like(x)
    for height, k_x, k_y, phase in waves.tolist():
        total += height * torch.sin(k_x * x + k_y * y + phase)
    return total


def _onto_level(origin: Ray, direction: Ray, level: Tensor) -> Tensor:
    return (level - origin[2]) / torch.where(direction[2].abs() < 1e-9, 1e-9, direction[2])


def _dot(a: Ray, b: Ray) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _nearer_root(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """Smaller root of ``a t^2 + 2 b t + c``, inf where it is not real or not in front."""
    discriminant = b * b - a * c
    t = (-b - discriminant.clamp(min=0).sqrt()) / a
    return torch.where((discriminant > 0) & (t > NEAREST), t, torch.inf)


def _slabs(origin: Ray, direction: Ray) -> tuple[Tensor, Tensor]:
    enter, leave = torch.full((), -torch.inf), torch.full((), torch.inf)
    for o, d in zip(origin, direction, strict=True):
        inverse = 1 / torch.where(d.abs() < 1e-12, 1e-12, d)
        one, other = (-1 - o) * inverse, (1 - o) * inverse
        enter = torch.maximum(enter.to(one), torch.minimum(one, other))
        leave = torch.minimum(leave.to(one), torch.maximum(one, other))
    return enter, leave
