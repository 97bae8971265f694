"""Random worlds: floating and standing solids before a wall, a ground, a room or the sky.

Realistic layout teaches nothing more; variety does. Sizes are drawn in pixels and places in disparity, so that every
world fills its view and its window whatever the baseline. What matching finds hard is common: plain walls, repetition,
things one to six pixels wide, gaps through which only ref sees, the same paint before and behind, glass, gloss.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.simulate.raycast.hits import Kind
from telewide.simulate.raycast.palette import Palette
from telewide.simulate.raycast.turns import any_turn, rotation, turn_with_z, unit, upright
from telewide.simulate.raycast.world import Light, Material, Solid, World

PLAIN_SHARES = (0.2, 0.45, 0.8)
"""Of a world, one of them at random: share of its materials with hardly any texture. With more of them everywhere the
first steps of a training teach little."""
GLASS_SHARE = 0.06
"""Share of the materials that are dark and mirror more than they show: panes, windscreens, screens, lacquer."""
NEAREST = 0.85
"""Of the nearest depth of a world: what would come nearer is left out."""
SEAMS_SHARE = 0.6
"""Share of the worlds with seams in their planes."""
FARTHEST_SEAM_M = 3.0
JUST_BEFORE = 0.999
"""Depth of a seam over that of its plane."""
SAME_AS_BEHIND = 0.12
"""Share of the solids that wear the background's paint."""


@dataclass(frozen=True)
class _Draft:
    """Parts that the pieces of a world have in common.

    Attributes:
        rng: source of all draws.
        hw: size of the views, px.
        focal_px: of the cameras.
        centre_px: principal point of ref.
        nearness: largest inverse depth; the background's is 1.
        ground_y: height of the ground, world; None without one.
        palette: what to paint with.
        backdrop: material of the background.
        detail: typical size of a texel on the nearest things, px.
        plain_share: of the materials.
    """

    rng: np.random.Generator
    hw: tuple[int, int]
    focal_px: float
    centre_px: tuple[float, float]
    nearness: float
    ground_y: float | None
    palette: Palette
    backdrop: Material
    detail: float
    plain_share: float


def draw_world(
    rng: np.random.Generator, palette: Palette, *, hw: tuple[int, int], disparities_px: tuple[float, float]
) -> World:
    """Draw a world.

    Args:
        rng: source of all draws.
        palette: textures and outlines.
        hw: height and width of the views, px.
        disparities_px: of the background in the middle of the view, and of the nearest things.

    Returns:
        The world; about a fifth of the pixels lie outside of `disparities_px`, most of them a little.
    """
    far_px, near_px = disparities_px
    focal_px = hw[1] * math.exp(rng.uniform(math.log(0.7), math.log(2.5)))
    nearness = 1 + math.exp(rng.uniform(math.log(0.15), math.log(6.0)))
    baseline_m = (near_px - far_px) / (focal_px * (nearness - 1))
    centre_px = (hw[1] * rng.uniform(0.4, 0.6), hw[0] * rng.uniform(0.3, 0.6))
    draft = _Draft(
        rng=rng,
        hw=hw,
        focal_px=focal_px,
        centre_px=centre_px,
        nearness=nearness,
        ground_y=None,
        palette=palette,
        backdrop=_NO_MATERIAL,
        detail=math.exp(rng.uniform(-1.2, 1.0)),
        plain_share=float(rng.choice(PLAIN_SHARES)),
    )
    draft = replace(draft, backdrop=_material(draft, depth_m=1.0))
    draft, background = _background(draft)
    solids = [*background, *_things(draft, background)]
    light = Light(unit(rng.normal((0, -1.2, -0.8), 1)), rng.uniform(0.25, 0.75), _light_colour(rng))
    sky = replace(_material(draft, depth_m=1.0), gloss=0.0, macro_contrast=0.3)
    return World(
        hw=hw,
        focal_px=focal_px,
        centre_px=centre_px,
        baseline_m=baseline_m,
        offset_px=far_px - focal_px * baseline_m,
        solids=tuple(_with_shadows(solids, rng)),
        light=light,
        sky=sky,
    )


