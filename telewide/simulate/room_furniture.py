"""Furnish a room: walls, a table with things on it near the phone, a chair, a lamp and a shelf behind it.

The world frame is that of `telewide.simulate.room_scene`. What stands where is drawn so that the tele lens, which sees
little, sees things at many distances: places are given as (u, z), u from -1 to 1 across the tele lens's field at z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import rigid_transform
from telewide.simulate import room_paint as paint
from telewide.simulate import room_things as things
from telewide.simulate.room_scene import (
    Light,
    Room,
    Solid,
    Vector,
    box,
    can,
    light,
    panel,
    plain,
    rod,
    turned,
)

TELE_HALF_TAN = 0.225
"""Half the tele lens's picture width over its focal length."""
FLOOR_M, CEILING_M = 1.15, -1.35
_TABLE_NEAR_M = 0.5
_AMBIENT = (0.075, 0.073, 0.07)


@dataclass(frozen=True)
class _Plan:
    """Where the large things are, m."""

    back_m: float
    side_m: float
    table_m: float
    table_far_m: float


def random_room(rng: np.random.Generator) -> Room:
    """Draw a room with a set table in front, things from 0.6 to 4 m.

    Args:
        rng: source of all draws.
    """
    plan = _random_plan(rng)
    solids = [*_walls(rng, plan), *_table(rng, plan), *_set_table(rng, plan)]
    solids += [*_chair(rng, z_m=float(rng.uniform(plan.table_far_m + 0.2, plan.table_far_m + 0.45)))]
    solids += [*_lamp(rng, z_m=float(rng.uniform(2.5, plan.back_m - 0.45))), *_shelf(rng, plan)]
    return Room(tuple(solids), _lights(rng, plan), _AMBIENT, _standpoint(rng, pitch_deg=float(rng.uniform(8.0, 11.0))))


def bare_room(rng: np.random.Generator) -> Room:
    """Draw a room without its table and with one lamp, for photos of something held before the phone.

    Args:
        rng: source of all draws.
    """
    plan = _random_plan(rng)
    solids = [*_walls(rng, plan), *_chair(rng, z_m=2.4), *_shelf(rng, plan)]
    return Room(tuple(solids), _lights(rng, plan)[:1], _AMBIENT, _standpoint(rng, pitch_deg=2.0))


def _random_plan(rng: np.random.Generator) -> _Plan:
    return _Plan(
        back_m=float(rng.uniform(3.4, 4.0)),
        side_m=float(rng.uniform(1.7, 2.1)),
        table_m=float(rng.uniform(0.33, 0.38)),
        table_far_m=float(rng.uniform(1.75, 2.0)),
    )


def _standpoint(rng: np.random.Generator, *, pitch_deg: float) -> FloatArray:
    tilt_rad = np.radians([-pitch_deg, rng.normal(0, 2.0), 0.0])
    level = rigid_transform(rotation=tilt_rad, translation=np.zeros(3))
    roll = rigid_transform(rotation=np.radians([0.0, 0.0, rng.normal(0, 0.8)]), translation=np.zeros(3))
    return np.asarray(level @ roll)


def _lights(rng: np.random.Generator, plan: _Plan) -> tuple[Light, ...]:
    """A lamp under the ceiling behind the phone, a window at one side; neither is in the picture."""
    side = float(rng.choice([-1.0, 1.0]))
    warm, cool = float(rng.uniform(0.8, 1.0)), float(rng.uniform(1.0, 1.15))
    above = light(
        (float(rng.uniform(-0.4, 0.4)), CEILING_M + 0.02, float(rng.uniform(0.2, 1.0))),
        (0.0, 1.0, 0.25),
        half_size_m=(0.35, 0.35),
        radiance=(12.0, 11.5 * math.sqrt(warm), 10.5 * warm),
    )
    window = light(
        (side * (plan.side_m - 0.02), -0.45, float(rng.uniform(0.9, 1.4))),
        (-side, 0.0, 0.0),
        half_size_m=(0.6, 0.5),
        radiance=(5.0, 5.2, 5.2 * cool),
    )
    return above, window


