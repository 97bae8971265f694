"""Crops of ray-cast worlds, damaged anew each time they are seen: a training's alone, or its rehearsal's.

Crop k of step i is a function of (seed, i, k) alone. Casting a world takes longer than damaging it, so that each is
seen a few times: crop k has worlds of its own, a new one every ``STEPS_A_WORLD`` steps, and draws from the
last of them. A process thus casts the worlds of its crops, and no others. Worlds are drawn on the processor, which
takes milliseconds; they are cast, cut and damaged on the device they are for.
Letters: B batch, H W crop.
"""

from __future__ import annotations

import math
from collections import OrderedDict, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import Dataset

from telewide.geometry.arrays import FloatImage
from telewide.matching.window import VOLUME_STEP_PX, Window
from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.damage import Damage, damage_views, draw_damage
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.render import cast_pair
from telewide.training.objective import Batch
from telewide.training.stages import Stage

STEPS_A_WORLD = 6
"""Steps to the next new world of a crop, and how often each is seen."""
KEPT_WORLDS = 8
"""Worlds that a crop is drawn from, the new one among them."""
WORLDS_A_PALETTE = 250
KEPT_PALETTES = 2
PALETTE_SIZE = 96
"""Textures, and as many outlines."""
SIZE_OF_CROPS = 1.5
"""Sides of a world's views, in those of a crop."""
PLANES = (12, 16, 20, 24)
"""Widths of the windows, in planes of the volume."""
MARGIN_PX = 3
"""Of a window, in which no world's disparity is meant to lie."""
LARGEST_FACTOR = 8.5
CPU = torch.device("cpu")
EQUAL_SHARE = 0.1
"""Of the pairs: only colour differs."""
ENLARGED_SHARE = 0.5
"""Of the crops: cut smaller, damaged and enlarged, as small pictures are before they are matched."""
MOST_ENLARGED = 2.0
STEP_PX = 0.5
"""A truth that differs by more from its neighbours' mean is at the border of a surface."""


@dataclass(frozen=True)
class WorldCrop:
    """Piece of a world.

    Attributes:
        ref: (3, H, W) float32 sRGB.
        src: (3, H, W) float32 sRGB.
        truth_px: (H, W) float32 disparity, known everywhere, the hidden parts too.
        occluded: (H, W) bool, hidden from src.
    """

    ref: Tensor
    src: Tensor
    truth_px: Tensor
    occluded: Tensor