def _things(draft: _Draft, background: Sequence[Solid]) -> list[Solid]:
    """Draw all that lies in the background or stands before it."""
    rng, things = draft.rng, list[Solid]()
    if rng.random() < SEAMS_SHARE:
        things += [seam for plane in background for seam in _seams(draft, plane)]
    things += [_single(draft) for _ in range(int(math.exp(rng.uniform(math.log(5), math.log(50)))))]
    for _ in range(int(rng.choice([0, 1, 2, 3, 5]))):
        things += _GROUPS[int(rng.integers(len(_GROUPS)))](draft)
    return [thing for thing in things if _nearest_m(thing) * draft.nearness > NEAREST]


def _nearest_m(solid: Solid) -> float:
    """Depth of the nearest corner of a solid's box."""
    return float(solid.centre[2] - np.abs(solid.turn[2]) @ solid.half_size)


_NO_MATERIAL = Material(
    texture=0,
    macro=0,
    texels_per_unit=1.0,
    texel_shift=(0.0, 0.0),
    contrast=0.0,
    macro_contrast=0.0,
    tint=(1.0, 1.0, 1.0),
)


def _light_colour(rng: np.random.Generator) -> tuple[float, float, float]:
    r, g, b = (float(c) for c in 1 + rng.normal(0, 0.12, 3))
    return r, g, b


def _with_shadows(solids: list[Solid], rng: np.random.Generator) -> list[Solid]:
    """Let a few of the larger bodies cast shadows."""
    bodies = (Kind.ELLIPSOID, Kind.BOX, Kind.CONE)
    largest = sorted(
        (i for i, s in enumerate(solids) if s.kind in bodies), key=lambda i: -float(np.sort(solids[i].half_size)[1])
    )
    chosen = set(largest[: int(rng.integers(0, 5))])
    return [replace(solid, casts_shadow=i in chosen) for i, solid in enumerate(solids)]


# Materials


def _material(draft: _Draft, *, depth_m: float) -> Material:
    rng = draft.rng
    texel_px = draft.detail * math.exp(rng.normal(0, 0.45))
    is_plain = rng.random() < draft.plain_share
    contrast = 0.25 * rng.random() ** 2 if is_plain else min(1.3, math.exp(rng.normal(-0.1, 0.35)))
    tint = np.exp(rng.normal(0, 0.35) + rng.normal(0, 0.08, 3))
    gloss = float(rng.uniform(0.05, 0.5)) if rng.random() < 0.12 else 0.0
    if rng.random() < GLASS_SHARE:
        tint, contrast, gloss = tint * rng.uniform(0.1, 0.5), 0.3 * contrast, float(rng.uniform(0.3, 1.0))
    return Material(
        texture=int(rng.integers(draft.palette.n_textures)),
        macro=int(rng.integers(draft.palette.n_textures)),
        texels_per_unit=draft.focal_px / (depth_m * texel_px),
        texel_shift=(float(rng.uniform(0, 512)), float(rng.uniform(0, 512))),
        contrast=float(contrast),
        macro_contrast=float(rng.uniform(0, 0.4 if is_plain else 1.2)),
        tint=(float(tint[0]), float(tint[1]), float(tint[2])),
        gloss=gloss,
    )


def _worn(draft: _Draft, *, depth_m: float) -> Material:
    """A material of its own, or now and then the background's."""
    return draft.backdrop if draft.rng.random() < SAME_AS_BEHIND else _material(draft, depth_m=depth_m)


# Backgrounds


def _background(draft: _Draft) -> tuple[_Draft, list[Solid]]:
    choose = draft.rng.choice(4, p=[0.35, 0.25, 0.25, 0.15])
    return (_before_wall, _on_ground_before_wall, _in_room, _under_sky)[choose](draft)


