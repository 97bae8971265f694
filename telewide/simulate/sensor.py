"""Sensor of a phone's camera: a noisy Bayer mosaic, and the photo the phone develops from it.

In the order of light: the lens blurs and darkens the corners; each pixel sees one colour, collects electrons and counts
them. With C the sensor's colours, V the lens's share at r (the corner's distance from the middle is 1) and 1 the white
level above black::

    signal = exposure V (C light)         V = 1 / (1 + r^2 t^2)^2,  the cos^4 law; t from the loss in the corners
    counts = black + (white - black) (Poisson(signal full_well) + N(0, read_noise^2)) / full_well

Developed, a grey card is ``exposure`` times the light of the scene: exposure is not undone.
Letters: H W photo.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.srgb import srgb_from_linear

Triple = tuple[float, float, float]

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the first two pixels of the first row, then of the second."""
SHADING_UNDONE = 0.8
"""Share of the lens's darkening that a phone takes out of its own photos, as an exponent."""
# Green along edges, by OpenCV: it keeps fine lines that bilinear demosaicing colours.
_DEMOSAICING = {pattern: int(getattr(cv2, f"COLOR_Bayer{pattern}2RGB_EA")) for pattern in PATTERNS}
_PEDESTAL = 0.1  # noise below black survives demosaicing, which knows no negative numbers
_FULL_SCALE = 65535
# Linear sRGB from white-balanced camera colours, rows that add up to 1: between those of several phones' profiles.
_USUAL_SRGB_FROM_BALANCED = np.array([[1.75, -0.60, -0.15], [-0.22, 1.52, -0.30], [0.02, -0.55, 1.53]])


@dataclass(frozen=True)
class Sensor:
    """One lens with its sensor, at one gain.

    Attributes:
        blur_px: standard deviation of the lens's blur, px.
        vignetting: share of the light that the corners lose, in [0, 1).
        colour_from_srgb: rows R, G, B of the sensor's colours out of linear sRGB; (1, 1, 1) is white under D65.
        neutral: what the phone takes for grey, R, G, B, the largest 1: DNG's AsShotNeutral, the inverse of the gains
            of white balance.
        exposure: signal of white light in the brightest colour, 1 at the white level.
        full_well_e: electrons at the white level.
        read_noise_e: standard deviation of what reading adds, electrons.
        black_level: count without light.
        white_level: largest count.
        pattern: one of `PATTERNS`.
    """

    blur_px: float = 0.0
    vignetting: float = 0.0
    colour_from_srgb: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    neutral: Triple = (1.0, 1.0, 1.0)
    exposure: float = 1.0
    full_well_e: float = 5000.0
    read_noise_e: float = 3.0
    black_level: int = 64
    white_level: int = 1023
    pattern: str = "RGGB"

    def __post_init__(self) -> None:
        """Refuse what is no sensor.

        Raises:
            ValueError: naming the value and what was expected.
        """
        if self.blur_px < 0 or self.read_noise_e < 0 or not 0 <= self.vignetting < 1:
            raise ValueError(
                f"blur_px {self.blur_px} and read_noise_e {self.read_noise_e} must not be negative, "
                f"vignetting {self.vignetting} lies in [0, 1)"
            )
        if min(self.exposure, self.full_well_e, *self.neutral) <= 0:
            raise ValueError(
                f"exposure {self.exposure}, full_well_e {self.full_well_e}, neutral {self.neutral} must be positive"
            )
        if not 0 <= self.black_level < self.white_level <= _FULL_SCALE:
            raise ValueError(f"black {self.black_level} and white {self.white_level} do not fit into 16 bits in order")
        if self.pattern not in PATTERNS:
            raise ValueError(f"pattern {self.pattern!r}; one of {', '.join(PATTERNS)} was expected")

    @property
    def colour_matrix(self) -> FloatArray:
        """`colour_from_srgb` as a (3, 3) array."""
        return np.asarray(self.colour_from_srgb, dtype=np.float64)

    @property
    def srgb_from_balanced(self) -> FloatArray:
        """(3, 3) linear sRGB from colours divided by those of white: what a profile states of the sensor."""
        response = self.colour_matrix
        return np.asarray(np.linalg.inv(response / response.sum(axis=1, keepdims=True)))


@dataclass(frozen=True)
class RawFrame:
    """Counts of the sensor.

    Attributes:
        bayer: (H, W) uint16 counts.
        sensor: that counted them.
    """

    bayer: NDArray[np.uint16]
    sensor: Sensor


