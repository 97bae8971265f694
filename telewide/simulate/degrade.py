"""Damage by a second, worse camera to a picture: it moves, blurs, darkens, shrinks, adds noise, compresses and tints.

The order is that of a phone: lens (vertical shift, blur, dark corners), sensor (fewer pixels, noise), storage (JPEG at
the sensor's own size), colour processing. What remains is enlarged back to the size of the sharp view, as a reader of
pairs does. Images are (H, W, 3) float32, sRGB, in [0, 1]. All resizing is bicubic (a = -0.5), antialiased when
shrinking, and obeys the half-pixel rule ``x' = (x + 0.5) s - 0.5`` with s the exact ratio of the two sizes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.capture.images import resize_bicubic
from telewide.geometry.arrays import FloatImage
from telewide.simulate.sensor import rows_and_columns, vignetting_at
from telewide.srgb import linear_from_srgb, srgb_from_linear

_BLUR_REACH = 2.6
"""Radius of the blur kernel in standard deviations."""


@dataclass(frozen=True)
class Degradation:
    """One known damage.

    Attributes:
        factor: how many times fewer pixels along each axis, >= 1.
        blur_sigma_px: standard deviations of the Gaussian blur along its major and its minor axis, px before shrinking.
        blur_angle_rad: direction of the major axis, from x towards y.
        vignetting: share of the light that the corners lose, in [0, 1); the cos^4 law of `sensor`.
        jpeg_quality: 1 to 100, or None for no compression.
        noise_std: standard deviation of the white noise of the shrunken image.
        gain: factor of each of the channels R, G, B.
        gamma: exponent applied to the sRGB values.
        colour_matrix: 3x3 rows that mix R, G, B, or None.
        vertical_offset_px: the content moves down by so many px (before shrinking).
        vertical_slope: and by so many px more per px of height below the centre.
    """

    factor: float = 1.0
    blur_sigma_px: tuple[float, float] = (0.0, 0.0)
    blur_angle_rad: float = 0.0
    vignetting: float = 0.0
    jpeg_quality: int | None = None
    noise_std: float = 0.0
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    colour_matrix: tuple[tuple[float, float, float], ...] | None = None
    vertical_offset_px: float = 0.0
    vertical_slope: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no camera can do.

        Raises:
            ValueError: naming the value and what was expected.
        """
        if not self.factor >= 1.0:
            raise ValueError(f"factor is {self.factor}, expected a number >= 1")
        if min(self.blur_sigma_px) < 0 or self.noise_std < 0:
            raise ValueError(f"blur_sigma_px {self.blur_sigma_px} and noise_std {self.noise_std} must not be negative")
        if not 0 <= self.vignetting < 1:
            raise ValueError(f"vignetting is {self.vignetting}, expected a share in [0, 1)")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality is {self.jpeg_quality}, expected 1 to 100 or None")


def degrade(image: FloatImage, degradation: Degradation, *, rng: np.random.Generator) -> FloatImage:
    """Damage a picture and enlarge it back to its own size.

    Args:
        image: (H, W, 3) float32, sRGB in [0, 1].
        degradation: the damage.
        rng: source of the noise.

    Returns:
        (H, W, 3) float32, sRGB in [0, 1].
    """
    small = degrade_small(image, degradation, rng=rng)
    return resize_bicubic(small, wh=(image.shape[1], image.shape[0]))


def degrade_small(image: FloatImage, degradation: Degradation, *, rng: np.random.Generator) -> FloatImage:
    """Damage a picture and leave it at the worse camera's own size.

    Args:
        image: (H, W, 3) float32, sRGB in [0, 1].
        degradation: the damage.
        rng: source of the noise.

    Returns:
        (round(H / factor), round(W / factor), 3) float32, sRGB in [0, 1].
    """
    moved = _move_vertically(image, offset_px=degradation.vertical_offset_px, slope=degradation.vertical_slope)
    blurred = _blur(moved, sigma_px=degradation.blur_sigma_px, angle_rad=degradation.blur_angle_rad)
    lit = _darken_corners(blurred, vignetting=degradation.vignetting)
    small = resize_bicubic(lit, wh=_shrunken_wh(image, factor=degradation.factor))
    if degradation.noise_std > 0:
        noise = rng.standard_normal(small.shape, dtype=np.float32)
        small = _clipped(small + np.float32(degradation.noise_std) * noise)
    if degradation.jpeg_quality is not None:
        small = _through_jpeg(small, quality=degradation.jpeg_quality)
    return _tint(small, degradation)