def _wall(draft: _Draft) -> Solid:
    """A plane that the axis meets at depth 1, slanted as far as the window allows, level or wavy."""
    rng, (height, width) = draft.rng, draft.hw
    steepest = min(0.7, 0.5 * (draft.nearness - 1) + 0.05)
    slope = rng.uniform(-steepest, steepest, 2) * (rng.random(2) < 0.6)
    normal = np.array([slope[0] * draft.focal_px / width, slope[1] * draft.focal_px / height, 1.0])
    turn = turn_with_z(unit(normal))
    waves = _waves(draft, extent=1.0, depth_m=1.0) if rng.random() < 0.3 else None
    return Solid(
        kind=Kind.PLANE,
        turn=turn,
        centre=np.array([0.0, 0.0, 1.0]),
        half_size=np.ones(3),
        material=draft.backdrop,
        waves=waves,
    )


def _waves(draft: _Draft, *, extent: float, depth_m: float) -> FloatArray:
    """Two or three sines whose slopes stay below about a third, in units of ``extent``."""
    rng = draft.rng
    count = int(rng.integers(1, 4))
    lengths = np.exp(rng.uniform(math.log(25), math.log(250), count)) * depth_m / draft.focal_px / extent
    angles = rng.uniform(0, 2 * math.pi, count)
    rates = 2 * math.pi / lengths
    slopes = rng.uniform(0.05, 0.35, count) / count
    return np.stack(
        [slopes / rates, rates * np.cos(angles), rates * np.sin(angles), rng.uniform(0, 2 * math.pi, count)], axis=1
    )


def _before_wall(draft: _Draft) -> tuple[_Draft, list[Solid]]:
    return draft, [_wall(draft)]


def _ground(draft: _Draft) -> tuple[_Draft, Solid]:
    """A level plane whose nearest visible part reaches the nearest depth of the world."""
    below = max(0.15 * draft.hw[0], draft.hw[0] - draft.centre_px[1])
    ground_y = below / draft.focal_px / (draft.nearness * draft.rng.uniform(0.5, 1.0))
    tilt = rotation(np.array([0.0, 0.0, 1.0]), draft.rng.normal(0, 0.04))
    turn = tilt @ turn_with_z(np.array([0.0, 1.0, 0.0]))
    waves = _waves(draft, extent=1.0, depth_m=0.5) if draft.rng.random() < 0.2 else None
    ground = Solid(
        kind=Kind.PLANE,
        turn=turn,
        centre=np.array([0.0, ground_y, 1.0]),
        half_size=np.ones(3),
        material=_material(draft, depth_m=0.7),
        waves=waves,
    )
    return replace(draft, ground_y=ground_y), ground


def _on_ground_before_wall(draft: _Draft) -> tuple[_Draft, list[Solid]]:
    draft, ground = _ground(draft)
    return draft, [_wall(draft), ground]


def _under_sky(draft: _Draft) -> tuple[_Draft, list[Solid]]:
    draft, ground = _ground(draft)
    return draft, [ground]


def _in_room(draft: _Draft) -> tuple[_Draft, list[Solid]]:
    """The inside of a box, turned a little; its far wall at about depth 1."""
    rng, (height, width) = draft.rng, draft.hw
    half_x = 0.5 * width / draft.focal_px * rng.uniform(0.5, 1.3)
    half_y = 0.5 * height / draft.focal_px * rng.uniform(0.5, 1.3)
    turn = rotation(np.array([0.0, 1.0, 0.0]), rng.normal(0, 0.25)) @ rotation(
        np.array([1.0, 0, 0]), rng.normal(0, 0.08)
    )
    # Only the far wall and what of the others lies before the nearest depth: the camera stands outside the other end.
    room = Solid(
        kind=Kind.ROOM,
        turn=turn,
        centre=turn @ np.array([0.0, 0.0, -2.0]) * 1.0,
        half_size=np.array([half_x, half_y, 3.0]),
        material=draft.backdrop,
    )
    return draft, [room]


