"""Things that stand on a table: cartons, tins, balls, vases, twigs, candles, books, a rack of wires.

Each takes the place of its foot in the world frame of `telewide.simulate.room_scene` and draws the rest.
"""

from __future__ import annotations

import numpy as np

from telewide.simulate import room_paint as paint
from telewide.simulate.room_scene import Solid, Vector, ball, box, can, plain, rod, turned


def carton(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """A printed carton."""
    size = (float(rng.uniform(0.08, 0.14)), float(rng.uniform(0.12, 0.22)), float(rng.uniform(0.06, 0.1)))
    texture = paint.packet(rng, hw=(256, 160))
    return [box((foot[0], foot[1] - size[1] / 2, foot[2]), size, texture, yaw_rad=float(rng.uniform(-0.7, 0.7)))]


def tin(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """A tin with a printed label."""
    texture = paint.packet(rng, hw=(160, 320))
    radius_m, height_m = float(rng.uniform(0.035, 0.05)), float(rng.uniform(0.1, 0.16))
    return [*can(foot, radius_m=radius_m, height_m=height_m, texture=texture, lid=plain((0.62, 0.62, 0.6)))]


def sphere(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """A painted ball."""
    radius_m = float(rng.uniform(0.045, 0.08))
    texture = paint.patterned(rng, hw=(200, 400), contrast=0.7)
    return [ball((foot[0], foot[1] - radius_m, foot[2]), radius_m, texture)]


def vase(rng: np.random.Generator, foot: Vector, *, heights_m: tuple[float, float] = (0.14, 0.24)) -> list[Solid]:
    """A vase from the lathe."""
    height_m = float(rng.uniform(*heights_m))
    at = np.array([0.0, 0.02, 0.15, 0.35, 0.55, 0.75, 0.88, 1.0])
    waist = np.array([0.0, 0.2, 0.28, 0.34, 0.3, 0.2, 0.14, 0.18]) * rng.uniform(0.85, 1.1)
    fine = np.linspace(0, 1, 40)
    profile = np.column_stack([np.interp(fine, at, waist), fine]) * height_m
    smooth = np.convolve(np.pad(profile[:, 0], 2, mode="edge"), np.full(5, 0.2), mode="valid")
    profile[1:, 0] = smooth[1:]
    texture = paint.patterned(rng, hw=(160, 320)) if rng.random() < 0.6 else plain(paint.thing_colour(rng))
    return [turned(foot, profile, texture)]


def twigs(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """Thin dry twigs with berries in a small vase."""
    solids = vase(rng, foot, heights_m=(0.12, 0.17))
    mouth = np.array([foot[0], foot[1] - 0.11, foot[2]])
    colour = plain(paint.colour_of("5b4632"))
    berry = plain(paint.colour_of("9c2f28"))
    for _ in range(6):
        lean = np.array([rng.normal(0, 0.28), -1.0, rng.normal(0, 0.25)])
        tip = mouth + lean * float(rng.uniform(0.14, 0.26))
        solids.append(rod(mouth, tip, radius_m=float(rng.uniform(0.0012, 0.002)), texture=colour))
        for share in rng.uniform(0.45, 1.0, 4):
            place = mouth + (tip - mouth) * share + rng.normal(0, 0.006, 3)
            solids.append(ball((float(place[0]), float(place[1]), float(place[2])), 0.0045, berry))
    return solids


def candles(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """Three candles on thin stands."""
    solids: list[Solid] = []
    metal, wax = plain((0.2, 0.19, 0.18)), plain((0.86, 0.82, 0.7))
    x, y, z = foot
    for step in (-1, 0, 1):
        at = (x + 0.045 * step, y, z + float(rng.uniform(-0.03, 0.03)))
        stand_m, candle_m = float(rng.uniform(0.08, 0.16)), float(rng.uniform(0.04, 0.08))
        solids += can(at, radius_m=0.016, height_m=0.006, texture=metal, lid=metal)
        solids.append(rod(at, (at[0], y - stand_m, at[2]), radius_m=0.0025, texture=metal))
        solids += can((at[0], y - stand_m, at[2]), radius_m=0.009, height_m=candle_m, texture=wax, lid=wax)
    return solids


def books(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """A pile of books."""
    solids: list[Solid] = []
    x, y, z = foot
    for _ in range(int(rng.integers(3, 6))):
        size = (float(rng.uniform(0.13, 0.18)), float(rng.uniform(0.018, 0.035)), float(rng.uniform(0.1, 0.13)))
        cover = np.ascontiguousarray(paint.book_back(rng, hw=(160, 30)).transpose(1, 0, 2))
        solids.append(box((x, y - size[1] / 2, z), size, cover, yaw_rad=float(rng.normal(0, 0.15))))
        y -= size[1]
    return solids


def rack(rng: np.random.Generator, foot: Vector) -> list[Solid]:
    """A rack of thin wires."""
    x, y, z = foot
    wire = plain(paint.thing_colour(rng) * np.float32(0.6))
    height_m, half_m = float(rng.uniform(0.1, 0.16)), 0.07
    bars = [
        rod((x + half_m * t, y, z), (x + half_m * t, y - height_m, z), radius_m=0.002, texture=wire)
        for t in np.linspace(-1, 1, 7)
    ]
    rails = [
        rod((x - half_m, y - h, z), (x + half_m, y - h, z), radius_m=0.003, texture=wire) for h in (0.005, height_m)
    ]
    return [*bars, *rails]
