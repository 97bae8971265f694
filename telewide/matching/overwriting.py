"""Operations that cost less where nobody asks for what was computed on the way: in inference, not under gradients.

Each equals the plain form to rounding, and is that form in training and for export. Letters: B batch, C channels, D
planes, H W grid.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


def is_overwriting_allowed() -> bool:
    """Whether a result may be written over what it was computed from."""
    return not (torch.is_grad_enabled() or torch.compiler.is_compiling())


def planar_conv1x1(conv: nn.Conv2d, x_BCHW: Tensor) -> Tensor:
    """Convolve by a 1x1 kernel, the result with each channel in one piece where x has them interleaved.

    That is for what adds up channel by channel. torch keeps them interleaved, and taking them apart afterwards takes
    several times as long as a matrix product that writes them apart.
    """
    is_interleaved = x_BCHW.is_contiguous(memory_format=torch.channels_last)
    if not is_overwriting_allowed() or not is_interleaved or conv.bias is None:
        convolved: Tensor = conv(x_BCHW)
        return convolved
    batch, _, height, width = x_BCHW.shape
    pixels_BCN = x_BCHW.permute(0, 2, 3, 1).flatten(1, 2).transpose(1, 2)
    weight = conv.weight.flatten(1).expand(batch, -1, -1)
    planes_BCN = torch.baddbmm(conv.bias[:, None], weight, pixels_BCN)
    return planes_BCN.view(batch, -1, height, width)


def add_enlarged(coarse_BCDHW: Tensor, fine_BCDHW: Tensor) -> Tensor:
    """Enlarge a volume to the size of a finer one, each cell repeated, and add that one; it may be written over."""
    batch, channels, *sides = fine_BCDHW.shape
    is_doubled = [2 * side for side in coarse_BCDHW.shape[2:]] == sides
    volumes = (coarse_BCDHW, fine_BCDHW)
    is_interleaved = all(x.is_contiguous(memory_format=torch.channels_last_3d) for x in volumes)
    if not (is_overwriting_allowed() and is_doubled and is_interleaved):
        return functional.interpolate(coarse_BCDHW, size=fine_BCDHW.shape[2:], mode="nearest").add_(fine_BCDHW)
    depth, height, width = coarse_BCDHW.shape[2:]
    # Only along the rows is the coarse volume repeated in memory.
    rows = coarse_BCDHW.permute(0, 2, 3, 4, 1)[..., None, :].expand(-1, -1, -1, -1, 2, -1)
    rows = rows.reshape(batch, depth, 1, height, 1, 2 * width * channels)
    fine_BCDHW.permute(0, 2, 3, 4, 1).view(batch, depth, 2, height, 2, 2 * width * channels).add_(rows)
    return fine_BCDHW
