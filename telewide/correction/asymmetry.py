"""The asymmetric factor: how many times finer tele resolves the scene than wide.

Three sources know it of photos as captured: a rig's intrinsics, the scale of matches, EXIF. They are compared here, and
disagreement is said. On rectified views, enlarged to one size, only sharpness still tells of it; the rest of this page
reads that off their spectra.

Two rectified views of one scene hold the same power at coarse scales. Their amplitude ratio ``T(f) = |SRC| / |REF|``,
1 at low frequencies, falls where src's optics and sampling give out. A view enlarged by a factor ``s`` loses half of
its amplitude at about ``f = 0.45 / s`` cycles per pixel (measured on antialiased bicubic, s = 2 to 6): that is inverted
here.
Convention: a factor above 1 says that ref is the sharper view, below 1 that src is.
Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

HALF_AMPLITUDE_CYCLES = 0.45
"""Frequency (cycles per px) times factor at which a view enlarged by that factor keeps half of its amplitude."""
SIGMA_PER_FACTOR_PX = np.sqrt(np.log(2.0) / 2.0) / (np.pi * HALF_AMPLITUDE_CYCLES)
"""Gaussian sigma per unit of the factor with the same half-amplitude frequency: ``exp(-2 pi^2 s^2 f^2) = 1/2``."""
LARGEST_FACTOR = 16.0
RIG_TOLERANCE = 0.03
"""A rig and the matches of one pair that differ by more are not of one state of the lenses."""
EXIF_TOLERANCE = 0.15
"""EXIF rounds to whole millimetres, and its numbers are nominal: only more than this speaks against it."""
_BANDS = 32
_LOW_BANDS = slice(1, 4)


@dataclass(frozen=True)
class AsymmetryEstimate:
    """``f_tele_px / f_wide_px`` of photos as captured, from each source that knows it.

    Attributes:
        rig: from the intrinsics of a calibrated rig.
        matches: from the scale of matches of one pair of photos.
        exif: from the focal lengths EXIF states.
        factor: the one to use; None where no source knows it.
        source: whose it is.
        statements: one sentence for every disagreement.
    """

    rig: float | None
    matches: float | None
    exif: float | None
    factor: float | None
    source: Literal["rig", "matches", "exif"] | None
    statements: tuple[str, ...]


def compare_factors(
    *, rig: float | None = None, matches: float | None = None, exif: float | None = None
) -> AsymmetryEstimate:
    """Choose the asymmetric factor and say where the sources disagree.

    A rig is trusted over matches, matches over EXIF.

    Args:
        rig: :attr:`~telewide.geometry.rig.StereoRig.asymmetry`.
        matches: scale of the matches of one pair.
        exif: what :func:`factor_from_exif` says.

    Returns:
        The comparison: rig and matches more than 3 % apart are reported, EXIF only more than 15 % off the chosen one.
    """
    factor, source = _first_known(rig, matches, exif)
    statements = []
    if rig is not None and matches is not None and abs(matches / rig - 1.0) > RIG_TOLERANCE:
        statements.append(
            f"the rig states an asymmetric factor of {rig:.3f}, the matches of this pair show {matches:.3f}, "
            f"{abs(matches / rig - 1.0):.1%} off: other lenses, a digital zoom, or photos of another size"
        )
    if exif is not None and factor is not None and abs(exif / factor - 1.0) > EXIF_TOLERANCE:
        named = {"rig": "the rig states", "matches": "the matches show"}[source or "rig"]
        statements.append(
            f"EXIF states an asymmetric factor of {exif:.2f}, {named} {factor:.2f}: a digital zoom or a crop"
        )
    return AsymmetryEstimate(rig, matches, exif, factor, source, tuple(statements))


def factor_from_exif(
    *,
    tele_f35_mm: float | None,
    wide_f35_mm: float | None,
    tele_hw: tuple[int, int] | None,
    wide_hw: tuple[int, int] | None,
) -> float | None:
    """Asymmetric factor from 35 mm equivalents: ``f_px = f35_mm * width_px / 36``, width being the longer side.

    Args:
        tele_f35_mm: FocalLengthIn35mmFilm of tele.
        wide_f35_mm: of wide.
        tele_hw: size of tele's photo.
        wide_hw: of wide's.

    Returns:
        The factor; None where something is not stated.
    """
    if not tele_f35_mm or not wide_f35_mm or tele_hw is None or wide_hw is None:
        return None
    return (tele_f35_mm * max(tele_hw)) / (wide_f35_mm * max(wide_hw))


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


def _first_known(
    rig: float | None, matches: float | None, exif: float | None
) -> tuple[float | None, Literal["rig", "matches", "exif"] | None]:
    if rig is not None:
        return rig, "rig"
    if matches is not None:
        return matches, "matches"
    return exif, None if exif is None else "exif"


def grey(image: FloatImage) -> FloatImage:
    """Luma (Rec. 601 weights) of an RGB image; a grey one is returned as it is."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.float32)


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