def _walls(rng: np.random.Generator, plan: _Plan) -> list[Solid]:
    height_m, depth_m = FLOOR_M - CEILING_M, plan.back_m + 1.0
    middle_y, middle_z = (FLOOR_M + CEILING_M) / 2, plan.back_m - depth_m / 2
    back = (
        paint.bricks(rng, hw=(700, 1200), colour=paint.colour_of("a8674e") * np.float32(0.95), rows=34)
        if rng.random() < 0.3
        else paint.wallpaper(rng, hw=(700, 1200))
    )
    side = paint.painted(rng, hw=(200, 300), colour=paint.wall_colour(rng))
    floor = paint.planks(rng, hw=(900, 1200), colour=paint.wood_colour(rng), rows=24)
    skirting_m = (2 * plan.side_m, 0.09, 0.02)
    return [
        panel((0.0, middle_y, plan.back_m), (0.0, 0.0, -1.0), back, half_size_m=(plan.side_m, height_m / 2)),
        panel((-plan.side_m, middle_y, middle_z), (1.0, 0.0, 0.0), side, half_size_m=(depth_m / 2, height_m / 2)),
        panel((plan.side_m, middle_y, middle_z), (-1.0, 0.0, 0.0), side, half_size_m=(depth_m / 2, height_m / 2)),
        panel((0.0, FLOOR_M, middle_z), (0.0, -1.0, 0.0), floor, half_size_m=(plan.side_m, depth_m / 2)),
        panel((0.0, CEILING_M, middle_z), (0.0, 1.0, 0.0), plain((0.85,) * 3), half_size_m=(plan.side_m, depth_m / 2)),
        box((0.0, FLOOR_M - 0.045, plan.back_m - 0.01), skirting_m, plain((0.8, 0.79, 0.76))),
    ]


def _table(rng: np.random.Generator, plan: _Plan) -> list[Solid]:
    colour = paint.wood_colour(rng)
    depth_m = plan.table_far_m - _TABLE_NEAR_M
    middle_z = (_TABLE_NEAR_M + plan.table_far_m) / 2
    width_m = float(rng.uniform(1.2, 1.5))
    top = (
        paint.patterned(rng, hw=(900, 900), contrast=0.3)
        if rng.random() < 0.4
        else paint.planks(rng, hw=(900, 1000), colour=colour, rows=int(rng.integers(5, 9)))
    )
    legs = [
        box(
            (x * (width_m / 2 - 0.06), (plan.table_m + FLOOR_M) / 2 + 0.02, middle_z + z * (depth_m / 2 - 0.06)),
            (0.06, FLOOR_M - plan.table_m - 0.04, 0.06),
            plain(colour * np.float32(0.8)),
        )
        for x in (-1, 1)
        for z in (-1, 1)
    ]
    return [box((0.0, plan.table_m + 0.02, middle_z), (width_m, 0.04, depth_m), top), *legs]


def _set_table(rng: np.random.Generator, plan: _Plan) -> list[Solid]:
    """Things on the table: one near and tall at a side, others further back, some for the wide lens alone."""
    side = float(rng.choice([-1.0, 1.0]))
    solids = things.twigs(rng, _at(side * float(rng.uniform(0.55, 0.8)), float(rng.uniform(0.66, 0.85)), plan.table_m))
    across = np.linspace(-0.85, 0.85, 5) + rng.normal(0, 0.05, 5)
    depths_m = np.linspace(1.0, plan.table_far_m - 0.15, 5) + rng.normal(0, 0.03, 5)
    makers = [things.carton, things.tin, things.sphere, things.vase, things.candles, things.books, things.rack]
    for u, z_m, kind in zip(across, rng.permutation(depths_m), rng.permutation(len(makers))[:5], strict=True):
        solids += makers[int(kind)](rng, _at(float(u), float(z_m), plan.table_m))
    for aside in (-1.0, 1.0):
        z_m = float(rng.uniform(1.0, 1.6))
        maker = makers[int(rng.integers(len(makers)))]
        solids += maker(rng, (aside * float(rng.uniform(0.42, 0.55)), plan.table_m, z_m))
    return solids


def _at(u: float, z_m: float, y_m: float) -> Vector:
    return u * TELE_HALF_TAN * z_m, y_m, z_m