def phone_sensor(rng: np.random.Generator, *, is_wide: bool, white_balance_std: float = 0.0) -> Sensor:
    """Draw one of the two cameras of a phone.

    Wide is exposed brighter, collects more light and darkens more towards its corners; each has colours of its own.

    Args:
        rng: source of all draws.
        is_wide: which of the two.
        white_balance_std: how far the phone's idea of grey is off, as a share of red and of blue.
    """
    mixed = _USUAL_SRGB_FROM_BALANCED + rng.normal(0.0, 0.05, (3, 3))
    mixed /= mixed.sum(axis=1, keepdims=True)
    white = np.array([rng.uniform(0.42, 0.6), 1.0, rng.uniform(0.5, 0.7)])
    response = white[:, None] * np.linalg.inv(mixed)
    neutral = white * np.exp(np.array([1.0, 0.0, 1.0]) * rng.normal(0.0, white_balance_std, 3))
    bits = int(rng.choice((10, 12)))
    return Sensor(
        blur_px=float(rng.uniform(0.4, 0.6) if is_wide else rng.uniform(0.5, 0.8)),
        vignetting=float(rng.uniform(0.35, 0.5) if is_wide else rng.uniform(0.1, 0.25)),
        colour_from_srgb=(_triple(response[0]), _triple(response[1]), _triple(response[2])),
        neutral=_triple(neutral / neutral.max()),
        exposure=float(rng.uniform(0.82, 0.95) if is_wide else rng.uniform(0.68, 0.8)),
        full_well_e=float(rng.uniform(6000, 10000) if is_wide else rng.uniform(3000, 6000)),
        read_noise_e=float(rng.uniform(1.5, 3.0) if is_wide else rng.uniform(2.0, 4.5)),
        black_level=2 ** (bits - 4),
        white_level=2**bits - 1,
    )


def expose(light: FloatImage, sensor: Sensor, *, rng: np.random.Generator) -> RawFrame:
    """Take a photo.

    Args:
        light: (H, W, 3) float32 linear sRGB light of the scene, 1 for white; more is clipped by the sensor.
        sensor: lens and sensor.
        rng: source of the noise.

    Returns:
        The counts, clipped to ``[0, white_level]``.
    """
    seen = light
    if sensor.blur_px > 0:
        seen = np.asarray(cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101))
    mosaic = _mosaic(np.asarray(seen @ sensor.colour_matrix.T.astype(np.float32)), sensor.pattern)
    hw = (light.shape[0], light.shape[1])
    signal = np.maximum(mosaic, 0) * vignetting_at(sensor.vignetting, rows_and_columns(hw), hw=hw) * sensor.exposure
    # Far beyond the white level no more electrons need be drawn: the count is the same.
    electrons = rng.poisson(np.minimum(signal, 4.0) * sensor.full_well_e) + rng.normal(0, sensor.read_noise_e, hw)
    counts = sensor.black_level + electrons * ((sensor.white_level - sensor.black_level) / sensor.full_well_e)
    return RawFrame(np.clip(np.rint(counts), 0, sensor.white_level).astype(np.uint16), sensor)


def developed(frame: RawFrame) -> FloatImage:
    """Develop a photo as the phone does for its JPEG.

    Black level, lens shading partly undone (`SHADING_UNDONE`), white balance, demosaicing, colour matrix, sRGB curve.

    Args:
        frame: what the sensor counted.

    Returns:
        (H, W, 3) sRGB float32 in [0, 1].
    """
    sensor, hw = frame.sensor, (frame.bayer.shape[0], frame.bayer.shape[1])
    linear = (frame.bayer.astype(np.float32) - sensor.black_level) / (sensor.white_level - sensor.black_level)
    linear *= vignetting_at(sensor.vignetting, rows_and_columns(hw), hw=hw).astype(np.float32) ** -SHADING_UNDONE
    linear /= _mosaic(np.broadcast_to(np.asarray(sensor.neutral, np.float32), (*hw, 3)), sensor.pattern)
    levels = (np.clip(linear, -_PEDESTAL, 1) + _PEDESTAL) * (_FULL_SCALE / (1 + _PEDESTAL))
    coloured = cv2.cvtColor(np.rint(levels).astype(np.uint16), _DEMOSAICING[sensor.pattern])
    balanced = coloured.astype(np.float32) * np.float32((1 + _PEDESTAL) / _FULL_SCALE) - np.float32(_PEDESTAL)
    linear_srgb = balanced @ sensor.srgb_from_balanced.T.astype(np.float32)
    return srgb_from_linear(np.clip(linear_srgb, 0, 1))


def vignetting_at(lost_share: float, rows_columns: tuple[FloatArray, FloatArray], *, hw: tuple[int, int]) -> FloatArray:
    """Share of the light that the lens lets through.

    Args:
        lost_share: of the light in the corners, in [0, 1).
        rows_columns: places, px; arrays that broadcast.
        hw: height and width of the photo.

    Returns:
        In (0, 1], 1 at the middle of the photo and ``1 - lost_share`` at the centres of its corner pixels.
    """
    middle = np.array([hw[0] - 1, hw[1] - 1]) / 2
    r2 = ((rows_columns[0] - middle[0]) ** 2 + (rows_columns[1] - middle[1]) ** 2) / max(float(middle @ middle), 0.5)
    t2 = (1 - lost_share) ** -0.5 - 1
    return np.asarray(1 / (1 + r2 * t2) ** 2)


def rows_and_columns(hw: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Places of all pixels, (H, 1) rows and (1, W) columns, for `vignetting_at`."""
    return np.arange(hw[0], dtype=np.float64)[:, None], np.arange(hw[1], dtype=np.float64)[None]


def _mosaic(image: FloatImage, pattern: str) -> FloatImage:
    """(H, W) of the one colour that each pixel sees of an (H, W, 3) image."""
    mosaic = np.empty(image.shape[:2], np.float32)
    for place, colour in enumerate(pattern):
        at = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        mosaic[at] = image[..., "RGB".index(colour)][at]
    return mosaic


def _triple(values: FloatArray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
