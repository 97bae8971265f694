"""Pictures to paint surfaces with: crops of the user's own photos, drawn patterns, and nearly nothing.

All are (h, w, 3) float32, sRGB in [0, 1], new arrays that the caller may change. Letters: h w texture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage, FloatMap


def photo_texture(
    rng: np.random.Generator, photo: FloatImage, *, hw: tuple[int, int], scale: tuple[float, float] = (0.5, 2.0)
) -> FloatImage:
    """Cut a random piece out of a photo: flipped, turned, resized, brightened.

    Args:
        rng: source of the draw.
        photo: (H, W, 3) float32, sRGB in [0, 1].
        hw: size of the texture.
        scale: least and largest enlargement; more where the photo is too small, up to 1.5 times, then mirrored.

    Returns:
        (hw[0], hw[1], 3) float32.
    """
    source = photo.transpose(1, 0, 2) if rng.random() < 0.2 else photo
    wanted = math.exp(rng.uniform(math.log(scale[0]), math.log(scale[1])))
    needed = max(hw[0] / source.shape[0], hw[1] / source.shape[1])
    enlargement = max(wanted, min(needed, 1.5))
    cut = tuple(max(2, math.ceil(size / enlargement)) for size in hw)
    piece = _mirrored_cut(rng, source, hw=(cut[0], cut[1]))
    if rng.random() < 0.5:
        piece = piece[:, ::-1]
    piece = np.ascontiguousarray(piece)
    method = cv2.INTER_AREA if enlargement < 1 else cv2.INTER_CUBIC
    texture = np.asarray(cv2.resize(piece, (hw[1], hw[0]), interpolation=method), dtype=np.float32)
    gain = np.exp(rng.normal(0.0, 0.2) + rng.normal(0.0, 0.05, 3)).astype(np.float32)
    return _clipped(texture * gain)


def weak_texture(rng: np.random.Generator, photo: FloatImage | None, *, hw: tuple[int, int]) -> FloatImage:
    """Make a surface with hardly anything to match: a plain colour, a soft gradient, a trace of grain.

    Args:
        rng: source of the draw.
        photo: where the colour comes from, or None for any colour.
        hw: size of the texture.

    Returns:
        (hw[0], hw[1], 3) float32.
    """
    if photo is None:
        colour = rng.uniform(0.15, 0.95, 3)
    else:
        colour = photo[rng.integers(photo.shape[0]), rng.integers(photo.shape[1])].astype(np.float64)
    cloud = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(0.3, 1.5) * max(hw)))
    texture = colour.astype(np.float32) * (1 + np.float32(rng.uniform(0.02, 0.15)) * cloud)[..., None]
    if rng.random() < 0.7:
        grain = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(2.0, 12.0)))
        texture += (np.float32(rng.uniform(0.003, 0.02)) * grain)[..., None]
    return _clipped(texture)


def drawn_texture(
    rng: np.random.Generator, *, hw: tuple[int, int], colours: tuple[FloatImage, FloatImage] | None = None
) -> FloatImage:
    """Draw a pattern of two colours: clouds, stripes, checks, dots or speckle.

    Args:
        rng: source of the draw.
        hw: size of the texture.
        colours: two (3,) sRGB colours; None draws them as well.

    Returns:
        (hw[0], hw[1], 3) float32.
    """
    pattern = _PATTERNS[int(rng.integers(len(_PATTERNS)))](rng, hw)
    dark, light = _two_colours(rng) if colours is None else colours
    texture = dark + (light - dark) * pattern[..., None]
    grain = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(2.5, 6.0)))
    cloud = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(20.0, 80.0)))
    weight = np.float32(rng.uniform(0.01, 0.08)) * grain + np.float32(rng.uniform(0.02, 0.1)) * cloud
    return _clipped(texture + weight[..., None])


def tiled_texture(rng: np.random.Generator, photos: Sequence[FloatImage], *, hw: tuple[int, int]) -> FloatImage:
    """Repeat a small cut of a photo, as printed cloth, bricks and shelves do.

    Args:
        rng: source of the draw.
        photos: where the cut comes from.
        hw: size of the texture.

    Returns:
        (hw[0], hw[1], 3) float32.
    """
    photo = photos[int(rng.integers(len(photos)))]
    size = (int(rng.integers(12, 48)), int(rng.integers(12, 48)))
    tile = photo_texture(rng, photo, hw=size, scale=(0.5, 1.0))
    rows = np.arange(hw[0]) % size[0]
    columns = np.arange(hw[1]) % size[1]
    texture = tile[rows[:, None], columns[None, :]]
    cloud = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(0.1, 0.5) * max(hw)))
    return _clipped(texture * (1 + np.float32(rng.uniform(0.03, 0.15)) * cloud)[..., None])


def band_noise(rng: np.random.Generator, *, hw: tuple[int, int], wavelength_px: float) -> FloatMap:
    """Make smooth noise of about one size of blob.

    Args:
        rng: source of the draw.
        hw: size of the map.
        wavelength_px: size of a bright and a dark blob together.

    Returns:
        (hw[0], hw[1]) float32, mean about 0, mostly within [-1, 1].
    """
    step = max(1.0, wavelength_px / 2)
    nodes = (math.ceil(hw[0] / step) + 3, math.ceil(hw[1] / step) + 3)
    grid = rng.uniform(-1.0, 1.0, nodes).astype(np.float32)
    scale = np.array([[1 / step, 0, 1 + rng.random()], [0, 1 / step, 1 + rng.random()]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    noise = cv2.warpAffine(grid, scale, (hw[1], hw[0]), flags=flags, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(noise, dtype=np.float32)


def _mirrored_cut(rng: np.random.Generator, photo: FloatImage, *, hw: tuple[int, int]) -> FloatImage:
    starts = [int(rng.integers(max(1, size - cut + 1))) for size, cut in zip(photo.shape, hw, strict=False)]
    if hw[0] <= photo.shape[0] and hw[1] <= photo.shape[1]:
        return photo[starts[0] : starts[0] + hw[0], starts[1] : starts[1] + hw[1]]
    rows, columns = (_mirrored(start, cut, size) for start, cut, size in zip(starts, hw, photo.shape, strict=False))
    return photo[rows[:, None], columns[None, :]]


def _mirrored(start: int, count: int, size: int) -> NDArray[np.intp]:
    position = np.arange(start, start + count) % (2 * size)
    return np.minimum(position, 2 * size - 1 - position)


def _waves(rng: np.random.Generator, hw: tuple[int, int], *, angle_rad: float, period_px: float) -> FloatMap:
    """Cosine across the given direction, bent a little."""
    y, x = np.ogrid[: hw[0], : hw[1]]
    bend = band_noise(rng, hw=hw, wavelength_px=8 * period_px) * np.float32(rng.uniform(0.0, 1.5))
    rate = 2 * math.pi / period_px
    phase = (x * (rate * math.cos(angle_rad)) + y * (rate * math.sin(angle_rad))).astype(np.float32)
    return np.asarray(np.cos(phase + bend), dtype=np.float32)


def _edge(values: FloatMap, *, sharpness: float) -> FloatMap:
    """Map values around zero to [0, 1], more or less abruptly."""
    return np.asarray(np.clip(0.5 + np.float32(sharpness) * values, 0.0, 1.0), dtype=np.float32)


def _clouds(rng: np.random.Generator, hw: tuple[int, int]) -> FloatMap:
    wavelength_px = float(rng.uniform(8.0, 60.0))
    total = band_noise(rng, hw=hw, wavelength_px=wavelength_px)
    for octave in (1, 2, 3):
        total = total + band_noise(rng, hw=hw, wavelength_px=wavelength_px / 2**octave) * np.float32(0.6**octave)
    return _edge(total, sharpness=0.4)


def _stripes(rng: np.random.Generator, hw: tuple[int, int]) -> FloatMap:
    period_px = float(rng.uniform(6.0, 30.0))
    wave = _waves(rng, hw, angle_rad=float(rng.uniform(0, math.pi)), period_px=period_px)
    return _edge(wave, sharpness=min(2.0, period_px / 8))


def _checks(rng: np.random.Generator, hw: tuple[int, int]) -> FloatMap:
    period_px = float(rng.uniform(10.0, 40.0))
    angle_rad = float(rng.uniform(0, math.pi))
    along = _waves(rng, hw, angle_rad=angle_rad, period_px=period_px)
    across = _waves(rng, hw, angle_rad=angle_rad + math.pi / 2, period_px=period_px * float(rng.uniform(0.7, 1.4)))
    woven = along * across if rng.random() < 0.5 else 0.5 * (along + across)
    return _edge(np.asarray(woven, np.float32), sharpness=min(2.5, period_px / 8))


def _dots(rng: np.random.Generator, hw: tuple[int, int]) -> FloatMap:
    period_px = float(rng.uniform(8.0, 28.0))
    angle_rad = float(rng.uniform(0, math.pi))
    along = _waves(rng, hw, angle_rad=angle_rad, period_px=period_px)
    across = _waves(rng, hw, angle_rad=angle_rad + math.pi / 2, period_px=period_px)
    return _edge(along + across - np.float32(rng.uniform(0.4, 1.2)), sharpness=min(1.5, period_px / 10))


def _speckle(rng: np.random.Generator, hw: tuple[int, int]) -> FloatMap:
    noise = band_noise(rng, hw=hw, wavelength_px=float(rng.uniform(3.0, 10.0)))
    return _edge(noise - np.float32(rng.uniform(0.0, 0.4)), sharpness=float(rng.uniform(0.8, 2.0)))


_PATTERNS: tuple[Callable[[np.random.Generator, tuple[int, int]], FloatMap], ...] = (
    _clouds,
    _stripes,
    _checks,
    _dots,
    _speckle,
)


def _two_colours(rng: np.random.Generator) -> tuple[FloatImage, FloatImage]:
    """Two colours of one family or of two, apart in brightness."""
    base = rng.uniform(0.1, 0.9, 3)
    other = base + rng.normal(0.0, 0.25, 3) + rng.choice([-1.0, 1.0]) * rng.uniform(0.12, 0.45)
    return base.astype(np.float32), np.clip(other, 0.03, 0.97).astype(np.float32)


def _clipped(texture: FloatImage) -> FloatImage:
    return np.asarray(np.clip(texture, 0.0, 1.0), dtype=np.float32)
