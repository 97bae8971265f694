"""Drawn walls, the oracle: parts that stuck to a thing before them return, and what the views contradict stays."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.backdrops import with_backdrops

HW = (200, 320)
WALL_PX, THING_PX = 4.0, 20.0
LEFT, RIGHT = 100, 200  # where the thing stands, column


def columns(hw: tuple[int, int] = HW) -> FloatMap:
    return np.broadcast_to(np.arange(hw[1], dtype=np.float32), hw)


def is_thing() -> BoolMap:
    return (columns() >= LEFT) & (columns() < RIGHT)


def shade(at: FloatMap, *, height: float = 0.0) -> FloatMap:
    """Brightness of a wall, in waves of 40 px."""
    return np.asarray(0.6 + height * np.sin(at * (2 * np.pi / 40)), dtype=np.float32)


def views(*, height: float = 0.0, left_px: float = WALL_PX) -> tuple[FloatImage, FloatImage]:
    """A dark thing before a bright wall, whose left part truly lies at some disparity."""
    x = columns()
    ref = np.where(is_thing(), np.float32(0.2), shade(x, height=height))
    is_left = x + left_px < LEFT
    behind = np.where(is_left, shade(x + left_px, height=height), shade(x + WALL_PX, height=height))
    src = np.where((x + THING_PX >= LEFT) & (x + THING_PX < RIGHT), np.float32(0.2), behind)
    tint = np.float32([1, 0.95, 0.9])
    return ref[..., None] * tint, src[..., None] * tint


def stuck(*, confidence: float = 0.1) -> DisparityMap:
    """The map of a network: the wall left of the thing has the disparity of the thing, and the network knows little."""
    x = columns()
    disparity_px = np.where(x < RIGHT, np.float32(THING_PX), np.float32(WALL_PX))
    sure = np.where(x < LEFT, np.float32(confidence), np.float32(0.9))
    return DisparityMap(disparity_px, sure, np.ones(HW, dtype=np.bool_))


@pytest.mark.parametrize("height", [0.0, 0.03])
def test_the_wall_on_the_side_that_src_does_not_see_returns(height: float) -> None:
    found = stuck()
    made = with_backdrops(found, *views(height=height))
    left, thing = columns() < LEFT - 2, is_thing()
    assert np.abs(made.disparity_px[left] - WALL_PX).max() < 0.1
    np.testing.assert_array_equal(made.disparity_px[thing], found.disparity_px[thing])
    np.testing.assert_array_equal(made.disparity_px[:, RIGHT:], found.disparity_px[:, RIGHT:])
    np.testing.assert_array_equal(made.confidence, found.confidence)


def test_a_slanted_wall_goes_on_in_its_plane() -> None:
    slant_px = 4 - 0.005 * columns()
    x = columns()
    found = stuck()
    ref, src = views()
    slanted = DisparityMap(np.where(x < RIGHT, THING_PX, slant_px).astype(np.float32), found.confidence, found.valid)
    made = with_backdrops(slanted, ref, src)
    assert np.abs(made.disparity_px - slant_px)[:, : LEFT - 2].max() < 0.5


def test_the_other_side_of_a_thing_returns_too() -> None:
    """Src sees all of it, and beside the thing both views show a blend that fits the thing alone."""
    x = columns()
    found = stuck()
    left_px = np.where(x < LEFT, np.float32(WALL_PX), np.float32(THING_PX))
    sure = np.where(x < RIGHT, np.float32(0.9), np.float32(0.1))
    made = with_backdrops(DisparityMap(left_px, sure, found.valid), *views())
    assert np.abs(made.disparity_px[:, RIGHT + 2 :] - WALL_PX).max() < 0.1


def test_a_bent_wall_at_the_side_of_the_picture_goes_on_in_its_slope() -> None:
    rows = np.broadcast_to(np.arange(HW[0], dtype=np.float32)[:, None], HW)
    x = columns()
    wall_px = 4 + 0.02 * rows + 1e-4 * (x - 260) ** 2
    found = stuck()
    bent = DisparityMap(np.where(x < RIGHT, 30, wall_px).astype(np.float32), found.confidence, found.valid)
    made = with_backdrops(bent, *views())
    moved = made.disparity_px[:, : LEFT - 2]
    assert np.abs(moved - (4 + 0.02 * rows[:, : LEFT - 2])).max() < 1


def test_a_wall_does_not_bend_along_what_leads_from_it_to_the_thing() -> None:
    """Above a thing the wall is unsure and rises, px by px, from its own disparity to that of the thing."""
    x, above = columns(), np.arange(HW[0])[:, None] < 90
    ref, src = (np.where(above[..., None], view[:1, -1:], view) for view in views())
    rising_px = np.interp(x, (20, 260), (THING_PX, WALL_PX)).astype(np.float32)
    sure = np.where(x < LEFT, np.float32(0.2), np.where(is_thing(), np.float32(0.9), np.float32(0.6)))
    found = DisparityMap(
        np.where(above, rising_px, stuck().disparity_px),
        np.where(above & (x < 260), np.float32(0.25), sure),
        stuck().valid,
    )
    made = with_backdrops(found, ref, src)
    assert np.abs(made.disparity_px[95:, : LEFT - 2] - WALL_PX).max() < 1


def test_sure_pixels_of_a_thing_of_the_walls_colour_stay_at_its_rim() -> None:
    ref, src = views()
    x = columns()
    pale = 0.58 * np.float32([1, 0.95, 0.9])
    ref[is_thing()] = pale
    src[(x + THING_PX >= LEFT) & (x + THING_PX < RIGHT)] = pale
    found = stuck()
    sure = np.where(is_thing(), np.float32(0.95), found.confidence)
    made = with_backdrops(DisparityMap(found.disparity_px, sure, found.valid), ref, src)
    np.testing.assert_array_equal(made.disparity_px[is_thing()], THING_PX)


def test_what_is_of_the_walls_colour_and_fits_where_it_was_stays() -> None:
    found = stuck()
    made = with_backdrops(found, *views(height=0.03, left_px=THING_PX))
    np.testing.assert_array_equal(made.disparity_px, found.disparity_px)


def test_a_faint_texture_decides_though_colours_differ_as_a_whole() -> None:
    """A tenth of the misfit comes and goes with where the region is put, the rest is one lens against another."""
    found = stuck()
    ref, src = views(height=0.004, left_px=THING_PX)
    np.testing.assert_array_equal(with_backdrops(found, ref, src + np.float32(0.03)).disparity_px, found.disparity_px)
    ref, src = views(height=0.004)
    made = with_backdrops(found, ref, src + np.float32(0.03))
    assert np.abs(made.disparity_px[:, : LEFT - 2] - WALL_PX).max() < 0.1


def test_what_has_another_colour_stays() -> None:
    ref, src = views()
    for view in (ref, src):
        view[:, : LEFT - int(THING_PX)] *= np.float32([1, 0.8, 0.6])
    found = stuck()
    np.testing.assert_array_equal(with_backdrops(found, ref, src).disparity_px[:, :64], found.disparity_px[:, :64])


def test_what_is_sure_or_enclosed_stays() -> None:
    found = stuck(confidence=0.6)
    assert with_backdrops(found, *views()) is found
    ref, src = views()
    enclosed = (columns() > LEFT + 10) & (columns() < RIGHT - 10)
    enclosed &= enclosed[0] & (np.arange(HW[0])[:, None] > 40) & (np.arange(HW[0])[:, None] < 160)
    ref[enclosed] = 0.6 * np.float32([1, 0.95, 0.9])
    window = stuck(confidence=0.9)
    unsure = DisparityMap(window.disparity_px, np.where(enclosed, 0.1, 0.9).astype(np.float32), window.valid)
    assert with_backdrops(unsure, ref, src) is unsure


def test_a_wall_before_what_is_unsure_takes_nothing() -> None:
    found = stuck()
    nearer = DisparityMap(
        np.where(columns() < LEFT, np.float32(WALL_PX - 3), found.disparity_px), found.confidence, found.valid
    )
    np.testing.assert_array_equal(with_backdrops(nearer, *views()).disparity_px, nearer.disparity_px)


def test_a_wall_half_way_to_the_front_is_no_backdrop() -> None:
    """A table cloth does not go to the bottle of its colour."""
    found = stuck()
    farther_px = found.disparity_px.copy()
    farther_px[:100] -= 40  # most of the picture lies far behind both
    made = with_backdrops(DisparityMap(farther_px, found.confidence, found.valid), *views())
    np.testing.assert_array_equal(made.disparity_px[100:], farther_px[100:])


def test_small_pictures_and_textures_are_left_alone(rng: np.random.Generator) -> None:
    small = DisparityMap(np.zeros((40, 40), np.float32), np.zeros((40, 40), np.float32), np.ones((40, 40), np.bool_))
    assert with_backdrops(small, np.zeros((40, 40, 3), np.float32), np.zeros((40, 40, 3), np.float32)) is small
    found = stuck()
    ref = rng.random((*HW, 3)).astype(np.float32)
    assert with_backdrops(found, ref, ref) is found
