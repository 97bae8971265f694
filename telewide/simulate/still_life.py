"""Still lifes that are pleasant to look at, for examples and for pictures in a manual.

A cloth or a brick wall, a floor of planks, balls, pots with plants and boxes that stand on it, thin rods, and a post
close to the camera. The same surfaces with exact disparity as in :mod:`telewide.simulate.scene`, arranged instead of
strewn. Letters: h w window of an object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.simulate import shapes
from telewide.simulate.layers import Layer, LayeredScene, disparity_range_px
from telewide.simulate.texture import band_noise, drawn_texture

_PALETTES = (
    ("#264653", "#2a9d8f", "#e9c46a", "#f4a261", "#e76f51"),
    ("#003049", "#c1392b", "#f0803c", "#fcbf49", "#eae2b7"),
    ("#606c38", "#39462a", "#f3ecd2", "#dda15e", "#bc6c25"),
    ("#3d405b", "#81b29a", "#f4f1de", "#e07a5f", "#f2cc8f"),
    ("#2b3a55", "#6c8ead", "#e8d5b7", "#b5485d", "#d9a566"),
)
_LIGHT = (-0.55, -0.6, 0.58)
"""Direction towards the light: x, y, towards the viewer."""

_BULGE = 0.15
"""Relief of a round body in parts of its radius; its slope is at most twice that."""

_MARGIN_PX = 4


@dataclass(frozen=True)
class _Stage:
    """Parts that the pieces of one still life have in common.

    Attributes:
        rng: source of all draws.
        hw: size of the views.
        box: (x0, y0, x1, y1) reference pixels that one of the two views can see.
        far_px: disparity of the wall.
        near_px: largest disparity.
        colours: five (3,) sRGB colours.
    """

    rng: np.random.Generator
    hw: tuple[int, int]
    box: shapes.Box
    far_px: float
    near_px: float
    colours: tuple[FloatImage, ...]

    def two_colours(self) -> tuple[FloatImage, FloatImage]:
        """Draw two different colours of the palette."""
        first, second = self.rng.choice(len(self.colours), 2, replace=False)
        return self.colours[int(first)], self.colours[int(second)]

    def at(self, share: float) -> float:
        """Disparity between the wall (0) and the nearest thing (1), px."""
        return self.far_px + share * (self.near_px - self.far_px)


def still_life(
    rng: np.random.Generator, *, hw: tuple[int, int], disparity_window_px: tuple[float, float]
) -> LayeredScene:
    """Arrange a still life.

    Args:
        rng: source of all draws; the same state gives the same scene.
        hw: height and width of the views.
        disparity_window_px: disparity of the wall, about, and of the nearest thing, px.

    Returns:
        The scene, far to near.

    Raises:
        ValueError: when the disparity window is empty.
    """
    low, high = disparity_window_px
    if not low < high:
        raise ValueError(f"disparity_window_px is {disparity_window_px}, expected a lower and a higher bound")
    x_first, x_end = math.floor(min(0.0, low)) - _MARGIN_PX, hw[1] + math.ceil(max(0.0, high)) + _MARGIN_PX
    colours = tuple(_colour(code) for code in _PALETTES[int(rng.integers(len(_PALETTES)))])
    stage = _Stage(
        rng=rng, hw=hw, box=(x_first, 0, x_end, hw[0]), far_px=low + 0.06 * (high - low), near_px=high, colours=colours
    )
    floor = _floor(stage, horizon=float(rng.uniform(0.42, 0.58)) * hw[0])
    standing: list[Layer] = []
    places = (np.arange(5) + rng.uniform(0.15, 0.85, 5)) / 5 * hw[1]
    depths = rng.permutation(np.array([0.16, 0.28, 0.42, 0.56, 0.68])) + rng.uniform(-0.04, 0.04, 5)
    makers = [_ball, _pot, _crate, _ball, _pot]
    for maker, x, depth in zip(rng.permutation(np.arange(5)), places, depths, strict=True):
        standing += makers[int(maker)](stage, floor, float(x), stage.at(float(depth)))
    standing += _rods(stage, floor)
    standing.append(_post(stage))
    standing.sort(key=lambda layer: sum(disparity_range_px(layer)))
    return LayeredScene((_wall(stage), floor, *standing), hw)


def _colour(code: str) -> FloatImage:
    return np.array([int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)], np.float32)


def _wall(stage: _Stage) -> Layer:
    """Hanging cloth, or bricks."""
    rng = stage.rng
    height, width = stage.box[3] - stage.box[1], stage.box[2] - stage.box[0]
    span = stage.near_px - stage.far_px
    relief = None
    if rng.random() < 0.5:
        texture = _bricks(stage, hw=(height, width))
    else:
        texture = drawn_texture(rng, hw=(height, width), colours=stage.two_colours())
        y, x = np.mgrid[:height, :width].astype(np.float32)
        bend = band_noise(rng, hw=(height, width), wavelength_px=0.8 * width)
        folds = np.sin(x * np.float32(2 * math.pi / rng.uniform(50, 90)) + 2 * bend) * (0.5 + 0.5 * y / height)
        relief = np.asarray(np.float32(0.02 * span) * folds, np.float32)
        texture = texture * (1 + np.float32(0.13) * np.roll(folds, 6, axis=1))[..., None]
    fall = np.linspace(1.08, 0.72, width, dtype=np.float32)[None, :, None]
    tilt = float(rng.normal(0.0, 0.03)) * span / width
    plane = (stage.far_px - tilt * stage.hw[1] / 2, tilt, 0.0)
    return Layer(
        texture=_clipped(texture * fall), alpha=None, origin_xy=stage.box[:2], plane_px=plane, relief_px=relief
    )


def _bricks(stage: _Stage, *, hw: tuple[int, int]) -> FloatImage:
    rng = stage.rng
    y, x = np.mgrid[: hw[0], : hw[1]].astype(np.float32)
    course_px = float(rng.uniform(0.065, 0.09)) * stage.hw[0]
    row = np.floor(y / course_px)
    along = x / np.float32(2.4 * course_px) + np.float32(0.5) * (row % 2)
    inner = np.clip((0.5 - np.abs(y / course_px - row - 0.5)) * course_px - 0.6, 0, 1)
    inner *= np.clip((0.5 - np.abs(along - np.floor(along) - 0.5)) * 2.4 * course_px - 0.6, 0, 1)
    tone = rng.uniform(0.72, 1.12, (64, 64)).astype(np.float32)
    each = tone[row.astype(int) % 64, np.floor(along).astype(int) % 64]
    brick, mortar = stage.colours[4], np.float32(0.55) * stage.colours[2] + np.float32(0.3)
    texture = mortar + inner[..., None] * (brick * each[..., None] - mortar)
    return _grained(rng, texture, amount=0.12)


def _floor(stage: _Stage, *, horizon: float) -> Layer:
    """Planks that run away from the viewer."""
    rng = stage.rng
    x0, _, x1, y1 = stage.box
    slope = (stage.at(0.78) - stage.far_px) / (stage.hw[0] - horizon)
    corners = np.array([[x0 - 9.0, horizon], [x1 + 9.0, horizon], [x1 + 9.0, y1 + 9.0], [x0 - 9.0, y1 + 9.0]])
    box = shapes.box_of(corners, limits=stage.box) or stage.box
    # Seen in perspective: a row's distance falls with its height below the vanishing row.
    vanish = horizon - 0.55 * (stage.hw[0] - horizon)
    y, x = np.mgrid[box[1] : box[3], box[0] : box[2]].astype(np.float32)
    far = np.float32(stage.hw[0] - vanish) / (y - np.float32(vanish))
    across = (x - np.float32(stage.hw[1] * rng.uniform(0.3, 0.7))) * far / np.float32(0.13 * stage.hw[1])
    plank = np.floor(across)
    grain = band_noise(rng, hw=(512, 512), wavelength_px=6.0) + 0.6 * band_noise(rng, hw=(512, 512), wavelength_px=3.0)
    shift = rng.uniform(0, 512, 64).astype(np.float32)[plank.astype(int) % 64]
    wood = cv2.remap(
        np.asarray(grain, np.float32), (across * 60) % 512, (far * 60 + shift) % 512, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )  # fmt: skip
    tone = rng.uniform(0.8, 1.15, 64).astype(np.float32)[plank.astype(int) % 64]
    seam = np.clip((0.5 - np.abs(across - plank - 0.5)) * np.float32(0.13 * stage.hw[1]) / far - 0.3, 0.25, 1)
    base = np.float32(0.6) * stage.colours[3] + np.float32(0.4) * np.array([0.55, 0.38, 0.22], np.float32)
    texture = base * (tone * seam * (1 + np.float32(0.22) * np.asarray(wood, np.float32)))[..., None]
    fall = (0.62 + 0.45 * (y - box[1]) / max(1, box[3] - box[1]))[..., None]
    plane = (stage.far_px - slope * horizon, 0.0, slope)
    return Layer(_clipped(texture * fall), shapes.filled(corners, box=box), box[:2], plane)


def _ball(stage: _Stage, floor: Layer, x: float, disparity_px: float) -> list[Layer]:
    rng = stage.rng
    radius = stage.hw[0] * float(rng.uniform(0.07, 0.11)) * _nearness(stage, disparity_px)
    foot = _foot(floor, disparity_px)
    centre = (x, foot - 0.95 * radius)
    angle_rad = np.linspace(0, 2 * math.pi, 96, endpoint=False)
    circle = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    outline = shapes.placed(circle, centre_xy=centre, radii_px=(radius, radius), angle_rad=0.0)
    box = shapes.box_of(outline, limits=stage.box)
    if box is None:
        return []
    _contact_shadow(floor, x=x, foot=foot, radius_px=radius)
    u, v = (axis / np.float32(radius) for axis in shapes.turned_grid(box=box, centre_xy=centre, angle_rad=0.0))
    pattern = drawn_texture(rng, hw=(256, 256), colours=stage.two_colours())
    # The pattern is wrapped around the ball: it narrows towards the outline.
    spread = np.float32(min(80.0, 1.0 * radius))
    wrapped = cv2.remap(
        pattern, 128 + spread * np.arcsin(np.clip(u, -1, 1)), 128 + spread * np.arcsin(np.clip(v, -1, 1)),
        cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101,
    )  # fmt: skip
    towards = np.sqrt(np.clip(1 - u * u - v * v, 0.02, 1))
    texture = _lit(np.asarray(wrapped, np.float32), u, v, towards)
    relief = np.float32(_BULGE * radius) * shapes.dome(u, v)
    return [
        Layer(
            texture=texture,
            alpha=shapes.filled(outline, box=box),
            origin_xy=box[:2],
            plane_px=(disparity_px, 0.0, 0.0),
            relief_px=_relief(relief),
        )
    ]


def _pot(stage: _Stage, floor: Layer, x: float, disparity_px: float) -> list[Layer]:
    """A pot, mostly with a plant."""
    rng = stage.rng
    half_height = stage.hw[0] * float(rng.uniform(0.08, 0.14)) * _nearness(stage, disparity_px)
    foot = _foot(floor, disparity_px)
    centre = (x, foot - half_height)
    t = np.linspace(-1.0, 1.0, 33)
    belly = 0.62 + rng.uniform(-0.1, 0.22) * np.cos(math.pi * (t - rng.uniform(-0.2, 0.3)))
    belly = belly + np.where(t < -0.8, 0.1, 0.0)
    polygon = np.stack([np.concatenate([belly, -belly[::-1]]), np.concatenate([t, t[::-1]])], axis=1)
    outline = shapes.placed(polygon, centre_xy=centre, radii_px=(half_height, half_height), angle_rad=0.0)
    box = shapes.box_of(outline, limits=stage.box)
    if box is None:
        return []
    _contact_shadow(floor, x=x, foot=foot, radius_px=0.7 * half_height)
    along, across = shapes.turned_grid(box=box, centre_xy=centre, angle_rad=0.0)
    half_width = np.interp(across[:, :1] / half_height, t, belly).astype(np.float32) * np.float32(half_height)
    u = np.clip(along / half_width, -1.1, 1.1)
    texture = drawn_texture(rng, hw=u.shape, colours=stage.two_colours())
    lit = _lit(texture, u, np.zeros_like(u), np.sqrt(np.clip(1 - u * u, 0.02, 1)))
    relief = np.float32(_BULGE) * half_width * (1 - np.minimum(u * u, 1))
    pot = Layer(
        texture=lit,
        alpha=shapes.filled(outline, box=box),
        origin_xy=box[:2],
        plane_px=(disparity_px, 0.0, 0.0),
        relief_px=_relief(relief),
    )
    rim = (x, foot - 1.9 * half_height)
    return [*_leaves(stage, rim, disparity_px=disparity_px, length_px=2.2 * half_height), pot]


def _leaves(stage: _Stage, root_xy: tuple[float, float], *, disparity_px: float, length_px: float) -> list[Layer]:
    rng = stage.rng
    leaves: list[Layer] = []
    green = np.array([0.25, 0.42, 0.18], np.float32) * np.float32(rng.uniform(0.7, 1.3))
    pale = np.clip(green * np.array([1.7, 1.6, 1.4], np.float32), 0, 0.9)
    for angle_rad in np.linspace(-2.7, -0.45, int(rng.integers(6, 10))) + rng.normal(0.0, 0.1):
        own_px = length_px * float(rng.uniform(0.6, 1.1))
        outline = shapes.placed(
            shapes.leaf_outline(rng), centre_xy=root_xy, radii_px=(own_px, own_px), angle_rad=float(angle_rad)
        )
        box = shapes.box_of(outline, limits=stage.box)
        if box is None:
            continue
        along, across = shapes.turned_grid(box=box, centre_xy=root_xy, angle_rad=float(angle_rad))
        vein = np.exp(-np.abs(across) / 1.5) + np.float32(0.4) * np.sin(np.abs(across) + along * np.float32(0.8))
        shade = np.float32(rng.uniform(0.75, 1.1)) + np.float32(0.25) * along / np.float32(own_px)
        texture = _grained(rng, (green + (pale - green) * vein[..., None]) * shade[..., None], amount=0.08)
        slope = float(rng.uniform(-0.1, 0.1))
        slopes = (slope * math.cos(angle_rad), slope * math.sin(angle_rad))
        plane = (disparity_px - slopes[0] * root_xy[0] - slopes[1] * root_xy[1], *slopes)
        leaves.append(Layer(texture, shapes.filled(outline, box=box), box[:2], plane))
    return leaves


def _crate(stage: _Stage, floor: Layer, x: float, disparity_px: float) -> list[Layer]:
    """A box seen on its edge from above: two faces that lean away, and its top."""
    rng = stage.rng
    size = stage.hw[0] * float(rng.uniform(0.11, 0.16)) * _nearness(stage, disparity_px)
    foot = _foot(floor, disparity_px)
    shift, rise, top_rise = float(rng.uniform(-0.25, 0.25)), 0.3, 0.22
    near, far = 0.8 + shift, 0.8 - shift
    # The faces lean away as fast as the floor does, so that their lower edges rest on it.
    lean = floor.plane_px[2] * rise / 0.8
    front = np.array([[-near, -1 - top_rise], [0, -1], [far, -1 - top_rise], [far, -rise], [0, 0], [-near, -rise]])
    lid = np.array([[-near, -1 - top_rise], [0, -1], [far, -1 - top_rise], [far - near, -1 - 2 * top_rise]])
    colours = stage.two_colours()
    _contact_shadow(floor, x=x, foot=foot - 0.2 * size, radius_px=0.9 * size)
    faces: list[Layer] = []
    for polygon, is_lid in ((front, False), (lid, True)):
        outline = shapes.placed(polygon, centre_xy=(x, foot), radii_px=(size, size), angle_rad=0.0)
        box = shapes.box_of(outline, limits=stage.box)
        if box is None:
            continue
        along, _ = shapes.turned_grid(box=box, centre_xy=(x, foot), angle_rad=0.0)
        light = np.full_like(along, 1.2) if is_lid else np.where(along < 0, np.float32(1.0), np.float32(0.6))
        texture = _clipped(drawn_texture(rng, hw=along.shape, colours=colours) * light[..., None])
        b = lean * shift / 0.8 if is_lid else 0.0
        c = far * (b + lean) / top_rise if is_lid else 0.0
        # Where surfaces touch, rounding must not decide which one is seen.
        lift_px = 0.2 if is_lid else 0.4
        plane = (disparity_px + lift_px - b * x - c * (foot - size), b, c)
        relief = None if is_lid else _relief(-np.float32(lean) * np.abs(along))
        faces.append(
            Layer(
                texture=texture,
                alpha=shapes.filled(outline, box=box),
                origin_xy=box[:2],
                plane_px=plane,
                relief_px=relief,
            )
        )
    return faces


def _rods(stage: _Stage, floor: Layer) -> list[Layer]:
    """Thin slanted rods that reach from the floor out of the picture."""
    rng = stage.rng
    rods: list[Layer] = []
    x = stage.hw[1] * float(rng.uniform(0.25, 0.8))
    for _ in range(int(rng.integers(2, 4))):
        x += float(rng.uniform(0.03, 0.09)) * stage.hw[1]
        angle_rad = math.pi / 2 + float(rng.normal(0.0, 0.12))
        width_px = float(rng.uniform(0.008, 0.016)) * stage.hw[0]
        disparity_px = stage.at(float(rng.uniform(0.2, 0.7)))
        foot = (x, _foot(floor, disparity_px))
        end = (foot[0] - stage.hw[0] * math.cos(angle_rad), foot[1] - stage.hw[0] * math.sin(angle_rad))
        box = shapes.box_of(np.add([foot, end], [[-width_px, 0], [width_px, 0]]), limits=stage.box)
        if box is None:
            continue
        alpha = shapes.bar(box=box, through_xy=foot, angle_rad=angle_rad, width_px=width_px)
        along, across = shapes.turned_grid(box=box, centre_xy=foot, angle_rad=angle_rad)
        first, second = stage.two_colours()
        band = np.clip(0.5 + 3 * np.sin(along * np.float32(2 * math.pi / (0.1 * stage.hw[0]))), 0, 1)[..., None]
        texture = (first + (second - first) * band) * (1 - np.float32(0.5) * across / np.float32(width_px))[..., None]
        rods.append(Layer(_clipped(texture), alpha, box[:2], (disparity_px, 0.0, 0.0)))
    return rods


def _post(stage: _Stage) -> Layer:
    """A thick round post near the camera, at one side."""
    rng = stage.rng
    width_px = float(rng.uniform(0.05, 0.075)) * stage.hw[1]
    share = float(rng.uniform(0.08, 0.2))
    x = stage.hw[1] * (share if rng.random() < 0.5 else 1 - share)
    centre = (x, 0.5 * stage.hw[0])
    box = (max(stage.box[0], math.floor(x - width_px)), 0, min(stage.box[2], math.ceil(x + width_px)), stage.hw[0])
    alpha = shapes.bar(box=box, through_xy=centre, angle_rad=math.pi / 2, width_px=width_px)
    u = (np.arange(box[0], box[2], dtype=np.float32) - np.float32(x))[None, :] / np.float32(width_px / 2)
    u = np.repeat(np.clip(u, -1, 1), box[3] - box[1], axis=0)
    y = np.arange(box[1], box[3], dtype=np.float32)[:, None]
    first, second = stage.two_colours()
    twist = np.sin((y + 0.6 * width_px * np.arcsin(u)) * np.float32(2 * math.pi / (1.5 * width_px)))
    texture = _grained(rng, first + (second - first) * np.clip(0.5 + 2.5 * twist, 0, 1)[..., None], amount=0.1)
    lit = _lit(texture, u, np.zeros_like(u), np.sqrt(np.clip(1 - u * u, 0.02, 1)))
    relief = np.float32(_BULGE * width_px / 2) * (1 - u * u)
    return Layer(
        texture=lit,
        alpha=alpha,
        origin_xy=box[:2],
        plane_px=(stage.near_px - _BULGE * width_px / 2, 0.0, 0.0),
        relief_px=_relief(relief),
    )


def _nearness(stage: _Stage, disparity_px: float) -> float:
    """Size at which a thing looks: nearer is larger."""
    return 0.75 + 0.9 * (disparity_px - stage.far_px) / (stage.near_px - stage.far_px)


def _foot(floor: Layer, disparity_px: float) -> float:
    """Row of the floor that has this disparity."""
    a, _, c = floor.plane_px
    return (disparity_px - a) / c


def _contact_shadow(floor: Layer, *, x: float, foot: float, radius_px: float) -> None:
    """Darken the floor under a thing and on the side away from the light (the floor's texture changes)."""
    height, width = floor.texture.shape[:2]
    dx = (np.arange(width, dtype=np.float32) + floor.origin_xy[0] - np.float32(x + 0.5 * radius_px))[None, :]
    dy = (np.arange(height, dtype=np.float32) + floor.origin_xy[1] - np.float32(foot))[:, None]
    reach = (dx / np.float32(1.5 * radius_px)) ** 2 + (dy / np.float32(0.4 * radius_px)) ** 2
    floor.texture[:] *= (1 - np.float32(0.6) * np.exp(-(reach**2)))[..., None]


def _lit(texture: FloatImage, x: FloatMap, y: FloatMap, z: FloatMap) -> FloatImage:
    """Light a surface with the normal (x, y, z): diffuse, with a small highlight that stays on the surface."""
    facing = x * np.float32(_LIGHT[0]) + y * np.float32(_LIGHT[1]) + z * np.float32(_LIGHT[2])
    facing = np.clip(facing, 0.0, 1.0)
    shine = np.float32(0.35) * facing**24
    return _clipped(texture * (np.float32(0.32) + np.float32(0.85) * facing)[..., None] + shine[..., None])


def _grained(rng: np.random.Generator, texture: FloatImage, *, amount: float) -> FloatImage:
    hw = (texture.shape[0], texture.shape[1])
    grain = band_noise(rng, hw=hw, wavelength_px=3.0) + band_noise(rng, hw=hw, wavelength_px=9.0)
    return _clipped(texture * (1 + np.float32(amount) * grain)[..., None])


def _relief(values: FloatMap) -> FloatMap:
    return np.asarray(values, np.float32)


def _clipped(texture: FloatImage) -> FloatImage:
    return np.asarray(np.clip(texture, 0.0, 1.0), dtype=np.float32)
