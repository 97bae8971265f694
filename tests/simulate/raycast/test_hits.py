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
from telewide.simulate.raycast.palette import OUTLINE_PX, Palette, draw_palette
from telewide.simulate.raycast.render import cast_pair
from telewide.simulate.raycast.world import Camera, Solid, World

RAYS = 160
FARTHEST = 3.0
HOLED = 2
"""Outline that is a disc with a hole."""
TEXEL = 2 / OUTLINE_PX


@pytest.fixture(scope="module")
def palette() -> Palette:
    drawn = draw_palette(np.random.default_rng(0), n_textures=4, n_outlines=4)
    texels = (np.arange(OUTLINE_PX) + 0.5) * TEXEL - 1
    outlines = drawn.outlines.reshape(4, OUTLINE_PX, OUTLINE_PX).clone()
    outlines[HOLED] = torch.from_numpy(from_rim(texels[None], texels[:, None]) / TEXEL)
    return replace(drawn, outlines=outlines.reshape(-1, 1))


def from_rim(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of local places from the rim of a disc with a hole beside its middle, positive where a sheet is."""
    return np.minimum(0.9 - np.hypot(x, y), -into_hole(x, y))


def into_hole(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.45 - np.hypot(x - 0.25, y + 0.15)


def random_solid(kind: Kind, world: World, *, seed: int, outline: int | None = None) -> Solid:
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
    solid = replace(world.solids[0], kind=kind, turn=turn, centre=centre, half_size=half_size)
    return replace(solid, taper=0.6, waves=waves, outline=outline if kind is Kind.SHEET else None)


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

    def inside(t: NDArray[np.float64]) -> NDArray[np.bool_]:
        return is_inside(solid, local_at(t, solid, world, camera=camera, xy_px=(x_px, y_px)))

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
        x, y, _ = local_at(np.array([high]), solid, world, camera=camera, xy_px=(x_px, y_px))[0]
        is_there = max(abs(x), abs(y)) < 1 if solid.outline is None else from_rim(x, y) > 0
        return high if is_there else math.inf
    return float(high)


def local_at(
    t: NDArray[np.float64], solid: Solid, world: World, *, camera: Camera, xy_px: tuple[float, float]
) -> NDArray[np.float64]:
    """(n, 3) places on a ray, in a solid's coordinates."""
    x, y = (np.array(xy_px) - camera.centre_px) / world.focal_px
    points = np.array([camera.x, 0, 0]) + t[:, None] * np.array([x, y, 1.0])
    return (points - solid.centre) @ solid.turn / solid.half_size


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


@pytest.mark.parametrize("seed", range(4))
def test_a_ray_through_the_hole_of_a_sheet_goes_on_and_one_beside_it_ends(seed: int, palette: Palette) -> None:
    """Within a texel of the rim it may be told either way."""
    rng = np.random.default_rng(seed)
    world = draw_world(rng, palette, hw=(64, 96), disparities_px=(2.0, 20.0))
    camera = (world.ref, world.src)[seed % 2]
    cut = random_solid(Kind.SHEET, world, seed=seed, outline=HOLED)
    xy = rng.uniform(0, [96, 64], (2 * RAYS, 2))
    found = first_hit(cut, *torch.from_numpy(xy).unbind(dim=1), camera=camera, palette=palette).numpy()
    whole = replace(cut, kind=Kind.PLANE)
    met = np.array([march(whole, world, *of, camera=camera) for of in xy])
    places = [local_at(np.array([t]), cut, world, camera=camera, xy_px=of)[0] for t, of in zip(met, xy, strict=True)]
    x, y, _ = np.array(places).T
    ends, goes_on = from_rim(x, y) > TEXEL, from_rim(x, y) < -TEXEL
    np.testing.assert_allclose(found[ends], met[ends], atol=2e-5)
    assert np.isinf(found[goes_on]).all()
    assert min(ends.sum(), (into_hole(x, y) > TEXEL).sum()) > 5


CAST = [
    ((Kind.ELLIPSOID, Kind.CONE, Kind.ROOM), None),
    ((Kind.BOX, Kind.SHEET, Kind.ROOM), None),
    ((Kind.ELLIPSOID, Kind.PLANE), None),
    ((Kind.ELLIPSOID, Kind.SHEET, Kind.ROOM), HOLED),
]


@pytest.mark.parametrize(("kinds", "outline"), CAST)
def test_disparity_of_a_cast_pair_is_that_of_the_nearest_place_where_marching_ends(
    kinds: tuple[Kind, ...], outline: int | None, palette: Palette
) -> None:
    """A pair is cast in single precision."""
    rng = np.random.default_rng(1)
    drawn = draw_world(rng, palette, hw=(64, 96), disparities_px=(2.0, 20.0))
    solids = tuple(random_solid(kind, drawn, seed=3 + n, outline=outline) for n, kind in enumerate(kinds))
    world = replace(drawn, solids=solids)
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
