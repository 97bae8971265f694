"""Grids, warps and convex upsampling: everything that says where a pixel lies.

Pixel (0, 0) is the centre of the top-left pixel and ``align_corners=False`` throughout, so a view resized by s has
``x' = (x + 0.5) s - 0.5``. ``disparity_px = x_ref - x_src``. Grids and warps are float32 or better whatever
the autocast.
Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

LARGEST_LOGIT = 20.0


def warp_to_ref(src_BCHW: Tensor, disparity_px_BHW: Tensor) -> Tensor:
    """Look src up where ref's pixels lie in it: ``warped(x, y) = src(x - d, y)``.

    Bilinear; zero outside src. Whole disparities are exact to rounding: 1e-7 of the width, in px.

    Args:
        src_BCHW: (B, C, H, W) source view.
        disparity_px_BHW: (B, H, W) disparity of ref, px of this map.

    Returns:
        (B, C, H, W) the source view as ref sees it.
    """
    src = at_least_float32(src_BCHW)
    return functional.grid_sample(
        src,
        _lookup_grid(at_least_float32(disparity_px_BHW)).to(src.dtype),
        mode="bilinear",
        padding_mode="zeros",
        align_corners=False,
    )


def _lookup_grid(disparity_px_BHW: Tensor) -> Tensor:
    """(B, H, W, 2) in grid_sample's units, where -1 and 1 are the outer edges of the border pixels."""
    _, height, width = disparity_px_BHW.shape
    x_px = torch.arange(width, device=disparity_px_BHW.device, dtype=torch.float32)
    y_px = torch.arange(height, device=disparity_px_BHW.device, dtype=torch.float32)
    grid_x = (2 * (x_px - disparity_px_BHW) + 1) / width - 1
    grid_y = ((2 * y_px + 1) / height - 1)[:, None].expand_as(disparity_px_BHW)
    return torch.stack((grid_x, grid_y), dim=-1)


def at_least_float32(x: Tensor) -> Tensor:
    """Lift low precision to float32; float64, in which gradients are checked, stays."""
    return x if x.dtype == torch.float64 else x.float()


def is_inside_src(disparity_px_BHW: Tensor) -> Tensor:
    """(B, H, W) bool: True where ref's pixel falls inside the source view."""
    width = disparity_px_BHW.shape[-1]
    x_src_px = torch.arange(width, device=disparity_px_BHW.device) - disparity_px_BHW
    return (x_src_px >= 0) & (x_src_px <= width - 1)


def upsample_convex(values_BHW: Tensor, weights_BCHW: Tensor, *, factor: int) -> Tensor:
    """Enlarge a map, each new pixel a learned convex combination of its 3x3 coarse neighbours.

    The form of RAFT (Teed and Deng, 2020). Values are not scaled: for disparities kept in full-size px.

    Args:
        values_BHW: (B, H, W) coarse map.
        weights_BCHW: (B, 9 factor^2, H, W) logits, taken as at most 20 and at least -20.
        factor: integer enlargement.

    Returns:
        (B, factor H, factor W) float32.
    """
    batch, height, width = values_BHW.shape
    # A softmax over the nine neighbours, summed as it goes: the whole is never laid out twice. Limits instead of the
    # largest logit keep it finite at half the time.
    scores = weights_BCHW.clamp(-LARGEST_LOGIT, LARGEST_LOGIT).contiguous().float().exp_()
    scores = scores.view(batch, 9, factor * factor, height, width)
    padded = functional.pad(values_BHW.float()[:, None], (1, 1, 1, 1), mode="replicate")
    fine = torch.zeros_like(scores[:, 0])
    for neighbour in range(9):
        row, column = divmod(neighbour, 3)
        fine.addcmul_(scores[:, neighbour], padded[..., row : row + height, column : column + width])
    return functional.pixel_shuffle(fine / scores.sum(dim=1), factor)[:, 0]


def pad_to_multiple(image_BCHW: Tensor, *, multiple: int) -> Tensor:
    """Pad right and bottom by repeating the border until both sides are multiples; pixel (0, 0) stays."""
    height, width = image_BCHW.shape[-2:]
    pad_right, pad_bottom = -width % multiple, -height % multiple
    if not pad_right and not pad_bottom:
        return image_BCHW
    return functional.pad(image_BCHW, (0, pad_right, 0, pad_bottom), mode="replicate")
