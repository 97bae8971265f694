"""Layered worlds photographed through a real aperture: exact truth for bokeh, independent of the package.

Every layer is a plane ``d = a + b x + c y`` in the frame of the sharp photo. Through the lens point ``u`` of the unit
disk its point at ``x`` appears at ``x + K u (d(x) - d_focus)``, an affine map. The photo is the mean over lens points
of the layers laid over each other, in linear light. Layers are painted beyond the frame, as the world is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

MARGIN_PX = 96
POINT = np.outer((0.25, 1.0, 0.25), (0.25, 1.0, 0.25)).astype(np.float32)  # as sharp as a lens shows a point


@dataclass(frozen=True)
class PlaneLayer:
    """Premultiplied linear light and coverage (h, w, 4) with a margin; plane (a, b, c) of the frame's pixels."""

    rgba: np.ndarray
    plane: tuple[float, float, float]

    @cached_property
    def extent(self) -> tuple[int, int, int, int]:
        """First and last covered row and column of the frame."""
        rows, columns = np.flatnonzero(self.rgba[..., 3].any(axis=1)), np.flatnonzero(self.rgba[..., 3].any(axis=0))
        return tuple(int(v) - MARGIN_PX for v in (rows[0], rows[-1], columns[0], columns[-1]))


@dataclass(frozen=True)
class World:
    """Layers, far to near, and the size of the frame."""

    layers: tuple[PlaneLayer, ...]
    hw: tuple[int, int]

    def photo_linear(
        self, *, lens_xy: tuple[float, float] = (0.0, 0.0), focus: float = 0.0, k: float = 0.0
    ) -> np.ndarray:
        """Light through one lens point."""
        height, width = self.hw
        light = np.zeros((height, width, 3), np.float32)
        u = k * np.array(lens_xy)
        for layer in self.layers:
            a, b, c = layer.plane
            first_y, last_y, first_x, last_x = layer.extent
            top, bottom = max(first_y - MARGIN_PX, 0), min(last_y + MARGIN_PX + 1, height)
            left, right = max(first_x - MARGIN_PX, 0), min(last_x + MARGIN_PX + 1, width)
            inverse = np.linalg.inv(np.eye(2) + np.outer(u, (b, c)))  # x' = x + u (a + (b, c) x - focus)
            shift = inverse @ ((left, top) - u * (a - focus)) + MARGIN_PX
            seen = cv2.warpAffine(
                layer.rgba,
                np.column_stack([inverse, shift]),
                (right - left, bottom - top),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REFLECT_101,
            )
            under = light[top:bottom, left:right]
            under *= 1 - seen[..., 3:]
            under += seen[..., :3]
        return light

    def through_lens_linear(self, *, focus: float, k: float, samples: int) -> np.ndarray:
        """Mean over a golden spiral of lens points; ``k`` is the blur radius per px of disparity."""
        n = np.arange(samples)
        radius, angle = np.sqrt((n + 0.5) / samples), n * np.pi * (3 - np.sqrt(5))
        total = np.zeros((*self.hw, 3), np.float32)
        for x, y in zip(radius * np.cos(angle), radius * np.sin(angle), strict=True):
            total += self.photo_linear(lens_xy=(x, y), focus=focus, k=k)
        return total / samples

    def disparity_px(self) -> np.ndarray:
        """Hard-edged truth."""
        y, x = np.mgrid[: self.hw[0], : self.hw[1]].astype(np.float32)
        disparity = np.zeros(self.hw, np.float32)
        inside = slice(MARGIN_PX, -MARGIN_PX)
        for layer in self.layers:
            a, b, c = layer.plane
            shown = layer.rgba[inside, inside, 3] > 0.5
            disparity[shown] = (a + b * x + c * y)[shown]
        return disparity


