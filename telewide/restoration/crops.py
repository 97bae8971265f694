"""Crops that a restorer learns from: crops of sharp pictures, and the same shrunken as the restorer assumes.

Every batch is a function of (seed, step) alone. Letters: B batch, C channels, H W crop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from telewide.capture.images import resize_bicubic
from telewide.errors import InputError
from telewide.geometry.arrays import FloatImage
from telewide.restoration.kernels import KERNEL_SIDE, KernelRange, blur_with, draw_kernels


@dataclass(frozen=True)
class Crops:
    """One batch.

    Attributes:
        small_BCHW: (B, 3, H, W) shrunken crops in [0, 1].
        sharp_BCHW: (B, 3, factor H, factor W) in [0, 1].
        kernels_BHW: (B, KERNEL_SIDE, KERNEL_SIDE) blurs before shrinking; a point where there was none.
    """

    small_BCHW: Tensor
    sharp_BCHW: Tensor
    kernels_BHW: Tensor

    def to(self, device: torch.device) -> Crops:
        """Move the tensors."""
        return Crops(self.small_BCHW.to(device), self.sharp_BCHW.to(device), self.kernels_BHW.to(device))


@dataclass(frozen=True)
class CropSource:
    """Where crops come from.

    Attributes:
        pictures: sharp views, (H, W, 3) float32 sRGB in [0, 1].
        factor: of the shrinking.
        kernels: blurs before it; None for bicubic shrinking alone.
        small_px: side of the shrunken crops.
        count: crops a batch.
    """

    pictures: Sequence[FloatImage]
    factor: int
    kernels: KernelRange | None
    small_px: int = 48
    count: int = 16

    def __post_init__(self) -> None:
        """Refuse pictures without a whole crop.

        Raises:
            InputError: there is no picture, or one is too small.
        """
        side = self.small_px * self.factor
        if not self.pictures:
            raise InputError("a restorer needs sharp pictures to learn from, and there is none")
        for picture in self.pictures:
            if min(picture.shape[:2]) < side:
                raise InputError(f"a picture of {picture.shape[1]}x{picture.shape[0]} px holds no crop of {side} px")

    def batch(self, step: int, *, seed: int) -> Crops:
        """The crops of one step."""
        rng = np.random.default_rng(np.random.SeedSequence([seed, step]))
        sharp = [self._crop(rng) for _ in range(self.count)]
        if self.kernels is None:
            kernels = np.zeros((self.count, KERNEL_SIDE, KERNEL_SIDE), np.float32)
            kernels[:, KERNEL_SIDE // 2, KERNEL_SIDE // 2] = 1
            small = [shrink(crop, factor=self.factor) for crop in sharp]
        else:
            kernels = draw_kernels(self.kernels, count=self.count, rng=rng)
            small = [shrink(blur_with(c, k), factor=self.factor) for c, k in zip(sharp, kernels, strict=True)]
        return Crops(_stacked(small), _stacked(sharp), torch.from_numpy(kernels))

    def _crop(self, rng: np.random.Generator) -> FloatImage:
        picture = self.pictures[int(rng.integers(len(self.pictures)))]
        side = self.small_px * self.factor
        y, x = (int(rng.integers(length - side + 1)) for length in picture.shape[:2])
        crop = np.rot90(picture[y : y + side, x : x + side], int(rng.integers(4)))
        return np.ascontiguousarray(crop[:, ::-1] if rng.random() < 0.5 else crop)


def shrink(picture: FloatImage, *, factor: int) -> FloatImage:
    """Bicubic shrinking, antialiased: what RCAN assumes."""
    return resize_bicubic(picture, wh=(picture.shape[1] // factor, picture.shape[0] // factor))


def _stacked(pictures: Sequence[FloatImage]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(np.stack(pictures).transpose(0, 3, 1, 2)))
