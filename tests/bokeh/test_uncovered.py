"""What wide shows behind nearer things, against a card before a painted wall that both lenses see exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.bokeh.focus import Focus
from telewide.bokeh.layers import Box
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.bokeh.render import render_bokeh
from telewide.bokeh.surroundings import Surroundings
from telewide.bokeh.uncovered import Uncovered, disparity_behind, find_uncovered, towards_wide
from telewide.bokeh.wide_light import WideView
from telewide.geometry.rig import Camera, StereoRig
from telewide.geometry.stereo import DisparityMap
from telewide.metrics import psnr_db
from telewide.srgb import linear_from_srgb, srgb_from_linear

WALL_M, CARD_M = 3.0, 0.6
HALF_CARD_M = (0.03, 0.02)
CARD = np.array([0.55, 0.2, 0.15], np.float32)
GAINS = np.array([0.8, 0.95, 1.1])


@dataclass(frozen=True)
class Scene:
    """Photos of a card before a wall; tele's without the card, and where the card is."""

    rig: StereoRig
    tele: np.ndarray
    wide: np.ndarray
    wall: np.ndarray
    is_card: np.ndarray

    def disparity_at(self, depth_m: float) -> np.float32:
        return np.float32(self.rig.tele.K[0, 0] * self.rig.baseline_m / depth_m)

    @property
    def disparity_px(self) -> np.ndarray:
        return np.where(self.is_card, self.disparity_at(CARD_M), self.disparity_at(WALL_M))

    @property
    def view(self) -> WideView:
        return WideView(self.wide, self.rig)


def card_in(camera: Camera, camera_from_tele: np.ndarray) -> np.ndarray:
    """Where a camera sees the card, by the rays of its pixels."""
    tele_from_camera = np.linalg.inv(camera_from_tele)
    y, x = np.indices(camera.hw)
    rays = np.column_stack([camera.normalised(np.column_stack([x.ravel(), y.ravel()]).astype(float)), np.ones(x.size)])
    rays, origin = rays @ tele_from_camera[:3, :3].T, tele_from_camera[:3, 3]
    points = origin + rays * ((CARD_M - origin[2]) / rays[:, 2])[:, None]
    return (np.abs(points[:, :2]) < HALF_CARD_M).all(axis=1).reshape(camera.hw)


@cache
def scene(*, is_vertical: bool = False) -> Scene:
    rig = phone_rig(is_vertical=is_vertical, width_px=400)
    views = [photos_of_a_plane(rig, np.random.default_rng(seed), depth_m=WALL_M) for seed in range(3)]
    wall, wide = (0.1 + 0.7 * np.stack(channels, axis=-1) for channels in zip(*views, strict=True))
    is_card = card_in(rig.tele, np.eye(4))
    tele = np.where(is_card[..., None], CARD, wall).astype(np.float32)
    wide = np.where(card_in(rig.wide, rig.wide_from_tele)[..., None], CARD, wide)
    wide = srgb_from_linear(linear_from_srgb(wide.astype(np.float64)) * GAINS)
    return Scene(rig, tele, np.clip(wide, 0, 1).astype(np.float32), wall.astype(np.float32), is_card)


@pytest.mark.parametrize("is_vertical", [False, True])
def test_the_wall_behind_the_card_is_seen_on_wides_side(is_vertical: bool) -> None:
    seen = scene(is_vertical=is_vertical)
    found = find_uncovered(seen.tele, seen.disparity_px, seen.view)
    assert seen.is_card[found.y, found.x].all()
    np.testing.assert_array_equal(found.disparity_px, seen.disparity_at(WALL_M))
    rows, columns = np.nonzero(seen.is_card)
    along, edge = (found.y, rows.max()) if is_vertical else (found.x, columns.max())
    open_px = seen.disparity_at(CARD_M) - seen.disparity_at(WALL_M)
    assert (edge - along <= open_px + 3).all()  # 3 px of tele are one of wide
    across_px = np.ptp(columns) + 1 if is_vertical else np.ptp(rows) + 1
    assert len(found.y) > 0.5 * open_px * across_px
    assert np.all(np.diff(found.y) >= 0)


@pytest.mark.parametrize("is_vertical", [False, True])
def test_its_colours_are_those_that_tele_would_have_seen(is_vertical: bool) -> None:
    seen = scene(is_vertical=is_vertical)
    found = find_uncovered(seen.tele, seen.disparity_px, seen.view)
    true = seen.wall[found.y, found.x]
    rows, columns = np.nonzero(seen.is_card)
    beside = (np.full_like(found.y, rows.max() + 1), found.x) if is_vertical else (found.y, columns.max() + 1)
    exact_db, continued_db = psnr_db(found.colour, true), psnr_db(seen.wall[beside], true)
    assert exact_db > 26
    assert exact_db > continued_db + 6


def test_what_another_thing_hides_from_wide_is_not_taken() -> None:
    seen = scene()
    columns = np.nonzero(seen.is_card)[1]
    found = find_uncovered(seen.tele, seen.disparity_px, seen.view)
    other_px = seen.disparity_px.copy()
    # A second card beside the first stands before that wall as wide sees it.
    other_px[:, columns.max() + 3 : columns.max() + 40] = 1.2 * seen.disparity_at(CARD_M)
    beside = find_uncovered(seen.tele, other_px, seen.view)
    n_left = 0 if beside is None else int(seen.is_card[beside.y, beside.x].sum())
    assert n_left < 0.1 * len(found.y)


