"""Blocks of the two pyramid stereo networks: convolutions with batch normalisation, and the hourglass.

Structure: Chang and Chen, *Pyramid Stereo Matching Network*, 2018; the layers have the names of the authors' code.
Letters: B batch, C channels, D planes, H W grid at hand.
"""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.batch_norm import BatchNorm2d, BatchNorm3d
from telewide.matching.conv3d import Conv3d

HALVED_PLANES = 4
"""An hourglass halves the volume twice."""


def conv2d(c_in: int, c_out: int, *, kernel: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """A padded convolution and its normalisation."""
    padding = dilation * (kernel // 2)
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, kernel, stride=stride, padding=padding, dilation=dilation, bias=False),
        BatchNorm2d(c_out),
    )


def conv3d(c_in: int, c_out: int, *, stride: int = 1) -> nn.Sequential:
    """A padded convolution of volumes and its normalisation."""
    return nn.Sequential(Conv3d(c_in, c_out, stride=stride, bias=False), BatchNorm3d(c_out))


def deconv3d(c_in: int, c_out: int) -> nn.Sequential:
    """A transposed convolution that doubles every side of a volume, and its normalisation."""
    layer = nn.ConvTranspose3d(c_in, c_out, 3, stride=2, padding=1, output_padding=1, bias=False)
    return nn.Sequential(layer, BatchNorm3d(c_out))


def stacked(
    block: Callable[..., nn.Module], c_in: int, c_out: int, *, count: int, stride: int = 1, dilation: int = 1
) -> nn.Sequential:
    """Put residual blocks behind one another; the first changes size and channels."""
    first = block(c_in, c_out, stride=stride, dilation=dilation)
    return nn.Sequential(first, *(block(c_out, c_out, dilation=dilation) for _ in range(count - 1)))


class Hourglass(nn.Module):
    """A volume halved twice and enlarged again, with what was there before added at each size."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        wide = 2 * channels
        self.conv1 = nn.Sequential(conv3d(channels, wide, stride=2), nn.ReLU())
        self.conv2 = conv3d(wide, wide)
        self.conv3 = nn.Sequential(conv3d(wide, wide, stride=2), nn.ReLU())
        self.conv4 = nn.Sequential(conv3d(wide, wide), nn.ReLU())
        self.conv5 = deconv3d(wide, wide)
        self.conv6 = deconv3d(wide, channels)

    def forward(
        self, x: Tensor, *, down: Tensor | None = None, up: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The volume, and its halves on the way down and up; those of earlier hourglasses are added to them."""
        half = self.conv2(self.conv1(x))
        half = functional.relu(half if up is None else half + up)
        quarter = self.conv4(self.conv3(half))
        added = half if down is None else down
        risen = functional.relu(_crop_like(self.conv5(quarter), added) + added)
        return _crop_like(self.conv6(risen), x), half, risen


def _crop_like(x: Tensor, like: Tensor) -> Tensor:
    """Drop what a doubled odd side has too much."""
    depth, height, width = like.shape[2:]
    return x[:, :, :depth, :height, :width]
