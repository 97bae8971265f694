"""`psmnet`: the pyramid stereo matching network in the layout and with the parameter names of its authors' code.

Structure: Chang and Chen, *Pyramid Stereo Matching Network*, 2018: widths 32/32/64/128/128, blocks 3/16/3/3, spatial
pooling over 64, 32, 16 and 8 cells, 32 feature channels, three stacked hourglasses; 5.2 M parameters. The names below
``features`` and ``matching`` are the authors', so that their checkpoints load (:func:`load_published_psmnet`).
Letters: B batch, C channels, D planes, H W grid at hand.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.conv3d import Conv3d
from telewide.matching.foreign_weights import load_tensors, read_tensors
from telewide.matching.psmnet_blocks import HALVED_PLANES, Hourglass, conv2d, conv3d, stacked
from telewide.matching.sampling import at_least_float32
from telewide.matching.volume import concatenate_views, expect_full_size, shifted_views
from telewide.matching.window import VOLUME_STEP_PX, Window, planes_of, widened_window

FEATURE_CHANNELS = 32
VOLUME_CHANNELS = 32
POOL_CELLS = (64, 32, 16, 8)
PUBLISHED_WINDOW: Window = (0, 192)
"""Disparities that the authors' checkpoints were trained for, px."""
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
FEATURES_PREFIX = "feature_extraction."
"""Of the authors' names of Phi_F; all other names are of Phi_M."""


class _Block(nn.Module):
    """Residual block without a last ReLU."""

    def __init__(self, c_in: int, c_out: int, *, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(conv2d(c_in, c_out, stride=stride, dilation=dilation), nn.ReLU())
        self.conv2 = conv2d(c_out, c_out, dilation=dilation)
        is_same = stride == 1 and c_in == c_out
        self.downsample = None if is_same else conv2d(c_in, c_out, kernel=1, stride=stride)

    def forward(self, x: Tensor) -> Tensor:
        residual: Tensor = self.conv2(self.conv1(x))
        return residual + (x if self.downsample is None else self.downsample(x))


class _Pool(nn.Module):
    """Means over cells; a view smaller than a cell is one cell.

    Args:
        cells: side of a cell.
        is_published: without what is left at the right and bottom, as the authors do; else that is a cell too.
    """

    def __init__(self, cells: int, *, is_published: bool) -> None:
        super().__init__()
        self.cells, self.is_published = cells, is_published

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        size = (min(self.cells, height), min(self.cells, width))
        return functional.avg_pool2d(x, size, ceil_mode=not self.is_published)


class PsmnetFullFeatures(nn.Module):
    """Phi_F: a view to (features at 1/4,).

    Args:
        is_published: prepare and enlarge as the authors' checkpoints were trained with.
    """

    def __init__(self, *, is_published: bool = False) -> None:
        super().__init__()
        self.is_published = is_published
        self.firstconv = nn.Sequential(
            conv2d(3, 32, stride=2), nn.ReLU(), conv2d(32, 32), nn.ReLU(), conv2d(32, 32), nn.ReLU()
        )
        self.layer1 = stacked(_Block, 32, 32, count=3)
        self.layer2 = stacked(_Block, 32, 64, count=16, stride=2)
        self.layer3 = stacked(_Block, 64, 128, count=3)
        self.layer4 = stacked(_Block, 128, 128, count=3, dilation=2)
        for number, cells in enumerate(POOL_CELLS, start=1):
            pool = _Pool(cells, is_published=is_published)
            branch = nn.Sequential(pool, conv2d(128, 32, kernel=1), nn.ReLU())
            self.add_module(f"branch{number}", branch)
        self.lastconv = nn.Sequential(conv2d(320, 128), nn.ReLU(), nn.Conv2d(128, FEATURE_CHANNELS, 1, bias=False))

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor]:
        """(B, 3, H, W) to ((B, 32, H/4, W/4),)."""
        quarter = self.layer2(self.layer1(self.firstconv(image_BCHW)))
        deep = self.layer4(self.layer3(quarter))
        pooled = [self._pooled(deep, number) for number in range(len(POOL_CELLS), 0, -1)]
        return (self.lastconv(torch.cat((quarter, deep, *pooled), dim=1)),)

    def _pooled(self, deep: Tensor, number: int) -> Tensor:
        cells: Tensor = self.get_submodule(f"branch{number}")(deep)
        if self.is_published:
            return _stretch(cells, deep.shape[-2:])
        # By the cells' own size, not to that of the view, which may end within a cell.
        size = tuple(POOL_CELLS[number - 1] * side for side in cells.shape[-2:])
        enlarged = functional.interpolate(cells, size=size, mode="bilinear", align_corners=False)
        return enlarged[..., : deep.shape[-2], : deep.shape[-1]]


class PublishedPsmnetFeatures(PsmnetFullFeatures):
    """Phi_F for the authors' checkpoints."""

    def __init__(self) -> None:
        super().__init__(is_published=True)

    def prepare(self, image_BCHW: Tensor) -> Tensor:
        """Shift and scale by the mean and deviation of ImageNet."""
        mean, deviation = (image_BCHW.new_tensor(t)[:, None, None] for t in (IMAGENET_MEAN, IMAGENET_DEVIATION))
        return (image_BCHW - mean) / deviation


