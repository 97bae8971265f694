"""Random still lifes with known disparity, to train and to judge matchers on.

A scene has a wall (slanted, folded like a corner, or hanging like cloth), often a floor, and objects before them:
stones, boxes, pots and balls with gentle reliefs, poles and bars, plants with thin slanted leaves, frames with holes.
Some share the texture of what is behind them, some have hardly any, some repeat. Everything is in reference pixels.
Letters: H W image, h w window of an object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatArray, FloatImage, FloatMap
from telewide.simulate import shapes
from telewide.simulate.layers import (
    Layer,
    LayeredScene,
    RenderedPair,
    disparity_range_px,
    render_pair,
    render_view,
)
from telewide.simulate.texture import band_noise, drawn_texture, photo_texture, tiled_texture, weak_texture

__all__ = [
    "Layer",
    "LayeredScene",
    "RenderedPair",
    "random_scene",
    "render_pair",
    "render_view",
]


_MARGIN_PX = 4
_LARGEST_SLOPE = 0.3
"""Largest slope of a surface, px of disparity per px: steeper ones hide themselves in the other view."""


@dataclass(frozen=True)
class _World:
    """Parts that the pieces of one scene have in common.

    Attributes:
        rng: source of all draws.
        hw: size of the views.
        box: (x0, y0, x1, y1) reference pixels that one of the two views can see.
        low_px: least disparity of the scene.
        high_px: largest disparity of the scene.
        photos: pictures to paint with; may be empty.
        favourite: the photo that the wall and some objects share, or None.
    """

    rng: np.random.Generator
    hw: tuple[int, int]
    box: shapes.Box
    low_px: float
    high_px: float
    photos: tuple[FloatImage, ...]
    favourite: FloatImage | None


def random_scene(
    rng: np.random.Generator,
    *,
    hw: tuple[int, int],
    disparity_window_px: tuple[float, float],
    photos: Sequence[FloatImage] | None = None,
    n_layers: tuple[int, int] = (4, 10),
) -> LayeredScene:
    """Draw a still life.

    Args:
        rng: source of all draws; the same state gives the same scene.
        hw: height and width of the views.
        disparity_window_px: every visible disparity lies within these bounds, px.
        photos: (H, W, 3) float32 sRGB pictures whose pieces paint the surfaces; None for drawn patterns only.
        n_layers: least and largest number of objects before the wall; a plant counts as one.

    Returns:
        The scene, far to near.

    Raises:
        ValueError: when the disparity window is empty.
    """
    world = _new_world(rng, hw=hw, window_px=disparity_window_px, photos=tuple(photos or ()))
    wall = _wall(world)
    ground = _floor(world, wall) if rng.random() < 0.45 else None
    behind = [wall] if ground is None else [wall, ground]
    objects: list[Layer] = []
    wall_px = float(np.mean(disparity_range_px(wall)))
    anchor_px = float(rng.uniform(wall_px, world.high_px))
    for _ in range(int(rng.integers(n_layers[0], n_layers[1] + 1))):
        # A third of the objects crowd around one distance, so that small steps of disparity occur too.
        near_anchor = rng.random() < 0.3
        disparity_px = anchor_px + rng.normal(0.0, 2.0) if near_anchor else rng.uniform(wall_px, world.high_px)
        objects += _object(world, ground, disparity_px=float(disparity_px))
    objects.sort(key=lambda layer: sum(disparity_range_px(layer)))
    if rng.random() < 0.5:
        for layer in objects:
            _cast_shadow(rng, layer, behind)
    return LayeredScene((*behind, *objects), hw)


def _new_world(
    rng: np.random.Generator, *, hw: tuple[int, int], window_px: tuple[float, float], photos: tuple[FloatImage, ...]
) -> _World:
    low, high = float(window_px[0]), float(window_px[1])
    if not low < high:
        raise ValueError(f"disparity_window_px is {window_px}, expected a lower and a higher bound")
    # Most scenes fill the window, some only a part of it.
    share = float(rng.uniform(0.3, 1.0)) ** 0.5
    start = low + float(rng.uniform(0.0, 1.0 - share)) * (high - low)
    x_first = math.floor(min(0.0, low)) - _MARGIN_PX
    x_end = hw[1] + math.ceil(max(0.0, high)) + _MARGIN_PX
    favourite = photos[int(rng.integers(len(photos)))] if photos else None
    return _World(
        rng=rng,
        hw=hw,
        box=(x_first, 0, x_end, hw[0]),
        low_px=start,
        high_px=start + share * (high - low),
        photos=photos,
        favourite=favourite,
    )


def _paint(world: _World, *, hw: tuple[int, int], weak_share: float = 0.15) -> FloatImage:
    """Choose what a surface looks like."""
    rng = world.rng
    draw = rng.random()
    source = world.photos[int(rng.integers(len(world.photos)))] if world.photos else None
    if draw < weak_share:
        return weak_texture(rng, source, hw=hw)
    if source is None or world.favourite is None or draw > 0.92:
        return drawn_texture(rng, hw=hw)
    if draw > 0.86:
        return tiled_texture(rng, world.photos, hw=hw)
    photo = world.favourite if rng.random() < 0.3 else source
    texture = photo_texture(rng, photo, hw=hw)
    if rng.random() < 0.08:
        texture = np.asarray(cv2.blur(texture, (15, 15), borderType=cv2.BORDER_REFLECT_101), np.float32)
    return texture


def _wall(world: _World) -> Layer:
    rng = world.rng
    height, width = world.box[3] - world.box[1], world.box[2] - world.box[0]
    span = world.high_px - world.low_px
    depth_px = span * float(rng.uniform(0.02, 0.6)) ** 1.5
    relief = None
    draw = rng.random()
    if draw < 0.25:
        relief = band_noise(rng, hw=(height, width), wavelength_px=float(rng.uniform(0.5, 1.5) * width))
    elif draw < 0.4:
        middle = (rng.uniform(world.box[0], world.box[2]), world.hw[0] / 2)
        u, v = shapes.turned_grid(box=world.box, centre_xy=middle, angle_rad=float(rng.normal(0.0, 0.1)))
        relief = shapes.fold(u / np.float32(width / 2), v) * np.float32(rng.choice([-1.0, 1.0]))
    if relief is not None:
        relief = np.asarray(relief * np.float32(rng.uniform(0.1, 0.3) * span), np.float32)
    plane = (0.0, float(rng.normal(0.0, 0.1)) * span / width, float(rng.normal(0.0, 0.2)) * span / height)
    texture = _paint(world, hw=(height, width), weak_share=0.2)
    layer = Layer(texture=texture, alpha=None, origin_xy=world.box[:2], plane_px=plane, relief_px=relief)
    low, high = disparity_range_px(layer)
    shift_px = world.low_px + depth_px - (low + high) / 2
    return _within_window(world, _shaded(rng, _moved(layer, shift_px)))


def _floor(world: _World, wall: Layer) -> Layer:
    """A floor or a table top that rises towards the viewer from a horizon on the wall."""
    rng = world.rng
    x0, _, x1, y1 = world.box
    horizon = float(rng.uniform(0.25, 0.85)) * world.hw[0]
    tilt = float(rng.normal(0.0, 0.04))
    a, b, c = wall.plane_px
    at_wall_px = a + b * world.hw[1] / 2 + c * horizon + float(rng.uniform(-0.05, 0.1)) * (world.high_px - world.low_px)
    near_px = world.low_px + float(rng.uniform(0.4, 1.0)) * (world.high_px - world.low_px)
    slope = max(0.02, (near_px - at_wall_px) / (y1 - horizon))
    corners = np.array([[x0, horizon], [x1, horizon + tilt * (x1 - x0)], [x1 + 9, y1 + 9], [x0 - 9, y1 + 9]])
    corners[0, 0] -= 9
    corners[1, 0] += 9
    box = shapes.box_of(corners, limits=world.box) or world.box
    hw = (box[3] - box[1], box[2] - box[0])
    plane = (at_wall_px - slope * horizon, float(rng.normal(0.0, 0.01)), slope)
    layer = Layer(_paint(world, hw=hw, weak_share=0.25), shapes.filled(corners, box=box), box[:2], plane)
    return _within_window(world, layer)


def _object(world: _World, ground: Layer | None, *, disparity_px: float) -> list[Layer]:
    draw = world.rng.random()
    if draw < 0.14:
        return _plant(world, disparity_px=disparity_px)
    if draw < 0.3:
        return _bars(world, disparity_px=disparity_px)
    return _solid(world, ground, disparity_px=disparity_px)


def _solid(world: _World, ground: Layer | None, *, disparity_px: float) -> list[Layer]:
    """A blob, stone, box, ball or pot, at times with a hole, at times standing on the floor."""
    rng = world.rng
    size = min(world.hw) * math.exp(rng.uniform(math.log(0.06), math.log(0.5)))
    radii = (size * float(rng.uniform(0.6, 1.5)), size * float(rng.uniform(0.6, 1.5)))
    centre = (float(rng.uniform(0, world.hw[1])), float(rng.uniform(0, world.hw[0])))
    if ground is not None and rng.random() < 0.6:
        foot = _foot_on(ground, x=centre[0], disparity_px=disparity_px)
        centre = (centre[0], foot - 0.85 * radii[1])
    angle_rad = float(rng.normal(0.0, 0.15)) if rng.random() < 0.6 else float(rng.uniform(0, math.pi))
    outline = shapes.placed(shapes.random_outline(rng), centre_xy=centre, radii_px=radii, angle_rad=angle_rad)
    box = shapes.box_of(outline, limits=world.box)
    if box is None:
        return []
    holes: tuple[FloatArray, ...] = ()
    if rng.random() < 0.12:
        share = float(rng.uniform(0.3, 0.75))
        inner = (radii[0] * share, radii[1] * share)
        holes = (shapes.placed(shapes.random_outline(rng), centre_xy=centre, radii_px=inner, angle_rad=angle_rad),)
    relief = None
    if rng.random() < 0.7:
        u, v = shapes.turned_grid(box=box, centre_xy=centre, angle_rad=angle_rad)
        shape = shapes.RELIEFS[int(rng.integers(len(shapes.RELIEFS)))]
        bulge_px = float(rng.uniform(0.03, 0.14)) * min(radii) * float(rng.choice([-1.0, 1.0], p=[0.2, 0.8]))
        relief = np.asarray(
            np.float32(bulge_px) * shape(u / np.float32(radii[0]), v / np.float32(radii[1])), np.float32
        )
    hw = (box[3] - box[1], box[2] - box[0])
    plane = _plane_at(centre, disparity_px=disparity_px, slopes=_random_slopes(rng))
    layer = Layer(_paint(world, hw=hw, weak_share=0.2), shapes.filled(outline, box=box, holes=holes), box[:2], plane)
    layer = Layer(texture=layer.texture, alpha=layer.alpha, origin_xy=layer.origin_xy, plane_px=plane, relief_px=relief)
    return [_within_window(world, _shaded(rng, layer))]


def _bars(world: _World, *, disparity_px: float) -> list[Layer]:
    """A pole, or a few parallel or crossing bars of one fence."""
    rng = world.rng
    centre = (float(rng.uniform(0, world.hw[1])), float(rng.uniform(0, world.hw[0])))
    angle_rad = float(rng.normal(math.pi / 2, 0.15)) if rng.random() < 0.6 else float(rng.uniform(0, math.pi))
    width_px = float(rng.uniform(1.0, 6.0)) * max(1.0, min(world.hw) / 256) * (2.0 if rng.random() < 0.3 else 1.0)
    count = 1 if rng.random() < 0.55 else int(rng.integers(2, 6))
    spacing_px = float(rng.uniform(4.0, 14.0)) * width_px
    length_px = float(rng.uniform(0.3, 1.6)) * max(world.hw)
    half = (length_px / 2, count * spacing_px / 2 + width_px)
    frame = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    box = shapes.box_of(shapes.placed(frame, centre_xy=centre, radii_px=half, angle_rad=angle_rad), limits=world.box)
    if box is None:
        return []
    curvature = float(rng.normal(0.0, 0.4)) / length_px if rng.random() < 0.4 else 0.0
    alpha: FloatMap = np.zeros((box[3] - box[1], box[2] - box[0]), np.float32)
    for number in range(count):
        shift = (number - (count - 1) / 2) * spacing_px
        through = (centre[0] - shift * math.sin(angle_rad), centre[1] + shift * math.cos(angle_rad))
        one = shapes.bar(
            box=box, through_xy=through, angle_rad=angle_rad, width_px=width_px, curvature_per_px=curvature
        )
        np.maximum(alpha, one, out=alpha)
    along, _ = shapes.turned_grid(box=box, centre_xy=centre, angle_rad=angle_rad)
    alpha *= np.clip(np.float32(length_px / 2) - np.abs(along), np.float32(0.0), np.float32(1.0))
    slope = float(rng.normal(0.0, 0.04))
    plane = _plane_at(
        centre, disparity_px=disparity_px, slopes=(slope * math.cos(angle_rad), slope * math.sin(angle_rad))
    )
    texture = _paint(world, hw=alpha.shape, weak_share=0.4)
    return [_within_window(world, Layer(texture, alpha, box[:2], plane))]


def _plant(world: _World, *, disparity_px: float) -> list[Layer]:
    """Thin slanted leaves around one stem, all of much the same colour."""
    rng = world.rng
    centre = (float(rng.uniform(0, world.hw[1])), float(rng.uniform(0.2, 1.0)) * world.hw[0])
    length_px = float(rng.uniform(0.15, 0.6)) * min(world.hw)
    middle_rad = float(rng.normal(-math.pi / 2, 0.5))
    spread_rad = float(rng.uniform(0.4, 1.8))
    paint = _paint(world, hw=(96, 96), weak_share=0.3)
    leaves: list[Layer] = []
    for _ in range(int(rng.integers(4, 10))):
        angle_rad = middle_rad + float(rng.uniform(-spread_rad, spread_rad))
        own_px = length_px * float(rng.uniform(0.5, 1.0))
        outline = shapes.placed(
            shapes.leaf_outline(rng), centre_xy=centre, radii_px=(own_px, own_px), angle_rad=angle_rad
        )
        box = shapes.box_of(outline, limits=world.box)
        if box is None:
            continue
        hw = (box[3] - box[1], box[2] - box[0])
        texture = photo_texture(rng, paint, hw=hw, scale=(0.8, 1.6))
        slope = float(np.clip(rng.normal(0.0, 0.1), -0.25, 0.25))
        plane = _plane_at(
            centre, disparity_px=disparity_px, slopes=(slope * math.cos(angle_rad), slope * math.sin(angle_rad))
        )
        leaves.append(_within_window(world, Layer(texture, shapes.filled(outline, box=box), box[:2], plane)))
    return leaves


def _random_slopes(rng: np.random.Generator) -> tuple[float, float]:
    """Slopes of an object's plane: mostly slight, at times strong."""
    spread = 0.03 if rng.random() < 0.7 else 0.12
    x, y = np.clip(rng.normal(0.0, spread, 2), -_LARGEST_SLOPE, _LARGEST_SLOPE)
    return float(x), float(y)