def shrink_and_enlarge(image: FloatImage, *, factor: float) -> FloatImage:
    """Remove the detail that a camera with ``factor`` times fewer pixels cannot see.

    Antialiased bicubic shrinking to ``round(size / factor)``, then bicubic enlarging to the original size.

    Args:
        image: (H, W) or (H, W, C) float32 in [0, 1].
        factor: >= 1, need not be whole.

    Returns:
        Same shape, float32 in [0, 1].

    Raises:
        ValueError: when the factor is below 1.
    """
    if not factor >= 1.0:
        raise ValueError(f"factor is {factor}, expected a number >= 1")
    small = resize_bicubic(image, wh=_shrunken_wh(image, factor=factor))
    return resize_bicubic(small, wh=(image.shape[1], image.shape[0]))


def _shrunken_wh(image: FloatImage, *, factor: float) -> tuple[int, int]:
    return max(1, round(image.shape[1] / factor)), max(1, round(image.shape[0] / factor))


def _clipped(image: FloatImage) -> FloatImage:
    return np.asarray(np.clip(image, 0.0, 1.0), dtype=np.float32)


def _move_vertically(image: FloatImage, *, offset_px: float, slope: float) -> FloatImage:
    """Move the point at row y to row ``y + offset + slope (y - centre)``."""
    if offset_px == 0 and slope == 0:
        return image
    centre = (image.shape[0] - 1) / 2
    scale = 1.0 / (1.0 + slope)
    source_from_moved = np.array([[1.0, 0.0, 0.0], [0.0, scale, (slope * centre - offset_px) * scale]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(
        image, source_from_moved, (image.shape[1], image.shape[0]), flags=flags, borderMode=cv2.BORDER_REFLECT_101
    )
    return np.asarray(moved, dtype=np.float32)


def _blur(image: FloatImage, *, sigma_px: tuple[float, float], angle_rad: float) -> FloatImage:
    major, minor = sigma_px
    if max(major, minor) < 0.05:
        return image
    radius = max(1, math.ceil(_BLUR_REACH * max(major, minor)))
    if major == minor:
        size = 2 * radius + 1
        return np.asarray(cv2.GaussianBlur(image, (size, size), major, borderType=cv2.BORDER_REFLECT_101), np.float32)
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    along = x * math.cos(angle_rad) + y * math.sin(angle_rad)
    across = y * math.cos(angle_rad) - x * math.sin(angle_rad)
    # A tenth of a pixel is narrower than the sampling of the kernel: it stands for no blur along that axis.
    kernel = np.exp(-0.5 * ((along / max(major, 0.1)) ** 2 + (across / max(minor, 0.1)) ** 2))
    kernel = (kernel / kernel.sum()).astype(np.float32)
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REFLECT_101), dtype=np.float32)


def _darken_corners(image_srgb: FloatImage, *, vignetting: float) -> FloatImage:
    if vignetting == 0:
        return image_srgb
    hw = (image_srgb.shape[0], image_srgb.shape[1])
    passed = vignetting_at(vignetting, rows_and_columns(hw), hw=hw).astype(np.float32)
    return srgb_from_linear(linear_from_srgb(image_srgb) * passed[..., None])


def _through_jpeg(image: FloatImage, *, quality: int) -> FloatImage:
    bytes_rgb = np.rint(image * 255.0).astype(np.uint8)
    _, encoded = cv2.imencode(".jpg", bytes_rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.float32)
    return np.ascontiguousarray(decoded[..., ::-1] / np.float32(255.0))


def _tint(image: FloatImage, degradation: Degradation) -> FloatImage:
    tinted = image
    if degradation.gamma != 1.0:
        tinted = np.asarray(cv2.pow(tinted, degradation.gamma), dtype=np.float32)
    matrix = np.diag(degradation.gain)
    if degradation.colour_matrix is not None:
        matrix = np.asarray(degradation.colour_matrix) @ matrix
    if not np.array_equal(matrix, np.eye(3)):
        tinted = np.asarray(cv2.transform(tinted, matrix), dtype=np.float32)
    return _clipped(tinted)
