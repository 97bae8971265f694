"""Cast a world for both cameras: colours, exact disparity, what src does not see.

One ray goes through each pixel's centre and gives its disparity; where the solid changes from one pixel to the next,
four more give the colour. Solids are tested only where they can be seen. Textures, light and shadows belong to the
surface and are alike in both views; reflections move.
Letters: H W view, N solids, n rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from telewide.simulate.raycast.casting import Box, box_in_view, first_hit
from telewide.simulate.raycast.palette import Palette
from telewide.simulate.raycast.shading import Hits, Paint, paint_of, shade
from telewide.simulate.raycast.world import Camera, World

HIDDEN_PX = 0.5
"""A pixel of ref counts as hidden where src shows something nearer by more than this."""
ONE_HIDES_STEP = 0.75
"""A single pixel of src hides what lies lower by more than this share of the step beside it: no slope, but an edge."""
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
    ref, depth = _view(paint, camera=world.ref)
    src, src_depth = _view(paint, camera=world.src)
    gain = _exposure(ref, world)
    disparity_px = disparity_of(depth, world)
    occluded = _hidden(disparity_px, disparity_of(src_depth, world))
    return CastPair((ref * gain).clamp(0, 1), (src * gain).clamp(0, 1), disparity_px, occluded)


def disparity_of(depth: Tensor, world: World) -> Tensor:
    """Disparity in px of a depth; inf is allowed."""
    return world.focal_px * world.baseline_m / depth + world.offset_px


def _exposure(ref: Tensor, world: World) -> Tensor:
    """Bring the bright parts of ref to where a camera would, some of them clipped."""
    sample = ref[::4, ::4].amax(dim=-1).flatten()
    bright = sample.sort().values[int(0.95 * (len(sample) - 1))]
    return (0.72 + 0.35 * world.light.ambient) / bright.clamp(min=0.05)


def _view(paint: Paint, *, camera: Camera) -> tuple[Tensor, Tensor]:
    """(H, W, 3) colour and (H, W) depth of one camera."""
    world = paint.world
    height, width = world.hw
    device = paint.rows.device
    depth = torch.full((height, width), torch.inf, device=device)
    solid = torch.full((height, width), len(world.solids), dtype=torch.int64, device=device)
    boxes = [box_in_view(item, camera=camera) for item in world.solids]
    for number, (item, box) in enumerate(zip(world.solids, boxes, strict=True)):
        if box is None:
            continue
        x0, y0, x1, y1 = box
        x = torch.arange(x0, x1, device=device, dtype=torch.float32)[None, :]
        y = torch.arange(y0, y1, device=device, dtype=torch.float32)[:, None]
        t = first_hit(item, x, y, camera=camera, palette=paint.palette)
        is_nearer = t < depth[y0:y1, x0:x1]
        depth[y0:y1, x0:x1] = torch.where(is_nearer, t, depth[y0:y1, x0:x1])
        solid[y0:y1, x0:x1].masked_fill_(is_nearer, number)
    y, x = torch.meshgrid(
        *(torch.arange(n, device=device, dtype=torch.float32) for n in (height, width)), indexing="ij"
    )
    hits = Hits(x.flatten(), y.flatten(), solid.flatten(), depth.flatten())
    colour = shade(paint, hits, camera=camera).reshape(height, width, 3)
    place = _beside_another(solid)
    if len(place):
        hits = _four_rays_each(place, solid, boxes, paint=paint, camera=camera)
        # The mean of four rays, where one would draw a staircase.
        colour.reshape(-1, 3)[place] = shade(paint, hits, camera=camera).reshape(-1, 4, 3).mean(dim=1)
    return colour, depth


def _beside_another(solid: Tensor) -> Tensor:
    """(n,) flat index of the pixels with another solid above, below or beside them."""
    border = torch.zeros_like(solid, dtype=torch.bool)
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        differs = solid[one] != solid[other]
        border[one] |= differs
        border[other] |= differs
    return border.flatten().nonzero()[:, 0]


def _four_rays_each(place: Tensor, solid: Tensor, boxes: Sequence[Box | None], *, paint: Paint, camera: Camera) -> Hits:
    """Cast four rays through each of some pixels, onto the solids that are seen in or next to it."""
    height, width = solid.shape
    rank = torch.full((height * width,), -1, dtype=torch.int64, device=solid.device)
    rank[place] = torch.arange(len(place), device=solid.device)
    offsets = torch.tensor(_SUBPIXELS, device=solid.device)
    x = (place % width).float()[:, None] + offsets[:, 0]
    y = torch.div(place, width, rounding_mode="floor").float()[:, None] + offsets[:, 1]
    depth = torch.full_like(x, torch.inf)
    owner = torch.full(x.shape, len(paint.world.solids), dtype=torch.int64, device=solid.device)
    for number, (item, box) in enumerate(zip(paint.world.solids, boxes, strict=True)):
        if box is None:
            continue
        x0, y0, x1, y1 = box
        seen = (solid[y0:y1, x0:x1] == number).float()[None, None]
        near = functional.max_pool2d(seen, 3, stride=1, padding=1)[0, 0] > 0
        rays = rank.reshape(height, width)[y0:y1, x0:x1][near]
        rays = rays[rays >= 0]
        if not len(rays):
            continue
        t = first_hit(item, x[rays], y[rays], camera=camera, palette=paint.palette)
        is_nearer = t < depth[rays]
        depth[rays] = torch.where(is_nearer, t, depth[rays])
        owner[rays] = torch.where(is_nearer, number, owner[rays])
    return Hits(x.flatten(), y.flatten(), owner.flatten(), depth.flatten())


def _hidden(disparity_px: Tensor, src_disparity_px: Tensor) -> Tensor:
    """Whether src shows something nearer at a pixel's image, or does not reach so far.

    It lies on both sides of the image, or at the pixel nearest to it; there a slope rises by half a step at the most.
    """
    width = disparity_px.shape[1]
    x_src = torch.arange(width, device=disparity_px.device) - disparity_px
    low, nearest = x_src.floor().clamp(0, width - 2).long(), x_src.round().clamp(0, width - 1).long()
    left_px, right_px = src_disparity_px.gather(1, low), src_disparity_px.gather(1, low + 1)
    excess_px = src_disparity_px.gather(1, nearest) - disparity_px
    on_both_sides = torch.minimum(left_px, right_px) > disparity_px + HIDDEN_PX
    by_one = (excess_px > HIDDEN_PX) & (excess_px > ONE_HIDES_STEP * (left_px - right_px).abs())
    return on_both_sides | by_one | (x_src < 0) | (x_src > width - 1)
