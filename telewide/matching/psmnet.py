"""`psmnet-s`: the compact pyramid stereo network of the paper's experiments.

Structure: Chang and Chen, *Pyramid Stereo Matching Network*, 2018, narrowed to 0.7 M parameters: widths
16/16/32/64/64, blocks 2/8/2/2, spatial pooling over 16 and 8 cells, 16 feature channels, one hourglass.
Batch normalisation throughout: run in eval mode wherever a result must not depend on its batch.
Letters: B batch, C channels, D planes, H W grid at hand.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.conv3d import Conv3d
from telewide.matching.psmnet_blocks import HALVED_PLANES, Hourglass, conv2d, conv3d, stacked
from telewide.matching.volume import concatenate_views, expect_full_size
from telewide.matching.window import Window, planes_of, widened_window

FEATURE_CHANNELS = 16
VOLUME_CHANNELS = 16
POOL_CELLS = (16, 8)


class _Block(nn.Module):
    """Residual block without a last ReLU."""

    def __init__(self, c_in: int, c_out: int, *, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv1 = conv2d(c_in, c_out, stride=stride, dilation=dilation)
        self.conv2 = conv2d(c_out, c_out, dilation=dilation)
        is_same = stride == 1 and c_in == c_out
        self.shortcut = nn.Identity() if is_same else conv2d(c_in, c_out, kernel=1, stride=stride)

    def forward(self, x: Tensor) -> Tensor:
        shortcut: Tensor = self.shortcut(x)
        residual: Tensor = self.conv2(functional.relu(self.conv1(x)))
        return shortcut + residual


class PsmnetPyramid(nn.Module):
    """The trunk of Phi_F: a standardised view to detail and to what lies around it."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Sequential(
            conv2d(3, 16, stride=2), nn.ReLU(), conv2d(16, 16), nn.ReLU(), conv2d(16, 16), nn.ReLU()
        )
        self.layer1 = stacked(_Block, 16, 16, count=2)
        self.layer2 = stacked(_Block, 16, 32, count=8, stride=2)
        self.layer3 = stacked(_Block, 32, 64, count=2)
        self.layer4 = stacked(_Block, 64, 64, count=2, dilation=2)
        self.pools = nn.ModuleList(
            # The last cell of a side may be cut: it is a mean over what there is of it.
            nn.Sequential(nn.AvgPool2d(cells, ceil_mode=True), conv2d(64, 16, kernel=1), nn.ReLU())
            for cells in POOL_CELLS
        )

    def pyramid(self, image_BCHW: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) to (B, 16, H/2, W/2) and (B, 128, H/4, W/4)."""
        half = self.first(image_BCHW)
        quarter = self.layer2(self.layer1(half))
        deep = self.layer4(self.layer3(quarter))
        height, width = deep.shape[-2:]
        pooled = [
            # By the cells' own size, not to that of the picture, which may end within a cell.
            functional.interpolate(pool(deep), scale_factor=cells, mode="bilinear", align_corners=False)
            for cells, pool in zip(POOL_CELLS, self.pools, strict=True)
        ]
        pooled = [spread[..., :height, :width] for spread in pooled]
        return half, torch.cat((quarter, deep, *pooled), dim=1)


class PsmnetFeatures(PsmnetPyramid):
    """Phi_F: a standardised view to (features at 1/4,)."""

    def __init__(self) -> None:
        super().__init__()
        self.last = nn.Sequential(conv2d(128, 64), nn.ReLU(), nn.Conv2d(64, FEATURE_CHANNELS, 1, bias=False))

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor]:
        """(B, 3, H, W) to ((B, 16, H/4, W/4),)."""
        return (self.last(self.pyramid(image_BCHW)[1]),)


class PsmnetMatching(nn.Module):
    """Phi_M: features of both views to the disparity of ref."""

    def __init__(self) -> None:
        super().__init__()
        c = VOLUME_CHANNELS
        self.dres0 = nn.Sequential(conv3d(2 * FEATURE_CHANNELS, c), nn.ReLU(), conv3d(c, c), nn.ReLU())
        self.dres1 = nn.Sequential(conv3d(c, c), nn.ReLU(), conv3d(c, c))
        self.hourglass = Hourglass(c)
        self.classify = nn.Sequential(conv3d(c, c), nn.ReLU(), Conv3d(c, 1, bias=False))

    def forward(self, ref: tuple[Tensor], src: tuple[Tensor], window: Window) -> tuple[list[Tensor], Tensor]:
        """[Disparity (B, H, W), px] and the volume (B, D, H/4, W/4)."""
        whole = widened_window(window, planes=HALVED_PLANES)
        volume = concatenate_views(ref[0], src[0], window=whole).contiguous(memory_format=torch.channels_last_3d)
        cost = self.dres0(volume)
        cost = cost + self.dres1(cost)
        logits = self.classify(cost + self.hourglass(cost)[0]).float()[:, :, planes_of(window, within=whole)]
        return [expect_full_size(logits[:, 0], window=window)], logits[:, 0]


def initialise_psmnet(module: nn.Module) -> None:
    """He-normal over the fan-out, N(0, sqrt(2 / n)), as PSMNet does."""
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.Conv3d):
            fan_out = math.prod(layer.kernel_size) * layer.out_channels
            nn.init.normal_(layer.weight, std=math.sqrt(2.0 / fan_out))
