"""Rendered views are exact: against closed forms, laws of projection, and the optics of a lens."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.simulate.layers import (
    Layer,
    LayeredScene,
    disparity_range_px,
    render_pair,
    render_view,
)
from telewide.simulate.scene import random_scene
from telewide.simulate.still_life import still_life
from telewide.srgb import linear_from_srgb, srgb_from_linear

HW = (48, 96)


def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([0.5 + 0.3 * np.sin(0.2 * x + 0.1 * y + p) for p in (0.0, 1.0, 2.0)], axis=-1).astype(np.float32)


def surface(
    plane: tuple[float, float, float],
    *,
    window: tuple[int, int, int, int] | None = None,
    relief: np.ndarray | None = None,
    reach: int = 40,
) -> Layer:
    """A wave-painted surface: over everything, or over a window (x0, y0, x1, y1)."""
    x0, y0, x1, y1 = window or (-reach, -reach, HW[1] + reach, HW[0] + reach)
    y, x = np.mgrid[y0:y1, x0:x1]
    alpha = None if window is None else np.ones((y1 - y0, x1 - x0), np.float32)
    return Layer(wave(x, y), alpha, (x0, y0), plane, relief)


def test_slanted_plane_in_closed_form() -> None:
    a, b, c = 4.0, 0.1, -0.05
    pair = render_pair(LayeredScene((surface((a, b, c)),), HW))
    y, x = np.mgrid[: HW[0], : HW[1]]
    np.testing.assert_allclose(pair.ref, wave(x, y), atol=1e-6)
    np.testing.assert_allclose(pair.disparity_px, a + b * x + c * y, atol=1e-4)
    # x_src = x - a - b x - c y, solved for x.
    np.testing.assert_allclose(pair.src, wave((x + a + c * y) / (1 - b), y), atol=4e-3)


def test_source_shows_the_same_relief() -> None:
    y, x = np.mgrid[-40 : HW[0] + 40, -40 : HW[1] + 40]
    relief = (3.0 * np.sin(x / 12.0) * np.cos(y / 15.0)).astype(np.float32)
    scene = LayeredScene((surface((6.0, 0.02, 0.0), relief=relief),), HW)
    ref, src = render_view(scene), render_view(scene, parallax_xy=(-1.0, 0.0))
    x_ref = np.arange(HW[1])
    for row in (5, 24, 40):
        x_src = x_ref - ref.disparity_px[row]
        inside = (x_src > 0) & (x_src < HW[1] - 1)
        seen = np.interp(x_src[inside], x_ref, src.disparity_px[row])
        np.testing.assert_allclose(seen, ref.disparity_px[row][inside], atol=0.02)


def test_hidden_pixels_of_a_square_before_a_wall() -> None:
    scene = LayeredScene((surface((5.0, 0.0, 0.0)), surface((20.0, 0.0, 0.0), window=(50, 10, 80, 30))), HW)
    pair = render_pair(scene)
    expected = np.zeros(HW, bool)
    expected[:, :5] = True  # beyond the source's edge
    expected[10:30, 35:50] = True  # wall behind the square, 20 - 5 px beside it
    np.testing.assert_array_equal(pair.occluded, expected)
    depths = np.where((np.indices(HW)[0] >= 10) & (np.indices(HW)[0] < 30) & (np.indices(HW)[1] >= 50), 20.0, 5.0)
    depths[:, 80:] = 5.0
    np.testing.assert_array_equal(pair.disparity_px, depths)


def test_nearer_surface_is_seen_where_two_cross() -> None:
    scene = LayeredScene((surface((8.0, 0.0, 0.0)), surface((2.0, 0.1, 0.0))), HW)
    x = np.arange(HW[1])
    seen = render_view(scene)
    np.testing.assert_allclose(seen.disparity_px[20], np.maximum(8.0, 2.0 + 0.1 * x), atol=1e-4)
    swapped = render_view(LayeredScene(scene.layers[::-1], HW))
    np.testing.assert_allclose(swapped.disparity_px, seen.disparity_px)


def test_nothing_there_is_nan() -> None:
    pair = render_pair(LayeredScene((surface((3.0, 0.0, 0.0), window=(20, 10, 40, 30)),), HW))
    assert np.isnan(pair.disparity_px[0, 0])
    assert pair.occluded[0, 0]
    assert pair.disparity_px[20, 30] == 3.0


@pytest.mark.parametrize("seed", range(6))
def test_source_warped_by_the_truth_is_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    if seed < 4:
        scene = random_scene(rng, hw=(120, 180), disparity_window_px=(-6.0, 30.0))
    else:
        scene = still_life(rng, hw=(120, 180), disparity_window_px=(2.0, 24.0))
    pair = render_pair(scene)
    y, x = np.mgrid[:120, :180].astype(np.float32)
    warped = cv2.remap(pair.src, x - pair.disparity_px, y, cv2.INTER_CUBIC)
    inner = cv2.erode((~pair.occluded).astype(np.uint8), np.ones((3, 3))) > 0
    steps = cv2.morphologyEx(pair.disparity_px, cv2.MORPH_GRADIENT, np.ones((3, 3)))
    inner &= steps < 1.5
    assert inner.mean() > 0.4
    assert cv2.PSNR(warped[inner], pair.ref[inner], R=1.0) > 30.0
    assert np.median(np.abs(warped - pair.ref)[inner]) < 0.01


def test_disparity_range_bounds_what_is_seen(rng: np.random.Generator) -> None:
    scene = random_scene(rng, hw=(80, 120), disparity_window_px=(0.0, 30.0))
    view = render_view(scene)
    for number, layer in enumerate(scene.layers):
        mine = view.disparity_px[view.layer_index == number]
        low, high = disparity_range_px(layer)
        assert ((mine >= low - 1e-3) & (mine <= high + 1e-3)).all()


def test_srgb_curve_and_its_inverse() -> None:
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-5)
    assert linear_from_srgb(np.array([0.5], np.float32))[0] == pytest.approx(0.21404, abs=1e-4)
