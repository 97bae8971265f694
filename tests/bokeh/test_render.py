"""Bokeh against exact lens sampling of layered worlds, closed forms, and bad input."""

from __future__ import annotations

import tracemalloc
from functools import cache

import cv2
import numpy as np
import pytest
from bokeh.layered_world import World, random_world, reference_world

from telewide.benchmark.outlines import speck_share
from telewide.bokeh import lens
from telewide.bokeh.focus import Focus
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.bokeh.render import (
    radius_per_px_from_f_number,
    radius_per_px_from_strength,
    render_bokeh,
)
from telewide.errors import InputError, UsageError
from telewide.geometry.stereo import DisparityMap
from telewide.srgb import linear_from_srgb, srgb_from_linear

FOCUSES = {"far": 0.0, "mid": 0.5, "near": 1.0}  # share of the way from the farthest disparity to the nearest


@cache
def world_of(seed: int) -> World:
    return random_world(seed) if seed else reference_world()


def psnr_db(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    squared = (np.clip(image, 0, 1) - np.clip(truth, 0, 1)) ** 2
    return float(-10 * np.log10((squared if mask is None else squared[mask]).mean()))


def gaussian_by_depth(light: np.ndarray, radius_px: np.ndarray) -> np.ndarray:
    """Blur every pixel by a Gaussian of its own disk's spread, in linear light: what bokeh is without layers."""
    sigma_px = np.abs(radius_px) / 2  # the spread of a disk along an axis
    levels = np.linspace(0, float(sigma_px.max()) + 1e-6, 17)
    level = np.digitize(sigma_px, levels)
    blurred = light.copy()
    for i in np.unique(level):
        sigma = float(sigma_px[level == i].mean())
        if sigma > 0.2:
            blurred[level == i] = cv2.GaussianBlur(light, (0, 0), sigma)[level == i]
    return blurred


def edge_band(radius_px: np.ndarray) -> np.ndarray:
    """Mark what lies within 8 px of a jump of the blur radius by more than 2 px."""
    square = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(radius_px, square) - cv2.erode(radius_px, square) > 2
    return cv2.dilate(jump.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (17, 17))) > 0


def inside(hw: tuple[int, int], *, margin_px: int) -> np.ndarray:
    mask = np.zeros(hw, bool)
    mask[margin_px:-margin_px, margin_px:-margin_px] = True
    return mask


@pytest.mark.parametrize(
    ("seed", "largest_radius_px", "focus"),
    [
        (0, 24.0, "near"),
        (0, 24.0, "far"),
        (1, 24.0, "mid"),
        *((1, 12.0, focus) for focus in FOCUSES),
        (2, 12.0, "mid"),
        (3, 12.0, "near"),
        (3, 12.0, "far"),
    ],
)
def test_bokeh_is_that_of_a_sampled_lens(seed: int, largest_radius_px: float, focus: str) -> None:
    world = world_of(seed)
    light, disparity_px = world.photo_linear(), world.disparity_px()
    far_px, near_px = float(disparity_px.min()), float(disparity_px.max())
    focus_px = far_px + FOCUSES[focus] * (near_px - far_px)
    k = largest_radius_px / (near_px - far_px)
    truth = world.through_lens_linear(focus=focus_px, k=k, samples=320 if largest_radius_px > 12 else 128)
    photo_srgb, truth_srgb = srgb_from_linear(light), srgb_from_linear(truth)
    radius_px = k * (disparity_px - focus_px)

    bokeh_srgb = render_bokeh(photo_srgb, disparity_px, focus_disparity_px=focus_px, radius_per_px=k)

    assert psnr_db(bokeh_srgb, truth_srgb) >= 42
    assert psnr_db(bokeh_srgb, truth_srgb, edge_band(radius_px)) >= 40
    assert linear_from_srgb(bokeh_srgb).sum() == pytest.approx(truth.sum(), rel=0.01)
    # Large disks reach beyond the frame, which neither way of blurring knows: there the two are compared inside.
    compared = np.ones(world.hw, bool) if largest_radius_px <= 12 else inside(world.hw, margin_px=24)
    gaussian_srgb = srgb_from_linear(gaussian_by_depth(light, radius_px))
    assert psnr_db(bokeh_srgb, truth_srgb, compared) >= 6 + psnr_db(gaussian_srgb, truth_srgb, compared)


