"""Cast a world for both cameras: colours, exact disparity, what src does not see.

One ray goes through each pixel's centre and gives its disparity; where the solid changes from one pixel to the next,
four more give the colour. Solids are tested only where they can be seen. Textures, light and shadows belong to the
surface and are alike in both views; reflections move.
Letters: H W view, N solids, n rays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from telewide.simulate.raycast.hits import Kind, Ray, hit_box, hit_cone, hit_ellipsoid, hit_plane, hit_room
from telewide.simulate.raycast.palette import Palette, look_up_outline
from telewide.simulate.raycast.shading import Paint, paint_of, shade
from telewide.simulate.raycast.world import Camera, Solid, World

HIDDEN_PX = 0.5
"""A pixel of ref counts as hidden where src shows something nearer by more than this."""
_SUBPIXELS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))


@dataclass(frozen=True)
class CastPair:
    """Two views of a world and the truth.

    Attributes:
        ref: (H, W, 3) float32, sRGB in [0, 1].
        src: (H, W, 3) float32, sRGB in [0, 1].
        disparity_px: (H, W) float32 of ref's pixel centres.
        occluded: (H, W) bool, hidden from src or outside it.
    """

    ref: Tensor
    src: Tensor
    disparity_px: Tensor
    occluded: Tensor


def cast_pair(world: World, palette: Palette) -> CastPair:
    """Cast both views on the device of the palette."""
    paint = paint_of(world, palette)
    ref, depth = _view(world, palette, paint, camera=world.ref)
    src, src_depth = _view(world, palette, paint, camera=world.src)
    gain = _exposure(ref, world)
    disparity_px = disparity_of(depth, world)
    occluded = _hidden(disparity_px, disparity_of(src_depth, world))
    return CastPair((ref * gain).clamp(0, 1), (src * gain).clamp(0, 1), disparity_px, occluded)


def disparity_of(depth: Tensor, world: World) -> Tensor:
    """Disparity in px of a depth; inf is allowed."""
    return world.focal_px * world.baseline / depth + world.offset_px


def _exposure(ref: Tensor, world: World) -> Tensor:
    """Bring the bright parts of ref to where a camera would, some of them clipped."""
    sample = ref[::4, ::4].amax(dim=-1).flatten()
    bright = sample.sort().values[int(0.95 * (len(sample) - 1))]
    return (0.72 + 0.35 * world.light.ambient) / bright.clamp(min=0.05)


def _view(world: World, palette: Palette, paint: Paint, *, camera: Camera) -> tuple[Tensor, Tensor]:
    """(H, W, 3) colour and (H, W) depth of one camera."""
    height, width = world.hw
    device = palette.textures.device
    depth = torch.full((height, width), torch.inf, device=device)
    solid = torch.full((height, width), len(world.solids), dtype=torch.int64, device=device)
    boxes = [_box_in_view(item, world, camera=camera) for item in world.solids]
    for number, (item, box) in enumerate(zip(world.solids, boxes, strict=True)):
        if box is None:
            continue
        x0, y0, x1, y1 = box
        x = torch.arange(x0, x1, device=device, dtype=torch.float32)[None, :]
        y = torch.arange(y0, y1, device=device, dtype=torch.float32)[:, None]
        t = first_hit(item, palette, x, y, world, camera=camera)
        is_nearer = t < depth[y0:y1, x0:x1]
        depth[y0:y1, x0:x1] = torch.where(is_nearer, t, depth[y0:y1, x0:x1])
        solid[y0:y1, x0:x1].masked_fill_(is_nearer, number)
    y, x = torch.meshgrid(
        *(torch.arange(n, device=device, dtype=torch.float32) for n in (height, width)), indexing="ij"
    )
    colour = shade(world, palette, paint, solid.flatten(), depth.flatten(), x.flatten(), y.flatten(), camera=camera)
    colour = colour.reshape(height, width, 3)
    _soften_borders(colour, solid, boxes, world, palette, paint, camera=camera)
    return colour, depth


def _soften_borders(
    colour: Tensor,
    solid: Tensor,
    boxes: list[tuple[int, int, int, int] | None],
    world: World,
    palette: Palette,
    paint: Paint,
    *,
    camera: Camera,
) -> None:
    """Replace the colour of pixels beside another solid by the mean of four rays through them."""
    height, width = solid.shape
    border = torch.zeros_like(solid, dtype=torch.bool)
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        differs = solid[one] != solid[other]
        border[one] |= differs
        border[other] |= differs
    place = border.flatten().nonzero()[:, 0]
    if not len(place):
        return
    rank = torch.zeros(height * width, dtype=torch.int64, device=solid.device)
    rank[place] = torch.arange(len(place), device=solid.device)
    offsets = torch.tensor(_SUBPIXELS, device=solid.device)
    x = (place % width).float()[:, None] + offsets[:, 0]
    y = torch.div(place, width, rounding_mode="floor").float()[:, None] + offsets[:, 1]
    depth = torch.full_like(x, torch.inf)
    owner = torch.full(x.shape, len(world.solids), dtype=torch.int64, device=solid.device)
    for number, (item, box) in enumerate(zip(world.solids, boxes, strict=True)):
        if box is None:
            continue
        x0, y0, x1, y1 = box
        seen = (solid[y0:y1, x0:x1] == number).float()[None, None]
        near = functional.max_pool2d(seen, 3, stride=1, padding=1)[0, 0] > 0
        rows, columns = (near & border[y0:y1, x0:x1]).nonzero(as_tuple=True)
        if not len(rows):
            continue
        rays = rank[(rows + y0) * width + columns + x0]
        t = first_hit(item, palette, x[rays], y[rays], world, camera=camera)
        is_nearer = t < depth[rays]
        depth[rays] = torch.where(is_nearer, t, depth[rays])
        owner[rays] = torch.where(is_nearer, number, owner[rays])
    fine = shade(world, palette, paint, owner.flatten(), depth.flatten(), x.flatten(), y.flatten(), camera=camera)
    colour.reshape(-1, 3)[place] = fine.reshape(-1, len(_SUBPIXELS), 3).mean(dim=1)


def first_hit(solid: Solid, palette: Palette, x: Tensor, y: Tensor, world: World, *, camera: Camera) -> Tensor:
    """Depth at which the rays through (x, y) px of a camera meet a solid, inf where they miss it."""
    local = solid.local_from_world
    o = local @ (np.array([camera.x, 0.0, 0.0]) - solid.centre)
    cx, cy = camera.centre_px
    per_px = local @ np.array([[1, 0, -cx], [0, 1, -cy], [0, 0, world.focal_px]]) / world.focal_px
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
    return t if solid.kind is Kind.PLANE else _cut_out(t, solid, palette, origin, direction)


def _cut_out(t: Tensor, solid: Solid, palette: Palette, origin: Ray, direction: Ray) -> Tensor:
    u, v = origin[0] + t * direction[0], origin[1] + t * direction[1]
    inside = (u.abs() < 1) & (v.abs() < 1)
    if solid.outline is not None:
        places = inside.nonzero(as_tuple=True)
        inside[places] = look_up_outline(palette, solid.outline, u[places].float(), v[places].float()) > 0
    return torch.where(inside, t, torch.inf)


def _box_in_view(solid: Solid, world: World, *, camera: Camera) -> tuple[int, int, int, int] | None:
    """(x0, y0, x1, y1) px that a solid can be seen in; None where it is out of view."""
    height, width = world.hw
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
    pixels = world.focal_px * points[:, :2] / points[:, 2:] + camera.centre_px
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    box = max(0, math.floor(x0)), max(0, math.floor(y0)), min(width, math.ceil(x1) + 1), min(height, math.ceil(y1) + 1)
    return box if box[0] < box[2] and box[1] < box[3] else None


def _hidden(disparity_px: Tensor, src_disparity_px: Tensor) -> Tensor:
    """Whether src shows something nearer at a pixel's image, on both sides of it, or does not reach so far."""
    width = disparity_px.shape[1]
    x_src = torch.arange(width, device=disparity_px.device) - disparity_px
    low = x_src.floor().clamp(0, width - 2).long()
    nearer = (
        torch.minimum(src_disparity_px.gather(1, low), src_disparity_px.gather(1, low + 1)) > disparity_px + HIDDEN_PX
    )
    return nearer | (x_src < 0) | (x_src > width - 1)