def _plane_at(
    centre_xy: tuple[float, float], *, disparity_px: float, slopes: tuple[float, float]
) -> tuple[float, float, float]:
    return disparity_px - slopes[0] * centre_xy[0] - slopes[1] * centre_xy[1], slopes[0], slopes[1]


def _foot_on(ground: Layer, *, x: float, disparity_px: float) -> float:
    """Row of the floor that has this disparity in this column."""
    a, b, c = ground.plane_px
    return (disparity_px - a - b * x) / c if c > 0 else float(ground.origin_xy[1])


def _moved(layer: Layer, shift_px: float) -> Layer:
    a, b, c = layer.plane_px
    return Layer(
        texture=layer.texture,
        alpha=layer.alpha,
        origin_xy=layer.origin_xy,
        plane_px=(a + shift_px, b, c),
        relief_px=layer.relief_px,
    )


def _within_window(world: _World, layer: Layer) -> Layer:
    """Flatten and shift a surface until all its disparities are the scene's."""
    low, high = disparity_range_px(layer)
    span = world.high_px - world.low_px
    a, b, c = layer.plane_px
    relief = layer.relief_px
    if high - low > span:
        flatter = 0.98 * span / (high - low)
        middle = (low + high) / 2
        a, b, c = middle + flatter * (a - middle), flatter * b, flatter * c
        relief = None if relief is None else np.asarray(relief * np.float32(flatter), np.float32)
        low, high = middle + flatter * (low - middle), middle + flatter * (high - middle)
    shift = max(0.0, world.low_px - low) - max(0.0, high - world.high_px)
    return Layer(
        texture=layer.texture,
        alpha=layer.alpha,
        origin_xy=layer.origin_xy,
        plane_px=(a + shift, b, c),
        relief_px=relief,
    )