def test_one_distance_is_one_disk(rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 1, (60, 70, 3)).astype(np.float32)
    y, x = np.mgrid[-8:9, -8:9]
    share = np.clip(6.5 - np.hypot(x, y), 0, 1)  # a disk of radius 6 px, its rim antialiased
    expected = cv2.filter2D(linear_from_srgb(photo), -1, share / share.sum(), borderType=cv2.BORDER_REFLECT_101)
    for disparity_px in (5.0, -1.0):
        bokeh = render_bokeh(photo, np.full((60, 70), disparity_px), focus_disparity_px=2.0, radius_per_px=2.0)
        assert psnr_db(bokeh, srgb_from_linear(expected)) > 45


@pytest.mark.parametrize("radius_px", [0.7, 3.0, 7.9, 8.1, 13.0, 30.0])
def test_disk_has_its_area_spread_and_centre(radius_px: float) -> None:
    light = np.zeros((160, 160, 3), np.float32)
    light[80, 80] = 1000.0
    spot = lens.spread_light(light, np.full((160, 160), radius_px, np.float32))[..., 1]
    y, x = np.mgrid[:160, :160]
    assert spot.sum() == pytest.approx(1000, rel=1e-3)
    assert (spot * x).sum() / spot.sum() == pytest.approx(80, abs=0.02 + lens._cell_of(radius_px) - 1)
    spread_px2 = (spot * ((x - 80) ** 2 + (y - 80) ** 2)).sum() / spot.sum()
    assert np.sqrt(2 * spread_px2) == pytest.approx(radius_px, rel=0.06, abs=0.25)


def test_nothing_moves_without_blur(rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 1, (40, 50, 3)).astype(np.float32)
    disparity_px = rng.uniform(-9, 9, (40, 50)).astype(np.float32)
    np.testing.assert_array_equal(render_bokeh(photo, disparity_px, focus_disparity_px=3.0, radius_per_px=0.0), photo)
    same = np.full((40, 50), -4.0, np.float32)
    np.testing.assert_array_equal(render_bokeh(photo, same, focus_disparity_px=-4.0, radius_per_px=9.0), photo)


def test_what_is_in_focus_stays_sharp(rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 1, (64, 96, 3)).astype(np.float32)
    disparity_px = np.where(np.arange(96) < 48, 2.0, 8.0)[None].repeat(64, axis=0).astype(np.float32)
    bokeh = render_bokeh(photo, disparity_px, focus_disparity_px=8.0, radius_per_px=1.0)
    np.testing.assert_allclose(bokeh[:, 49:], photo[:, 49:], atol=1e-5)  # in front, so nothing is laid over it
    assert bokeh[:, :40].std() < 0.5 * photo[:, :40].std()


def test_only_differences_of_disparity_count(rng: np.random.Generator) -> None:
    world = world_of(0)
    photo = srgb_from_linear(world.photo_linear())[100:200, 100:200]
    disparity_px = 8 * world.disparity_px()[100:200, 100:200]
    ahead = render_bokeh(photo, disparity_px, focus_disparity_px=4.0, radius_per_px=1.0)
    behind = render_bokeh(
        photo, disparity_px - 64, focus_disparity_px=-60.0, radius_per_px=1.0
    )  # both signs of x_ref - x_src
    np.testing.assert_allclose(behind, ahead, atol=1e-5)


