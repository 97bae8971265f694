"""Surfaces of a room: wood, planks, bricks, wallpaper, cloth, packets, book backs, pictures, in quiet colours.

All are (h, w, 3) float32, sRGB in [0, 1], new arrays. Letters: h w texture.
"""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.simulate.texture import band_noise, drawn_texture

_WALL = ("d9d2c4", "c9d0cf", "d8cdb8", "c3c8b9", "cfc4c0", "b9c3cc")
_WOOD = ("a9794a", "8a5a35", "c19a68", "6f4a30", "b58a5e")
_THINGS = ("8c3b32", "2f5d73", "c79a3b", "5a7048", "7a4a63", "c9c2b2", "3d4b5c", "b5683d", "6f8f92", "a34e57", "46413c")


def colour_of(code: str) -> FloatImage:
    """(3,) sRGB of six hexadecimal digits."""
    return np.array([int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)], np.float32)


def thing_colour(rng: np.random.Generator) -> FloatImage:
    """Draw the colour of some thing."""
    return _varied(rng, _THINGS)


def wall_colour(rng: np.random.Generator) -> FloatImage:
    """Draw the colour of a painted wall."""
    return _varied(rng, _WALL)


def wood_colour(rng: np.random.Generator) -> FloatImage:
    """Draw the colour of a kind of wood."""
    return _varied(rng, _WOOD)


def wood(rng: np.random.Generator, *, hw: tuple[int, int], colour: FloatImage) -> FloatImage:
    """Grain along x, with rings that run out of straight.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        colour: (3,) sRGB, of the light wood.
    """
    bend = band_noise(rng, hw=hw, wavelength_px=0.6 * max(hw)) * np.float32(0.15 * hw[0])
    rows = np.arange(hw[0], dtype=np.float32)[:, None] + bend
    rings = np.sin(rows * np.float32(2 * math.pi / rng.uniform(0.03, 0.08) / hw[0]))
    fibre = _stretched_noise(rng, hw, wavelength_px=4.0, stretch=14) + _stretched_noise(
        rng, hw, wavelength_px=10.0, stretch=20
    )
    value = 1 + np.float32(0.07) * rings + np.float32(0.11) * fibre
    return _clipped(colour * value[..., None])


def planks(rng: np.random.Generator, *, hw: tuple[int, int], colour: FloatImage, rows: int) -> FloatImage:
    """Boards side by side along x, each of its own tone, dark joints between.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        colour: (3,) sRGB.
        rows: number of boards.
    """
    floor = np.empty((*hw, 3), np.float32)
    edges = np.linspace(0, hw[0], rows + 1).astype(int)
    for top, bottom in itertools.pairwise(edges):
        tone = np.float32(rng.uniform(0.8, 1.1))
        floor[top:bottom] = wood(rng, hw=(bottom - top, hw[1]), colour=colour * tone)
        floor[top : top + 2] *= np.float32(0.45)
        end = int(rng.integers(hw[1]))
        floor[top:bottom, end : end + 2] *= np.float32(0.45)
    return floor


def bricks(rng: np.random.Generator, *, hw: tuple[int, int], colour: FloatImage, rows: int) -> FloatImage:
    """A brick wall, each brick of its own tone.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        colour: (3,) sRGB of the bricks.
        rows: number of layers.
    """
    height_px = hw[0] / rows
    y, x = np.indices(hw, dtype=np.float32)
    row = np.floor(y / np.float32(height_px)).astype(int)
    along = x / np.float32(3 * height_px) + np.float32(0.5) * (row % 2)
    column = np.floor(along).astype(int)
    tones = rng.uniform(0.75, 1.1, (row.max() + 1, column.max() + 1)).astype(np.float32)
    joint_px = 0.09 * height_px
    is_joint = (y - row * np.float32(height_px) < joint_px) | ((along - column) * 3 * height_px < joint_px)
    grain = 1 + np.float32(0.08) * (
        band_noise(rng, hw=hw, wavelength_px=5.0) + band_noise(rng, hw=hw, wavelength_px=17)
    )
    mortar = np.array([0.72, 0.7, 0.66], np.float32)
    wall = np.where(is_joint[..., None], mortar, colour * tones[row, column][..., None])
    return _clipped(wall * grain[..., None])


def painted(rng: np.random.Generator, *, hw: tuple[int, int], colour: FloatImage) -> FloatImage:
    """Nearly plain: paint that dried a little unevenly.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        colour: (3,) sRGB.
    """
    cloud = band_noise(rng, hw=hw, wavelength_px=0.4 * max(hw)) * np.float32(0.03)
    grain = band_noise(rng, hw=hw, wavelength_px=4.0) * np.float32(0.012)
    return _clipped(colour * (1 + cloud + grain)[..., None])


def patterned(rng: np.random.Generator, *, hw: tuple[int, int], contrast: float = 0.5) -> FloatImage:
    """A printed or woven pattern of two tones.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        contrast: how far the second tone goes towards another colour, 0 to 1.
    """
    first, second = thing_colour(rng), thing_colour(rng)
    other = first + np.float32(contrast) * (second - first)
    if float(np.abs(other - first).max()) < 0.12:
        other = first * np.float32(1.35 if float(first.mean()) < 0.5 else 0.7)
    return drawn_texture(rng, hw=hw, colours=(first, _clipped(other)))


