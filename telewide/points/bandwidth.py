"""Bandwidth of two views: how many times finer one resolves the scene, read off their spectra.

Two rectified views of one scene hold the same power at coarse scales. Their amplitude ratio ``T(f) = |SRC| / |REF|``,
1 at low frequencies, falls where src's optics and sampling give out. A view enlarged by a factor ``s`` loses half of
its amplitude at about ``f = 0.45 / s`` cycles per pixel (measured on antialiased bicubic, s = 2 to 6): that is inverted
here.
Convention: a factor above 1 says that ref is the sharper view, below 1 that src is.
Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage
from telewide.srgb import grey

HALF_AMPLITUDE_CYCLES = 0.45
"""Frequency (cycles per px) times factor at which a view enlarged by that factor keeps half of its amplitude."""
SIGMA_PER_FACTOR_PX = np.sqrt(np.log(2.0) / 2.0) / (np.pi * HALF_AMPLITUDE_CYCLES)
"""Gaussian sigma per unit of the factor with the same half-amplitude frequency: ``exp(-2 pi^2 s^2 f^2) = 1/2``."""
LARGEST_FACTOR = 16.0
_BANDS = 32
_LOW_BANDS = slice(1, 4)


def estimate_asymmetry(ref: FloatImage, src: FloatImage) -> float | None:
    """Estimate how many times finer ref resolves the scene than src.

    Args:
        ref: (H, W, 3) or (H, W), in [0, 1].
        src: (H, W, 3) or (H, W), in [0, 1], the same scene.

    Returns:
        The factor: 1 for equally sharp views, below 1 where src is the sharper one, within [1/16, 16]; None where a
        view has no texture to tell it from.
    """
    ref_power = _band_power(grey(ref))
    src_power = _band_power(grey(src))
    if min(ref_power[_LOW_BANDS].min(), src_power[_LOW_BANDS].min()) <= 1e-12:
        return None
    floor = 1e-12
    amplitude = np.sqrt((src_power + floor) / (ref_power + floor))
    amplitude = amplitude / np.median(amplitude[_LOW_BANDS])
    falling = _factor_from_transfer(amplitude)
    rising = _factor_from_transfer(1.0 / amplitude)
    return falling if falling >= rising else 1.0 / rising


def blur_to_bandwidth(image: FloatImage, *, factor: float) -> FloatImage:
    """Blur an image as if a camera ``factor`` times coarser had taken it.

    A Gaussian of variance ``(0.416 px)^2 (factor^2 - 1)``; a factor of 1 or less changes nothing.

    Args:
        image: (H, W, 3) or (H, W) float32.
        factor: how many times coarser.

    Returns:
        The same shape, float32.
    """
    if factor <= 1.0:
        return image
    sigma_px = float(SIGMA_PER_FACTOR_PX * np.sqrt(factor**2 - 1.0))
    if sigma_px < 0.2:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101), dtype=np.float32)


def _band_power(image_HW: FloatImage) -> NDArray[np.float64]:
    """Mean power in rings of the spectrum, from 0 to Nyquist, under a Hann window."""
    height, width = image_HW.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    power = np.abs(np.fft.rfft2((image_HW - image_HW.mean()) * window)) ** 2
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    band = np.minimum((radius * 2 * _BANDS).astype(np.int64), _BANDS).ravel()
    total = np.bincount(band, weights=power.ravel(), minlength=_BANDS + 1)
    count = np.bincount(band, minlength=_BANDS + 1)
    mean_power: NDArray[np.float64] = total[:_BANDS] / np.maximum(count[:_BANDS], 1) / (height * width)
    return mean_power


def _factor_from_transfer(amplitude: NDArray[np.float64]) -> float:
    """Where a transfer curve falls to one half, as a factor; 1 where it never does below 0.45 cycles per px."""
    padded = np.pad(amplitude, 1, mode="edge")
    smooth = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    below = np.flatnonzero(smooth < 0.5)
    if below.size == 0 or below[0] == 0:
        return 1.0 if below.size == 0 else LARGEST_FACTOR
    last = int(below[0])
    share = (smooth[last - 1] - 0.5) / max(float(smooth[last - 1] - smooth[last]), 1e-9)
    frequency = (last - 1 + share + 0.5) / (2 * _BANDS)
    return float(np.clip(HALF_AMPLITUDE_CYCLES / frequency, 1.0, LARGEST_FACTOR))
