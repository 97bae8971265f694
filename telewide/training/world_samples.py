"""Crops of ray-cast worlds, damaged anew each time they are seen.

Crop k of step i is a function of (seed, i, k) alone. Casting a world takes longer than damaging it, so that each is
seen a few times: step i has one new world, and draws the rest from steps before it. These are multiples of ``STRIDE``
away, so that each of up to so many processes draws from worlds it has cast itself.
Letters: B batch, H W crop.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from telewide.matching.window import VOLUME_STEP_PX, Window
from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.damage import Damage, damage_view, draw_damage
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.render import cast_pair
from telewide.training.objective import Batch
from telewide.training.stages import Stage

STRIDE = 8
KEPT_WORLDS = 8
"""Worlds that a crop is drawn from, the new one among them."""
WORLDS_A_PALETTE = 250
PALETTE_SIZE = 96
"""Textures, and as many outlines."""
WORLD_HW = (288, 480)
PLANES = (12, 16, 20, 24)
"""Widths of the windows, in planes of the volume."""
FIRST_WORLD = STRIDE * KEPT_WORLDS
"""Number of the world that is new in step 0."""


@dataclass(frozen=True)
class WorldSource:
    """Where crops of worlds come from; travels to worker processes.

    Attributes:
        seed: of everything.
        crop_hw: size of the crops.
        window_px: the widest window that crops are searched in.
    """

    seed: int
    crop_hw: tuple[int, int]
    window_px: Window = (0, PLANES[-1] * VOLUME_STEP_PX)


class WorldBatches(Dataset[Batch]):
    """Batch i of a stage, as a function of (seed, i) alone.

    Args:
        source: sizes and seed.
        stage: how many crops, how many steps.
        rank: this process; it makes every ``world``-th crop of the joint batch.
        world: number of processes.
    """

    def __init__(self, source: WorldSource, stage: Stage, *, rank: int = 0, world: int = 1) -> None:
        self._source, self._stage = source, stage
        self._mine = range(rank, stage.options.rehearsed, world)
        self._worlds = _CastWorlds(source.seed)

    def __len__(self) -> int:
        return self._stage.options.steps

    def __getitem__(self, step: int) -> Batch:
        seed = self._source.seed
        planes = int(np.random.default_rng([seed, 1, step]).choice(PLANES))
        window = (0, planes * VOLUME_STEP_PX)
        crops = [self._crop(np.random.default_rng([seed, 2, step, k]), step, k, window) for k in self._mine]
        ref, src, truth_px, occluded = (torch.stack(parts) for parts in zip(*crops, strict=True))
        return Batch(
            ref_BCHW=ref,
            src_BCHW=src,
            truth_px_BHW=truth_px,
            n_rehearsed=len(crops),
            occluded_BHW=occluded,
            window=window,
        )

    def _crop(self, rng: np.random.Generator, step: int, k: int, window: Window) -> tuple[Tensor, ...]:
        ago = int(rng.integers(KEPT_WORLDS)) if k else 0
        return _crop(self._worlds.cast(FIRST_WORLD + step - STRIDE * ago), rng, self._source.crop_hw, window)


@dataclass(frozen=True)
class _Cast:
    ref: Tensor
    src: Tensor
    disparity_px: Tensor
    occluded: Tensor


@dataclass
class _CastWorlds:
    """Worlds by number; keeps the last ones."""

    seed: int
    _kept: OrderedDict[int, _Cast] = field(default_factory=OrderedDict)
    _palette: tuple[int, Palette] | None = None

    def cast(self, number: int) -> _Cast:
        if number not in self._kept:
            self._kept[number] = self._cast(number)
            while len(self._kept) > 2 * STRIDE * KEPT_WORLDS:
                self._kept.popitem(last=False)
        return self._kept[number]

    def _cast(self, number: int) -> _Cast:
        rng = np.random.default_rng([self.seed, 3, number])
        palette = self._palette_of(number)
        far_px = rng.uniform(-10, 30)
        span_px = math.exp(rng.uniform(math.log(6), math.log(75)))
        world = draw_world(rng, palette, hw=WORLD_HW, disparities_px=(far_px, far_px + span_px))
        pair = cast_pair(world, palette)
        ref, src = ((view * 255).round().byte() for view in (pair.ref, pair.src))
        return _Cast(ref, src, pair.disparity_px, pair.occluded)

    def _palette_of(self, number: int) -> Palette:
        epoch = number // WORLDS_A_PALETTE
        if self._palette is None or self._palette[0] != epoch:
            rng = np.random.default_rng([self.seed, 4, epoch])
            self._palette = (epoch, draw_palette(rng, n_textures=PALETTE_SIZE, n_outlines=PALETTE_SIZE))
        return self._palette[1]


def _crop(cast: _Cast, rng: np.random.Generator, hw: tuple[int, int], window: Window) -> tuple[Tensor, ...]:
    """Ref, src, truth and what is hidden, of a piece of a world; src is moved so that the window holds it."""
    height, width = hw
    y0, x0 = (int(rng.integers(whole - part + 1)) for whole, part in zip(cast.disparity_px.shape, hw, strict=True))
    here = np.s_[y0 : y0 + height, x0 : x0 + width]
    truth_px, occluded = cast.disparity_px[here], cast.occluded[here]
    shift = _shift(truth_px, window, rng, limits=(x0 - (cast.ref.shape[1] - width), x0))
    ref, src = cast.ref[here], cast.src[y0 : y0 + height, x0 - shift : x0 - shift + width]
    ref, src = (view.permute(2, 0, 1).float() / 255 for view in (ref, src))
    truth_px = truth_px - shift
    x_src = torch.arange(width) - truth_px
    occluded = occluded | (x_src < 0) | (x_src > width - 1)
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    src = damage_view(src, draw_damage(rng), generator=generator)
    ref = damage_view(ref, _mild_damage(rng), generator=generator)
    parts = (*_recoloured(ref, src, rng), truth_px, occluded)
    return tuple(part.flip(-2) for part in parts) if rng.random() < 0.5 else parts


def _shift(truth_px: Tensor, window: tuple[int, int], rng: np.random.Generator, *, limits: tuple[int, int]) -> int:
    """Shift of src by which the crop's disparities lie somewhere in the window."""
    low, high = (float(v) for v in torch.quantile(truth_px.flatten()[::7], torch.tensor([0.01, 0.99])))
    slack = max(0.0, window[1] - window[0] - (high - low) - 6)
    wanted = low - window[0] - 3 - rng.uniform(0, 1) * slack
    return int(np.clip(round(wanted), *limits))


def _mild_damage(rng: np.random.Generator) -> Damage:
    """Damage by the sharp camera itself: a little blur and noise."""
    sigma = rng.uniform(0, 0.8) * (rng.random() < 0.4)
    return Damage(blur_sigma_px=(sigma, sigma), noise_std=rng.uniform(0, 0.012) * (rng.random() < 0.6))


def _recoloured(ref: Tensor, src: Tensor, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Exchange channels and change exposure alike in both views; grey now and then."""
    order = torch.from_numpy(rng.permutation(3))
    gamma, gain = math.exp(rng.normal(0, 0.25)), math.exp(rng.normal(0, 0.2))
    ref, src = ((view[order] ** gamma * gain).clamp(0, 1) for view in (ref, src))
    if rng.random() < 0.08:
        ref, src = (view.mean(dim=0, keepdim=True).expand(3, -1, -1) for view in (ref, src))
    return ref, src
