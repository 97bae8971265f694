"""Drawn scenes keep their promises: bounds, order, repeatability, use of the given photos."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.simulate.layers import LayeredScene, disparity_range_px, render_pair
from telewide.simulate.scene import random_scene
from telewide.simulate.still_life import still_life

HW = (72, 112)


def photo(rng: np.random.Generator) -> np.ndarray:
    """A picture that no drawn pattern looks like: pure red, more or less."""
    image = np.zeros((90, 130, 3), np.float32)
    image[..., 0] = rng.uniform(0.3, 0.9, (90, 130))
    return image


@pytest.mark.parametrize("window", [(0.0, 24.0), (-10.0, 12.0), (5.0, 9.0)])
def test_every_disparity_is_in_the_window(window: tuple[float, float]) -> None:
    for seed in range(6):
        scene = random_scene(np.random.default_rng(seed), hw=HW, disparity_window_px=window)
        pair = render_pair(scene)
        assert pair.ref.shape == (*HW, 3)
        assert pair.ref.dtype == pair.src.dtype == pair.disparity_px.dtype == np.float32
        assert np.isfinite(pair.disparity_px).all()
        assert pair.disparity_px.min() >= window[0] - 1e-3
        assert pair.disparity_px.max() <= window[1] + 1e-3
        assert pair.ref.min() > -0.3
        assert pair.ref.max() < 1.3


def test_still_life_stays_in_its_window() -> None:
    for seed in range(4):
        pair = render_pair(still_life(np.random.default_rng(seed), hw=HW, disparity_window_px=(2.0, 14.0)))
        assert pair.disparity_px.min() >= 1.5
        assert pair.disparity_px.max() <= 14.01
        assert pair.disparity_px.max() - pair.disparity_px.min() > 8.0


def middle_disparities(scene: LayeredScene) -> list[float]:
    return [sum(disparity_range_px(layer)) / 2 for layer in scene.layers]


def test_objects_come_far_to_near_before_a_wall_that_covers_all() -> None:
    scene = random_scene(np.random.default_rng(5), hw=HW, disparity_window_px=(0.0, 24.0))
    assert scene.layers[0].alpha is None
    objects = LayeredScene(scene.layers[2:], HW)  # after the wall and, at times, the floor
    assert middle_disparities(objects) == sorted(middle_disparities(objects))


def test_same_seed_same_scene() -> None:
    pairs = [
        render_pair(random_scene(np.random.default_rng(seed), hw=HW, disparity_window_px=(0.0, 24.0)))
        for seed in (3, 3, 4)
    ]
    np.testing.assert_array_equal(pairs[0].src, pairs[1].src)
    assert not np.array_equal(pairs[0].disparity_px, pairs[2].disparity_px)


def test_surfaces_are_painted_with_the_photos(rng: np.random.Generator) -> None:
    photos = [photo(rng)]
    before = photos[0].copy()
    red = [render_pair(random_scene(rng, hw=HW, disparity_window_px=(0.0, 24.0), photos=photos)).ref for _ in range(6)]
    share = np.mean([(image[..., 0] > 2 * image[..., 1:].max(axis=-1)).mean() for image in red])
    assert share > 0.5
    np.testing.assert_array_equal(photos[0], before)


def test_number_of_objects_follows_the_request(rng: np.random.Generator) -> None:
    few = [len(random_scene(rng, hw=HW, disparity_window_px=(0, 20), n_layers=(1, 1)).layers) for _ in range(10)]
    many = [len(random_scene(rng, hw=HW, disparity_window_px=(0, 20), n_layers=(12, 12)).layers) for _ in range(10)]
    assert min(few) >= 1
    assert np.mean(many) > np.mean(few) + 8


@pytest.mark.parametrize("make", [random_scene, still_life])
def test_empty_window_is_refused(make: object, rng: np.random.Generator) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match="disparity_window_px"):
        make(rng, hw=HW, disparity_window_px=(5.0, 5.0))
