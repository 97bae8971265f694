"""Rays of a camera against solids of one kind, and where in the view a solid can be.

Letters: n solids.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from telewide.geometry.arrays import FloatArray
from telewide.simulate.raycast.hits import Kind, Ray, hit_box, hit_cone, hit_ellipsoid, hit_plane, hit_room
from telewide.simulate.raycast.palette import Palette, look_up_outline
from telewide.simulate.raycast.world import Camera, Solid

Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class Alike:
    """Solids of one kind, all wavy or level, all cut out or whole, before one camera.

    Attributes:
        kind: of all.
        number: (n,) int64 their places in the world.
        origin: (n, 3) where the rays begin, local.
        per_px: (n, 3, 3) direction of the ray through (x, y, 1) px, local.
        taper: (n,) float64, of CONE.
        waves: (n, k, 4) relief of SHEET and PLANE; None for none.
        outline: (n,) int64 outlines of SHEET; None for the whole square.
    """

    kind: Kind
    number: Tensor
    origin: Tensor
    per_px: Tensor
    taper: Tensor
    waves: Tensor | None
    outline: Tensor | None


def form_of(solid: Solid) -> tuple[Kind, bool, bool]:
    """Form of a solid: those of one form can be tested together."""
    return solid.kind, solid.waves is not None, solid.outline is not None


def alike(numbers: Sequence[int], solids: Sequence[Solid], *, camera: Camera, like: Tensor) -> Alike:
    """Gather solids of one form before a camera.

    Args:
        numbers: which of the solids.
        solids: all.
        camera: where the rays begin.
        like: its device and precision are those of the rays.
    """
    chosen = [solids[number] for number in numbers]

    def table(rows: FloatArray | Sequence[FloatArray | float], dtype: torch.dtype = like.dtype) -> Tensor:
        return torch.from_numpy(np.array(rows)).to(device=like.device, dtype=dtype)

    rays = [_rays(solid, camera) for solid in chosen]
    kind, is_wavy, is_cut_out = form_of(chosen[0])
    return Alike(
        kind=kind,
        number=table(numbers, torch.int64),
        origin=table([origin for origin, _ in rays]),
        per_px=table([per_px for _, per_px in rays]),
        taper=table([solid.taper for solid in chosen], torch.float64),
        waves=table(padded_waves([solid.waves for solid in chosen])) if is_wavy else None,
        outline=table([solid.outline or 0 for solid in chosen], torch.int64) if is_cut_out else None,
    )


def padded_waves(waves: Sequence[FloatArray | None]) -> FloatArray:
    """(n, k, 4) reliefs of n solids, those with fewer waves filled up with waves of no height."""
    table = np.zeros((len(waves), max((len(rows) for rows in waves if rows is not None), default=0), 4))
    for filled, rows in zip(table, waves, strict=True):
        if rows is not None:
            filled[: len(rows)] = rows
    return table


def _rays(solid: Solid, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Origin and direction of a camera's rays in a solid's coordinates."""
    local = solid.local_from_world
    o = local @ (np.array([camera.x, 0.0, 0.0]) - solid.centre)
    cx, cy = camera.centre_px
    per_px = local @ np.array([[1, 0, -cx], [0, 1, -cy], [0, 0, camera.focal_px]]) / camera.focal_px
    return o, per_px


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
    return first_hits(alike([0], [solid], camera=camera, like=x), x, y, palette=palette)[0]


def first_hits(solids: Alike, x: Tensor, y: Tensor, *, palette: Palette) -> Tensor:
    """Cast the rays through some pixels onto each of some solids.

    Args:
        solids: what they may meet.
        x: px, of any shape that broadcasts with y, of the solids' precision.
        y: px.
        palette: outlines of sheets.

    Returns:
        (n, ...) depth of the first hit, inf where a ray misses.
    """

    def for_each(values: Tensor) -> Tensor:
        return values.reshape(len(values), *[1] * max(x.dim(), y.dim()), *values.shape[1:])

    origin: Ray = tuple(for_each(column) for column in solids.origin.unbind(dim=1))  # type: ignore[assignment]
    rows = [[for_each(entry) for entry in row.unbind(dim=1)] for row in solids.per_px.unbind(dim=1)]
    direction: Ray = tuple((row[0] * x + row[2]) + row[1] * y for row in rows)  # type: ignore[assignment]
    if solids.kind is Kind.CONE:
        return hit_cone(origin, direction, taper=for_each(solids.taper))
    if solids.kind in _PLAIN:
        return _PLAIN[solids.kind](origin, direction)
    t = hit_plane(origin, direction, waves=None if solids.waves is None else for_each(solids.waves))
    if solids.kind is Kind.PLANE:
        return t
    return torch.where(_is_covered(solids, palette, _at(t, origin, direction)), t, torch.inf)


_PLAIN: dict[Kind, Callable[[Ray, Ray], Tensor]] = {
    Kind.ELLIPSOID: hit_ellipsoid,
    Kind.BOX: hit_box,
    Kind.ROOM: hit_room,
}


def _at(t: Tensor, origin: Ray, direction: Ray) -> tuple[Tensor, Tensor]:
    return origin[0] + t * direction[0], origin[1] + t * direction[1]


def _is_covered(solids: Alike, palette: Palette, place: tuple[Tensor, Tensor]) -> Tensor:
    """Whether sheets are there, at local places."""
    u, v = place
    inside = (u.abs() < 1) & (v.abs() < 1)
    if solids.outline is not None:
        kept = inside.nonzero(as_tuple=True)
        if len(kept[0]):
            uv = torch.stack((u[kept], v[kept]), dim=-1).float()
            inside[kept] = look_up_outline(palette, solids.outline[kept[0]], uv) > 0
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
