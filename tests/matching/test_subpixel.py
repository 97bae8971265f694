"""Fractions of a pixel, against photos that are shifted exactly, by the phase of their spectrum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from telewide.capture.images import read_image
from telewide.geometry.arrays import FloatMap
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.subpixel import refine_subpixel

SEEN = (slice(8, -8), slice(24, -24))
LARGEST_BIAS_PX = 0.05


@pytest.fixture(scope="module")
def photo(repo: Path) -> FloatMap:
    return np.ascontiguousarray(read_image(repo / "examples" / "captures" / "000" / "tele.jpg")[:96, :240])


def shifted(photo: FloatMap, shift_px: float) -> FloatMap:
    """``photo(x + shift)``; mirrored at its end, so that the spectrum sees no jump."""
    endless = np.concatenate([photo, photo[:, ::-1]], axis=1).astype(np.float64)
    phase = np.exp(2j * np.pi * np.fft.fftfreq(endless.shape[1]) * shift_px)
    moved = np.fft.ifft(np.fft.fft(endless, axis=1) * phase[:, None], axis=1).real
    return np.clip(moved[:, : photo.shape[1]], 0, 1).astype(np.float32)


@pytest.mark.parametrize("first", [0.0, 0.25, 0.5, 0.75])
def test_sgm_is_drawn_to_no_whole_pixel(photo: FloatMap, first: float) -> None:
    """At every twentieth of a pixel: mean and median of the error."""
    for fraction in np.arange(first, first + 0.25, 0.05):
        found = match_semiglobal(photo, shifted(photo, 8 + fraction), window=(0, 16))
        error_px = (found.disparity_px - (8 + fraction))[SEEN]
        assert abs(error_px.mean()) < LARGEST_BIAS_PX, f"8 + {fraction:.2f} px"
        assert abs(np.median(error_px)) < LARGEST_BIAS_PX, f"8 + {fraction:.2f} px"


@pytest.mark.parametrize("gain", [0.9, 1.1])
@pytest.mark.parametrize("offset", [-0.05, 0.05])
def test_contrast_and_brightness_of_a_view_are_no_shift(photo: FloatMap, gain: float, offset: float) -> None:
    ref = (0.2 + 0.5 * photo).astype(np.float32)
    src = shifted(ref, 8.35) * np.float32(gain) + np.float32(offset)
    start_px, sure = np.full(ref.shape[:2], 8.0, np.float32), np.ones(ref.shape[:2], np.float32)
    error_px = (refine_subpixel(ref, src, start_px, confidence=sure) - 8.35)[SEEN]
    assert abs(np.median(error_px)) < LARGEST_BIAS_PX


def test_two_surfaces_keep_their_own_fractions(photo: FloatMap) -> None:
    """Upper half at 8.3 px, lower at 5.7 px, found as 8 and 6."""
    half = photo.shape[0] // 2
    src = np.concatenate([shifted(photo, 8.3)[:half], shifted(photo, 5.7)[half:]])
    start_px = np.repeat(np.float32([8, 6]), half)[:, None] * np.ones(photo.shape[1], np.float32)
    refined_px = refine_subpixel(photo, src, start_px, confidence=np.ones_like(start_px))
    assert np.median(refined_px[8 : half - 8, 24:-24]) == pytest.approx(8.3, abs=LARGEST_BIAS_PX)
    assert np.median(refined_px[half + 8 : -8, 24:-24]) == pytest.approx(5.7, abs=LARGEST_BIAS_PX)


def test_what_tells_nothing_moves_nothing(photo: FloatMap, rng: np.random.Generator) -> None:
    """An even wall, views with nothing in common, and disparities nobody trusts."""
    flat = np.full_like(photo, 0.4)
    start_px, sure = np.full(photo.shape[:2], 8.25, np.float32), np.ones(photo.shape[:2], np.float32)
    other = rng.random(photo.shape, dtype=np.float32)
    assert np.abs(refine_subpixel(flat, flat, start_px, confidence=sure) - start_px).max() < 0.01
    assert np.median(np.abs(refine_subpixel(photo, other, start_px, confidence=sure) - start_px)) < 0.1
    unsure = refine_subpixel(photo, shifted(photo, 8), start_px, confidence=np.zeros_like(sure))
    np.testing.assert_allclose(unsure, start_px, atol=1e-3)


def test_no_disparity_moves_by_a_level(photo: FloatMap) -> None:
    start_px = np.full(photo.shape[:2], 8.0, np.float32)
    refined_px = refine_subpixel(photo, shifted(photo, 9.5), start_px, confidence=np.ones_like(start_px))
    assert refined_px.dtype == np.float32
    assert np.abs(refined_px - start_px).max() <= 0.6 + 1e-5