def _seams(draft: _Draft, plane: Solid) -> list[Solid]:
    """Narrow stripes in a level plane: joints of doors and floors, cords on walls; thin, and they do not stand out."""
    if plane.kind != Kind.PLANE or plane.waves is not None:
        return []
    rng, (height, width), normal = draft.rng, draft.hw, plane.turn[:, 2]
    square = rng.uniform(0, math.pi)
    seams = []
    for _ in range(int(rng.integers(1, 6))):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        ray = np.array([(x - draft.centre_px[0]) / draft.focal_px, (y - draft.centre_px[1]) / draft.focal_px, 1.0])
        depth_m = float(plane.centre @ normal) / (float(ray @ normal) or math.inf)
        if not 1 / draft.nearness < depth_m < FARTHEST_SEAM_M:
            continue
        per_px = depth_m / draft.focal_px
        half_px = math.exp(rng.uniform(math.log(0.5), math.log(4.0))), rng.uniform(20, 0.7 * width)
        turn = plane.turn @ rotation(np.array([0.0, 0.0, 1.0]), square + 0.5 * math.pi * int(rng.integers(2)))
        half_size = np.array([*half_px, 1.0]) * per_px
        material = _material(draft, depth_m=depth_m)
        seams.append(
            Solid(
                kind=Kind.SHEET, turn=turn, centre=JUST_BEFORE * depth_m * ray, half_size=half_size, material=material
            )
        )
    return seams


# Single things


def _place(draft: _Draft, *, radius_px: float) -> tuple[FloatArray, float]:
    """Where a thing of a size stands: its centre, and the length of a pixel there."""
    rng, (height, width) = draft.rng, draft.hw
    inverse = 1 + (draft.nearness - 1) * rng.beta(1.1, 1.1)
    depth = max(1 / inverse, 1 / draft.nearness + 0.5 * radius_px / draft.focal_px / inverse)
    x, y = rng.uniform(-0.08, 1.08) * width, rng.uniform(-0.08, 1.08) * height
    per_px = depth / draft.focal_px
    centre = np.array([(x - draft.centre_px[0]) * per_px, (y - draft.centre_px[1]) * per_px, depth])
    return centre, per_px


def _standing(draft: _Draft, centre: FloatArray, half_height: float) -> FloatArray:
    """Put a thing onto the ground now and then."""
    if draft.ground_y is None or draft.rng.random() < 0.5:
        return centre
    return np.array([centre[0], draft.ground_y - half_height, centre[2]])


def _single(draft: _Draft) -> Solid:
    draw = draft.rng.choice(len(_SINGLES), p=_SINGLE_SHARES)
    return _SINGLES[draw](draft)


def _size_px(draft: _Draft) -> float:
    """Radius in px, every octave alike."""
    largest = 0.33 * min(draft.hw)
    return math.exp(draft.rng.uniform(math.log(5), math.log(largest)))


def _body(draft: _Draft, kind: Kind) -> Solid:
    rng, radius_px = draft.rng, _size_px(draft)
    centre, per_px = _place(draft, radius_px=radius_px)
    half_size = radius_px * per_px * np.exp(rng.normal(0, 0.35, 3))
    half_size = np.minimum(half_size, 0.45 * centre[2])
    turn = upright(rng) if rng.random() < 0.5 else any_turn(rng)
    centre = _standing(draft, centre, float(half_size[1]))
    return Solid(
        kind=kind,
        turn=turn,
        centre=centre,
        half_size=half_size,
        material=_worn(draft, depth_m=centre[2]),
        taper=rng.uniform(0, 0.9) * (rng.random() < 0.5),
    )


def _ellipsoid(draft: _Draft) -> Solid:
    return _body(draft, Kind.ELLIPSOID)


def _box(draft: _Draft) -> Solid:
    return _body(draft, Kind.BOX)


