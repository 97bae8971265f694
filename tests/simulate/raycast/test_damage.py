"""Damage in torch: what it shares with numpy's against that, its JPEG against Pillow's, many views at once against one
at a time, moves and dark corners against their closed forms.
"""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.raycast.damage import Damage, compress_jpeg, damage_view, damage_views, draw_damage
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


def test_a_small_turn_moves_rows_by_what_grows_with_the_column() -> None:
    """By whole pixels in some columns, where nothing is interpolated; in all of them a ramp tells how far."""
    turn_rad, side = 1 / 16, 95
    right = np.arange(side) - side // 2
    picture = view(2)[:side, :side]
    moved = damaged(picture, Damage(turn_rad=turn_rad))
    for column in np.flatnonzero(right % 16 == 0):
        down = right[column] // 16
        np.testing.assert_allclose(moved[6:-6, column], picture[6 - down : side - 6 - down, column], atol=1e-4)
    ramp = np.broadcast_to(np.arange(side, dtype=np.float32)[:, None, None] / side, (side, side, 3))
    down_px = (ramp - damaged(ramp, Damage(turn_rad=turn_rad)))[6:-6] * side
    # A cubic through four points is up to a twentieth of a pixel off a ramp.
    np.testing.assert_allclose(down_px, np.broadcast_to((turn_rad * right)[:, None], down_px.shape), atol=0.06)


@pytest.mark.parametrize("lost", [0.2, 0.5])
def test_corners_lose_their_share_and_the_middle_keeps_its_light(lost: float) -> None:
    """Half of it is lost in the middles of the sides, by the square of the distance along each axis."""
    picture = view(3)[:61, :95]
    dark = damaged(picture, Damage(vignetting=lost))
    down, right = np.arange(-30, 31)[:, None] / 30, np.arange(-47, 48)[None] / 47
    kept = dark / np.maximum(picture, 1e-6)
    assert kept[30, 47] == pytest.approx(1, abs=1e-5)
    assert kept[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(1 - lost, abs=1e-5)
    assert kept[[0, -1, 30, 30], [47, 47, 0, -1]] == pytest.approx(1 - lost / 2, abs=1e-5)
    np.testing.assert_allclose(dark, picture * (1 - lost * (down**2 + right**2) / 2)[..., None], atol=1e-6)


def drawn(seed: int) -> Damage:
    return draw_damage(np.random.default_rng(seed), factors=(1.0, 8.5), equal_share=0.1)


def test_drawn_damage_is_a_function_of_its_generators() -> None:
    picture = view(4)
    first, second = (damaged(picture, drawn(7), seed=7) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert sum(drawn(seed).factor == 1 for seed in range(300)) in range(12, 60)


def many(count: int, *, device: str = "cpu") -> tuple[list[torch.Tensor], list[Damage]]:
    """Views of one size with a drawn damage each, some of them alike in what is damaged."""
    views = [torch.from_numpy(view(seed % 5).transpose(2, 0, 1).copy()).to(device) for seed in range(count)]
    return views, [drawn(seed) if seed % 3 else Damage(blur_sigma_px=(0.5, 0.5)) for seed in range(count)]


def generators(count: int, *, device: str = "cpu") -> list[torch.Generator]:
    return [torch.Generator(device).manual_seed(seed) for seed in range(count)]


def apart(one: list[torch.Tensor], other: list[torch.Tensor]) -> list[float]:
    return [float((a - b.to(a)).abs().mean()) for a, b in zip(one, other, strict=True)]


def test_views_damaged_together_are_damaged_as_each_alone() -> None:
    views, damages = many(16)
    assert len({damage.jpeg_quality for damage in damages}) > 1
    together = damage_views(views, damages, generators=generators(16))
    alone = [damage_view(*pair, generator=of) for *pair, of in zip(views, damages, generators(16), strict=True)]
    assert max(apart(together, alone)) < 1e-5
    assert min(apart(together, views)) > 1e-4


def test_views_that_share_a_generator_draw_from_it_in_turn() -> None:
    views, damages = many(2)
    noisy = [Damage(noise_std=0.1, factor=3.0), Damage(noise_std=0.1)]
    shared, (again, _) = generators(1) * 2, generators(2)
    together = damage_views(views, noisy, generators=shared)
    in_turn = [damage_view(one, damage, generator=again) for one, damage in zip(views, noisy, strict=True)]
    assert max(apart(together, in_turn)) < 1e-5
    assert min(apart(together, damage_views(views, damages, generators=generators(2)))) > 1e-3


def test_a_gpu_damages_as_the_processor_does(gpu: str) -> None:
    (views, damages), (there, _) = many(16), many(16, device=gpu)
    silent = [replace(damage, noise_std=0.0) for damage in damages]  # each device draws noise of its own
    found = damage_views(there, silent, generators=generators(16, device=gpu))
    assert all(each.device.type == gpu for each in found)
    assert max(apart(damage_views(views, silent, generators=generators(16)), found)) < 2e-3
