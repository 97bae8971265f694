"""Known damage does what it says: against Keys' kernel written out, closed forms, and bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from telewide.simulate.degrade import Degradation, degrade, degrade_small, shrink_and_enlarge


def keys_matrix(size_in: int, size_out: int) -> np.ndarray:
    """Weights of 1-D cubic convolution (a = -0.5), widened when shrinking, with the half-pixel rule."""
    scale = size_in / size_out
    width = max(scale, 1.0)
    centre = (np.arange(size_out)[:, None] + 0.5) * scale - 0.5
    t = np.abs(np.arange(size_in)[None, :] - centre) / width
    near = 1.5 * t**3 - 2.5 * t**2 + 1
    far = -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    weights = np.where(t < 1, near, np.where(t < 2, far, 0.0))
    return weights / weights.sum(axis=1, keepdims=True)


def smooth_image(rng: np.random.Generator, hw: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[: hw[0], : hw[1]]
    waves = [np.sin(x * a + y * b + p) for a, b, p in rng.uniform(0.05, 0.25, (3, 3))]
    return (0.5 + 0.2 * np.stack(waves, axis=-1)).astype(np.float32)


@pytest.mark.parametrize(("hw", "factor"), [((60, 80), 2.0), ((61, 83), 3.0), ((64, 96), 2.5), ((50, 70), 1.0)])
def test_shrink_and_enlarge_is_keys_kernel_twice(rng: np.random.Generator, hw: tuple[int, int], factor: float) -> None:
    image = (0.3 + 0.4 * rng.random((*hw, 3))).astype(np.float32)
    small = (round(hw[0] / factor), round(hw[1] / factor))
    rows = keys_matrix(small[0], hw[0]) @ keys_matrix(hw[0], small[0])
    columns = keys_matrix(small[1], hw[1]) @ keys_matrix(hw[1], small[1])
    expected = np.stack([rows @ image[..., channel] @ columns.T for channel in range(3)], axis=-1)
    np.testing.assert_allclose(shrink_and_enlarge(image, factor=factor), expected, atol=2e-6)


def test_shrinking_keeps_position_and_removes_detail() -> None:
    x = np.arange(240)
    for period, kept in ((48.0, 0.97), (3.0, 0.0)):
        wave = np.cos(2 * math.pi * x / period)
        image = np.broadcast_to(0.5 + 0.3 * wave[:, None], (32, 240, 3)).astype(np.float32)
        row = shrink_and_enlarge(image, factor=4.0)[16, 24:-24, 0] - 0.5
        phasor = np.mean(row * np.exp(-2j * math.pi * x[24:-24] / period)) * 2 / 0.3
        assert abs(abs(phasor) - kept) < 0.03
        if kept:
            assert abs(np.angle(phasor)) < 0.005  # 0.04 px


def test_no_damage_changes_nothing(rng: np.random.Generator) -> None:
    image = rng.random((33, 47, 3), dtype=np.float32)
    np.testing.assert_array_equal(degrade(image, Degradation(), rng=rng), image)


def test_content_moves_down(rng: np.random.Generator) -> None:
    image = smooth_image(rng, (121, 40))
    moved = degrade(image, Degradation(vertical_offset_px=5.0), rng=rng)
    np.testing.assert_allclose(moved[10:-5], image[5:-10], atol=1e-5)
    stretched = degrade(image, Degradation(vertical_offset_px=1.0, vertical_slope=0.05), rng=rng)
    y = np.arange(20, 100)
    landed = y + 1.0 + 0.05 * (y - 60.0)
    for column, channel in ((7, 0), (30, 2)):
        seen = np.interp(landed, np.arange(121), stretched[:, column, channel])
        np.testing.assert_allclose(seen, image[y, column, channel], atol=4e-3)


def test_blur_has_the_given_spread_and_direction(rng: np.random.Generator) -> None:
    image = np.zeros((61, 61, 3), np.float32)
    image[30, 30] = 1.0
    angle_rad = 0.6
    blurred = degrade(image, Degradation(blur_sigma_px=(3.0, 1.5), blur_angle_rad=angle_rad), rng=rng)[..., 0]
    assert blurred.sum() == pytest.approx(1.0, abs=1e-4)
    y, x = np.mgrid[-30:31, -30:31]
    covariance = np.array([[(blurred * a * b).sum() for a in (x, y)] for b in (x, y)])
    values, vectors = np.linalg.eigh(covariance)
    np.testing.assert_allclose(np.sqrt(values), [1.5, 3.0], rtol=0.08)
    major = vectors[:, 1]
    assert abs(major @ [math.cos(angle_rad), math.sin(angle_rad)]) > 0.999


def test_colour_is_the_stated_one(rng: np.random.Generator) -> None:
    image = rng.uniform(0.2, 0.6, (8, 9, 3)).astype(np.float32)
    matrix = ((0.9, 0.1, 0.0), (0.0, 1.0, 0.0), (0.05, 0.05, 0.9))
    damage = Degradation(gain=(1.2, 1.0, 0.8), gamma=1.1, colour_matrix=matrix)
    expected = (image.astype(np.float64) ** 1.1 * [1.2, 1.0, 0.8]) @ np.array(matrix).T
    np.testing.assert_allclose(degrade(image, damage, rng=rng), expected, atol=1e-5)


def test_noise_and_compression(rng: np.random.Generator) -> None:
    flat = np.full((90, 120, 3), 0.5, np.float32)
    noisy = degrade_small(flat, Degradation(factor=3.0, noise_std=0.02), rng=rng)
    assert noisy.shape == (30, 40, 3)
    assert np.std(noisy - 0.5) == pytest.approx(0.02, rel=0.05)
    image = smooth_image(rng, (64, 80))
    rough = [
        float(np.abs(degrade(image, Degradation(jpeg_quality=quality), rng=rng) - image).mean())
        for quality in (95, 60, 15)
    ]
    assert 0 < rough[0] < rough[1] < rough[2] < 0.05


ALL_AT_ONCE = Degradation(
    factor=2.7,
    blur_sigma_px=(1.2, 0.6),
    blur_angle_rad=0.4,
    jpeg_quality=70,
    noise_std=0.02,
    gamma=1.1,
    colour_matrix=((0.96, 0.02, 0.02), (0.01, 0.98, 0.01), (0.0, 0.05, 0.95)),
    vertical_offset_px=0.3,
    vertical_slope=0.001,
)


def test_same_seed_same_damage() -> None:
    image = np.random.default_rng(1).random((40, 50, 3), dtype=np.float32)
    twice = []
    for _ in range(2):
        rng = np.random.default_rng(9)
        twice.append(degrade(image, ALL_AT_ONCE, rng=rng))
    np.testing.assert_array_equal(*twice)


@pytest.mark.parametrize("gain", [0.5, 1.0, 1.6])
def test_damaged_pictures_are_pictures(gain: float, rng: np.random.Generator) -> None:
    image = rng.random((37, 53, 3), dtype=np.float32)
    damage = replace(ALL_AT_ONCE, gain=(gain, gain, 1 / gain))
    result = degrade(image, damage, rng=rng)
    assert result.shape == image.shape
    assert result.dtype == np.float32
    assert result.min() >= 0
    assert result.max() <= 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"factor": 0.5},
        {"factor": math.nan},
        {"jpeg_quality": 0},
        {"jpeg_quality": 101},
        {"noise_std": -0.1},
        {"blur_sigma_px": (1.0, -1.0)},
    ],
)
def test_impossible_damage_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Degradation(**wrong)


def test_enlarging_factor_is_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.5"):
        shrink_and_enlarge(np.zeros((8, 8, 3), np.float32), factor=0.5)
