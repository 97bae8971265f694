"""Colour of what rays have met: paint, light, soft shadows, reflections.

Everything about a solid stands in one row of a table, so that a whole view is shaded at once.
Letters: N solids, n rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from telewide.simulate.raycast.casting import padded_waves
from telewide.simulate.raycast.hits import Kind, relief
from telewide.simulate.raycast.palette import Palette, look_up_texture
from telewide.simulate.raycast.world import Camera, Material, World

SHADOW_EDGE = (0.75, 1.35)
"""Distance from a shadow's axis, in radii of what casts it, at which it is full and over."""
SHADOW_CASTERS = 5
MACRO_RATIO = 0.09
MIRRORED_TEXELS = 90.0
MIRRORED_BLUR = 10.0
"""Texels that what the dullest gloss mirrors is blurred by; the more a surface mirrors, the sharper."""


@dataclass(frozen=True)
class Paint:
    """A world with what it is painted with.

    Attributes:
        world: the scene.
        palette: its textures.
        rows: (N + 1, columns) float32, the last row for the sky.
        waves: (N + 1, k, 4) reliefs, waves of no height where a solid has none.
        is_wavy: (N + 1,) bool.
        casters: of shadows: number, (3, 3) ``local_from_world`` and (3,) centre.
        towards: (3,) to the light.
        light_colour: (3,) of the directed light.
    """

    world: World
    palette: Palette
    rows: Tensor
    waves: Tensor
    is_wavy: Tensor
    casters: tuple[tuple[int, Tensor, Tensor], ...]
    towards: Tensor
    light_colour: Tensor


_COLUMNS = {"local": 9, "centre": 3, "size": 3, "kind": 1, "taper": 1, "texture": 1, "macro": 1, "density": 1}
_COLUMNS |= {"offset": 2, "contrast": 1, "macro_contrast": 1, "tint": 3, "gloss": 1}
_ENDS = dict(zip(_COLUMNS, np.cumsum(list(_COLUMNS.values())).tolist(), strict=True))
_SKY_KIND = len(Kind)


def paint_of(world: World, palette: Palette) -> Paint:
    """Gather what shading needs to know of every solid."""
    rows = [
        [
            *solid.local_from_world.flatten(),
            *solid.centre,
            *solid.half_size,
            float(solid.kind),
            solid.taper,
            *_material(solid.material),
        ]
        for solid in world.solids
    ]
    rows.append([*np.eye(3).flatten(), 0, 0, 0, 1, 1, 1, _SKY_KIND, 0, *_material(world.sky)])
    waves = [*(solid.waves for solid in world.solids), None]

    def table(values: object) -> Tensor:
        return torch.from_numpy(np.array(values, np.float32)).to(palette.textures.device)

    casters = [(number, solid) for number, solid in enumerate(world.solids) if solid.casts_shadow][:SHADOW_CASTERS]
    return Paint(
        world=world,
        palette=palette,
        rows=table(rows),
        waves=table(padded_waves(waves)),
        is_wavy=table([rows is not None for rows in waves]) > 0,
        casters=tuple((number, table(solid.local_from_world), table(solid.centre)) for number, solid in casters),
        towards=table(world.light.towards),
        light_colour=table(world.light.colour),
    )


def _material(material: Material) -> list[float]:
    return [
        material.texture,
        material.macro,
        material.texels_per_unit,
        *material.texel_shift,
        material.contrast,
        material.macro_contrast,
        *material.tint,
        material.gloss,
    ]


@dataclass(frozen=True)
class Hits:
    """Points that rays have met.

    Attributes:
        x_px: (n,) where each ray goes through the view.
        y_px: (n,) likewise.
        solid: (n,) int64 which solid it meets; N for the sky.
        depth: (n,) at which depth; inf for the sky.
    """

    x_px: Tensor
    y_px: Tensor
    solid: Tensor
    depth: Tensor


def shade(paint: Paint, hits: Hits, *, camera: Camera) -> Tensor:
    """Colour of rays: (n, 3) float32, not yet exposed."""
    world, palette, solid, depth = paint.world, paint.palette, hits.solid, hits.depth
    rows = functional.embedding(solid, paint.rows)
    part = {name: rows[:, _ENDS[name] - size : _ENDS[name]] for name, size in _COLUMNS.items()}
    ray = torch.stack(
        ((hits.x_px - camera.centre_px[0]) / world.focal_px, (hits.y_px - camera.centre_px[1]) / world.focal_px), dim=-1
    )
    ray = functional.pad(ray, (0, 1), value=1.0)
    far = depth.isinf()
    depth = torch.where(far, 1.0, depth)
    point = ray * depth[:, None]
    point[:, 0] += camera.x * ~far
    local_from_world = part["local"].reshape(-1, 3, 3)
    local = torch.einsum("nij,nj->ni", local_from_world, point - part["centre"])
    normal_local, axis = _normal(
        local=local, kind=part["kind"][:, 0], taper=part["taper"][:, 0], solid=solid, paint=paint
    )
    normal = functional.normalize(torch.einsum("nij,ni->nj", local_from_world, normal_local), dim=-1)
    normal = torch.where((normal * ray).sum(dim=-1, keepdim=True) > 0, -normal, normal)
    facing = -(normal * functional.normalize(ray, dim=-1)).sum(dim=-1)
    colour = _albedo(palette=palette, part=part, local=local, axis=axis, depth=depth, facing=facing, world=world)
    lit = _light(paint, point, normal, solid)
    colour = torch.where(far[:, None], colour, colour * lit)
    return _mirror(colour=colour, palette=palette, part=part, ray=ray, normal=normal, far=far)


