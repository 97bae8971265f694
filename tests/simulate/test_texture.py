"""Textures and outlines have the size, range and coverage they state."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from telewide.simulate import shapes
from telewide.simulate.texture import band_noise, drawn_texture, photo_texture, tiled_texture, weak_texture

HW = (50, 70)


def test_every_texture_fits(rng: np.random.Generator) -> None:
    photo = rng.random((40, 60, 3), dtype=np.float32)  # smaller than the texture: it is enlarged and mirrored
    for _ in range(12):
        for texture in (
            photo_texture(rng, photo, hw=HW),
            weak_texture(rng, photo, hw=HW),
            weak_texture(rng, None, hw=HW),
            drawn_texture(rng, hw=HW),
            tiled_texture(rng, [photo], hw=HW),
        ):
            assert texture.shape == (*HW, 3)
            assert texture.dtype == np.float32
            assert texture.flags.writeable
            assert texture.min() >= 0
            assert texture.max() <= 1


def test_photo_texture_is_a_piece_of_the_photo(rng: np.random.Generator) -> None:
    y, x = np.mgrid[:200, :300].astype(np.float32)
    photo = np.stack([np.full_like(x, 0.4), x / 600 + 0.2, y / 600 + 0.2], axis=-1)
    texture = photo_texture(rng, photo, hw=HW, scale=(1.0, 1.0))
    ratio = texture / texture[..., :1]  # without the change of brightness
    slopes = [float(np.abs(np.diff(ratio[..., channel], axis=axis)).mean()) for channel in (1, 2) for axis in (0, 1)]
    lying, upright = slopes[1] > slopes[0], slopes[0] > slopes[1]
    assert lying != upright
    assert min(slopes) < 0.02 * max(slopes)


def test_weak_texture_is_weak_and_drawn_texture_is_not(rng: np.random.Generator) -> None:
    def detail(texture: np.ndarray) -> float:
        return float(np.std(texture - cv2.GaussianBlur(texture, (0, 0), 3)))

    weak = [detail(weak_texture(rng, None, hw=HW)) for _ in range(20)]
    drawn = [detail(drawn_texture(rng, hw=HW)) for _ in range(20)]
    assert np.median(weak) < 0.02 < np.median(drawn)


@pytest.mark.parametrize("wavelength_px", [4.0, 12.0, 40.0])
def test_noise_has_its_wavelength(rng: np.random.Generator, wavelength_px: float) -> None:
    noise = band_noise(rng, hw=(128, 512), wavelength_px=wavelength_px)
    assert abs(noise.mean()) < 0.2
    power = (np.abs(np.fft.rfft(noise, axis=1)) ** 2).mean(axis=0)
    frequency = np.fft.rfftfreq(512)
    assert power[frequency > 1.2 / wavelength_px].sum() < 0.12 * power[1:].sum()


def test_bar_covers_width_times_length() -> None:
    for width_px, angle_rad in ((1.0, 0.3), (3.4, 1.2), (0.6, 2.0)):
        cover = shapes.bar(box=(-60, -60, 61, 61), through_xy=(0.3, -0.2), angle_rad=angle_rad, width_px=width_px)
        y, x = np.mgrid[-60:61, -60:61]
        along = x * math.cos(angle_rad) + y * math.sin(angle_rad)
        assert cover[np.abs(along) < 30].sum() == pytest.approx(width_px * 60, rel=0.06)


def test_filled_disk_with_a_hole() -> None:
    angle_rad = np.linspace(0, 2 * math.pi, 90, endpoint=False)
    circle = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    disk = shapes.placed(circle, centre_xy=(10.0, 5.0), radii_px=(20.0, 12.0), angle_rad=0.7)
    hole = shapes.placed(circle, centre_xy=(10.0, 5.0), radii_px=(6.0, 6.0), angle_rad=0.0)
    box = shapes.box_of(disk, limits=(-100, -100, 100, 100))
    assert box is not None
    whole = shapes.filled(disk, box=box)
    assert whole.sum() == pytest.approx(math.pi * 20 * 12, rel=0.08)
    assert max(whole[0].max(), whole[-1].max(), whole[:, 0].max(), whole[:, -1].max()) == 0
    open_px = (whole - shapes.filled(disk, box=box, holes=(hole,))).sum()
    assert open_px == pytest.approx(math.pi * 36, rel=0.2)


def test_placed_turns_from_x_towards_y() -> None:
    turned = shapes.placed(np.array([[1.0, 0.0]]), centre_xy=(5.0, 7.0), radii_px=(2.0, 3.0), angle_rad=math.pi / 2)
    np.testing.assert_allclose(turned, [[5.0, 9.0]], atol=1e-12)


def test_box_is_cut_to_its_limits() -> None:
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 10
    assert shapes.box_of(square, limits=(0, 0, 50, 50)) == (0, 0, 13, 13)
    assert shapes.box_of(square + 200, limits=(0, 0, 50, 50)) is None


def test_outlines_stay_in_the_unit_circle_and_reliefs_are_gentle(rng: np.random.Generator) -> None:
    for _ in range(60):
        outline = shapes.random_outline(rng)
        assert outline.shape[1] == 2
        assert np.abs(outline).max() <= 1.3
    leaf = shapes.leaf_outline(rng)
    assert leaf[:, 0].min() >= 0
    v, u = np.mgrid[-1.2:1.2:0.01, -1.2:1.2:0.01].astype(np.float32)
    for relief in shapes.RELIEFS:
        heights = relief(u, v)
        assert heights.shape == u.shape
        assert np.abs(np.diff(heights, axis=1)).max() / 0.01 < 2.4