def _shaded(rng: np.random.Generator, layer: Layer) -> Layer:
    """Darken the side of a relief that looks away from a light, and everything a little along one direction."""
    height, width = layer.texture.shape[:2]
    angle_rad = float(rng.uniform(0, 2 * math.pi))
    direction = (math.cos(angle_rad), math.sin(angle_rad))
    x = np.linspace(-1.0, 1.0, width, dtype=np.float32)[None, :]
    y = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, None]
    falloff = np.float32(rng.uniform(0.0, 0.2))
    light: FloatMap = 1 + falloff * (np.float32(direction[0]) * x + np.float32(direction[1]) * y)
    if layer.relief_px is not None:
        slope_x = np.asarray(cv2.Sobel(layer.relief_px, cv2.CV_32F, 1, 0, scale=1 / 8), np.float32)
        slope_y = np.asarray(cv2.Sobel(layer.relief_px, cv2.CV_32F, 0, 1, scale=1 / 8), np.float32)
        lean = np.float32(direction[0]) * slope_x + np.float32(direction[1]) * slope_y
        light = np.asarray(light + np.float32(rng.uniform(0.0, 3.0)) * lean, np.float32)
    texture = np.clip(layer.texture * np.clip(light, 0.3, 1.6)[..., None], 0.0, 1.0)
    return Layer(
        texture=np.asarray(texture, np.float32),
        alpha=layer.alpha,
        origin_xy=layer.origin_xy,
        plane_px=layer.plane_px,
        relief_px=layer.relief_px,
    )