def test_bokeh_stays_in_the_range_of_the_photo_up_to_the_frame(rng: np.random.Generator) -> None:
    photo = rng.uniform(0.2, 0.8, (70, 90, 3)).astype(np.float32)
    disparity_px = np.zeros((70, 90), np.float32)
    disparity_px[:, :9] = 20  # a near object cut by the frame
    disparity_px[:12] = -10
    for focus_px in (-10.0, 0.0, 20.0):
        bokeh = render_bokeh(photo, disparity_px, focus_disparity_px=focus_px, radius_per_px=0.5)
        assert bokeh.min() > 0.2 - 1e-4
        assert bokeh.max() < 0.8 + 1e-4
    flat = render_bokeh(np.full_like(photo, 0.4), disparity_px, focus_disparity_px=0.0, radius_per_px=0.5)
    np.testing.assert_allclose(flat, 0.4, atol=1e-4)  # no dark or bright seam anywhere


@pytest.mark.parametrize("focus_px", [0.0, 10.0])
def test_an_outline_whose_blur_changes_along_it_has_no_specks(focus_px: float, rng: np.random.Generator) -> None:
    """A dark thing before a bright wall, its depth uneven by half a pixel of blur, its edge soft over 3 px."""
    y, x = np.mgrid[:120, :160].astype(np.float32)
    outside_px = np.hypot(x - 80, y - 60) - 40
    coverage = np.clip(0.5 - outside_px / 3, 0, 1)[..., None]
    photo = srgb_from_linear(np.float32(0.02) * coverage + np.float32(0.6) * (1 - coverage)).repeat(3, axis=2)
    uneven_px = cv2.GaussianBlur(rng.normal(size=(120, 160)).astype(np.float32), (0, 0), 2)
    disparity_px = np.where(outside_px < 0, 10 + 0.5 * uneven_px / uneven_px.std(), 0).astype(np.float32)
    bokeh = render_bokeh(photo, disparity_px, focus_disparity_px=focus_px, radius_per_px=1.0)
    assert speck_share(bokeh, disparity_px) <= speck_share(photo, disparity_px) + 0.005


def test_tiles_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    world = world_of(0)
    photo, disparity_px = srgb_from_linear(world.photo_linear()), 8 * world.disparity_px()
    whole = render_bokeh(photo, disparity_px, focus_disparity_px=2.0, radius_per_px=1.0)
    monkeypatch.setattr(lens, "TILE_PX", 64)
    tiled = render_bokeh(photo, disparity_px, focus_disparity_px=2.0, radius_per_px=1.0)
    assert np.abs(tiled - whole).mean() < 1e-5
    assert np.quantile(np.abs(tiled - whole), 0.999) < 2 / 255


@pytest.mark.parametrize("radius_px", [6.0, 60.0])
def test_memory_goes_by_pixels_and_not_by_the_radius(
    radius_px: float, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    monkeypatch.setattr(lens, "TILE_PX", 64)
    photo = rng.random((600, 700, 3)).astype(np.float32)
    slope_px = np.linspace(0, 1, 700, dtype=np.float32)[None].repeat(600, axis=0)
    tracemalloc.start()
    render_bokeh(photo, slope_px, focus_disparity_px=0.5, radius_per_px=2 * radius_px)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 75 * slope_px.size


def test_a_photo_is_let_go_before_its_blur_is_drawn(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """With the photo itself a picture takes no more than what is made of it, though reading it takes memory first."""
    monkeypatch.setattr(lens, "TILE_PX", 64)
    levels = rng.integers(0, 256, (600, 700, 3), dtype=np.uint8)
    slope_px = np.linspace(0, 1, 700, dtype=np.float32)[None].repeat(600, axis=0)
    maps, options = DisparityMap(slope_px, np.ones_like(slope_px), slope_px >= 0), BokehOptions(strength_px=60.0)
    tracemalloc.start()
    bokeh_picture(
        lambda: levels * np.float32(1 / 255), maps, options=options, baseline_m=None, focus=Focus(0.5, 350, 300)
    )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 75 * slope_px.size


def test_unknown_disparity_is_that_of_the_nearest_known(rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 1, (50, 60, 3)).astype(np.float32)
    disparity_px = np.full((50, 60), 3.0, np.float32)
    disparity_px[:, 30:] = 9.0
    holed_px = disparity_px.copy()
    holed_px[10:20, 5:15] = np.nan
    holed_px[30:, 45:] = np.inf
    expected = render_bokeh(photo, disparity_px, focus_disparity_px=3.0, radius_per_px=1.0)
    bokeh = render_bokeh(photo, holed_px, focus_disparity_px=3.0, radius_per_px=1.0)
    np.testing.assert_array_equal(bokeh, expected)


@pytest.mark.parametrize("hw", [(1, 1), (1, 40), (7, 3)])
def test_tiny_photos_come_back(hw: tuple[int, int], rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 1, (*hw, 3)).astype(np.float32)
    disparity_px = rng.uniform(0, 50, hw).astype(np.float32)
    assert render_bokeh(photo, disparity_px, focus_disparity_px=0.0, radius_per_px=9.0).shape == photo.shape


def test_srgb_curve_is_undone_also_above_white() -> None:
    values = np.linspace(0, 4, 200, dtype=np.float32)
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(values)), values, rtol=1e-5, atol=1e-6)
    assert linear_from_srgb(np.float32([0.5]))[0] == pytest.approx(0.21404, abs=1e-4)


