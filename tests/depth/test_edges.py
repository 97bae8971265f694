"""Edges of a disparity map follow those of the photo, and no value appears between two surfaces."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest
from bokeh.layered_world import World, random_world, reference_world

from telewide.bokeh.render import render_bokeh
from telewide.depth import edges
from telewide.depth.edges import REACH_PX, ROUNDS, follow_edges
from telewide.depth.nearest import fill_unknown, nearest_known
from telewide.errors import InputError
from telewide.srgb import srgb_from_linear

SCALE_PX = 24.0  # the worlds' disparities span about 1


def exact(disparity_px: np.ndarray) -> np.ndarray:
    return disparity_px.copy()


def dilated(disparity_px: np.ndarray) -> np.ndarray:
    return cv2.dilate(disparity_px, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7)))


def quarter_nearest(disparity_px: np.ndarray) -> np.ndarray:
    return cv2.resize(disparity_px[2::4, 2::4], disparity_px.shape[::-1], interpolation=cv2.INTER_NEAREST)


def quarter_linear(disparity_px: np.ndarray) -> np.ndarray:
    return cv2.resize(disparity_px[2::4, 2::4], disparity_px.shape[::-1], interpolation=cv2.INTER_LINEAR)


@cache
def world_of(seed: int) -> World:
    return random_world(seed, 256) if seed else reference_world(256)


def photo_and_truth(seed: int) -> tuple[np.ndarray, np.ndarray]:
    world = world_of(seed)
    return np.clip(srgb_from_linear(world.photo_linear()), 0, 1), SCALE_PX * world.disparity_px()


def followed(disparity_px: np.ndarray, photo: np.ndarray) -> np.ndarray:
    sure = np.ones_like(disparity_px)
    return follow_edges(disparity_px, photo, confidence=sure, valid=sure > 0)


def bad_share_at_edges(disparity_px: np.ndarray, truth_px: np.ndarray) -> float:
    square = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(truth_px, square) - cv2.erode(truth_px, square) > 2
    near_edge = cv2.dilate(edge.astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
    return float((np.abs(disparity_px - truth_px) > 1)[near_edge].mean())


def bokeh_db(disparity_px: np.ndarray, truth_px: np.ndarray, photo: np.ndarray, *, focus_px: float) -> float:
    """Bokeh from a map against bokeh from the true one."""
    ours, best = (
        render_bokeh(photo, map_px, focus_disparity_px=focus_px, radius_per_px=0.5)
        for map_px in (disparity_px, truth_px)
    )
    return float(-10 * np.log10(((ours - best) ** 2).mean() + 1e-12))


@pytest.mark.parametrize("damage", [dilated, quarter_nearest, quarter_linear])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_damaged_edges_return_to_the_photo(seed: int, damage: Callable[[np.ndarray], np.ndarray]) -> None:
    photo, truth_px = photo_and_truth(seed)
    damaged_px = damage(truth_px)
    followed_px = followed(damaged_px, photo)
    assert bad_share_at_edges(followed_px, truth_px) < 0.6 * bad_share_at_edges(damaged_px, truth_px)
    for focus_px in (float(truth_px.min()), float(truth_px.max())):
        before_db, after_db = (bokeh_db(m, truth_px, photo, focus_px=focus_px) for m in (damaged_px, followed_px))
        assert after_db >= before_db


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_exact_edges_stay(seed: int) -> None:
    photo, truth_px = photo_and_truth(seed)
    followed_px = followed(truth_px, photo)
    assert bad_share_at_edges(followed_px, truth_px) < 0.015
    for focus_px in (float(truth_px.min()), float(truth_px.max())):
        assert bokeh_db(followed_px, truth_px, photo, focus_px=focus_px) > 50


def test_every_value_is_one_of_its_window(rng: np.random.Generator) -> None:
    disparity_px = rng.choice(np.float32([-3.25, 0.5, 7.0, 21.0]), (40, 50))
    photo = rng.uniform(0, 1, (40, 50, 3)).astype(np.float32)
    confidence = rng.uniform(0, 1, (40, 50)).astype(np.float32)
    followed_px = follow_edges(disparity_px, photo, confidence=confidence, valid=confidence > 0.3)
    reach_px = REACH_PX * ROUNDS
    for y, x in np.ndindex(disparity_px.shape):
        rows, columns = (slice(max(v - reach_px, 0), v + reach_px + 1) for v in (y, x))
        assert followed_px[y, x] in disparity_px[rows, columns]


@pytest.mark.parametrize("damage", [dilated, quarter_nearest])
def test_a_large_photo_is_followed_at_its_own_pixels(
    damage: Callable[[np.ndarray], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Followed at a half, the map still ends nearer to the truth than any map of half the size could lie."""
    photo, truth_px = photo_and_truth(1)
    monkeypatch.setattr(edges, "FULL_SCALE_WIDTH_PX", truth_px.shape[1] // 2)
    damaged_px = damage(truth_px)
    followed_px = followed(damaged_px, photo)
    assert bad_share_at_edges(followed_px, truth_px) < 0.4 * bad_share_at_edges(damaged_px, truth_px)
    assert set(np.unique(followed_px)) <= set(np.unique(damaged_px))


def test_a_large_photo_keeps_its_own_values_apart_from_edges(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(edges, "FULL_SCALE_WIDTH_PX", 30)
    slope_px = np.linspace(-4, 4, 91, dtype=np.float32)[None].repeat(61, axis=0)
    photo = rng.uniform(0, 1, (61, 91, 3)).astype(np.float32)
    np.testing.assert_array_equal(followed(slope_px, photo), slope_px)


def test_two_surfaces_stay_two() -> None:
    photo, truth_px = photo_and_truth(0)
    step_px = np.where(truth_px > 6, np.float32(20), np.float32(5))
    assert set(np.unique(followed(dilated(step_px), photo))) == {5, 20}


def test_slope_without_an_edge_is_left_alone(rng: np.random.Generator) -> None:
    slope_px = np.linspace(-10, 10, 80, dtype=np.float32)[None].repeat(60, axis=0)
    photo = rng.uniform(0, 1, (60, 80, 3)).astype(np.float32)
    np.testing.assert_array_equal(followed(slope_px, photo), slope_px)


def test_confident_neighbours_decide() -> None:
    photo = np.full((60, 80, 3), 0.5, np.float32)
    photo[:, 40:] = 0.9
    disparity_px = np.full((60, 80), 4.0, np.float32)
    disparity_px[:, 34:] = 15.0  # the near surface, 6 px too wide
    confidence = np.ones_like(disparity_px)
    confidence[:, 34:40] = 0.02
    followed_px = follow_edges(disparity_px, photo, confidence=confidence, valid=confidence > 0.5)
    assert (followed_px[:, :40] == 4).mean() > 0.99
    assert (followed_px[:, 40:] == 15).all()


def test_unknown_is_filled_from_the_nearest(rng: np.random.Generator) -> None:
    disparity_px = rng.uniform(-5, 5, (30, 40)).astype(np.float32)
    disparity_px[rng.uniform(size=(30, 40)) < 0.8] = np.nan
    known_yx = np.argwhere(np.isfinite(disparity_px))
    filled_px = fill_unknown(disparity_px)
    distance_px, index = nearest_known(np.isfinite(disparity_px))
    for y, x in np.ndindex(disparity_px.shape):
        best = np.hypot(*(known_yx - (y, x)).T).min()
        at = np.unravel_index(index[y, x], disparity_px.shape)
        assert np.hypot(at[0] - y, at[1] - x) <= 1.1 * best + 1e-6
        assert filled_px[y, x] == disparity_px[at]
    assert (distance_px[np.isfinite(disparity_px)] == 0).all()
    whole_px = np.zeros((3, 4), np.float32)
    assert fill_unknown(whole_px) is whole_px


def test_maps_that_do_not_fit_are_refused() -> None:
    flat, photo = np.zeros((20, 30), np.float32), np.zeros((20, 31, 3), np.float32)
    with pytest.raises(InputError, match=r"\(20, 30\).*\(20, 31\)"):
        follow_edges(flat, photo, confidence=flat, valid=flat == 0)
    with pytest.raises(InputError, match="no known value"):
        fill_unknown(np.full((4, 4), np.nan, np.float32))
