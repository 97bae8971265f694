"""Damage in torch against its twin in numpy, and its JPEG against Pillow's."""

from __future__ import annotations

import io

import numpy as np
import pytest
import torch
from PIL import Image

from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.raycast.damage import Damage, compress_jpeg, damage_view, draw_damage
from telewide.simulate.raycast.patterns import draw_texture

SIDE = 96


def view(seed: int) -> np.ndarray:
    return draw_texture(np.random.default_rng(seed), side_px=SIDE)


def damaged(picture: np.ndarray, damage: Damage, *, seed: int = 0) -> np.ndarray:
    result = damage_view(
        torch.from_numpy(picture.transpose(2, 0, 1).copy()), damage, generator=torch.Generator().manual_seed(seed)
    )
    return result.permute(1, 2, 0).numpy()


@pytest.mark.parametrize(
    "settings",
    [
        {"factor": 4.0},
        {"factor": 2.5, "blur_sigma_px": (1.5, 0.8), "blur_angle_rad": 0.6},
        {"gain": (1.2, 0.9, 0.7), "factor": 2.0},
    ],
)
def test_torch_and_numpy_damage_alike(settings: dict[str, object]) -> None:
    picture = view(3)
    ours = damaged(picture, Damage(**settings))
    theirs = degrade(picture, Degradation(**settings), rng=np.random.default_rng(0))
    assert np.abs(ours - theirs)[8:-8, 8:-8].mean() < 0.006


@pytest.mark.parametrize("quality", [40, 75, 92])
def test_jpeg_loses_what_pillow_loses(quality: int) -> None:
    picture = view(5)
    ours = compress_jpeg(torch.from_numpy(picture.transpose(2, 0, 1).copy())[None], quality=quality)[0]
    stream = io.BytesIO()
    Image.fromarray((picture * 255).round().astype(np.uint8)).save(stream, "JPEG", quality=quality, subsampling="4:2:0")
    theirs = np.asarray(Image.open(stream), np.float32) / 255
    apart = np.sqrt(np.mean((ours.permute(1, 2, 0).numpy() - theirs) ** 2))
    lost = np.sqrt(np.mean((picture - theirs) ** 2))
    assert apart < 0.5 * lost + 0.004


def test_no_damage_changes_nothing() -> None:
    picture = view(1)
    np.testing.assert_allclose(damaged(picture, Damage()), picture, atol=1e-6)


def test_a_vertical_offset_moves_the_content_down() -> None:
    picture = view(2)
    moved = damaged(picture, Damage(vertical_px=2.0))
    np.testing.assert_allclose(moved[6:-6], picture[4:-8], atol=1e-4)


def drawn(seed: int) -> Damage:
    return draw_damage(np.random.default_rng(seed), factors=(1.0, 8.5), equal_share=0.1)


def test_drawn_damage_is_a_function_of_its_generators() -> None:
    picture = view(4)
    first, second = (damaged(picture, drawn(7), seed=7) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert sum(drawn(seed).factor == 1 for seed in range(300)) in range(12, 60)
