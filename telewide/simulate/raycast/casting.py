"""Rays of a camera against one solid, and where in the view that solid can be."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from telewide.simulate.raycast.hits import Kind, Ray, hit_box, hit_cone, hit_ellipsoid, hit_plane, hit_room
from telewide.simulate.raycast.palette import Palette, look_up_outline
from telewide.simulate.raycast.world import Camera, Solid

Box = tuple[int, int, int, int]


def first_hit(solid: Solid, x: Tensor, y: Tensor, *, camera: Camera, palette: Palette) -> Tensor:
    """Cast the rays through some pixels of a camera onto a solid.

    Args:
        solid: what they may meet.
        x: px, of any shape that broadcasts with y; float32 or float64, which is the precision.
        y: px.
        camera: where the rays begin.
        palette: outlines of sheets.

    Returns:
        Depth of the first hit, inf where a ray misses.
    """
    local = solid.local_from_world
    o = local @ (np.array([camera.x, 0.0, 0.0]) - solid.centre)
    cx, cy = camera.centre_px
    per_px = local @ np.array([[1, 0, -cx], [0, 1, -cy], [0, 0, camera.focal_px]]) / camera.focal_px
    origin: Ray = tuple(torch.tensor(v, dtype=x.dtype, device=x.device) for v in o)  # type: ignore[assignment]
    direction: Ray = tuple((row[0] * x + row[2]) + row[1] * y for row in per_px.tolist())
    match solid.kind:
        case Kind.ELLIPSOID:
            return hit_ellipsoid(origin, direction)
        case Kind.CONE:
            return hit_cone(origin, direction, taper=solid.taper)
        case Kind.BOX:
            return hit_box(origin, direction)
        case Kind.ROOM:
            return hit_room(origin, direction)
    waves = None if solid.waves is None else torch.as_tensor(solid.waves, dtype=x.dtype, device=x.device)
    t = hit_plane(origin, direction, waves=waves)
    return (
        t
        if solid.kind is Kind.PLANE
        else torch.where(_is_covered(solid, palette, _at(t, origin, direction)), t, torch.inf)
    )


def _at(t: Tensor, origin: Ray, direction: Ray) -> tuple[Tensor, Tensor]:
    return origin[0] + t * direction[0], origin[1] + t * direction[1]


def _is_covered(solid: Solid, palette: Palette, place: tuple[Tensor, Tensor]) -> Tensor:
    """Whether a sheet is there, at local places."""
    u, v = place
    inside = (u.abs() < 1) & (v.abs() < 1)
    if solid.outline is not None:
        kept = inside.nonzero(as_tuple=True)
        uv = torch.stack((u[kept], v[kept]), dim=-1).float()
        inside[kept] = look_up_outline(palette, solid.outline, uv) > 0
    return inside


def box_in_view(solid: Solid, *, camera: Camera) -> Box | None:
    """(x0, y0, x1, y1) px that a solid can be seen in; None where it is out of view."""
    height, width = camera.hw
    if solid.kind in (Kind.PLANE, Kind.ROOM):
        return 0, 0, width, height
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], np.float64)
    if solid.kind is Kind.SHEET:
        corners[:, 2] *= 0.0 if solid.waves is None else float(np.abs(solid.waves[:, 0]).sum())
    points = (corners * solid.half_size) @ solid.turn.T + solid.centre - [camera.x, 0, 0]
    if points[:, 2].max() <= 0:
        return None
    if points[:, 2].min() < 0.02:
        return 0, 0, width, height
    pixels = camera.focal_px * points[:, :2] / points[:, 2:] + camera.centre_px
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    box = max(0, math.floor(x0)), max(0, math.floor(y0)), min(width, math.ceil(x1) + 1), min(height, math.ceil(y1) + 1)
    return box if box[0] < box[2] and box[1] < box[3] else None