def texture(
    rng: np.random.Generator, hw: tuple[int, int], *, colour: tuple[float, float, float], grain: float = 1.0
) -> np.ndarray:
    """Noise of several sizes around a colour, linear light."""
    light = np.zeros((*hw, 3), np.float32)
    for size, weight in ((2, 0.12), (5, 0.2), (17, 0.4), (60, 0.6)):
        small = rng.normal(size=(hw[0] // size + 3, hw[1] // size + 3, 3)).astype(np.float32)
        light += weight * cv2.resize(small, hw[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(colour, np.float32) * np.exp(0.35 * grain * light)


def painted(light: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Premultiplied RGBA."""
    return np.dstack([light * coverage[..., None], coverage]).astype(np.float32)


def coverage_of(draw, hw: tuple[int, int], *, times: int = 4) -> np.ndarray:
    """Antialias what ``draw(canvas, times)`` draws on a canvas ``times`` as large."""
    canvas = np.zeros((hw[0] * times, hw[1] * times), np.uint8)
    draw(canvas, times)
    return cv2.resize(canvas, hw[::-1], interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def with_lights(rng: np.random.Generator, layers: list[PlaneLayer], *, count: int) -> tuple[PlaneLayer, ...]:
    """Add points of light to the farthest layer, 4 to 12 times as bright as white.

    None stands behind another layer or across the border: what nobody can see nobody can render.
    """
    wall = layers[0].rgba.copy()
    hidden = np.maximum.reduce([cv2.dilate(layer.rgba[..., 3], np.ones((7, 7))) for layer in layers[1:]]) > 0
    border = MARGIN_PX + 26
    free = np.zeros_like(hidden)
    free[border:-border, border:-border] = ~hidden[border:-border, border:-border]
    places = np.argwhere(free)
    for y, x in places[rng.choice(len(places), count, replace=False)]:
        colour = rng.uniform(4, 12) * rng.uniform(0.6, 1, 3).astype(np.float32)
        wall[y - 1 : y + 2, x - 1 : x + 2, :3] += POINT[..., None] * colour
    return PlaneLayer(wall, layers[0].plane), *layers[1:]


def reference_world(size: int = 320) -> World:
    """Build a far wall with lights, a slanted ground, a wheel of thin spokes and a near post; disparity 0 to 1."""
    rng = np.random.default_rng(7)
    side = size + 2 * MARGIN_PX
    hw = (side, side)

    def at(value: float, times: int) -> int:
        return round((value * size + MARGIN_PX) * times)

    def ground(canvas, t):
        cv2.rectangle(canvas, (0, at(0.6, t)), (side * t, side * t), 255, -1)

    def wheel(canvas, t):
        centre = at(0.38, t), at(0.42, t)
        cv2.circle(canvas, centre, round(0.2 * size * t), 255, 3 * t, cv2.LINE_8)
        for k in range(9):
            angle = np.pi * k / 4.5 + 0.1
            tip = tuple(round(c + 0.2 * size * t * f(angle)) for c, f in zip(centre, (np.cos, np.sin), strict=True))
            cv2.line(canvas, centre, tip, 255, 2 * t)
        cv2.circle(canvas, centre, round(0.05 * size * t), 255, -1)

    def post(canvas, t):
        cv2.rectangle(canvas, (at(0.74, t), at(0.2, t)), (at(0.84, t), side * t), 255, -1)

    slope = 0.5 / (0.4 * size)
    surfaces = (
        ((0.12, 0.16, 0.25), 1.0, np.ones(hw, np.float32), (0.0, 0.0, 0.0)),
        ((0.3, 0.35, 0.12), 1.0, coverage_of(ground, hw), (0.1 - slope * 0.6 * size, 0.0, slope)),
        ((0.6, 0.15, 0.1), 0.4, coverage_of(wheel, hw), (0.5, 0.0, 0.0)),
        ((0.25, 0.25, 0.3), 1.0, coverage_of(post, hw), (1.0, 0.0, 0.0)),
    )
    layers = [
        PlaneLayer(painted(texture(rng, hw, colour=colour, grain=grain), coverage), plane)
        for colour, grain, coverage, plane in surfaces
    ]
    return World(with_lights(rng, layers, count=30), (size, size))


def random_world(seed: int, size: int = 320) -> World:
    """Build a wall with lights, a ground or side plane, and three to five shapes; disparity -0.5 to 0.5."""
    rng = np.random.default_rng(seed)
    side = size + 2 * MARGIN_PX
    hw = (side, side)
    light = texture(rng, hw, colour=tuple(rng.uniform(0.1, 0.4, 3)))
    layers = [PlaneLayer(painted(light, np.ones(hw, np.float32)), (-0.5, 0.0, 0.0))]
    horizon = rng.uniform(0.5, 0.7)
    slope = 0.5 / ((1 - horizon) * size)

    def ground(canvas, t):
        canvas[round((horizon * size + MARGIN_PX) * t) :] = 255

    light = texture(rng, hw, colour=tuple(rng.uniform(0.1, 0.5, 3)))
    layers.append(PlaneLayer(painted(light, coverage_of(ground, hw)), (-0.45 - slope * horizon * size, 0.0, slope)))
    for disparity in np.sort(rng.uniform(-0.3, 0.5, rng.integers(3, 6))):
        centre, extent = rng.uniform(0.1, 0.9, 2) * size + MARGIN_PX, rng.uniform(0.04, 0.16) * size
        angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
        arm = extent * rng.uniform(0.5, 1.5, 9)
        outline = centre + arm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        ends = centre + rng.normal(size=(2, 2)) * 0.2 * size
        thick = rng.uniform(2, 6)

        def shape(canvas, t, outline=outline, ends=ends, thick=thick):
            cv2.fillPoly(canvas, [np.round(outline * t).astype(np.int32)], 255)
            cv2.line(canvas, *(tuple(np.round(e * t).astype(int).tolist()) for e in ends), 255, round(thick * t))

        light = texture(rng, hw, colour=tuple(rng.uniform(0.05, 0.6, 3)), grain=rng.uniform(0.3, 1))
        layers.append(PlaneLayer(painted(light, coverage_of(shape, hw)), (float(disparity), 0.0, 0.0)))
    layers[2:] = sorted(layers[2:], key=lambda layer: layer.plane[0])
    return World(with_lights(rng, layers, count=30), (size, size))
