"""Strands against drawn truth: straight twigs over a ground, of which the map knows a part."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.depth.edges import follow_edges
from telewide.depth.strands import LARGEST_WIDTH_PX, with_strands

HW = (200, 240)
GROUND_PX, NEAR_PX, SLOPE_PX = 8.0, 20.0, 0.02  # the last a px along x
DARK, BRIGHT = (0.15, 0.12, 0.1), (0.75, 0.75, 0.7)


def strand(angle_deg: float, *, length_px: float = 150, width_px: int = 4, scale: int = 1) -> np.ndarray:
    """Bool map of a straight piece through the middle."""
    drawn, middle = np.zeros((HW[0] * scale, HW[1] * scale), np.uint8), np.array([HW[1], HW[0]]) * scale / 2
    way = scale * length_px / 2 * np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    first, last = (tuple(int(v) for v in np.round(middle + sign * way)) for sign in (-1, 1))
    return cv2.line(drawn, first, last, 1, width_px * scale) > 0


def photo(front: np.ndarray, rng: np.random.Generator, *, of: tuple[float, ...] = DARK) -> np.ndarray:
    ground = DARK if of == BRIGHT else BRIGHT
    noise = rng.normal(0, 0.01, (*front.shape, 3))
    return np.clip(np.where(front[..., None], of, ground) + noise, 0, 1).astype(np.float32)


def true_px(front: np.ndarray, *, scale: int = 1) -> np.ndarray:
    near_px = NEAR_PX + SLOPE_PX * (np.arange(front.shape[1]) / scale - HW[1] / 2)
    return (scale * np.where(front, near_px, GROUND_PX)).astype(np.float32)


def found_part(front: np.ndarray, share: float = 0.35) -> np.ndarray:
    """Part of a strand around the middle of the picture."""
    y, x = np.nonzero(front)
    away = np.hypot(y - y.mean(), x - x.mean())
    part = np.zeros_like(front)
    inner = away < share * away.max()
    part[y[inner], x[inner]] = True
    return part


def known_px(front: np.ndarray, part: np.ndarray, *, scale: int = 1) -> np.ndarray:
    return np.where(part, true_px(front, scale=scale), np.float32(scale * GROUND_PX))


@pytest.mark.parametrize("angle_deg", [0, 17, 45, 76, 90, 130])
@pytest.mark.parametrize("of", [DARK, BRIGHT])
def test_the_rest_of_a_strand_takes_the_line_of_its_part(
    angle_deg: float, of: tuple[float, ...], rng: np.random.Generator
) -> None:
    front = strand(angle_deg)
    before_px, truth_px = known_px(front, found_part(front)), true_px(front)
    followed_px = with_strands(before_px, photo(front, rng, of=of), trust=np.ones(HW, np.float32))
    assert (np.abs(before_px - truth_px)[front] < 0.6).mean() < 0.45
    assert (np.abs(followed_px - truth_px)[front] < 0.6).mean() > 0.9
    np.testing.assert_array_equal(followed_px[~front], before_px[~front])
    assert (followed_px >= before_px).all()


def test_a_large_photo_is_followed_at_a_fraction_and_ends_at_its_own_pixels(rng: np.random.Generator) -> None:
    front = strand(30, scale=3)
    before_px, truth_px = known_px(front, found_part(front), scale=3), true_px(front, scale=3)
    trust = np.ones(front.shape, np.float32)
    followed_px = with_strands(before_px, photo(front, rng), trust=trust, scale=3)
    assert (np.abs(followed_px - truth_px)[front] < 1.8).mean() > 0.9
    np.testing.assert_array_equal(followed_px[~front], before_px[~front])


def unlike_half(front: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A photo in which the strand has another colour right of the picture's middle and beyond what is found."""
    picture = photo(front, rng)
    beyond = front & ~found_part(front)
    picture[beyond] += np.float32(0.25)
    return picture


