"""Cast pairs: truth warps one view onto the other, hidden means hidden, and a seed means one world."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.casting import first_hit
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.render import CastPair, cast_pair
from telewide.simulate.raycast.world import World

HW = (120, 208)
WINDOW_PX = (4.0, 36.0)


@pytest.fixture(scope="module")
def palette() -> Palette:
    return draw_palette(np.random.default_rng(0), n_textures=24, n_outlines=24)


def cast(seed: int, palette: Palette, *, is_matt: bool = True) -> tuple[World, CastPair]:
    """A random world; matt, so that nothing in it moves against its surface."""
    world = draw_world(np.random.default_rng(seed), palette, hw=HW, disparities_px=WINDOW_PX)
    if is_matt:
        matt = tuple(replace(solid, material=replace(solid.material, gloss=0.0)) for solid in world.solids)
        world = replace(world, solids=matt)
    return world, cast_pair(world, palette)


def warp_error(pair: CastPair) -> float:
    """Mean difference of ref and the warped src, where src sees the pixel and no outline is near."""
    disparity = pair.disparity_px.numpy()
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    warped = cv2.remap(pair.src.numpy(), x - disparity, y, cv2.INTER_CUBIC)
    steps = np.abs(np.diff(disparity, axis=1, prepend=disparity[:, :1])) + np.abs(
        np.diff(disparity, axis=0, prepend=disparity[:1])
    )
    near_outline = cv2.dilate(((steps > 0.7) | pair.occluded.numpy()).astype(np.uint8), np.ones((7, 7))) > 0
    seen = ~near_outline & (x - disparity > 2) & (x - disparity < HW[1] - 3)
    return float(np.abs(warped - pair.ref.numpy())[seen].mean()) if seen.sum() > 200 else 0.0


def test_truth_warps_src_onto_ref(palette: Palette) -> None:
    errors = [warp_error(cast(seed, palette)[1]) for seed in range(12)]
    assert np.median(errors) < 0.012
    assert max(errors) < 0.05


@pytest.mark.slow
def test_truth_warps_src_onto_ref_in_a_hundred_worlds(palette: Palette) -> None:
    errors = [warp_error(cast(seed, palette)[1]) for seed in range(100, 200)]
    assert np.median(errors) < 0.012
    assert max(errors) < 0.08


def test_a_wrong_truth_does_not(palette: Palette) -> None:
    pair = cast(3, palette)[1]
    assert warp_error(replace(pair, disparity_px=pair.disparity_px + 2)) > 2 * warp_error(pair)


@pytest.mark.parametrize("seed", range(5))
def test_hidden_is_what_a_ray_from_src_does_not_reach(seed: int, palette: Palette) -> None:
    world, pair = cast(seed, palette)
    rng = np.random.default_rng(seed)
    y, x = rng.integers(0, HW[0], 4000), rng.integers(0, HW[1], 4000)
    disparity = pair.disparity_px.numpy()[y, x].astype(np.float64)
    x_src = torch.from_numpy(x - disparity)
    depths = [
        first_hit(solid, x_src, torch.from_numpy(y).double(), camera=world.src, palette=palette)
        for solid in world.solids
    ]
    depth = torch.stack(depths).amin(dim=0).numpy()
    seen_px = world.focal_px * world.baseline_m / depth + world.offset_px
    hidden = (seen_px > disparity + 0.5) | (x_src.numpy() < 0) | (x_src.numpy() > HW[1] - 1)
    assert (hidden == pair.occluded.numpy()[y, x]).mean() > 0.98


def test_a_seed_is_a_world(palette: Palette) -> None:
    first, second, other = (cast(seed, palette, is_matt=False)[1] for seed in (5, 5, 6))
    assert torch.equal(first.ref, second.ref)
    assert torch.equal(first.disparity_px, second.disparity_px)
    assert not torch.equal(first.ref, other.ref)


def test_disparities_fill_the_range_asked_for(palette: Palette) -> None:
    values = torch.cat([cast(seed, palette)[1].disparity_px.flatten() for seed in range(30)])
    inside = ((values > WINDOW_PX[0] - 4) & (values < WINDOW_PX[1] + 4)).float().mean()
    assert inside > 0.8
    assert float(torch.quantile(values, 0.9)) > 20


def shares_apart(one: CastPair, other: CastPair) -> list[float]:
    """Shares of the pixels whose colours, disparity or hiding differ by more than rounding."""
    apart = [
        *((getattr(one, name) - getattr(other, name)).abs().amax(dim=-1) > 1e-3 for name in ("ref", "src")),
        (one.disparity_px - other.disparity_px).abs() > 1e-3,
        one.occluded != other.occluded,
    ]
    return [float(each.float().mean()) for each in apart]


@pytest.mark.parametrize("rays_at_once", [HW[0] * HW[1], 5 * HW[0] * HW[1], 1 << 30])
def test_solids_tested_together_are_seen_as_those_tested_one_by_one(palette: Palette, rays_at_once: int) -> None:
    for seed in range(5):
        world, alone = cast(seed, palette, is_matt=False)
        assert max(shares_apart(cast_pair(world, palette, rays_at_once=rays_at_once), alone)) < 1e-3


def test_a_gpu_casts_what_the_processor_casts(palette: Palette, gpu: str) -> None:
    there = palette.to(torch.device(gpu))
    for seed in range(5):
        world, here = cast(seed, palette, is_matt=False)
        pair = cast_pair(world, there)
        assert pair.ref.device.type == gpu
        moved = CastPair(pair.ref.cpu(), pair.src.cpu(), pair.disparity_px.cpu(), pair.occluded.cpu())
        assert max(shares_apart(moved, here)) < 0.01
