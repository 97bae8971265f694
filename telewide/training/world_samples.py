"""Crops of ray-cast worlds, damaged anew each time they are seen.

Sample k of step i is a function of (seed, i, k) alone. Casting a world takes longer than damaging it, so that each is
seen a few times: step i draws from the last ``KEPT_WORLDS`` worlds, of which ``worlds_a_step`` are new.
Letters: H W crop.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from telewide.matching.window import VOLUME_STEP_PX
from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.damage import Damage, damage_view, draw_damage
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.render import cast_pair

KEPT_WORLDS = 64
WORLDS_A_PALETTE = 250
PALETTE_SIZE = 96
"""Textures, and as many outlines."""
WORLD_HW = (288, 480)


@dataclass(frozen=True)
class WorldBatch:
    """Crops of worlds.

    Attributes:
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        truth_px_BHW: (B, H, W).
        occluded_BHW: (B, H, W) bool.
        window: disparities of the volume to search.
    """

    ref_BCHW: Tensor
    src_BCHW: Tensor
    truth_px_BHW: Tensor
    occluded_BHW: Tensor
    window: tuple[int, int]


@dataclass(frozen=True)
class _Cast:
    ref: Tensor
    src: Tensor
    disparity_px: Tensor
    occluded: Tensor


@dataclass
class WorldSamples:
    """The stream of crops; keeps the worlds it has cast lately.

    Attributes:
        seed: of everything.
        crop_hw: size of the crops.
        crops: B.
        worlds_a_step: how many worlds are new in each step.
    """

    seed: int
    crop_hw: tuple[int, int] = (192, 320)
    crops: int = 4
    worlds_a_step: int = 1
    _worlds: OrderedDict[int, _Cast] = field(default_factory=OrderedDict)
    _palette: tuple[int, Palette] | None = None

    def batch(self, step: int) -> WorldBatch:
        """Crops of a step."""
        rng = np.random.default_rng([self.seed, 1, step])
        planes = int(rng.choice([12, 16, 20, 24]))
        window = (0, planes * VOLUME_STEP_PX)
        newest = KEPT_WORLDS + step * self.worlds_a_step
        numbers = newest - rng.integers(0, KEPT_WORLDS, self.crops)
        if step:
            # What is new is seen at once, so that the work of casting is spread evenly.
            numbers[: self.worlds_a_step] = newest - np.arange(self.worlds_a_step)
        samples = [
            self._sample(int(number), np.random.default_rng([self.seed, 2, step, k]), window)
            for k, number in enumerate(numbers)
        ]
        ref, src, truth, occluded = (torch.stack(parts) for parts in zip(*samples, strict=True))
        return WorldBatch(ref, src, truth, occluded, window)

    def _sample(
        self, number: int, rng: np.random.Generator, window: tuple[int, int]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        cast = self._world(number)
        height, width = self.crop_hw
        y0 = int(rng.integers(cast.ref.shape[0] - height + 1))
        x0 = int(rng.integers(cast.ref.shape[1] - width + 1))
        here = np.s_[y0 : y0 + height, x0 : x0 + width]
        truth, occluded = cast.disparity_px[here], cast.occluded[here]
        shift = _shift(truth, window, rng, limits=(x0 - (cast.ref.shape[1] - width), x0))
        ref = cast.ref[here].permute(2, 0, 1).float() / 255
        src = cast.src[y0 : y0 + height, x0 - shift : x0 - shift + width].permute(2, 0, 1).float() / 255
        truth = truth - shift
        x_src = torch.arange(width) - truth
        occluded = occluded | (x_src < 0) | (x_src > width - 1)
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        src = damage_view(src, draw_damage(rng), generator=generator)
        ref = damage_view(ref, _mild_damage(rng), generator=generator)
        ref, src = _recoloured(ref, src, rng)
        parts = (ref, src, truth, occluded)
        if rng.random() < 0.5:
            return tuple(part.flip(-2) for part in parts)  # type: ignore[return-value]
        return parts

    def _world(self, number: int) -> _Cast:
        if number in self._worlds:
            return self._worlds[number]
        rng = np.random.default_rng([self.seed, 3, number])
        far_px = rng.uniform(-10, 30)
        span_px = math.exp(rng.uniform(math.log(6), math.log(75)))
        world = draw_world(rng, self._palette_of(number), hw=WORLD_HW, disparities_px=(far_px, far_px + span_px))
        pair = cast_pair(world, self._palette_of(number))
        ref, src = ((view * 255).round().byte() for view in (pair.ref, pair.src))
        self._worlds[number] = _Cast(ref, src, pair.disparity_px, pair.occluded)
        while len(self._worlds) > 2 * KEPT_WORLDS:
            self._worlds.popitem(last=False)
        return self._worlds[number]

    def _palette_of(self, number: int) -> Palette:
        epoch = number // WORLDS_A_PALETTE
        if self._palette is None or self._palette[0] != epoch:
            rng = np.random.default_rng([self.seed, 4, epoch])
            self._palette = (epoch, draw_palette(rng, n_textures=PALETTE_SIZE, n_outlines=PALETTE_SIZE))
        return self._palette[1]


def _shift(truth_px: Tensor, window: tuple[int, int], rng: np.random.Generator, *, limits: tuple[int, int]) -> int:
    """How far src is moved so that the crop's disparities lie somewhere in the window."""
    low, high = (float(v) for v in torch.quantile(truth_px.flatten()[::7], torch.tensor([0.01, 0.99])))
    slack = max(0.0, window[1] - window[0] - (high - low) - 6)
    wanted = low - window[0] - 3 - rng.uniform(0, 1) * slack
    return int(np.clip(round(wanted), *limits))


def _mild_damage(rng: np.random.Generator) -> Damage:
    """What the sharp camera does itself: a little blur and noise."""
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