def _chair(rng: np.random.Generator, *, z_m: float) -> list[Solid]:
    """A chair that shows its back, with bars."""
    x = float(rng.uniform(-0.7, 0.7)) * TELE_HALF_TAN * z_m
    colour = paint.wood_colour(rng) * np.float32(0.8)
    dull, seat_m, top_m = plain(colour), FLOOR_M - 0.46, FLOOR_M - 0.98
    seat = box((x, seat_m, z_m - 0.2), (0.42, 0.03, 0.42), paint.wood(rng, hw=(128, 128), colour=colour))
    legs = [
        rod((x + 0.18 * side, FLOOR_M, z_m - 0.2 + z), (x + 0.18 * side, seat_m, z_m - 0.2 + z), radius_m=0.016,
            texture=dull)
        for side in (-1, 1) for z in (-0.17, 0.17)
    ]  # fmt: skip
    posts = [rod((x + 0.19 * s, seat_m, z_m), (x + 0.2 * s, top_m, z_m + 0.06), radius_m=0.014, texture=dull)
             for s in (-1, 1)]  # fmt: skip
    bars = [rod((x + t, seat_m, z_m), (x + t, top_m, z_m + 0.06), radius_m=0.007, texture=dull)
            for t in np.linspace(-0.13, 0.13, 5)]  # fmt: skip
    return [seat, *legs, *posts, *bars, box((x, top_m, z_m + 0.06), (0.44, 0.05, 0.025), dull)]


def _lamp(rng: np.random.Generator, *, z_m: float) -> list[Solid]:
    """A standing lamp: a thin pole and a shade of cloth."""
    x = float(rng.uniform(0.35, 0.8)) * float(rng.choice([-1.0, 1.0])) * TELE_HALF_TAN * z_m
    metal = plain((0.17, 0.16, 0.15))
    pole = rod((x, FLOOR_M, z_m), (x, -0.2, z_m), radius_m=0.009, texture=metal)
    shade = turned((x, -0.12, z_m), np.array([[0.19, 0.0], [0.12, 0.28]]), paint.wallpaper(rng, hw=(64, 256)))
    return [pole, *can((x, FLOOR_M, z_m), radius_m=0.13, height_m=0.02, texture=metal, lid=metal), shade]


def _shelf(rng: np.random.Generator, plan: _Plan) -> list[Solid]:
    """A shelf of books along the back wall, a picture beside it."""
    colour = paint.wood_colour(rng)
    width_m, depth_m = float(rng.uniform(1.1, 1.6)), 0.28
    side = float(rng.choice([-1.0, 1.0]))
    x, z = side * float(rng.uniform(0.1, 0.4)), plan.back_m - depth_m / 2 - 0.02
    board = paint.wood(rng, hw=(48, 512), colour=colour)
    levels_m = FLOOR_M - 0.08 - 0.33 * np.arange(5)
    solids = [box((x, float(y), z), (width_m, 0.022, depth_m), board) for y in levels_m]
    height_m = FLOOR_M - levels_m[-1]
    for end in (-1, 1):
        post_m = (x + end * width_m / 2, FLOOR_M - height_m / 2, z)
        solids.append(box(post_m, (0.025, height_m, depth_m), plain(colour * np.float32(0.85))))
    for y in levels_m[:-1]:
        solids += _row_of_books(rng, (x - width_m / 2 + 0.04, float(y) - 0.011, z), width_m=width_m - 0.08)
    frame = paint.picture(rng, hw=(200, 280))
    at = (x - side * (width_m / 2 + 0.45), -0.05, plan.back_m - 0.015)
    return [*solids, box(at, (0.56, 0.4, 0.03), frame)]


def _row_of_books(rng: np.random.Generator, start: Vector, *, width_m: float) -> list[Solid]:
    solids: list[Solid] = []
    x, y, z = start
    while x < start[0] + width_m - 0.06:
        size = (float(rng.uniform(0.022, 0.05)), float(rng.uniform(0.17, 0.27)), float(rng.uniform(0.13, 0.19)))
        if rng.random() < 0.12:  # a gap, or a thing among the books
            x += float(rng.uniform(0.06, 0.14))
            continue
        solids.append(box((x + size[0] / 2, y - size[1] / 2, z - 0.03), size, paint.book_back(rng)))
        x += size[0] + 0.002
    return solids