def _normal(local: Tensor, kind: Tensor, taper: Tensor, solid: Tensor, paint: Paint) -> tuple[Tensor, Tensor]:
    """(n, 3) local normal up to length and sign, and (n,) the axis that the texture is projected along."""
    size = local.abs()
    is_cone = kind == Kind.CONE
    on_end = is_cone & (size[:, 2] > 0.999)
    # A mantle with the radius 1 - taper (1 + z) / 2 leans by taper / 2.
    mantle = torch.stack((local[:, 0], local[:, 1], 0.5 * taper * local[:, :2].norm(dim=-1)), dim=-1)
    axis = size.argmax(dim=-1)
    flat = (kind == Kind.SHEET) | (kind == Kind.PLANE) | (kind == _SKY_KIND) | on_end
    axis = torch.where(flat, 2, torch.where(is_cone, size[:, :2].argmax(dim=-1), axis))
    normal = functional.one_hot(axis, 3).to(local)
    round_one = (kind == Kind.ELLIPSOID)[:, None]
    normal = torch.where(round_one, local, torch.where((is_cone & ~on_end)[:, None], mantle, normal))
    place = paint.is_wavy[solid].nonzero()[:, 0]
    if len(place):
        _, slope_x, slope_y = relief(local[place, 0], local[place, 1], paint.waves[solid[place]])
        normal[place, :2] = -torch.stack((slope_x, slope_y), dim=-1)
    return normal, axis


def _albedo(
    palette: Palette, part: dict[str, Tensor], local: Tensor, axis: Tensor, depth: Tensor, facing: Tensor, world: World
) -> Tensor:
    position = local * part["size"]
    other = torch.stack(((axis == 0).long(), 2 - (axis == 2).long()), dim=-1)
    texels_per_px = part["density"][:, 0] * depth / world.focal_px
    uv = position.gather(1, other) * part["density"] + part["offset"]
    texture, macro = part["texture"][:, 0].long(), part["macro"][:, 0].long()
    fine = look_up_texture(palette, texture, uv, texels_per_px=texels_per_px / facing.clamp(min=0.1).sqrt())
    coarse = look_up_texture(palette, macro, uv * MACRO_RATIO, texels_per_px=texels_per_px * MACRO_RATIO)
    mean = functional.embedding(texture, palette.means)
    shade_of_coarse = (coarse - functional.embedding(macro, palette.means)).mean(dim=-1, keepdim=True)
    colour = mean + part["contrast"] * (fine - mean)
    return colour * (1 + part["macro_contrast"] * shade_of_coarse).clamp(min=0.2) * part["tint"]


def _light(paint: Paint, point: Tensor, normal: Tensor, solid: Tensor) -> Tensor:
    """(n, 3) ambient and directed light; the directed part is cut off softly behind the largest solids."""
    towards, ambient = paint.towards, paint.world.light.ambient
    direct = (normal @ towards).clamp(min=0)
    for number, local, centre in paint.casters:
        start, way = (point - centre) @ local.T, local @ towards
        along = -(start @ way) / (way @ way)
        distance = (start + along[:, None] * way).norm(dim=-1)
        light = ((distance - SHADOW_EDGE[0]) / (SHADOW_EDGE[1] - SHADOW_EDGE[0])).clamp(0, 1)
        direct = direct * torch.where((along > 0) & (solid != number), light, 1.0)
    return ambient + (1 - ambient) * direct[:, None] * paint.light_colour


def _mirror(
    colour: Tensor, palette: Palette, part: dict[str, Tensor], ray: Tensor, normal: Tensor, far: Tensor
) -> Tensor:
    """Blend in what glossy surfaces mirror: a soft picture that belongs to the direction, not to the surface."""
    place = ((part["gloss"][:, 0] > 0) & ~far).nonzero()[:, 0]
    if not len(place):
        return colour
    way = functional.normalize(ray[place], dim=-1)
    n = normal[place]
    reflected = way - 2 * (way * n).sum(dim=-1, keepdim=True) * n
    macro = part["macro"][place, 0].long()
    gloss = part["gloss"][place]
    coarse = (MIRRORED_BLUR * (1 - gloss[:, 0])).clamp(min=1)
    seen = look_up_texture(palette, macro, reflected[:, :2] * MIRRORED_TEXELS, texels_per_px=coarse)
    colour[place] = colour[place] + gloss * (1.6 * seen - 0.5)
    return colour
