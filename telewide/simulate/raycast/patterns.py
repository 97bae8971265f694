"""Square textures in many families: what the surfaces of homes, streets and gardens look like from near.

All are (h, h, 3) float32, sRGB in [0, 1].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage
from telewide.simulate.texture import band_noise, drawn_texture, photo_texture, tiled_texture

PHOTO_SHARE = 0.6
"""Share of the textures that are cut from photos where there are any."""


def draw_texture(rng: np.random.Generator, *, side_px: int, photos: Sequence[FloatImage] = ()) -> FloatImage:
    """Draw a texture of a random family, or cut one from a photo.

    Args:
        rng: source of all draws.
        side_px: h.
        photos: (H, W, 3) float32 sRGB; may be empty.
    """
    if photos and rng.random() < PHOTO_SHARE:
        photo = photos[int(rng.integers(len(photos)))]
        return photo_texture(rng, photo, hw=(side_px, side_px), scale=(0.5, 1.5))
    return _FAMILIES[int(rng.integers(len(_FAMILIES)))](rng, side_px)


def _colours(rng: np.random.Generator, count: int) -> FloatImage:
    """Colours of one family, mostly muted: (count, 3)."""
    base = rng.uniform(0.1, 0.85) + rng.normal(0, rng.choice([0.03, 0.08, 0.2]), 3)
    spread = rng.uniform(0.05, 0.35)
    colours = base + rng.normal(0, spread, (count, 1)) + rng.normal(0, 0.4 * spread, (count, 3))
    return np.clip(colours, 0.02, 0.98).astype(np.float32)


def _octaves(rng: np.random.Generator, side: int, *, coarsest_px: float, falloff: float) -> NDArray[np.float32]:
    total, weight, wavelength = np.zeros((side, side), np.float32), 1.0, coarsest_px
    while wavelength >= 2.5:
        total += np.float32(weight) * band_noise(rng, hw=(side, side), wavelength_px=wavelength)
        weight *= falloff
        wavelength /= 2
    return total / np.float32(max(1e-3, total.std()))


def _clouds(rng: np.random.Generator, side: int) -> FloatImage:
    """Noise over octaves, coloured by a ramp through three colours: stone, plaster, earth, lawn."""
    height = _octaves(rng, side, coarsest_px=rng.uniform(8, 200), falloff=rng.uniform(0.55, 1.0))
    ramp = _colours(rng, 3)
    t = np.clip(0.5 + 0.22 * height, 0, 1)[..., None] * 2
    return _clipped(np.where(t < 1, ramp[0] + (ramp[1] - ramp[0]) * t, ramp[1] + (ramp[2] - ramp[1]) * (t - 1)))


def _dead_leaves(rng: np.random.Generator, side: int) -> FloatImage:
    """Shapes of all sizes that cover one another: the statistics of natural pictures."""
    canvas = np.empty((side, side, 3), np.float32)
    canvas[:] = _colours(rng, 1)[0]
    palette = _colours(rng, 12)
    smallest, largest = rng.uniform(1.5, 5), rng.uniform(20, 70)
    for _ in range(int(rng.integers(200, 700))):
        # Density of radii ~ r^-3, so that every octave of sizes covers the same area.
        radius = 1 / math.sqrt(rng.uniform(1 / largest**2, 1 / smallest**2))
        x, y = rng.uniform(0, side, 2)
        colour = tuple(float(c) for c in palette[rng.integers(12)] * rng.uniform(0.8, 1.2))
        kind = rng.integers(3)
        if kind == 0:
            cv2.circle(canvas, (int(x * 8), int(y * 8)), int(radius * 8), colour, -1, cv2.LINE_AA, 3)
        else:
            count = int(rng.integers(3, 8)) if kind == 1 else 4
            angle = np.sort(rng.uniform(0, 2 * math.pi, count))
            points = np.stack([x + radius * np.cos(angle), y + radius * rng.uniform(0.3, 1) * np.sin(angle)], axis=1)
            cv2.fillPoly(canvas, [np.rint(points * 8).astype(np.int32)], colour, cv2.LINE_AA, 3)
    return _grained(rng, canvas)


def _cells(rng: np.random.Generator, side: int) -> FloatImage:
    """Voronoi cells with seams: gravel, cobbles, mosaics, leather."""
    count = int(rng.integers(30, 500))
    seeds = rng.uniform(0, side, (count, 2)).astype(np.float32)
    mask = np.full((side, side), 255, np.uint8)
    points = np.clip(np.rint(seeds), 0, side - 1).astype(int)
    mask[points[:, 1], points[:, 0]] = 0
    distance, labels = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    palette = _colours(rng, 16)[rng.integers(0, 16, labels.max() + 1)]
    colour = palette[labels] * np.float32(rng.uniform(0.8, 1.1))
    seam = (cv2.morphologyEx(labels.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0)[..., None]
    dome = 1 - np.float32(rng.uniform(0, 0.6)) * (distance / max(1.0, float(distance.max())))[..., None]
    return _grained(rng, np.where(seam, colour * np.float32(rng.uniform(0.3, 1)), colour * dome).astype(np.float32))


def _wood(rng: np.random.Generator, side: int) -> FloatImage:
    """Rings cut lengthwise, with fibres."""
    y = np.arange(side, dtype=np.float32)[:, None]
    bend = _octaves(rng, side, coarsest_px=rng.uniform(60, 200), falloff=0.5)
    phase = y / np.float32(rng.uniform(3, 18)) + np.float32(rng.uniform(0.3, 2)) * bend
    ring = 0.5 + 0.5 * np.sin(phase)
    fibre = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), sigmaX=12, sigmaY=0.7)
    dark, light = np.sort(_colours(rng, 2), axis=0)
    value = np.clip(ring * np.float32(rng.uniform(0.2, 1)) + fibre * np.float32(rng.uniform(0.3, 2)), 0, 1)
    picture = dark + (light - dark) * value[..., None]
    return np.ascontiguousarray(picture.transpose(1, 0, 2) if rng.random() < 0.5 else picture, np.float32)


def _tiles(rng: np.random.Generator, side: int) -> FloatImage:
    """Bricks, tiles, planks, shelves: courses with joints, each piece of its own shade."""
    height, width = int(rng.integers(6, 48)), int(rng.integers(8, 96))
    joint = int(rng.integers(1, max(2, height // 6) + 1))
    offset = rng.choice([0.0, 0.5, 0.33])
    y, x = np.mgrid[:side, :side]
    row = y // height
    column = ((x + row * int(offset * width)) // width).astype(int)
    is_joint = (y % height < joint) | ((x + row * int(offset * width)) % width < joint)
    shades = _colours(rng, 1)[0] + rng.normal(0, rng.uniform(0, 0.12), (512, 1)) + rng.normal(0, 0.02, (512, 3))
    piece = shades[(row * 37 + column * 101) % 512]
    return _grained(rng, np.where(is_joint[..., None], _colours(rng, 1)[0], piece).astype(np.float32))


def _text(rng: np.random.Generator, side: int) -> FloatImage:
    """Lines of strokes in words: print, spines of books, labels."""
    paper, ink = (_colours(rng, 1)[0] for _ in range(2))
    if np.abs(paper - ink).max() < 0.25:
        ink = 1 - paper
    canvas = np.empty((side, side, 3), np.uint8)
    canvas[:] = np.rint(255 * paper)
    size = rng.uniform(0.25, 1.6)
    letters = "abcdefghijklmnopqrstuvwxyzABCDEFGHKLMNOPRSTVW0123456789.,-&"
    y = 0.0
    while y < side + 30 * size:
        text = "".join(letters[i] if i < len(letters) else " " for i in rng.integers(0, len(letters) + 12, 60))
        colour = tuple(float(c) for c in 255 * (ink if rng.random() < 0.9 else _colours(rng, 1)[0]))
        origin = (int(rng.uniform(-60, 20)), int(y))
        cv2.putText(canvas, text, origin, int(rng.integers(0, 8)), size, colour, int(rng.integers(1, 3)), cv2.LINE_AA)
        y += (24 + rng.uniform(0, 20)) * size
    return _grained(rng, (canvas / np.float32(255)).astype(np.float32))


def _cloth(rng: np.random.Generator, side: int) -> FloatImage:
    """Warp and weft, with stripes of other colours."""
    period = rng.uniform(3, 9)
    y, x = np.mgrid[:side, :side].astype(np.float32)
    bend = _octaves(rng, side, coarsest_px=120, falloff=0.4) * np.float32(rng.uniform(0, 0.6))
    weave = np.sin(2 * math.pi * x / period + bend) * np.sin(2 * math.pi * y / period + bend)
    palette = _colours(rng, 6)
    stripes = palette[rng.integers(0, 6, side)[(x / np.float32(rng.uniform(2, 30))).astype(int) % side]]
    return _clipped(stripes * (1 + np.float32(rng.uniform(0.05, 0.4)) * weave[..., None]))


def _gradient(rng: np.random.Generator, side: int) -> FloatImage:
    """Hardly anything: a soft gradient and a trace of grain, as plaster and lacquer have."""
    cloud = band_noise(rng, hw=(side, side), wavelength_px=float(rng.uniform(60, 400)))[..., None]
    grain = _octaves(rng, side, coarsest_px=rng.uniform(3, 30), falloff=0.7)[..., None]
    colour = _colours(rng, 1)[0]
    return _clipped(colour * (1 + rng.uniform(0, 0.12) * cloud) + rng.uniform(0.004, 0.03) * grain)


def _drawn(rng: np.random.Generator, side: int) -> FloatImage:
    return drawn_texture(rng, hw=(side, side))


def _repeated(rng: np.random.Generator, side: int) -> FloatImage:
    return tiled_texture(rng, [_dead_leaves(rng, 64)], hw=(side, side))


def _grained(rng: np.random.Generator, picture: FloatImage) -> FloatImage:
    side = picture.shape[0]
    grain = _octaves(rng, side, coarsest_px=rng.uniform(3, 60), falloff=rng.uniform(0.5, 1))[..., None]
    return _clipped(picture * (1 + np.float32(rng.uniform(0.01, 0.12)) * grain))


def _clipped(picture: NDArray[np.floating]) -> FloatImage:
    return np.asarray(np.clip(picture, 0, 1), np.float32)


_FAMILIES: tuple[Callable[[np.random.Generator, int], FloatImage], ...] = (
    _clouds,
    _clouds,
    _clouds,
    _dead_leaves,
    _dead_leaves,
    _dead_leaves,
    _cells,
    _cells,
    _wood,
    _tiles,
    _text,
    _cloth,
    _gradient,
    _drawn,
    _drawn,
    _repeated,
)