def test_what_is_not_a_strand_found_in_part_stays(rng: np.random.Generator) -> None:
    front = strand(40)
    part, trust, lit = found_part(front), np.ones(HW, np.float32), photo(front, rng)
    broad = strand(40, width_px=14)
    shallow_px = np.where(part, np.float32(GROUND_PX + 2), np.float32(GROUND_PX))
    uneven_px = known_px(front, part) + np.where(part, rng.uniform(-6, 6, HW), 0).astype(np.float32)
    for why, disparity_px, picture, sure in (
        ("nothing of it is found", np.full(HW, GROUND_PX, np.float32), lit, trust),
        ("what is found is not sure", known_px(front, part), lit, 0.4 * trust),
        ("it hardly stands before its ground", shallow_px, lit, trust),
        ("what is found lies on no line", uneven_px, lit, trust),
        ("the rest has another colour", known_px(front, part), unlike_half(front, rng), trust),
        ("it is too broad", known_px(broad, found_part(broad)), photo(broad, rng), trust),
    ):
        followed_px = with_strands(disparity_px, picture, trust=sure)
        np.testing.assert_array_equal(followed_px, disparity_px, err_msg=why)


def test_a_short_part_does_not_speak_for_what_is_far_away(rng: np.random.Generator) -> None:
    front = strand(0, length_px=230, width_px=3)
    part = found_part(front, 0.1)
    followed_px = with_strands(known_px(front, part), photo(front, rng), trust=np.ones(HW, np.float32))
    columns = np.nonzero((followed_px > GROUND_PX) & front)[1]
    length = np.ptp(np.nonzero(part)[1])
    assert np.ptp(columns) > 3 * length
    assert np.ptp(columns) < 7.5 * length


def test_a_bend_is_not_cut_short(rng: np.random.Generator) -> None:
    """Two straight pieces in one: each takes its own line, and nothing beside them."""
    drawn = np.zeros(HW, np.uint8)
    cv2.polylines(drawn, [np.array([[30, 160], [120, 100], [210, 150]])], isClosed=False, color=1, thickness=4)
    front = drawn > 0
    part = front & (np.abs(np.arange(HW[1]) - 75) < 25)
    before_px = known_px(front, part)
    followed_px = with_strands(before_px, photo(front, rng), trust=np.ones(HW, np.float32))
    np.testing.assert_array_equal(followed_px[~front], before_px[~front])
    left = front & (np.arange(HW[1]) < 115)
    assert (np.abs(followed_px - true_px(front))[left] < 0.6).mean() > 0.8
    assert LARGEST_WIDTH_PX < 4


def test_a_line_that_branches_off_is_another_one(rng: np.random.Generator) -> None:
    """At a small angle, in the colour of the strand: a crack of the ground, say."""
    first, branch = np.zeros(HW, np.uint8), np.zeros(HW, np.uint8)
    cv2.line(first, (20, 100), (220, 100), 1, 3)
    cv2.line(branch, (110, 100), (220, 125), 1, 3)
    front, crack = first > 0, (branch > 0) & (first == 0)
    before_px = known_px(front, found_part(front))
    followed_px = with_strands(before_px, photo(front | crack, rng), trust=np.ones(HW, np.float32))
    assert (np.abs(followed_px - true_px(front))[front] < 0.6).mean() > 0.75
    beyond = crack & (np.arange(HW[1]) > 165)
    np.testing.assert_array_equal(followed_px[beyond], before_px[beyond])


def test_depth_on_a_photo_has_whole_strands(rng: np.random.Generator) -> None:
    front = strand(60)
    before_px, lit = known_px(front, found_part(front)), photo(front, rng)
    sure, valid = np.full(HW, 0.9, np.float32), np.ones(HW, bool)
    followed_px = follow_edges(before_px, lit, confidence=sure, valid=valid)
    assert (np.abs(followed_px - true_px(front))[front] < 1).mean() > 0.85
    unmeasured_px = follow_edges(before_px, lit, confidence=sure, valid=np.zeros(HW, bool))
    assert (np.abs(unmeasured_px - true_px(front))[front] < 1).mean() < 0.6
