"""Pictures through a large aperture: against the photo, closed forms and another sampling."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.simulate.apertures import through_lens
from telewide.simulate.layers import Layer, LayeredScene, render_view
from telewide.simulate.still_life import still_life
from telewide.srgb import linear_from_srgb

HW = (48, 64)


@pytest.fixture
def world(rng: np.random.Generator) -> LayeredScene:
    return still_life(rng, hw=(2 * HW[0], 2 * HW[1]), disparity_window_px=(2.0, 18.0))


def test_a_closed_aperture_gives_the_photo(world: LayeredScene) -> None:
    closed = through_lens(world, focus_px=4.0, k=0.0, hw=HW, points=2)
    light = linear_from_srgb(render_view(world).image).reshape(HW[0], 2, HW[1], 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(linear_from_srgb(closed), light, atol=1e-4)


def test_a_plane_is_blurred_by_the_disk_of_its_distance_from_the_focus() -> None:
    texture = np.zeros((65, 65, 3), np.float32)
    texture[32, 32] = 1
    plane = LayeredScene((Layer(texture, None, (0, 0), (7.0, 0.0, 0.0)),), (65, 65))
    light = linear_from_srgb(through_lens(plane, focus_px=3.0, k=1.5, hw=(65, 65), points=400))[..., 0]
    y, x = np.mgrid[:65, :65] - 32
    assert (light * (x**2 + y**2)).sum() / light.sum() == pytest.approx(6.0**2 / 2, rel=0.08)  # a disk of 6 px
    assert light[np.hypot(y, x) > 8].max() < 1e-3
    assert (light * x).sum() / light.sum() == pytest.approx(0, abs=0.2)


def test_more_points_change_nothing_that_shows(world: LayeredScene) -> None:
    few, many = (through_lens(world, focus_px=4.0, k=0.4, hw=HW, points=points) for points in (96, 300))
    assert -10 * np.log10(np.mean((few - many) ** 2)) > 45
