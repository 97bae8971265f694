"""What lies beyond the frame, against a painted plane that reaches beyond it, and bokeh of a photo that shows it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.bokeh.focus import Focus
from telewide.bokeh.layers import Box
from telewide.bokeh.picture import BokehOptions, bokeh_picture
from telewide.bokeh.render import render_bokeh
from telewide.bokeh.surroundings import Surroundings, find_surroundings
from telewide.bokeh.wide_light import WideView
from telewide.geometry.rig import StereoRig
from telewide.geometry.stereo import DisparityMap
from telewide.metrics import psnr_db
from telewide.srgb import linear_from_srgb, srgb_from_linear

MARGIN_PX = 24
GAINS = np.array([0.8, 0.95, 1.1])


@dataclass(frozen=True)
class Scene:
    """A plane seen by both lenses; tele's photo as a larger sensor would have taken it, and the frame cut out of it."""

    rig: StereoRig
    larger: np.ndarray
    wide: np.ndarray
    disparity_px: np.ndarray

    @property
    def tele(self) -> np.ndarray:
        return np.ascontiguousarray(self.larger[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX])

    @property
    def mirrored(self) -> np.ndarray:
        return cv2.copyMakeBorder(self.tele, *[MARGIN_PX] * 4, cv2.BORDER_REFLECT)

    @property
    def band(self) -> np.ndarray:
        mask = np.ones(self.larger.shape[:2], bool)
        mask[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = False
        return mask

    def view(self, **changed: object) -> WideView:
        return replace(WideView(self.wide, self.rig), **changed)


@cache
def scene(*, is_vertical: bool = False, depth_m: float = 1.5) -> Scene:
    """Photos of a plane of three colours; wide's are exposed and balanced in another way."""
    rig = phone_rig(is_vertical=is_vertical, width_px=400)
    K = rig.tele.K.copy()
    K[:2, 2] += MARGIN_PX
    hw = rig.tele.hw[0] + 2 * MARGIN_PX, rig.tele.hw[1] + 2 * MARGIN_PX
    larger_rig = replace(rig, tele=replace(rig.tele, K=K, hw=hw))
    channels = [photos_of_a_plane(larger_rig, np.random.default_rng(seed), depth_m=depth_m) for seed in range(3)]
    larger, wide = (0.1 + 0.7 * np.stack(views, axis=-1) for views in zip(*channels, strict=True))
    wide = srgb_from_linear(linear_from_srgb(wide.astype(np.float64)) * GAINS).astype(np.float32)
    disparity_px = np.full(rig.tele.hw, K[0, 0] * rig.baseline_m / depth_m, np.float32)
    return Scene(rig, larger.astype(np.float32), np.clip(wide, 0, 1), disparity_px)


@pytest.mark.parametrize(("is_vertical", "depth_m"), [(False, 1.5), (True, 1.5), (False, 0.5)])
def test_band_is_what_lies_beyond_the_frame(is_vertical: bool, depth_m: float) -> None:
    seen = scene(is_vertical=is_vertical, depth_m=depth_m)
    found = find_surroundings(seen.tele, seen.disparity_px, seen.view(), margin_px=MARGIN_PX)
    around = found.of(seen.tele)
    np.testing.assert_array_equal(around[~seen.band], seen.larger[~seen.band])
    np.testing.assert_array_equal(found.of_map(seen.disparity_px), seen.disparity_px[0, 0])
    exact_db, mirrored_db = (psnr_db(each, seen.larger, mask=seen.band) for each in (around, seen.mirrored))
    assert exact_db > 32
    assert exact_db > mirrored_db + 12


def test_zero_of_a_pinned_map_does_not_move_the_photos() -> None:
    seen = scene()
    found = find_surroundings(seen.tele, seen.disparity_px, seen.view(), margin_px=MARGIN_PX)
    moved_px = seen.disparity_px + np.float32(5)
    pinned = find_surroundings(seen.tele, moved_px, seen.view(zero_px=5.0), margin_px=MARGIN_PX)
    np.testing.assert_allclose(pinned.of(seen.tele), found.of(seen.tele), atol=1e-4)
    np.testing.assert_array_equal(pinned.of_map(moved_px), found.of_map(seen.disparity_px) + np.float32(5))


def cut_at(seen: Scene, column: int) -> WideView:
    """The wide photo without what lies right of a column."""
    wide = replace(seen.rig.wide, hw=(seen.wide.shape[0], column))
    return seen.view(photo=np.ascontiguousarray(seen.wide[:, :column]), rig=replace(seen.rig, wide=wide))


def test_world_is_mirrored_where_wide_does_not_reach() -> None:
    seen = scene()
    ramp_px = seen.disparity_px + np.linspace(0, 0.5, seen.disparity_px.shape[1], dtype=np.float32)
    middle = seen.wide.shape[1] // 2
    found = find_surroundings(seen.tele, ramp_px, cut_at(seen, middle), margin_px=MARGIN_PX)
    around, around_px = found.of(seen.tele), found.of_map(ramp_px)
    left, right = (np.s_[:, :MARGIN_PX], np.s_[:, -MARGIN_PX:])
    np.testing.assert_array_equal(around[right], seen.mirrored[right])
    mirrored_px = cv2.copyMakeBorder(ramp_px, *[MARGIN_PX] * 4, cv2.BORDER_REFLECT)
    np.testing.assert_array_equal(around_px[right], mirrored_px[right])
    np.testing.assert_array_equal(around_px[left], 0 * mirrored_px[left] + ramp_px[0, 0])
    assert psnr_db(around[left], seen.larger[left]) > 30


def test_wide_that_shows_nothing_of_it_is_not_used() -> None:
    seen, rng = scene(), np.random.default_rng(5)
    other = rng.random(seen.wide.shape, np.float32)
    views = {
        "it ends within the frame": cut_at(seen, seen.wide.shape[1] // 4),
        "it shows something else": seen.view(photo=np.asarray(other > 0.5, np.float32) * np.float32(0.9)),
        "all of it is clipped": seen.view(photo=np.ones_like(seen.wide)),
        "tele's distortion folds": seen.view(
            rig=replace(seen.rig, tele=replace(seen.rig.tele, distortion=np.array([-40.0, 0, 0, 0])))
        ),
    }
    for why, view in views.items():
        assert find_surroundings(seen.tele, seen.disparity_px, view, margin_px=MARGIN_PX) is None, why


def test_lamps_beyond_the_frame_stay_as_bright_as_white() -> None:
    seen = scene()
    lit = seen.wide.copy()
    near_left = np.s_[seen.wide.shape[0] // 2 - 4 : seen.wide.shape[0] // 2 + 4]
    shown = find_surroundings(seen.tele, seen.disparity_px, seen.view(), margin_px=MARGIN_PX)
    before = shown.of(seen.tele)
    lit[near_left] = 1
    after = find_surroundings(seen.tele, seen.disparity_px, seen.view(photo=lit), margin_px=MARGIN_PX)
    middle = np.s_[seen.larger.shape[0] // 2 - 4 : seen.larger.shape[0] // 2 + 4, : MARGIN_PX // 2]
    assert before[middle].max() < 0.95
    assert after.of(seen.tele)[middle].min() >= 0.98


# In the picture

BLURRED = BokehOptions(strength_px=9.0)
FOCUS = Focus(0.0, 0, 0)


def picture(seen: Scene, wide: object, *, options: BokehOptions = BLURRED, focus: Focus = FOCUS) -> np.ndarray:
    maps = DisparityMap(seen.disparity_px, np.ones_like(seen.disparity_px), np.ones(seen.disparity_px.shape, bool))
    return bokeh_picture(lambda: seen.tele, maps, options=options, baseline_m=None, focus=focus, wide=wide)


def test_blur_at_the_border_is_that_of_a_photo_that_shows_more() -> None:
    seen = scene()
    per_px = BLURRED.strength_px / float(seen.disparity_px[0, 0])
    larger_px = np.full(seen.larger.shape[:2], seen.disparity_px[0, 0], np.float32)
    true = render_bokeh(seen.larger, larger_px, focus_disparity_px=0.0, radius_per_px=per_px)
    inner = np.s_[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    near_border = np.ones(seen.tele.shape[:2], bool)
    near_border[9:-9, 9:-9] = False
    from_wide, mirrored = (psnr_db(picture(seen, w), true[inner], mask=near_border) for w in (seen.view, None))
    assert from_wide > 45
    assert from_wide > mirrored + 12


def test_picture_is_as_ever_where_wide_shows_nothing_or_the_border_is_sharp() -> None:
    seen = scene()
    nothing = cut_at(seen, seen.wide.shape[1] // 4)
    np.testing.assert_array_equal(picture(seen, lambda: nothing), picture(seen, None))

    def never() -> WideView:
        raise AssertionError("the wide photo was read for nothing")

    sharp = replace(FOCUS, disparity_px=float(seen.disparity_px[0, 0]))
    np.testing.assert_array_equal(picture(seen, never, focus=sharp), seen.tele)


def surrounded(larger: np.ndarray, larger_px: np.ndarray, *, margin_px: int) -> Surroundings:
    """Surroundings that are known: those of the middle of a larger photo."""
    return Surroundings(margin_px, (Box(0, larger.shape[0], 0, larger.shape[1]),), ((larger, larger_px),))


@pytest.mark.parametrize("margin_px", [1, 7])
def test_bokeh_with_its_surroundings_is_cut_from_that_of_a_larger_photo(margin_px: int) -> None:
    larger = scene().larger
    larger_px = np.random.default_rng(2).random(larger.shape[:2], np.float32) * 4
    lens = {"focus_disparity_px": 1.0, "radius_per_px": 2.0}
    inner = np.s_[margin_px:-margin_px, margin_px:-margin_px]
    around = surrounded(larger, larger_px, margin_px=margin_px)
    cut = render_bokeh(larger[inner], larger_px[inner], around=around, **lens)
    np.testing.assert_array_equal(cut, render_bokeh(larger, larger_px, **lens)[inner])


def test_strongest_blur_is_a_share_of_the_frame_alone() -> None:
    point, near_px = np.zeros((100, 140, 3), np.float32), np.ones((100, 140), np.float32)
    point[50, 70] = 1
    inner = np.s_[20:-20, 20:-20]
    around = surrounded(point, near_px, margin_px=20)
    spot = render_bokeh(point[inner], near_px[inner], focus_disparity_px=0.0, radius_per_px=50, around=around)
    rows = np.flatnonzero(spot.max(axis=(1, 2)) > 1e-3)
    assert rows[-1] - rows[0] == pytest.approx(2 * 6, abs=2)  # a tenth of 60 px
