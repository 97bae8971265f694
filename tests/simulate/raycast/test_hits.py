"""Rays against solids: the oracle marches along each ray in double precision and halves the step where it enters."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.casting import first_hit
from telewide.simulate.raycast.hits import Kind
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.render import cast_pair
from telewide.simulate.raycast.world import Camera, Solid, World

RAYS = 160
FARTHEST = 3.0


@pytest.fixture(scope="module")
def palette() -> Palette:
    return draw_palette(np.random.default_rng(0), n_textures=4, n_outlines=4)


def random_solid(kind: Kind, world: World, *, seed: int) -> Solid:
    """A solid in front of the cameras; a plane faces them, a room holds them."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turn = np.linalg.qr(np.stack([axis, rng.normal(size=3), rng.normal(size=3)], axis=1))[0]
    centre, half_size = np.array([*rng.uniform(-0.1, 0.1, 2), 0.7]), rng.uniform(0.05, 0.2, 3)
    waves = None
    if kind in (Kind.PLANE, Kind.SHEET):
        tilt = rng.uniform(-0.5, 0.5, 2)
        z = np.array([*tilt, 1.0]) / math.sqrt(1 + tilt @ tilt)
        x = np.cross([0, 1, 0], z) / np.linalg.norm(np.cross([0, 1, 0], z))
        turn = np.stack([x, np.cross(z, x), z], axis=1)
        half_size = np.full(3, 0.2)
        waves = np.array([[0.02, 8.0, 3.0, 0.3], [0.01, -5.0, 12.0, 2.0]]) if seed % 2 else None
    if kind is Kind.ROOM:
        turn, centre, half_size = np.eye(3), np.array([0.0, 0.0, -1.0]), np.array([3.0, 2.0, 2.0])
    return replace(
        world.solids[0], kind=kind, turn=turn, centre=centre, half_size=half_size, taper=0.6, waves=waves, outline=None
    )


def is_inside(solid: Solid, local: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points lie in a solid; of a surface, on its far side."""
    x, y, z = local.T
    match solid.kind:
        case Kind.ELLIPSOID:
            return x * x + y * y + z * z < 1
        case Kind.CONE:
            return (np.abs(z) < 1) & (np.hypot(x, y) < 1 - solid.taper * (1 + z) / 2)
        case Kind.BOX:
            return np.abs(local).max(axis=1) < 1
        case Kind.ROOM:
            return np.abs(local).max(axis=1) > 1
    rise = np.zeros_like(x)
    for height, k_x, k_y, phase in [] if solid.waves is None else solid.waves:
        rise += height * np.sin(k_x * x + k_y * y + phase)
    return z > rise


def march(solid: Solid, world: World, x_px: float, y_px: float, *, camera: Camera) -> float:
    """First t at which a ray enters, by small steps and bisection."""
    start = np.array([camera.x, 0, 0])
    way = np.array([(x_px - camera.centre_px[0]) / world.focal_px, (y_px - camera.centre_px[1]) / world.focal_px, 1.0])

    def inside(t: NDArray[np.float64]) -> NDArray[np.bool_]:
        points = start + t[:, None] * way
        return is_inside(solid, (points - solid.centre) @ solid.turn / solid.half_size)

    t = np.linspace(2e-3, FARTHEST, 6001)
    states = inside(t)
    crossed = np.flatnonzero(states[1:] != states[0])
    if not len(crossed):
        return math.inf
    low, high = t[crossed[0]], t[crossed[0] + 1]
    for _ in range(60):
        middle = (low + high) / 2
        if inside(np.array([middle]))[0] == states[0]:
            low = middle
        else:
            high = middle
    if solid.kind is Kind.SHEET:
        local = (start + high * way - solid.centre) @ solid.turn / solid.half_size
        return high if np.abs(local[:2]).max() < 1 else math.inf
    return float(high)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", list(Kind))
def test_a_ray_ends_where_marching_along_it_ends(kind: Kind, seed: int, palette: Palette) -> None:
    rng = np.random.default_rng(seed)
    world = draw_world(rng, palette, hw=(64, 96), disparities_px=(2.0, 20.0))
    solid = random_solid(kind, world, seed=seed)
    x, y = rng.uniform(0, 96, RAYS), rng.uniform(0, 64, RAYS)
    camera = (world.ref, world.src)[seed % 2]
    found = first_hit(solid, torch.from_numpy(x), torch.from_numpy(y), camera=camera, palette=palette).numpy()
    expected = np.array([march(solid, world, *xy, camera=camera) for xy in zip(x, y, strict=True)])
    found = np.where(found < FARTHEST, found, math.inf)
    # A ray that grazes an outline may be told either way.
    differs = np.isinf(found) != np.isinf(expected)
    assert differs.mean() < 0.02
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.sum() > 5
    np.testing.assert_allclose(found[both], expected[both], atol=2e-5)


@pytest.mark.parametrize(
    "kinds", [(Kind.ELLIPSOID, Kind.CONE, Kind.ROOM), (Kind.BOX, Kind.SHEET, Kind.ROOM), (Kind.ELLIPSOID, Kind.PLANE)]
)
def test_disparity_of_a_cast_pair_is_that_of_the_nearest_place_where_marching_ends(
    kinds: tuple[Kind, ...], palette: Palette
) -> None:
    """A pair is cast in single precision."""
    rng = np.random.default_rng(1)
    drawn = draw_world(rng, palette, hw=(64, 96), disparities_px=(2.0, 20.0))
    world = replace(drawn, solids=tuple(random_solid(kind, drawn, seed=3 + n) for n, kind in enumerate(kinds)))
    found_px = cast_pair(world, palette).disparity_px.numpy()
    y, x = rng.integers(0, 64, RAYS), rng.integers(0, 96, RAYS)
    depth = np.array(
        [min(march(solid, world, *xy, camera=world.ref) for solid in world.solids) for xy in zip(x, y, strict=True)]
    )
    expected_px = world.focal_px * world.baseline_m / depth + world.offset_px
    off_px = np.abs(found_px[y, x] - expected_px)
    on_outline = off_px > 0.2  # a ray that grazes it may be told either way
    assert on_outline.mean() < 0.02
    assert off_px[~on_outline].max() < 1e-3
