"""Textures and outlines that the solids of a world are painted with and cut out by, as tables for look-up.

A texture is square and repeats mirrored; each has a pyramid, so that a surface far away is read from a coarse level.
An outline is a signed distance map over [-1, 1]^2, positive inside. Letters: T textures, M outlines, L levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from telewide.simulate.raycast.outlines import draw_outline
from telewide.simulate.raycast.patterns import draw_texture

TEXTURE_PX = 256
LEVELS = 6
OUTLINE_PX = 128
_TEXELS = sum((TEXTURE_PX >> level) ** 2 for level in range(LEVELS))


@dataclass(frozen=True)
class Palette:
    """Colours a world is painted with.

    Attributes:
        textures: (T * texels of a pyramid, 3) float32 sRGB, all levels of a texture one after the other.
        outlines: (M * OUTLINE_PX^2, 1) float32 signed distances, units of a texel, positive inside.
        means: (T, 3) float32 mean colour of each texture.
    """

    textures: Tensor
    outlines: Tensor
    means: Tensor

    def to(self, device: torch.device) -> Palette:
        """Move the tables."""
        return Palette(*(table.to(device) for table in (self.textures, self.outlines, self.means)))

    @property
    def n_textures(self) -> int:
        """T."""
        return len(self.means)

    @property
    def n_outlines(self) -> int:
        """M."""
        return len(self.outlines) // OUTLINE_PX**2


def draw_palette(
    rng: np.random.Generator, *, n_textures: int, n_outlines: int, photos: Sequence[NDArray[np.float32]] = ()
) -> Palette:
    """Draw a palette.

    Args:
        rng: source of all draws.
        n_textures: T.
        n_outlines: M.
        photos: (H, W, 3) float32 sRGB pictures to cut some of the textures from; none for drawn ones alone.
    """
    textures = [draw_texture(rng, side_px=TEXTURE_PX, photos=photos) for _ in range(n_textures)]
    outlines = [draw_outline(rng, side_px=OUTLINE_PX) for _ in range(n_outlines)]
    table = np.concatenate([_pyramid(texture) for texture in textures])
    distances = np.stack(outlines).reshape(-1, 1)
    means = np.stack([texture.mean(axis=(0, 1)) for texture in textures])
    return Palette(*(torch.from_numpy(np.ascontiguousarray(array, np.float32)) for array in (table, distances, means)))


def look_up_texture(palette: Palette, texture: Tensor, uv: Tensor, *, texels_per_px: Tensor) -> Tensor:
    """Read textures, bilinear in the pyramid's level nearest to one texel a pixel.

    Args:
        palette: the tables.
        texture: (n,) int64 which one.
        uv: (n, 2) position, texels of the finest level.
        texels_per_px: (n,) how many texels of the finest level a pixel spans.

    Returns:
        (n, 3) float32.
    """
    level = texels_per_px.clamp(min=1e-3).log2().round().clamp(0, LEVELS - 1).long()
    side = torch.bitwise_right_shift(torch.full_like(level, TEXTURE_PX), level)
    # Levels of S^2, (S / 2)^2, (S / 4)^2, ... texels lie one after the other.
    start = torch.div((TEXTURE_PX**2 - side * side) * 4, 3, rounding_mode="floor")
    first = texture * _TEXELS + start
    position = (uv + 0.5) * torch.exp2(-level.float())[:, None] - 0.5
    return _bilinear(palette.textures, position, first, side)


def look_up_outline(palette: Palette, outline: Tensor, uv: Tensor) -> Tensor:
    """(n,) signed distance of (n,) outlines at (n, 2) positions in [-1, 1], bilinear."""
    position = (uv + 1) * (OUTLINE_PX / 2) - 0.5
    position = position.clamp(0, OUTLINE_PX - 1)
    side = torch.full((len(position),), OUTLINE_PX, device=uv.device)
    return _bilinear(palette.outlines, position, outline * OUTLINE_PX**2, side)[:, 0]


def _bilinear(table: Tensor, position: Tensor, first: Tensor, side: Tensor) -> Tensor:
    """Four neighbours of each position in its square of the table, weighted; beyond its sides mirrored."""
    low = position.floor()
    fraction = position - low
    x, y = (_mirrored(torch.stack((i, i + 1), dim=-1).long(), side[:, None]) for i in (low[:, 0], low[:, 1]))
    index = first[:, None, None] + y[:, :, None] * side[:, None, None] + x[:, None, :]
    weight_x = torch.stack((1 - fraction[:, 0], fraction[:, 0]), dim=-1)
    weight_y = torch.stack((1 - fraction[:, 1], fraction[:, 1]), dim=-1)
    weights = (weight_y[:, :, None] * weight_x[:, None, :]).flatten(1)
    return functional.embedding_bag(index.flatten(1), table, mode="sum", per_sample_weights=weights.to(table.dtype))


def _mirrored(index: Tensor, side: Tensor) -> Tensor:
    turned = torch.remainder(index, 2 * side)
    return torch.minimum(turned, 2 * side - 1 - turned)


def _pyramid(texture: NDArray[np.float32]) -> NDArray[np.float32]:
    levels = [texture]
    for _ in range(LEVELS - 1):
        half = levels[-1].shape[0] // 2
        levels.append(np.asarray(cv2.resize(levels[-1], (half, half), interpolation=cv2.INTER_AREA), np.float32))
    return np.concatenate([level.reshape(-1, 3) for level in levels])
