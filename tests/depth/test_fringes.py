"""Fringes against drawn truth: strands on an outline, seen by a map that ends at it."""

from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest

from telewide.bokeh.render import render_bokeh
from telewide.depth.edges import follow_edges
from telewide.depth.fringes import REACH_PX, with_fringes
from telewide.metrics import psnr_db

HW = (160, 200)
NEAR_PX, FAR_PX = 20.0, 8.0
EDGE_ROW = 100
DARK, BRIGHT = (0.15, 0.12, 0.1), (0.7, 0.7, 0.75)


def strands(*, width_px: int = 2, length_px: int = 10) -> np.ndarray:
    """Bool map of a body below EDGE_ROW with strands that lean this way and that."""
    drawn = np.zeros(HW, np.uint8)
    drawn[EDGE_ROW:] = 1
    for x in range(20, HW[1] - 20, 12):
        tip = (x + (5 if x % 24 < 12 else -5), EDGE_ROW - length_px)
        cv2.line(drawn, (x, EDGE_ROW), tip, 1, width_px)
    return drawn > 0


def body_px() -> np.ndarray:
    return np.where(np.arange(HW[0])[:, None] >= EDGE_ROW, NEAR_PX, FAR_PX).repeat(HW[1], axis=1).astype(np.float32)


def photo(front: np.ndarray, rng: np.random.Generator, *, front_rgb: tuple[float, ...] = DARK) -> np.ndarray:
    """Photo of two surfaces, each with some texture."""
    ground = np.where(front[..., None], np.float32(front_rgb), np.float32(BRIGHT))
    texture = cv2.GaussianBlur(rng.normal(0, 1, HW).astype(np.float32), (0, 0), 3)
    return np.clip(ground + 0.03 * (texture / texture.std())[..., None], 0, 1).astype(np.float32)


@pytest.mark.parametrize("width_px", [1, 2])
def test_strands_come_to_the_surface_that_they_hang_on(width_px: int, rng: np.random.Generator) -> None:
    truth = strands(width_px=width_px)
    found_px = with_fringes(body_px(), photo(truth, rng), jump_px=1.0)
    is_strand = truth & (body_px() == FAR_PX)
    assert (found_px[is_strand] == NEAR_PX).mean() > 0.9
    assert (found_px[~truth] == FAR_PX).all()


def test_bright_strands_before_the_dark_come_too(rng: np.random.Generator) -> None:
    truth = strands()
    bright = 1 - photo(truth, rng)
    found_px = with_fringes(body_px(), bright, jump_px=1.0)
    assert (found_px[truth] == NEAR_PX).mean() > 0.97


def test_the_bokeh_keeps_strands_sharp(rng: np.random.Generator) -> None:
    truth = strands()
    sharp = photo(truth, rng)
    by_truth, by_body, by_found = (
        render_bokeh(sharp, np.asarray(px, np.float32), focus_disparity_px=NEAR_PX, radius_per_px=0.7)
        for px in (
            np.where(truth, NEAR_PX, FAR_PX),
            body_px(),
            follow_edges(body_px(), sharp, confidence=np.ones(HW, np.float32), valid=np.ones(HW, bool)),
        )
    )
    band = np.zeros(HW, bool)
    band[EDGE_ROW - REACH_PX : EDGE_ROW] = True
    assert psnr_db(by_found, by_truth, mask=band) > psnr_db(by_body, by_truth, mask=band) + 6


def test_large_photos_have_larger_fringes(rng: np.random.Generator) -> None:
    size = (3 * HW[1], 3 * HW[0])
    truth = cv2.resize(strands().astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    large_px = cv2.resize(body_px(), size, interpolation=cv2.INTER_NEAREST)
    large = cv2.resize(photo(strands(), rng), size, interpolation=cv2.INTER_NEAREST)
    is_strand = truth & (large_px == FAR_PX)
    assert (with_fringes(large_px, large, jump_px=1.0, scale=3)[is_strand] == NEAR_PX).mean() > 0.9


def test_what_lies_apart_or_is_broad_stays_behind(rng: np.random.Generator) -> None:
    truth = strands(length_px=0)
    scene = truth.copy()
    scene[EDGE_ROW - 8 : EDGE_ROW - 6, 40:60] = True  # a line of the ground, a strand's width, apart from the body
    scene[EDGE_ROW - 9 : EDGE_ROW, 100:130] = True  # a shadow on the ground beside the body
    found_px = with_fringes(body_px(), photo(scene, rng), jump_px=1.0)
    np.testing.assert_array_equal(found_px[:, :80], body_px()[:, :80])
    assert (found_px[EDGE_ROW - 9 : EDGE_ROW, 100:130] == FAR_PX).mean() > 0.8


def test_nothing_moves_where_colour_does_not_tell(rng: np.random.Generator) -> None:
    same = photo(strands(), rng, front_rgb=tuple(value - 0.03 for value in BRIGHT))
    np.testing.assert_array_equal(with_fringes(body_px(), same, jump_px=1.0), body_px())
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    leaning_px = 0.3 * x + 0.2 * y  # no edge
    np.testing.assert_array_equal(with_fringes(leaning_px, same, jump_px=1.0), leaning_px)


def test_a_colour_of_neither_surface_stays(rng: np.random.Generator) -> None:
    truth = strands()
    scene = photo(truth, rng)
    scene[truth & (body_px() == FAR_PX)] = (0.1, 0.7, 0.05)  # leaves behind a dark body
    np.testing.assert_array_equal(with_fringes(body_px(), scene, jump_px=1.0), body_px())


def test_nothing_goes_back_and_no_value_is_new(rng: np.random.Generator) -> None:
    scene = rng.random((*HW, 3)).astype(np.float32)
    map_px = rng.choice(np.float32([3, 8, 20]), (8, 10)).repeat(20, axis=0).repeat(20, axis=1)
    found_px = with_fringes(map_px, scene, jump_px=1.0)
    assert (found_px >= map_px).all()
    assert set(np.unique(found_px)) <= set(np.unique(map_px))


def test_memory_goes_by_pixels_however_many_lie_beside_an_edge(rng: np.random.Generator) -> None:
    """30 bytes a pixel: a large photo's pair of maps, not a matrix for each pixel that is told by its colour."""
    stripes_px = np.where(np.arange(1200) // 60 % 2, np.float32(10), np.float32(0)) * np.ones((900, 1), np.float32)
    colours = np.where(stripes_px[..., None] > 0, np.float32(0.2), np.float32(0.7))
    colours = colours + rng.normal(0, 0.02, (*colours.shape[:2], 3)).astype(np.float32)
    tracemalloc.start()
    with_fringes(stripes_px, colours, jump_px=1.0, scale=2)
    most_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most_bytes < 30 * stripes_px.size
