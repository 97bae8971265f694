"""Where rays meet solids.

A solid lives in local coordinates ``p = local_from_world (P - centre)`` in which it has unit size; a ray is ``o + t d``
there. Rays of a pinhole camera have ``d_z = 1`` in the world, so that t is the depth. Every function returns t of the
first hit, inf where there is none, and broadcasts over the maps of the ray's direction: one solid or many at a time.
"""

from __future__ import annotations

from enum import IntEnum

import torch
from torch import Tensor

NEAREST = 1e-3
NEWTON_STEPS = 4
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


def hit_cone(origin: Ray, direction: Ray, *, taper: Tensor) -> Tensor:
    """First hit of the mantle or of the end that faces the camera; the taper is float64."""
    (ox, oy, oz), (dx, dy, dz) = origin, direction
    slope, squared, level = ((taper / 2).to(dz), (taper / 2).square().to(dz), (1 - taper / 2).to(dz))
    radius = level - slope * oz
    a = dx * dx + dy * dy - squared * dz * dz
    b = ox * dx + oy * dy + slope * dz * radius
    c = ox * ox + oy * oy - radius * radius
    mantle = _nearer_root(a.clamp(min=1e-12), b, c)
    mantle = torch.where((oz + mantle * dz).abs() <= 1, mantle, torch.inf)
    end = (-torch.sign(dz) - oz) / dz
    x, y, z = ox + end * dx, oy + end * dy, -torch.sign(dz)
    is_on_end = (x * x + y * y <= (level - slope * z) ** 2) & (end > NEAREST)
    return torch.minimum(mantle, torch.where(is_on_end, end, torch.inf))


def hit_box(origin: Ray, direction: Ray) -> Tensor:
    """Slab method: enter the last slab before leaving the first."""
    enter, leave = _slabs(origin, direction)
    return torch.where((enter <= leave) & (enter > NEAREST), enter, torch.inf)


def hit_room(origin: Ray, direction: Ray) -> Tensor:
    """Leave the box; its walls are seen from inside only, so that a camera beside it looks in."""
    enter, leave = _slabs(origin, direction)
    return torch.where((enter <= leave) & (leave > NEAREST), leave, torch.inf)


def hit_plane(origin: Ray, direction: Ray, *, waves: Tensor | None) -> Tensor:
    """Meet ``z = relief(x, y)``: exact without waves, by Newton's steps from the level plane with them."""
    t = -origin[2] / _kept_from_zero(direction[2])
    if waves is not None:
        for _ in range(NEWTON_STEPS):
            x, y, z = (o + t * d for o, d in zip(origin, direction, strict=True))
            height, slope_x, slope_y = relief(x, y, waves)
            t = t - (z - height) / _kept_from_zero(direction[2] - slope_x * direction[0] - slope_y * direction[1])
    return torch.where(t > NEAREST, t, torch.inf)


def relief(x: Tensor, y: Tensor, waves: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Height and both slopes of a sum of sines: rows (..., n, 4) are (height, rate in x, rate in y, phase)."""
    total, slope_x, slope_y = (torch.zeros_like(x) for _ in range(3))
    for wave in waves.unbind(dim=-2):
        height, rate_x, rate_y, phase = wave.unbind(dim=-1)
        angle = rate_x * x + rate_y * y + phase
        total += height * torch.sin(angle)
        steep = height * torch.cos(angle)
        slope_x += rate_x * steep
        slope_y += rate_y * steep
    return total, slope_x, slope_y


def _kept_from_zero(x: Tensor) -> Tensor:
    return torch.where(x.abs() < 1e-9, 1e-9, x)


def _dot(a: Ray, b: Ray) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _nearer_root(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """Smaller root of ``a t^2 + 2 b t + c``, inf where it is not real or not in front."""
    discriminant = b * b - a * c
    t = (-b - discriminant.clamp(min=0).sqrt()) / a
    return torch.where((discriminant > 0) & (t > NEAREST), t, torch.inf)


def _slabs(origin: Ray, direction: Ray) -> tuple[Tensor, Tensor]:
    enter, leave = (origin[0].new_full((), far) for far in (-torch.inf, torch.inf))
    for o, d in zip(origin, direction, strict=True):
        inverse = 1 / torch.where(d.abs() < 1e-12, 1e-12, d)
        one, other = (-1 - o) * inverse, (1 - o) * inverse
        enter = torch.maximum(enter, torch.minimum(one, other))
        leave = torch.minimum(leave, torch.maximum(one, other))
    return enter, leave
