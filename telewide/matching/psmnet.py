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

from telewide.matching.batch_norm import BatchNorm2d, BatchNorm3d
from telewide.matching.conv3d import Conv3d
from telewide.matching.volume import concatenate_views
from telewide.matching.window import VOLUME_STEP_PX, Window, planes_of, widened_window

FEATURE_CHANNELS = 16
VOLUME_CHANNELS = 16
POOL_CELLS = (16, 8)
HALVED_PLANES = 4
"""The hourglass halves the volume twice."""


def _conv2d(c_in: int, c_out: int, *, kernel: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    padding = dilation * (kernel // 2)
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, kernel, stride=stride, padding=padding, dilation=dilation, bias=False),
        BatchNorm2d(c_out),
    )


def _conv3d(c_in: int, c_out: int, *, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(Conv3d(c_in, c_out, stride=stride, bias=False), BatchNorm3d(c_out))


def _deconv3d(c_in: int, c_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.ConvTranspose3d(c_in, c_out, 3, stride=2, padding=1, output_padding=1, bias=False), BatchNorm3d(c_out)
    )


class _Block(nn.Module):
    """Residual block without a last ReLU."""

    def __init__(self, c_in: int, c_out: int, *, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv1 = _conv2d(c_in, c_out, stride=stride, dilation=dilation)
        self.conv2 = _conv2d(c_out, c_out, dilation=dilation)
        is_same = stride == 1 and c_in == c_out
        self.shortcut = nn.Identity() if is_same else _conv2d(c_in, c_out, kernel=1, stride=stride)

    def forward(self, x: Tensor) -> Tensor:
        shortcut: Tensor = self.shortcut(x)
        residual: Tensor = self.conv2(functional.relu(self.conv1(x)))
        return shortcut + residual


def _blocks(c_in: int, c_out: int, count: int, *, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    first = _Block(c_in, c_out, stride=stride, dilation=dilation)
    return nn.Sequential(first, *(_Block(c_out, c_out, dilation=dilation) for _ in range(count - 1)))


class PsmnetPyramid(nn.Module):
    """The trunk of Phi_F: a standardised view to detail and to what lies around it."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Sequential(
            _conv2d(3, 16, stride=2), nn.ReLU(), _conv2d(16, 16), nn.ReLU(), _conv2d(16, 16), nn.ReLU()
        )
        self.layer1 = _blocks(16, 16, 2)
        self.layer2 = _blocks(16, 32, 8, stride=2)
        self.layer3 = _blocks(32, 64, 2)
        self.layer4 = _blocks(64, 64, 2, dilation=2)
        self.pools = nn.ModuleList(
            # The last cell of a side may be cut: it is a mean over what there is of it.
            nn.Sequential(nn.AvgPool2d(cells, ceil_mode=True), _conv2d(64, 16, kernel=1), nn.ReLU())
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
        self.last = nn.Sequential(_conv2d(128, 64), nn.ReLU(), nn.Conv2d(64, FEATURE_CHANNELS, 1, bias=False))

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor]:
        """(B, 3, H, W) to ((B, 16, H/4, W/4),)."""
        return (self.last(self.pyramid(image_BCHW)[1]),)


class _Hourglass(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        wide = 2 * channels
        self.conv1 = nn.Sequential(_conv3d(channels, wide, stride=2), nn.ReLU())
        self.conv2 = _conv3d(wide, wide)
        self.conv3 = nn.Sequential(_conv3d(wide, wide, stride=2), nn.ReLU())
        self.conv4 = nn.Sequential(_conv3d(wide, wide), nn.ReLU())
        self.conv5 = _deconv3d(wide, wide)
        self.conv6 = _deconv3d(wide, channels)

    def forward(self, x: Tensor) -> Tensor:
        half = functional.relu(self.conv2(self.conv1(x)))
        quarter = self.conv4(self.conv3(half))
        half = functional.relu(_crop_like(self.conv5(quarter), half) + half)
        return _crop_like(self.conv6(half), x)


def _crop_like(x: Tensor, like: Tensor) -> Tensor:
    """Drop what a doubled odd side has too much."""
    depth, height, width = like.shape[2:]
    return x[:, :, :depth, :height, :width]


class PsmnetMatching(nn.Module):
    """Phi_M: features of both views to the disparity of ref."""

    def __init__(self) -> None:
        super().__init__()
        c = VOLUME_CHANNELS
        self.dres0 = nn.Sequential(_conv3d(2 * FEATURE_CHANNELS, c), nn.ReLU(), _conv3d(c, c), nn.ReLU())
        self.dres1 = nn.Sequential(_conv3d(c, c), nn.ReLU(), _conv3d(c, c))
        self.hourglass = _Hourglass(c)
        self.classify = nn.Sequential(_conv3d(c, c), nn.ReLU(), Conv3d(c, 1, bias=False))

    def forward(self, ref: tuple[Tensor], src: tuple[Tensor], window: Window) -> tuple[list[Tensor], Tensor]:
        """[Disparity (B, H, W), px] and the volume (B, D, H/4, W/4)."""
        whole = widened_window(window, planes=HALVED_PLANES)
        volume = concatenate_views(ref[0], src[0], window=whole).contiguous(memory_format=torch.channels_last_3d)
        cost = self.dres0(volume)
        cost = cost + self.dres1(cost)
        logits = self.classify(cost + self.hourglass(cost)).float()[:, :, planes_of(window, within=whole)]
        return [_expect_full_size(logits, window)], logits[:, 0]


def _expect_full_size(logits_B1DHW: Tensor, window: Window) -> Tensor:
    """Trilinear to one level a pixel, softmax, expectation (PSMNet, section 3.5).

    Enlarged levels lie at half-pixel centres, so level j stands for ``d_min + j - (step - 1) / 2``.
    """
    full = functional.interpolate(logits_B1DHW, scale_factor=VOLUME_STEP_PX, mode="trilinear", align_corners=False)
    levels = torch.arange(full.shape[2], dtype=torch.float32, device=full.device)
    levels_px = window[0] + levels - (VOLUME_STEP_PX - 1) / 2
    # No einsum: autocast computes it in bf16, which knows 100 px to half a pixel.
    return (full[:, 0].softmax(dim=1) * levels_px[:, None, None]).sum(dim=1)


def initialise_psmnet(module: nn.Module) -> None:
    """He-normal over the fan-out, N(0, sqrt(2 / n)), as PSMNet does."""
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.Conv3d):
            fan_out = math.prod(layer.kernel_size) * layer.out_channels
            nn.init.normal_(layer.weight, std=math.sqrt(2.0 / fan_out))
