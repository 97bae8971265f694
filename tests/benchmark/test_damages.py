"""Damages of the comparison against OpenCV's Gaussian, Pillow's JPEG and closed forms."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from telewide.benchmark.damages import Damage, Damages, damaged_view, drawn_degradation, find_damage, load_damages
from telewide.capture.images import resize_bicubic
from telewide.errors import InputError, UsageError
from telewide.srgb import linear_from_srgb

PUBLISHED = ("BIC", "IG", "AG", "IG_JPEG", "AG_JPEG")
HW = (96, 144)


@pytest.fixture
def view(rng: np.random.Generator) -> np.ndarray:
    coarse = rng.random((HW[0] // 3, HW[1] // 3, 3), dtype=np.float32)
    return np.clip(resize_bicubic(coarse, wh=HW[::-1]), 0, 1)


def damaged(view: np.ndarray, name: str, *, factor: float = 4, seed: int = 0) -> np.ndarray:
    return damaged_view(view, find_damage(name, load_damages()), factor=factor, scene="Art", seed=seed)


def written_out_kernel(major: float, minor: float, angle_deg: float) -> np.ndarray:
    """A Gaussian of 21 by 21 by its covariance."""
    turn = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    across = np.array([-turn[1], turn[0]])
    covariance = major**2 * np.outer(turn, turn) + minor**2 * np.outer(across, across)
    xy = np.stack(np.meshgrid(np.arange(-10, 11), np.arange(-10, 11)), axis=-1)
    kernel = np.exp(-0.5 * np.einsum("...i,ij,...j", xy, np.linalg.inv(covariance), xy))
    return kernel / kernel.sum()


@pytest.mark.parametrize(("name", "kernel"), [("IG", (2.4, 2.4, 0.0)), ("AG", (2.4, 1.2, 30.0))])
def test_gaussian_kernels_at_factor_four(view: np.ndarray, name: str, kernel: tuple[float, float, float]) -> None:
    blurred = cv2.filter2D(view, -1, written_out_kernel(*kernel), borderType=cv2.BORDER_REFLECT_101)
    small = resize_bicubic(blurred, wh=(HW[1] // 4, HW[0] // 4))
    expected = resize_bicubic(small, wh=HW[::-1])
    np.testing.assert_allclose(damaged(view, name), expected, atol=0.004)
    assert np.abs(damaged(view, "BIC") - expected).max() > 0.02


def test_jpeg_comes_at_the_small_size(view: np.ndarray) -> None:
    small = resize_bicubic(view, wh=(HW[1] // 2, HW[0] // 2))
    stream = io.BytesIO()
    Image.fromarray(np.rint(small * 255).astype(np.uint8)).save(stream, "JPEG", quality=75)
    coded = np.asarray(Image.open(stream), np.float32) / 255
    ours = damaged_view(view, Damage(jpeg_quality=75), factor=2, scene="Art", seed=0)
    difference = np.abs(ours - resize_bicubic(coded, wh=HW[::-1]))
    assert difference.mean() < 0.01 < np.abs(ours - resize_bicubic(small, wh=HW[::-1])).mean()


def test_published_damages_draw_nothing(view: np.ndarray) -> None:
    for name in PUBLISHED:
        np.testing.assert_array_equal(damaged(view, name, seed=0), damaged(view, name, seed=1))


@pytest.mark.parametrize("name", ["haze", "Haze", "HAZE"])
def test_a_damage_is_found_in_any_letter_case(name: str) -> None:
    damage = Damage(gamma=(1.1, 1.2))
    assert find_damage(name, Damages(format=1, damages={"Haze": damage})) is damage


def test_open_damages_are_drawn_between_their_ends(rng: np.random.Generator) -> None:
    damage = find_damage("open", load_damages())
    drawn = [drawn_degradation(damage, factor=4, rng=rng) for _ in range(400)]
    for name, (low, high) in {
        "vignetting": (0.2, 0.5),
        "noise_std": (0.005, 0.03),
        "gamma": (0.8, 1.25),
        "vertical_offset_px": (-2, 2),
        "vertical_slope": (-0.005, 0.005),
    }.items():
        values = np.array([getattr(one, name) for one in drawn])
        assert low <= values.min() < low + 0.1 * (high - low), name
        assert high >= values.max() > high - 0.1 * (high - low), name
    gains = np.array([one.gain for one in drawn])
    assert 0.6 * 0.75 <= gains.min() < gains.max() <= 1.6 * 1.4
    assert len(np.unique(gains[0])) == 3
    gain = find_damage("GAIN", load_damages())
    alone = np.array([drawn_degradation(gain, factor=1, rng=rng).gain for _ in range(200)])
    assert (alone == alone[:, :1]).all()  # one gain for all channels
    assert 0.6 <= alone.min() < 0.65
    assert 1.5 < alone.max() <= 1.6


def test_what_is_drawn_depends_on_scene_and_seed(view: np.ndarray) -> None:
    noise = find_damage("NOISE", load_damages())
    first = damaged_view(view, noise, factor=2, scene="Art", seed=0)
    np.testing.assert_array_equal(first, damaged_view(view, noise, factor=2, scene="Art", seed=0))
    for scene, seed in (("Books", 0), ("Art", 1)):
        assert np.abs(first - damaged_view(view, noise, factor=2, scene=scene, seed=seed)).max() > 0.01


def test_corners_lose_their_share_of_light() -> None:
    grey = np.full((*HW, 3), 0.6, np.float32)
    dark = damaged_view(grey, Damage(vignetting=(0.4, 0.4)), factor=1, scene="Art", seed=0)
    share = linear_from_srgb(dark) / linear_from_srgb(grey)
    assert share[0, 0, 0] == pytest.approx(0.6, abs=1e-3)
    assert share[HW[0] // 2, HW[1] // 2, 0] == pytest.approx(1, abs=1e-3)


def test_slips(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown damage") as caught:
        find_damage("IG_JPG", load_damages())
    assert "IG_JPEG" in (caught.value.hint or "")
    path = tmp_path / "mine.yaml"
    for slip, expected in (("{gain: [2, 1]}", "lower end"), ("{gain: [0, 1]}", "gain"), ("{gian: [1, 1]}", "gian")):
        path.write_text(f"format: 1\ndamages: {{MINE: {slip}}}\n")
        with pytest.raises(InputError, match=expected):
            load_damages(path=path)