def wallpaper(rng: np.random.Generator, *, hw: tuple[int, int]) -> FloatImage:
    """A wall's pattern, paler than a thing's."""
    base = wall_colour(rng)
    return drawn_texture(rng, hw=hw, colours=(base, base * np.float32(rng.uniform(0.78, 0.9))))


def packet(rng: np.random.Generator, *, hw: tuple[int, int]) -> FloatImage:
    """A carton: a printed ground, a pale label with lines of print on it."""
    sheet = patterned(rng, hw=hw, contrast=0.35)
    top, bottom = int(hw[0] * rng.uniform(0.15, 0.3)), int(hw[0] * rng.uniform(0.6, 0.8))
    left, right = int(hw[1] * 0.12), int(hw[1] * 0.88)
    sheet[top:bottom, left:right] = np.array([0.86, 0.84, 0.78], np.float32) * np.float32(rng.uniform(0.85, 1.05))
    ink = thing_colour(rng) * np.float32(0.6)
    step = max(6, (bottom - top) // 6)
    for y in range(top + step // 2, bottom - step // 2, step):
        _print_line(rng, sheet[y : y + step // 2, left + 4 : right - 4], ink)
    return _clipped(sheet)


def book_back(rng: np.random.Generator, *, hw: tuple[int, int] = (96, 24)) -> FloatImage:
    """The back of a book: cloth, two bands, a title that runs along it."""
    sheet = painted(rng, hw=hw, colour=thing_colour(rng))
    band = thing_colour(rng)
    for place in (0.1, 0.85):
        y = int(hw[0] * place)
        sheet[y : y + 3] = band
    title = sheet[int(hw[0] * 0.25) : int(hw[0] * 0.7), hw[1] // 3 : 2 * hw[1] // 3]
    _print_line(rng, title.transpose(1, 0, 2), np.array([0.85, 0.8, 0.6], np.float32))
    return sheet


def picture(rng: np.random.Generator, *, hw: tuple[int, int]) -> FloatImage:
    """A framed picture: hills under a sky, on a pale mount."""
    y, x = np.indices(hw, dtype=np.float32)
    sky, end = thing_colour(rng), wall_colour(rng)
    sheet = sky + (end - sky) * (y / hw[0])[..., None]
    for level in (0.45, 0.6, 0.75):
        wave = band_noise(rng, hw=(1, hw[1]), wavelength_px=0.4 * hw[1]) * np.float32(0.12 * hw[0])
        hill = thing_colour(rng) * (1 + np.float32(0.15) * band_noise(rng, hw=hw, wavelength_px=6.0))[..., None]
        sheet = np.where((y > level * hw[0] + wave)[..., None], hill, sheet)
    mount = int(0.09 * min(hw))
    is_mount = (np.minimum(x, hw[1] - 1 - x) < mount) | (np.minimum(y, hw[0] - 1 - y) < mount)
    is_frame = (np.minimum(x, hw[1] - 1 - x) < mount // 3) | (np.minimum(y, hw[0] - 1 - y) < mount // 3)
    sheet = np.where(is_mount[..., None], np.array([0.85, 0.83, 0.8], np.float32), sheet)
    return _clipped(np.where(is_frame[..., None], np.array([0.16, 0.12, 0.1], np.float32), sheet))


def chessboard(*, corners: tuple[int, int], margin: int = 1, cell_px: int = 16) -> FloatImage:
    """A chessboard on white paper, sharp edges between whole pixels.

    Args:
        corners: inner corners along x and y.
        margin: white around it, in squares.
        cell_px: of a square.
    """
    columns, rows = corners[0] + 1, corners[1] + 1
    is_black = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    cells = np.pad(np.where(is_black, np.float32(0.12), np.float32(0.9)), margin, constant_values=0.9)
    grey = np.kron(cells, np.ones((cell_px, cell_px), np.float32))
    return np.asarray(grey[..., None] * np.array([1.0, 0.98, 0.95], np.float32), np.float32)


def _print_line(rng: np.random.Generator, place: FloatImage, ink: FloatImage) -> None:
    """Words of random strokes into a strip (h, w, 3) of a texture, which changes."""
    strokes = rng.random(max(1, place.shape[1] // 3)) < 0.62
    is_ink = np.repeat(strokes, 3)[: place.shape[1]]
    place[:, : len(is_ink)][:, is_ink] = ink


def _varied(rng: np.random.Generator, codes: tuple[str, ...]) -> FloatImage:
    colour = colour_of(codes[int(rng.integers(len(codes)))])
    return np.asarray(np.clip(colour * np.exp(rng.normal(0, 0.06, 3)), 0.04, 0.9), np.float32)


def _stretched_noise(rng: np.random.Generator, hw: tuple[int, int], *, wavelength_px: float, stretch: int) -> FloatMap:
    narrow = band_noise(rng, hw=(hw[0], max(2, hw[1] // stretch)), wavelength_px=wavelength_px)
    return np.asarray(cv2.resize(narrow, (hw[1], hw[0]), interpolation=cv2.INTER_CUBIC), np.float32)


def _clipped(texture: FloatImage) -> FloatImage:
    return np.asarray(np.clip(texture, 0.0, 1.0), dtype=np.float32)