def _cone(draft: _Draft) -> Solid:
    cone = _body(draft, Kind.CONE)
    up = cone.turn @ turn_with_z(np.array([0.0, 1.0, 0.0]))
    return replace(cone, turn=up)


_LOG_ROD_RADII = (math.log(0.5), math.log(12.0))
"""Rods and legs are 1 to 24 px wide."""


def _rod(draft: _Draft) -> Solid:
    """A tapered rod, long, in any direction but mostly across the view.

    Along the baseline its ends and what it is fixed to are all that tells its disparity.
    """
    rng = draft.rng
    radius_px = math.exp(rng.uniform(*_LOG_ROD_RADII))
    length_px = rng.uniform(0.1, 0.9) * draft.hw[1]
    centre, per_px = _place(draft, radius_px=radius_px)
    way = unit(rng.normal(0, 1, 3) * [1.0, 1.0, 0.35])
    if rng.random() < 0.5:
        way = np.eye(3)[int(rng.random() < 0.7)]
    half = np.array([radius_px * per_px, radius_px * per_px, 0.5 * length_px * per_px])
    half[2] = min(half[2], 0.45 * centre[2] / max(1e-3, abs(way[2])))
    return Solid(
        kind=Kind.CONE,
        turn=turn_with_z(way),
        centre=centre,
        half_size=half,
        material=_worn(draft, depth_m=centre[2]),
        taper=rng.uniform(0, 0.8) * (rng.random() < 0.4),
    )


def _sheet(draft: _Draft) -> Solid:
    """A flat or wavy outline, mostly facing the cameras."""
    rng, radius_px = draft.rng, 1.3 * _size_px(draft)
    centre, per_px = _place(draft, radius_px=radius_px)
    turn = upright(rng) if rng.random() < 0.4 else turn_with_z(unit(np.array([*rng.normal(0, 0.5, 2), 1.0])))
    turn = turn @ rotation(np.array([0.0, 0.0, 1.0]), rng.uniform(0, 2 * math.pi) * (rng.random() < 0.7))
    half_size = np.array([radius_px, radius_px * math.exp(rng.normal(0, 0.4)), radius_px]) * per_px
    outline = None if rng.random() < 0.1 else int(rng.integers(draft.palette.n_outlines))
    waves = None
    if rng.random() < 0.35 and radius_px > 20:
        waves = _waves(draft, extent=float(half_size[0]), depth_m=centre[2])
    return Solid(
        kind=Kind.SHEET,
        turn=turn,
        centre=centre,
        half_size=half_size,
        material=_worn(draft, depth_m=centre[2]),
        outline=outline,
        waves=waves,
    )


_SINGLES: tuple[Callable[[_Draft], Solid], ...] = (_ellipsoid, _box, _cone, _rod, _sheet)
_SINGLE_SHARES = (0.16, 0.2, 0.1, 0.22, 0.32)


# Groups


def _row(draft: _Draft) -> list[Solid]:
    """Equal things side by side: railings, books, columns, legs."""
    rng, first = draft.rng, _single(draft)
    count = int(rng.integers(3, 10))
    step_px = max(2.5 * float(first.half_size[0]) / first.centre[2] * draft.focal_px, rng.uniform(6, 40))
    way = unit(rng.normal(0, 1, 3) * [1.0, 0.4, 0.8]) * step_px * first.centre[2] / draft.focal_px
    return [replace(first, centre=first.centre + (i - count / 2) * way) for i in range(count)]