def test_where_wide_tells_nothing_there_is_nothing() -> None:
    seen, rng = scene(), np.random.default_rng(3)
    flat_px = np.full_like(seen.disparity_px, seen.disparity_at(WALL_M))
    assert find_uncovered(seen.tele, flat_px, seen.view) is None
    other = (rng.random(seen.wide.shape) > 0.5).astype(np.float32) * np.float32(0.9)
    assert find_uncovered(seen.tele, seen.disparity_px, replace(seen.view, photo=other)) is None


def test_a_surface_reaches_behind_a_nearer_one_as_far_as_their_disparities_differ() -> None:
    row_px = np.array([[9.0] * 12 + [4.0] * 8], np.float32)
    behind_px = disparity_behind(row_px, np.array([-1.0, 0.0]))
    assert np.flatnonzero(np.isfinite(behind_px[0])).tolist() == list(range(6, 12))
    assert set(behind_px[0, 6:12]) == {4.0}
    assert np.isnan(disparity_behind(row_px, np.array([1.0, 0.0]))).all()  # wide on the other side sees none of it
    in_steps_px = disparity_behind(row_px[:, ::2], np.array([-0.5, 0.0]))
    assert np.flatnonzero(np.isfinite(in_steps_px[0])).tolist() == [3, 4, 5]


def test_near_things_move_away_from_where_wide_stands() -> None:
    for is_vertical, way in ((False, (-1, 0)), (True, (0, -1))):
        view = replace(scene().view, rig=phone_rig(is_vertical=is_vertical))
        np.testing.assert_allclose(towards_wide(view), way, atol=0.1)


# In the picture


def test_light_behind_a_blurred_card_is_what_is_known_of_it() -> None:
    """The wall is sharp: of each pixel it shows its own light, by the part of the disk that lies beyond the card."""
    hw, edge, radius_px = (60, 120), 60, 8.0
    disparity_px = np.where(np.arange(hw[1]) < edge, np.float32(4), np.float32(0)) * np.ones(hw, np.float32)
    wall = np.random.default_rng(1).random((*hw, 3), np.float32) * np.float32(0.5) + np.float32(0.2)
    photo = np.where(disparity_px[..., None] > 0, np.float32(0.0), wall)
    y, x = (axis.ravel() for axis in np.mgrid[0 : hw[0], edge - 20 : edge])
    known = Uncovered(y, x, wall[y, x], np.zeros(len(y), np.float32))
    lens = {"focus_disparity_px": 0.0, "radius_per_px": radius_px / 4, "sharp_px": (0.0, 0.0)}
    inside = np.s_[20:40, edge - 6 : edge - 1]
    away = (edge - 0.5 - np.arange(edge - 6, edge - 1)) / radius_px
    segment = (np.arccos(away) - away * np.sqrt(1 - away**2)) / np.pi
    true = linear_from_srgb(wall)[inside]

    def error(**behind: object) -> float:
        light = linear_from_srgb(render_bokeh(photo, disparity_px, **lens, **behind))[inside]
        share = light.mean(axis=(0, 2)) / true.mean(axis=(0, 2))
        np.testing.assert_allclose(share, segment, atol=0.1)
        return float(np.abs(light - share[:, None] * true).mean())

    assert error(uncovered=known) < 0.2 * error()


def test_it_stays_in_its_place_where_there_are_surroundings() -> None:
    rng, margin_px = np.random.default_rng(4), 7
    larger, larger_px = rng.random((60, 80, 3), np.float32), 4 * rng.random((60, 80), np.float32)
    larger_px[20:40, 30:50] = 9
    inner = np.s_[margin_px:-margin_px, margin_px:-margin_px]
    y, x = (axis.ravel() for axis in np.mgrid[20:40, 40:50])
    known = Uncovered(y, x, rng.random((len(y), 3), np.float32), np.full(len(y), 2, np.float32))
    within = replace(known, y=y - margin_px, x=x - margin_px)
    around = Surroundings(margin_px, (Box(0, 60, 0, 80),), ((larger, larger_px),))
    lens = {"focus_disparity_px": 1.0, "radius_per_px": 0.4}
    cut = render_bokeh(larger[inner], larger_px[inner], around=around, uncovered=within, **lens)
    np.testing.assert_array_equal(cut, render_bokeh(larger, larger_px, uncovered=known, **lens)[inner])
    assert not np.array_equal(cut, render_bokeh(larger, larger_px, **lens)[inner])


def test_a_picture_takes_it_from_wide() -> None:
    seen = scene()
    maps = DisparityMap(seen.disparity_px, np.ones_like(seen.disparity_px), np.ones(seen.disparity_px.shape, bool))
    options, focus = BokehOptions(strength_px=8.0), Focus(float(seen.disparity_at(WALL_M)), 0, 0)
    given = find_uncovered(seen.tele, seen.disparity_px, seen.view)
    made, without = (
        bokeh_picture(lambda: seen.tele, maps, options=options, baseline_m=None, focus=focus, wide=wide)
        for wide in (lambda: seen.view, None)
    )
    changed = np.abs(made - without).max(axis=-1) > 2e-3
    assert changed.sum() > 0.3 * len(given.y)
    assert np.abs(np.nonzero(changed)[1].mean() - given.x.mean()) < 10