def _cast_shadow(rng: np.random.Generator, layer: Layer, behind: list[Layer]) -> None:
    """Paint a soft shadow of an object on what is behind it (their textures change)."""
    if layer.alpha is None:
        return
    height, width = layer.alpha.shape
    coarse = cv2.resize(layer.alpha, (max(2, width // 4), max(2, height // 4)), interpolation=cv2.INTER_AREA)
    sigma = float(rng.uniform(0.8, 2.5))
    coarse = cv2.GaussianBlur(np.pad(coarse, 4), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    shadow = np.asarray(cv2.resize(coarse, (width + 32, height + 32)), np.float32) * np.float32(rng.uniform(0.1, 0.4))
    reach = 8.0
    x_shadow = layer.origin_xy[0] - 16 + round(rng.uniform(-reach, reach))
    y_shadow = layer.origin_xy[1] - 16 + round(rng.uniform(0.0, reach))
    for surface in behind:
        x, y = x_shadow - surface.origin_xy[0], y_shadow - surface.origin_xy[1]
        x0, y0 = max(0, x), max(0, y)
        x1, y1 = min(surface.texture.shape[1], x + width + 32), min(surface.texture.shape[0], y + height + 32)
        if x0 < x1 and y0 < y1:
            surface.texture[y0:y1, x0:x1] *= 1 - shadow[y0 - y : y1 - y, x0 - x : x1 - x, None]