def _classifier(channels: int) -> nn.Sequential:
    return nn.Sequential(conv3d(channels, channels), nn.ReLU(), Conv3d(channels, 1, bias=False))


class PsmnetFullMatching(nn.Module):
    """Phi_M: features of both views to the disparities of ref.

    Args:
        is_published: enlarge the volume as the authors' checkpoints were trained with.
    """

    def __init__(self, *, is_published: bool = False) -> None:
        super().__init__()
        self.is_published = is_published
        c = VOLUME_CHANNELS
        self.dres0 = nn.Sequential(conv3d(2 * FEATURE_CHANNELS, c), nn.ReLU(), conv3d(c, c), nn.ReLU())
        self.dres1 = nn.Sequential(conv3d(c, c), nn.ReLU(), conv3d(c, c))
        self.dres2, self.dres3, self.dres4 = (Hourglass(c) for _ in range(3))
        self.classif1, self.classif2, self.classif3 = (_classifier(c) for _ in range(3))

    def forward(self, ref: tuple[Tensor], src: tuple[Tensor], window: Window) -> tuple[list[Tensor], Tensor]:
        """Disparities (B, H, W), px, one a hourglass in training, else the last; and the volume (B, D, H/4, W/4)."""
        whole = widened_window(window, planes=HALVED_PLANES)
        volume = _visible_volume(ref[0], src[0], whole).contiguous(memory_format=torch.channels_last_3d)
        start = self.dres0(volume)
        start = start + self.dres1(start)
        first, down, up = self.dres2(start)
        second, _, second_up = self.dres3(first + start, down=down, up=up)
        third, _, _ = self.dres4(second + start, down=down, up=second_up)
        costs = [self.classif1(first + start)]
        costs.append(self.classif2(second + start) + costs[-1])
        costs.append(self.classif3(third + start) + costs[-1])
        logits = [at_least_float32(cost)[:, :, planes_of(window, within=whole)] for cost in costs]
        read = logits if self.training else logits[-1:]
        return [self._disparity(x, window) for x in read], logits[-1][:, 0]

    def _disparity(self, logits_B1DHW: Tensor, window: Window) -> Tensor:
        if self.is_published:
            return _expect_as_published(logits_B1DHW, window)
        return expect_full_size(logits_B1DHW[:, 0], window=window)


def _visible_volume(ref_BCHW: Tensor, src_BCHW: Tensor, window: Window) -> Tensor:
    """Both views' features at every plane, ref's too only where src is seen, as published."""
    seen = torch.stack(shifted_views(torch.ones_like(src_BCHW[:, :1]), window), dim=2)
    return concatenate_views(ref_BCHW, src_BCHW, window=window) * seen


def _expect_as_published(logits_B1DHW: Tensor, window: Window) -> Tensor:
    """`expect_full_size` of the time of the authors' checkpoints.

    Torch then aligned corners, and called level j of D j px: plane k stands for ``step k (D - 1) / (D - step)``.
    """
    full = _stretch(logits_B1DHW, tuple(n * VOLUME_STEP_PX for n in logits_B1DHW.shape[2:]))
    levels_px = torch.arange(full.shape[2], dtype=full.dtype, device=full.device)
    end_px = PUBLISHED_WINDOW[1]
    stretch = (end_px - 1) / (end_px - VOLUME_STEP_PX)
    within = levels_px / max(1, full.shape[2] - 1) * (full.shape[2] - VOLUME_STEP_PX)
    return (full[:, 0].softmax(dim=1) * ((window[0] + within) * stretch)[:, None, None]).sum(dim=1)


def _stretch(x: Tensor, size: tuple[int, ...]) -> Tensor:
    """Linear along every axis behind the channels, first and last samples on one another."""
    for axis, length in enumerate(size, start=2):
        position = torch.linspace(0, x.shape[axis] - 1, length, device=x.device, dtype=torch.float64)
        first = position.floor().long().clamp(max=max(0, x.shape[axis] - 2))
        share = (position - first).to(x.dtype).view(-1, *(1,) * (x.ndim - axis - 1))
        near, far = (x.index_select(axis, index.clamp(max=x.shape[axis] - 1)) for index in (first, first + 1))
        x = torch.lerp(near, far, share.expand_as(near))
    return x


def load_published_psmnet(features: nn.Module, matching: nn.Module, path: Path) -> None:
    """Fill both parts from a checkpoint of the authors' code.

    Args:
        features: Phi_F of this module.
        matching: Phi_M of this module.
        path: a ``.tar`` of their training, or the same tensors as safetensors; nothing in it is executed.

    Raises:
        InputError: the file is corrupt, or its names or shapes are not those of PSMNet.
    """
    tensors = read_tensors(path)
    own = {key.removeprefix(FEATURES_PREFIX): value for key, value in tensors.items() if _is_of_features(key)}
    rest = {key: value for key, value in tensors.items() if not _is_of_features(key)}
    load_tensors(features, own, path=path, what="the features of PSMNet", prefix=FEATURES_PREFIX)
    load_tensors(matching, rest, path=path, what="the matching of PSMNet")


def _is_of_features(key: str) -> bool:
    return key.startswith(FEATURES_PREFIX)
