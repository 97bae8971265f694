"""DAN, which assumes a Gaussian blur before bicubic shrinking: deep alternating network (Luo et al., 2020), version 1.

A restorer and an estimator of the blur take turns. Layout and parameter names are those of the authors' code, so that
their checkpoints load; the principal components of the kernels come with them.
Letters: B batch, C channels, H W image; in the authors' names L R low and H R high resolution.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from telewide.geometry.arrays import FloatMap
from telewide.restoration.kernels import KERNEL_SIDE

CHANNELS, BLOCKS = 64, 40
ESTIMATOR_CHANNELS, ESTIMATOR_BLOCKS = 32, 5
CODE_LENGTH = 10
LOOPS = 4
REDUCTION = 16
SLOPE = 0.2
FACTORS = (2, 3, 4)


def _conv(c_in: int, c_out: int, *, kernel: int = 3, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, kernel, stride=stride, padding=kernel // 2)


class _Attention(nn.Module):
    """Scale every channel by what its mean over the picture says."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        hidden = max(1, channels // REDUCTION)
        self.body = nn.Sequential(
            _conv(channels, hidden, kernel=1), nn.LeakyReLU(SLOPE), _conv(hidden, channels, kernel=1), nn.Sigmoid()
        )

    def forward(self, x: Tensor) -> Tensor:
        scale: Tensor = self.body(x.mean(dim=(-2, -1), keepdim=True))
        return x * scale


class _ConditionalBlock(nn.Module):
    """A residual to features that depends on other ones."""

    def __init__(self, channels: int, conditions: int) -> None:
        super().__init__()
        both = channels + conditions
        self.body = nn.Sequential(_conv(both, both), nn.LeakyReLU(SLOPE), _conv(both, channels), _Attention(channels))

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        residual: Tensor = self.body(torch.cat((x, condition), dim=1))
        return x + residual


class _Restorer(nn.Module):
    def __init__(self, factor: int, *, channels: int, blocks: int) -> None:
        super().__init__()
        self.head = _conv(3, channels)
        self.body = nn.ModuleList(_ConditionalBlock(channels, CODE_LENGTH) for _ in range(blocks))
        self.fusion = _conv(channels, channels)
        layers: list[nn.Module] = []
        for step in [2, 2] if factor == 4 else [factor]:
            layers += [_conv(channels, step * step * channels), nn.PixelShuffle(step)]
        self.upscale = nn.Sequential(*layers, _conv(channels, 3))

    def forward(self, small: Tensor, code: Tensor) -> Tensor:
        condition = code[:, :, None, None].expand(-1, -1, *small.shape[-2:])
        features = self.head(small)
        for block in self.body:
            features = block(features, condition)
        restored: Tensor = self.upscale(self.fusion(features))
        return restored


class _Estimator(nn.Module):
    def __init__(self, factor: int) -> None:
        super().__init__()
        c = ESTIMATOR_CHANNELS
        self.head_LR = _conv(3, c, kernel=1)
        self.head_HR = _conv(3, c, kernel=9, stride=factor)
        self.body = nn.ModuleList(_ConditionalBlock(c, c) for _ in range(ESTIMATOR_BLOCKS))
        self.out = _conv(c, CODE_LENGTH)

    def forward(self, restored: Tensor, small: Tensor) -> Tensor:
        features, condition = self.head_LR(small), self.head_HR(restored)
        for block in self.body:
            features = block(features, condition)
        code: Tensor = self.out(features)
        return code.mean(dim=(-2, -1))


class Dan(nn.Module):
    """A small picture to one ``factor`` times as large, and what blurred it.

    Args:
        factor: 2, 3 or 4; the authors have no model for 8.
        components: (KERNEL_SIDE^2, CODE_LENGTH) principal components of the kernels it is to assume.
        channels: width of the restorer.
        blocks: its conditional blocks.

    Raises:
        ValueError: for another factor.
    """

    encoder: Tensor
    init_kernel: Tensor
    init_ker_map: Tensor

    def __init__(self, factor: int, components: FloatMap, *, channels: int = CHANNELS, blocks: int = BLOCKS) -> None:
        super().__init__()
        if factor not in FACTORS:
            raise ValueError(f"DAN enlarges by {FACTORS}, not by {factor}")
        self.factor = factor
        self.Restorer = _Restorer(factor, channels=channels, blocks=blocks)
        self.Estimator = _Estimator(factor)
        encoder = torch.from_numpy(np.asarray(components, np.float32))[None]
        sharp = torch.zeros(1, KERNEL_SIDE, KERNEL_SIDE)
        sharp[:, KERNEL_SIDE // 2, KERNEL_SIDE // 2] = 1
        self.register_buffer("encoder", encoder)
        self.register_buffer("init_kernel", sharp)
        self.register_buffer("init_ker_map", sharp.view(1, -1) @ encoder[0])

    def forward(self, image_BCHW: Tensor) -> Tensor:
        """(B, 3, H, W) in [0, 1] to (B, 3, factor H, factor W) of the last turn, not clipped."""
        return self.turns(image_BCHW)[0][-1]

    def turns(self, image_BCHW: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Restored pictures (B, 3, factor H, factor W) and codes (B, CODE_LENGTH) of the kernel, one of each a turn."""
        code = self.init_ker_map.expand(len(image_BCHW), -1)
        pictures, codes = [], []
        for _ in range(LOOPS):
            pictures.append(self.Restorer(image_BCHW, code.detach()))
            code = self.Estimator(pictures[-1].detach(), image_BCHW)
            codes.append(code)
        return pictures, codes

    def encode(self, kernels_BHW: Tensor) -> Tensor:
        """Kernels (B, KERNEL_SIDE, KERNEL_SIDE) as codes (B, CODE_LENGTH)."""
        return kernels_BHW.flatten(1) @ self.encoder[0]
