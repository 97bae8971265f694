"""Worlds are made of what they promise: hard things are common, and whatever is drawn fits its window and view."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.simulate.raycast.arrange import draw_world
from telewide.simulate.raycast.hits import Kind
from telewide.simulate.raycast.palette import Palette, draw_palette
from telewide.simulate.raycast.world import Solid, World

HW = (288, 480)
WIDE_PX = 6.0
"""Things up to this wide count as thin."""


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    palette: Palette = draw_palette(np.random.default_rng(0), n_textures=4, n_outlines=4)
    rng = np.random.default_rng(1)
    return [draw_world(rng, palette, hw=HW, disparities_px=(2.0, 40.0)) for _ in range(200)]


def width_px(world: World, solid: Solid) -> float:
    """Smallest width of a bounded solid, seen from the front."""
    return 2 * float(solid.half_size.min()) * world.focal_px / float(solid.centre[2])


def test_a_world_holds_several_to_many_things(worlds: list[World]) -> None:
    counts = np.array([len(world.solids) for world in worlds])
    assert counts.min() >= 5
    assert 15 <= np.median(counts) <= 50
    assert np.mean(counts >= 40) > 0.1


def test_what_matching_finds_hard_is_common(worlds: list[World]) -> None:
    bounded = [
        (world, solid) for world in worlds for solid in world.solids if solid.kind not in (Kind.PLANE, Kind.ROOM)
    ]
    thin_worlds = {id(world) for world, solid in bounded if 1 <= width_px(world, solid) <= WIDE_PX}
    assert len(thin_worlds) > 0.9 * len(worlds)
    materials = [solid.material for _, solid in bounded]
    plain = np.mean([material.contrast < 0.25 for material in materials])
    assert 0.35 < plain < 0.65
    mirroring = np.mean([material.gloss > 0.3 and material.contrast < 0.45 for material in materials])
    assert 0.03 < mirroring < 0.15
    behind = [world.solids[0].material for world in worlds]
    alike = np.mean([any(s.material == m for s in w.solids[1:]) for w, m in zip(worlds, behind, strict=True)])
    assert alike > 0.6


def test_backgrounds_are_walls_grounds_rooms_and_skies(worlds: list[World]) -> None:
    first = [world.solids[0] for world in worlds]
    kinds = [solid.kind for solid in first]
    assert 0.15 < np.mean([kind == Kind.ROOM for kind in kinds]) < 0.35
    level = [abs(float(solid.turn[1, 2])) > 0.9 for solid in first if solid.kind == Kind.PLANE]
    assert 0.05 < np.mean(level) < 0.4


def test_hardly_anything_lies_nearer_than_the_window_reaches(worlds: list[World]) -> None:
    placed_px = []
    for world in worlds:
        parallax = world.focal_px * world.baseline_m
        assert parallax + world.offset_px == pytest.approx(2.0, abs=1e-9)
        placed_px += [parallax / float(solid.centre[2]) + world.offset_px for solid in world.solids[2:]]
    assert np.mean(np.array(placed_px) > 40.0) < 0.02
    assert np.mean(np.array(placed_px) > 20.0) > 0.3


def test_equal_seeds_are_equal_worlds() -> None:
    palette = draw_palette(np.random.default_rng(0), n_textures=4, n_outlines=4)
    one, other = (draw_world(np.random.default_rng(7), palette, hw=HW, disparities_px=(0.0, 30.0)) for _ in range(2))
    assert len(one.solids) == len(other.solids)
    for own, its in zip(one.solids, other.solids, strict=True):
        assert own.material == its.material
        assert np.array_equal(own.centre, its.centre)


def test_thin_lines_in_a_wall_are_common_and_lie_in_it(worlds: list[World]) -> None:
    with_seams = 0
    for world in worlds:
        walls = [solid for solid in world.solids[:2] if solid.kind == Kind.PLANE and solid.waves is None]
        seams = [
            abs(float((solid.centre - wall.centre) @ wall.turn[:, 2])) / float(solid.centre[2])
            for wall in walls
            for solid in world.solids
            if solid.kind == Kind.SHEET and np.allclose(solid.turn[:, 2], wall.turn[:, 2])
        ]
        with_seams += bool(seams)
        assert all(off < 0.01 for off in seams)
    assert 0.25 < with_seams / len(worlds) < 0.7