@dataclass
class Worlds:
    """Worlds that crops are cut from, by crop and step; keeps the last ones that were asked for.

    Attributes:
        seed: of everything.
        crop_hw: size of the crops.
        crops: how many a step has.
        room: how many worlds are kept.
        window_px: disparities to fill; None for ranges as phones, light fields and test scenes have them.
        photos: (H, W, 3) float32 sRGB, to paint with beside what is drawn.
        device: where worlds are cast, and their crops lie.
    """

    seed: tuple[int, ...]
    crop_hw: tuple[int, int]
    crops: int
    room: int
    window_px: Window | None = None
    photos: Sequence[FloatImage] = ()
    device: torch.device = CPU
    _kept: OrderedDict[int, WorldCrop] = field(default_factory=OrderedDict)
    _palettes: OrderedDict[int, Palette] = field(default_factory=OrderedDict)

    def crop(self, step: int, k: int, *, rng: np.random.Generator, window: Window, scale: float = 1.0) -> WorldCrop:
        """Cut crop k of a step, in colours of its own, with src moved so that the window holds its disparities.

        Args:
            step: of the stage.
            k: number of the crop in the step.
            rng: source of all draws but the world's own.
            window: disparities ``[d_min, d_max)``, px of whole crops.
            scale: size of this crop, in whole ones, at most 1.
        """
        hw = (round(scale * self.crop_hw[0]), round(scale * self.crop_hw[1]))
        scaled_window = (math.floor(scale * window[0]), math.ceil(scale * window[1]))
        # Not all crops take a new world in the same step.
        turn = (step + k * STEPS_A_WORLD // self.crops) // STEPS_A_WORLD + int(rng.integers(KEPT_WORLDS))
        return recoloured(_cut(self._cast_once(turn * self.crops + k), rng, hw, scaled_window), rng)

    def _cast_once(self, number: int) -> WorldCrop:
        if number not in self._kept:
            self._kept[number] = self.cast(number)
            while len(self._kept) > self.room:
                self._kept.popitem(last=False)
        self._kept.move_to_end(number)
        return self._kept[number]

    def cast(self, number: int) -> WorldCrop:
        """Cast a world anew; its views are bytes.

        Args:
            number: of the world; each crop of each turn has one.
        """
        rng = np.random.default_rng([*self.seed, 3, number])
        palette = self._palette_of(number)
        hw = (int(SIZE_OF_CROPS * self.crop_hw[0]), int(SIZE_OF_CROPS * self.crop_hw[1]))
        world = draw_world(rng, palette, hw=hw, disparities_px=self._draw_range(rng))
        pair = cast_pair(world, palette)
        ref, src = ((view * 255).round().byte().permute(2, 0, 1) for view in (pair.ref, pair.src))
        return WorldCrop(ref, src, pair.disparity_px, pair.occluded)

    def _draw_range(self, rng: np.random.Generator) -> tuple[float, float]:
        """Disparities of the background and of the nearest things, px."""
        if self.window_px is None:
            far_px = rng.uniform(-10, 30)
            return far_px, far_px + math.exp(rng.uniform(math.log(6), math.log(75)))
        low, high = self.window_px[0] + MARGIN_PX, self.window_px[1] - MARGIN_PX
        far_px = rng.uniform(low, low + 0.5 * (high - low))
        return far_px, rng.uniform(far_px + 0.5 * (high - far_px), high)

    def _palette_of(self, number: int) -> Palette:
        epoch = number // WORLDS_A_PALETTE
        if epoch not in self._palettes:
            seed = (*self.seed, 4, epoch)
            palette = _palette(seed, PALETTE_SIZE, self.photos) if self.photos else _drawn_palette(seed, PALETTE_SIZE)
            self._palettes[epoch] = palette.to(self.device)
            # Worlds of the next palette come between the last ones of this.
            while len(self._palettes) > KEPT_PALETTES:
                self._palettes.popitem(last=False)
        return self._palettes[epoch]


def _palette(seed: tuple[int, ...], size: int, photos: Sequence[FloatImage] = ()) -> Palette:
    return draw_palette(np.random.default_rng(seed), n_textures=size, n_outlines=size, photos=photos)


_drawn_palette = lru_cache(maxsize=2)(_palette)


def damaged_crops(
    crops: Sequence[WorldCrop],
    rngs: Sequence[np.random.Generator],
    *,
    factors: tuple[float, float],
    equal_share: float = EQUAL_SHARE,
) -> list[WorldCrop]:
    """Damage src as a wide lens would, and ref a little.

    Args:
        crops: as they were cut.
        rngs: source of all draws of each.
        factors: range of how many times fewer pixels src has along each axis.
        equal_share: of the pairs that differ in colour alone.
    """
    views, damages, generators = list[Tensor](), list[Damage](), list[torch.Generator]()
    for crop, rng in zip(crops, rngs, strict=True):
        generator = torch.Generator(crop.src.device).manual_seed(int(rng.integers(2**62)))
        views += [crop.src, crop.ref]
        damages += [draw_damage(rng, factors=factors, equal_share=equal_share), _mild_damage(rng)]
        generators += [generator, generator]
    for these in _together(views):
        damaged = damage_views(
            [views[k] for k in these], [damages[k] for k in these], generators=[generators[k] for k in these]
        )
        for k, view in zip(these, damaged, strict=True):
            views[k] = view
    return [
        WorldCrop(ref, src, crop.truth_px, crop.occluded)
        for crop, src, ref in zip(crops, views[::2], views[1::2], strict=True)
    ]


def _together(views: Sequence[Tensor]) -> list[list[int]]:
    """Views that are damaged in the same calls: on a GPU all of one size, on a processor each alone."""
    if views[0].device.type == "cpu":
        return [[k] for k in range(len(views))]
    by_size: dict[torch.Size, list[int]] = defaultdict(list)
    for k, view in enumerate(views):
        by_size[view.shape].append(k)
    return list(by_size.values())


@dataclass(frozen=True)
class WorldSource:
    """Where crops of worlds come from; travels to worker processes.

    Attributes:
        seed: of everything.
        crop_hw: size of the crops.
        window_px: the widest window that crops are searched in.
        device: where worlds are cast, and the crops lie.
    """

    seed: int
    crop_hw: tuple[int, int]
    window_px: Window = (0, PLANES[-1] * VOLUME_STEP_PX)
    device: torch.device = CPU


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
        self._worlds = worlds_for(
            (source.seed,),
            crop_hw=source.crop_hw,
            crops=stage.options.rehearsed,
            mine=len(self._mine),
            device=source.device,
        )

    def __len__(self) -> int:
        return self._stage.options.steps

    def __getitem__(self, step: int) -> Batch:
        seed = self._source.seed
        planes = int(np.random.default_rng([seed, 1, step]).choice(PLANES))
        window = (0, planes * VOLUME_STEP_PX)
        rngs = [np.random.default_rng([seed, 2, step, k]) for k in self._mine]
        scales = [_draw_scale(rng) for rng in rngs]
        crops = [
            self._worlds.crop(step, k, rng=rng, window=window, scale=scale)
            for k, rng, scale in zip(self._mine, rngs, scales, strict=True)
        ]
        crops = [
            crop if scale == 1 else enlarged_crop(crop, hw=self._source.crop_hw)
            for crop, scale in zip(damaged_crops(crops, rngs, factors=(1.0, LARGEST_FACTOR)), scales, strict=True)
        ]
        return Batch(
            ref_BCHW=torch.stack([crop.ref for crop in crops]),
            src_BCHW=torch.stack([crop.src for crop in crops]),
            truth_px_BHW=torch.stack([crop.truth_px for crop in crops]),
            n_rehearsed=len(crops),
            occluded_BHW=torch.stack([crop.occluded for crop in crops]),
            window=window,
        )


def _draw_scale(rng: np.random.Generator) -> float:
    """Size that a crop is cut with, in whole ones."""
    return 1 / rng.uniform(1, MOST_ENLARGED) if rng.random() < ENLARGED_SHARE else 1.0


def enlarged_crop(crop: WorldCrop, *, hw: tuple[int, int]) -> WorldCrop:
    """Enlarge a crop to a height and width, px: bicubic views, and a truth whose steps stay steps."""
    ref, src = (
        functional.interpolate(view[None], hw, mode="bicubic", align_corners=False)[0].clamp(0, 1)
        for view in (crop.ref, crop.src)
    )
    maps = torch.stack((crop.truth_px, crop.occluded.float()))[None]
    nearest_px, occluded = functional.interpolate(maps, hw, mode="nearest-exact")[0]
    smooth_px = functional.interpolate(maps[:, :1], hw, mode="bilinear", align_corners=False)[0, 0]
    is_surface = (smooth_px - nearest_px).abs() < STEP_PX
    scale = hw[1] / crop.truth_px.shape[1]
    return WorldCrop(ref, src, torch.where(is_surface, smooth_px, nearest_px) * scale, occluded > 0.5)


def worlds_for(
    seed: tuple[int, ...],
    *,
    crop_hw: tuple[int, int],
    crops: int,
    mine: int,
    window_px: Window | None = None,
    photos: Sequence[FloatImage] = (),
    device: torch.device = CPU,
) -> Worlds:
    """Worlds of a process that makes some crops of each step.

    Args:
        seed: of everything.
        crop_hw: size of the crops.
        crops: how many a step has.
        mine: how many of them this process makes.
        window_px: as of `Worlds`.
        photos: as of `Worlds`.
        device: as of `Worlds`.
    """
    room = 2 * KEPT_WORLDS * max(1, mine)
    return Worlds(seed=seed, crop_hw=crop_hw, crops=crops, room=room, window_px=window_px, photos=photos, device=device)


def _cut(whole: WorldCrop, rng: np.random.Generator, hw: tuple[int, int], window: Window) -> WorldCrop:
    height, width = hw
    y0, x0 = (int(rng.integers(side - part + 1)) for side, part in zip(whole.truth_px.shape, hw, strict=True))
    here = np.s_[..., y0 : y0 + height, x0 : x0 + width]
    truth_px, occluded = whole.truth_px[here], whole.occluded[here]
    shift = _shift(truth_px, window, rng, limits=(x0 - (whole.ref.shape[-1] - width), x0))
    ref, src = whole.ref[here], whole.src[..., y0 : y0 + height, x0 - shift : x0 - shift + width]
    truth_px = truth_px - shift
    x_src = torch.arange(width, device=truth_px.device) - truth_px
    occluded = occluded | (x_src < 0) | (x_src > width - 1)
    return WorldCrop(ref.float() / 255, src.float() / 255, truth_px, occluded)


def _shift(truth_px: Tensor, window: tuple[int, int], rng: np.random.Generator, *, limits: tuple[int, int]) -> int:
    """Shift of src by which the crop's disparities lie somewhere in the window."""
    shares = torch.tensor([0.01, 0.99], device=truth_px.device)
    low, high = torch.quantile(truth_px.flatten()[::7], shares).tolist()
    return int(np.clip(round(shift_into(window, (low, high), rng=rng)), *limits))


def shift_into(window: Window, range_px: tuple[float, float], *, rng: np.random.Generator) -> float:
    """Draw what to take off disparities of a range so that a window holds them somewhere, px.

    Args:
        window: disparities ``[d_min, d_max)``, px.
        range_px: the least and the greatest of them; of a range too wide for the window the least.
        rng: source of the draw.
    """
    low, high = range_px
    slack = max(0.0, window[1] - window[0] - (high - low) - 2 * MARGIN_PX)
    return low - window[0] - MARGIN_PX - rng.uniform(0, 1) * slack


def _mild_damage(rng: np.random.Generator) -> Damage:
    """Damage by the sharp camera itself: a little blur and noise."""
    sigma = rng.uniform(0, 0.8) * (rng.random() < 0.4)
    return Damage(blur_sigma_px=(sigma, sigma), noise_std=rng.uniform(0, 0.012) * (rng.random() < 0.6))


def recoloured(crop: WorldCrop, rng: np.random.Generator) -> WorldCrop:
    """Exchange channels, change exposure and turn upside down, alike in both views; grey now and then."""
    order = rng.permutation(3).tolist()
    gamma, gain = math.exp(rng.normal(0, 0.25)), math.exp(rng.normal(0, 0.2))
    ref, src = (
        (torch.stack([view[channel] for channel in order]) ** gamma * gain).clamp(0, 1) for view in (crop.ref, crop.src)
    )
    if rng.random() < 0.08:
        ref, src = (view.mean(dim=0, keepdim=True).expand(3, -1, -1) for view in (ref, src))
    parts = (ref, src, crop.truth_px, crop.occluded)
    return WorldCrop(*(part.flip(-2) for part in parts)) if rng.random() < 0.5 else WorldCrop(*parts)
