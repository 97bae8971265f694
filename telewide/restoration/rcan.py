"""RCAN, which assumes bicubic shrinking: residual channel attention (Zhang et al., 2018), 15.6 M parameters.

Layout and parameter names are those of its authors' code, so that their checkpoints load.
Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

CHANNELS = 64
GROUPS, BLOCKS = 10, 20
REDUCTION = 16
"""Channels over hidden channels of the attention."""
VALUE_RANGE = 255.0
"""The layers compute in 8-bit levels."""
MEAN_RGB = (0.4488, 0.4371, 0.4040)
"""Of the DIV2K pictures it was trained on."""
FACTORS = (2, 3, 4, 8)


def _conv(c_in: int, c_out: int, *, kernel: int = 3) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, kernel, padding=kernel // 2)


class _Attention(nn.Module):
    """Scale every channel by what its mean over the picture says."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        hidden = max(1, channels // REDUCTION)
        self.conv_du = nn.Sequential(
            _conv(channels, hidden, kernel=1), nn.ReLU(), _conv(hidden, channels, kernel=1), nn.Sigmoid()
        )

    def forward(self, x: Tensor) -> Tensor:
        scale: Tensor = self.conv_du(x.mean(dim=(-2, -1), keepdim=True))
        return x * scale


class _Residual(nn.Module):
    """Layers beside the identity."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.body = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        residual: Tensor = self.body(x)
        return x + residual


def _block(channels: int) -> _Residual:
    return _Residual(_conv(channels, channels), nn.ReLU(), _conv(channels, channels), _Attention(channels))


def _group(channels: int, blocks: int) -> _Residual:
    return _Residual(*(_block(channels) for _ in range(blocks)), _conv(channels, channels))


def _enlarger(channels: int, factor: int) -> nn.Sequential:
    """Pixel shuffles of 2, or one of 3."""
    steps = [3] if factor == 3 else [2] * (factor.bit_length() - 1)
    layers: list[nn.Module] = []
    for step in steps:
        layers += [_conv(channels, step * step * channels), nn.PixelShuffle(step)]
    return nn.Sequential(*layers)


def _shift(sign: int) -> nn.Conv2d:
    """Add or take away the mean colour; a fixed convolution, as published."""
    layer = _conv(3, 3, kernel=1)
    with torch.no_grad():
        layer.weight.copy_(torch.eye(3)[:, :, None, None])
        if layer.bias is not None:
            layer.bias.copy_(sign * VALUE_RANGE * torch.tensor(MEAN_RGB))
    return layer.requires_grad_(False)


class Rcan(nn.Module):
    """A small picture to one ``factor`` times as large.

    Args:
        factor: 2, 3, 4 or 8.
        groups: residual groups.
        blocks: attention blocks in each.
        channels: width.

    Raises:
        ValueError: for another factor.
    """

    def __init__(self, factor: int, *, groups: int = GROUPS, blocks: int = BLOCKS, channels: int = CHANNELS) -> None:
        super().__init__()
        if factor not in FACTORS:
            raise ValueError(f"RCAN enlarges by {FACTORS}, not by {factor}")
        self.factor = factor
        self.sub_mean = _shift(-1)
        self.head = nn.Sequential(_conv(3, channels))
        self.body = nn.Sequential(*(_group(channels, blocks) for _ in range(groups)), _conv(channels, channels))
        self.tail = nn.Sequential(_enlarger(channels, factor), _conv(channels, 3))
        self.add_mean = _shift(1)

    def forward(self, image_BCHW: Tensor) -> Tensor:
        """(B, 3, H, W) in [0, 1] to (B, 3, factor H, factor W), not clipped."""
        shallow = self.head(self.sub_mean(image_BCHW * VALUE_RANGE))
        enlarged: Tensor = self.add_mean(self.tail(self.body(shallow) + shallow))
        return enlarged / VALUE_RANGE
