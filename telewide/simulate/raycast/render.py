"""Cast a world for both cameras: colours, exact disparity, what src does not see.

One ray goes through each pixel's centre and gives its disparity; where the solid changes from one pixel to the next,
four more give the colour. On a processor each solid is tested where it can be seen; on a GPU, which calls cost more
than arithmetic, all of one form are tested together. Textures, light and shadows belong to the
surface and are alike in both views; reflections move.
Letters: H W view, N solids, n rays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from telewide.simulate.raycast.casting import Alike, Box, alike, box_in_view, first_hits, form_of
from telewide.simulate.raycast.palette import Palette
from telewide.simulate.raycast.shading import Hits, Paint, paint_of, shade
from telewide.simulate.raycast.world import Camera, World

HIDDEN_PX = 0.5
"""A pixel of ref counts as hidden where src shows something nearer by more than this."""
ONE_HIDES_STEP = 0.75
"""A single pixel of src hides what lies lower by more than this share of the step beside it: no slope, but an edge."""
RAYS_AT_ONCE = 1 << 25
"""Of a GPU: 128 MiB for each of the maps that a test takes."""
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


def cast_pair(world: World, palette: Palette, *, rays_at_once: int | None = None) -> CastPair:
    """Cast both views on the device of the palette.

    Args:
        world: the scene.
        palette: what it is painted with.
        rays_at_once: rays against solids that are tested in one call; 0 tests each solid on its own, where it can be
            seen. None takes what suits the device.
    """
    if rays_at_once is None:
        rays_at_once = 0 if palette.textures.device.type == "cpu" else RAYS_AT_ONCE
    paint = paint_of(world, palette)
    ref, depth = _view(paint, camera=world.ref, rays_at_once=rays_at_once)
    src, src_depth = _view(paint, camera=world.src, rays_at_once=rays_at_once)
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


def _view(paint: Paint, *, camera: Camera, rays_at_once: int) -> tuple[Tensor, Tensor]:
    """(H, W, 3) colour and (H, W) depth of one camera."""
    (height, width), count = camera.hw, len(paint.world.solids)
    columns, rows = (torch.arange(n, device=paint.rows.device, dtype=torch.float32) for n in (width, height))
    depth = torch.full((height, width), torch.inf, device=paint.rows.device)
    solid = torch.full((height, width), count, dtype=torch.int64, device=paint.rows.device)
    groups = _groups(paint, camera, rays_at_once)
    for solids, (x0, y0, x1, y1) in groups:
        t = first_hits(solids, columns[None, x0:x1], rows[y0:y1, None], palette=paint.palette)
        _keep_nearer(depth[y0:y1, x0:x1], solid[y0:y1, x0:x1], t, solids.number)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    hits = Hits(x.flatten(), y.flatten(), solid.flatten(), depth.flatten())
    colour = shade(paint, hits, camera=camera).reshape(height, width, 3)
    place = _beside_another(solid)
    if len(place):
        hits = _four_rays_each(place, solid, [solids for solids, _ in groups], paint=paint)
        # The mean of four rays, where one would draw a staircase.
        colour.reshape(-1, 3)[place] = shade(paint, hits, camera=camera).reshape(-1, 4, 3).mean(dim=1)
    return colour, depth


def _groups(paint: Paint, camera: Camera, rays_at_once: int) -> list[tuple[Alike, Box]]:
    """Solids that are tested in one call, and where: each on its own, or many of a form in the whole view."""
    solids, (height, width) = paint.world.solids, camera.hw
    boxes = [box_in_view(solid, camera=camera) for solid in solids]
    seen = [number for number, box in enumerate(boxes) if box is not None]
    together = [[number] for number in seen]
    if rays_at_once:
        by_form: dict[object, list[int]] = defaultdict(list)
        for number in seen:
            by_form[form_of(solids[number])].append(number)
        most = max(1, rays_at_once // (height * width))
        together = [of_form[i : i + most] for of_form in by_form.values() for i in range(0, len(of_form), most)]
    whole = (0, 0, width, height)
    return [
        (alike(numbers, solids, camera=camera, like=paint.rows), whole if rays_at_once else boxes[numbers[0]] or whole)
        for numbers in together
    ]


def _keep_nearer(depth: Tensor, solid: Tensor, t: Tensor, number: Tensor) -> None:
    """Let the nearest of some solids cover what lies behind it; depth and solid are changed in place.

    Args:
        depth: (...) of what was met so far.
        solid: (...) which it was.
        t: (n, ...) depths of some solids.
        number: (n,) which these are.
    """
    nearest, which = t.min(dim=0) if len(t) > 1 else (t[0], None)
    is_nearer = nearest < depth
    depth.copy_(torch.where(is_nearer, nearest, depth))
    solid.copy_(torch.where(is_nearer, number[0] if which is None else number[which], solid))


def _beside_another(solid: Tensor) -> Tensor:
    """(n,) flat index of the pixels with another solid above, below or beside them."""
    border = torch.zeros_like(solid, dtype=torch.bool)
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        differs = solid[one] != solid[other]
        border[one] |= differs
        border[other] |= differs
    return border.flatten().nonzero()[:, 0]


def _four_rays_each(place: Tensor, solid: Tensor, groups: Sequence[Alike], *, paint: Paint) -> Hits:
    """Cast four rays through each of some pixels, onto the solids that are seen in or next to it."""
    height, width = solid.shape
    offsets = torch.tensor(_SUBPIXELS, device=solid.device)
    column, row = place % width, torch.div(place, width, rounding_mode="floor")
    x, y = column.float()[:, None] + offsets[:, 0], row.float()[:, None] + offsets[:, 1]
    around = torch.stack(  # (9, n) solids
        [
            solid[(row + down).clamp(0, height - 1), (column + right).clamp(0, width - 1)]
            for down in (-1, 0, 1)
            for right in (-1, 0, 1)
        ]
    )
    depth = torch.full_like(x, torch.inf)
    owner = torch.full(x.shape, len(paint.world.solids), dtype=torch.int64, device=solid.device)
    for solids in groups:
        is_near = (around == solids.number[:, None, None]).any(dim=1)
        rays = is_near.any(dim=0).nonzero()[:, 0]
        if not len(rays):
            continue
        t = first_hits(solids, x[rays], y[rays], palette=paint.palette)
        t = torch.where(is_near[:, rays, None], t, torch.inf)
        nearest, met = depth[rays], owner[rays]
        _keep_nearer(nearest, met, t, solids.number)
        depth[rays], owner[rays] = nearest, met
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