def _chair(draft: _Draft) -> list[Solid]:
    """A seat on four legs with a back of rails; half of them lie, as in photos of a phone that was held upright."""
    rng = draft.rng
    side_px = rng.uniform(20, 0.3 * draft.hw[1])
    centre, per_px = _place(draft, radius_px=side_px)
    side, leg = side_px * per_px, math.exp(rng.uniform(*_LOG_ROD_RADII)) * per_px
    lying = rotation(np.array([0.0, 0.0, 1.0]), float(rng.choice([-0.5, 0.0, 0.0, 0.5])) * math.pi)
    turn, material = lying @ upright(rng), _worn(draft, depth_m=centre[2])
    down = rng.uniform(0.6, 1.4) * side

    def part(kind: Kind, at: tuple[float, float, float], half: tuple[float, float, float]) -> Solid:
        return Solid(
            kind=kind, turn=turn, centre=centre + turn @ np.array(at), half_size=np.array(half), material=material
        )

    parts = [part(Kind.BOX, (0, 0, 0), (side / 2, 2 * leg, side / 2))]
    for x in (-1, 1):
        parts += [part(Kind.BOX, (x * side / 2, down / 2, z * side / 2), (leg, down / 2, leg)) for z in (-1, 1)]
        parts.append(part(Kind.BOX, (x * side / 2, -down / 2, side / 2), (leg, down / 2, leg)))
    rails = int(rng.integers(1, 5))
    parts += [part(Kind.BOX, (0, -down * (0.25 + 0.2 * i), side / 2), (side / 2, leg, leg)) for i in range(rails)]
    return parts


def _plant(draft: _Draft) -> list[Solid]:
    """Stems and leaves about one place, of one paint."""
    rng = draft.rng
    radius_px = rng.uniform(15, 0.3 * draft.hw[0])
    centre, per_px = _place(draft, radius_px=radius_px)
    radius, material = radius_px * per_px, _material(draft, depth_m=centre[2])
    outline = int(rng.integers(draft.palette.n_outlines))
    solids = []
    for _ in range(int(rng.integers(5, 14))):
        at = centre + rng.normal(0, 0.5, 3) * radius
        half = rng.uniform(0.12, 0.45) * radius * np.array([1.0, rng.uniform(0.5, 1.0), 1.0])
        solids.append(
            Solid(kind=Kind.SHEET, turn=any_turn(rng), centre=at, half_size=half, material=material, outline=outline)
        )
    for _ in range(int(rng.integers(1, 5))):
        tip = rng.normal(0, 0.6, 3) * radius
        way, length = unit(tip), float(np.linalg.norm(tip)) / 2
        stem = np.array([rng.uniform(0.5, 2.5) * per_px] * 2 + [length])
        solids.append(
            Solid(
                kind=Kind.CONE,
                turn=turn_with_z(way),
                centre=centre + tip / 2,
                half_size=stem,
                material=material,
                taper=0.5,
            )
        )
    return solids


def _clutter(draft: _Draft) -> list[Solid]:
    """Many small things about one place, each of its own paint: shelves, engines, tools, gravel."""
    rng = draft.rng
    radius_px = rng.uniform(15, 0.25 * draft.hw[0])
    centre, per_px = _place(draft, radius_px=radius_px)
    spread = radius_px * per_px * np.array([1.0, rng.uniform(0.3, 1.0), 0.5])
    solids = []
    for _ in range(int(rng.integers(8, 24))):
        half = math.exp(rng.uniform(math.log(1.0), math.log(9.0))) * per_px * np.exp(rng.normal(0, 0.5, 3))
        at = centre + rng.normal(0, 0.6, 3) * spread
        at[2] = max(at[2], 1 / draft.nearness)
        kind = _SMALL_KINDS[int(rng.integers(len(_SMALL_KINDS)))]
        turn = upright(rng) if rng.random() < 0.5 else any_turn(rng)
        solids.append(
            Solid(kind=kind, turn=turn, centre=at, half_size=half, material=_material(draft, depth_m=centre[2]))
        )
    return solids


_SMALL_KINDS = (Kind.BOX, Kind.BOX, Kind.ELLIPSOID, Kind.CONE)
_GROUPS: tuple[Callable[[_Draft], list[Solid]], ...] = (_row, _row, _chair, _plant, _clutter, _clutter)