@pytest.mark.parametrize(("focus_px", "radius"), [(0.0, -1.0), (np.nan, 1.0), (0.0, np.inf)])
def test_impossible_blur_is_refused(focus_px: float, radius: float) -> None:
    with pytest.raises(UsageError, match="px"):
        render_bokeh(
            np.zeros((9, 9, 3), np.float32),
            np.zeros((9, 9), np.float32),
            focus_disparity_px=focus_px,
            radius_per_px=radius,
        )


def test_maps_that_do_not_fit_are_refused() -> None:
    photo = np.zeros((9, 9, 3), np.float32)
    with pytest.raises(InputError, match=r"\(8, 9\).*\(9, 9\)"):
        render_bokeh(photo, np.zeros((8, 9), np.float32), focus_disparity_px=0.0, radius_per_px=1.0)
    with pytest.raises(InputError, match="no known value"):
        render_bokeh(photo, np.full((9, 9), np.nan, np.float32), focus_disparity_px=0.0, radius_per_px=1.0)


# Strength


def test_strength_is_the_radius_farthest_from_the_focus() -> None:
    disparity_px = np.full((40, 50), 10.0, np.float32)
    disparity_px[:, :10], disparity_px[:, 40:] = -5.0, 18.0
    assert radius_per_px_from_strength(disparity_px, 10.0, strength_px=12.0) == pytest.approx(12 / 15)
    assert radius_per_px_from_strength(disparity_px, -5.0, strength_px=12.0) == pytest.approx(12 / 23)
    disparity_px[3, 3], disparity_px[4, 4] = 900.0, np.nan  # a mistake and a hole change nothing
    assert radius_per_px_from_strength(disparity_px, 10.0, strength_px=12.0) == pytest.approx(12 / 15)


def test_strength_of_a_scene_at_one_distance_is_no_blur() -> None:
    assert radius_per_px_from_strength(np.full((9, 9), 4.0, np.float32), 4.0, strength_px=12.0) == 0
    with pytest.raises(UsageError, match="-2"):
        radius_per_px_from_strength(np.zeros((9, 9), np.float32), 0.0, strength_px=-2.0)


def test_f_number_gives_the_thin_lens_blur() -> None:
    f_px, baseline_m, z_m, z_focus_m = 3000.0, 0.012, 4.0, 1.5
    aperture_m = 0.050 / 1.8
    diameter_px = f_px * aperture_m * abs(1 / z_m - 1 / z_focus_m)
    disparity_px = f_px * baseline_m * (1 / z_m - 1 / z_focus_m)
    radius_per_px = radius_per_px_from_f_number(f_number=1.8, baseline_m=baseline_m)
    assert abs(radius_per_px * disparity_px) == pytest.approx(diameter_px / 2)
    with pytest.raises(UsageError, match="baseline"):
        radius_per_px_from_f_number(f_number=1.8, baseline_m=0.0)
