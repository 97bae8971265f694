"""Matches of rectified views, against the rendered disparity and planted outliers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.benchmark.datasets.middlebury import read_middlebury_2006
from telewide.errors import InputError
from telewide.geometry.arrays import FloatImage
from telewide.points.features import sift_features
from telewide.points.matches import Matches, consistent_matches, find_matches, split_matches
from telewide.simulate.degrade import shrink_and_enlarge
from telewide.simulate.layers import RenderedPair


def disparity_error_px(matches: Matches, truth_px: NDArray[np.float32]) -> NDArray[np.float64]:
    """Distance of every match from the nearest true disparity within 2 px of its point; unknown truth left out."""
    at = np.round(matches.ref_px).astype(int)
    error = np.full(len(matches), np.inf)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            y = np.clip(at[:, 1] + dy, 0, truth_px.shape[0] - 1)
            x = np.clip(at[:, 0] + dx, 0, truth_px.shape[1] - 1)
            error = np.fmin(error, np.abs(truth_px[y, x] - matches.disparity_px))
    return error[np.isfinite(error)]


def test_matches_agree_with_the_rendered_truth(world: RenderedPair) -> None:
    matches = find_matches(world.ref, world.src)
    error_px = disparity_error_px(matches, world.disparity_px)
    assert len(matches) > 150
    assert np.median(error_px) < 0.1
    assert np.mean(error_px > 1.0) < 0.01
    assert np.median(np.abs(matches.vertical_px)) < 0.1


def test_matches_survive_three_times_fewer_pixels_and_other_colours(world: RenderedPair, wide_src: FloatImage) -> None:
    matches = find_matches(world.ref, wide_src)
    error_px = disparity_error_px(matches, world.disparity_px)
    assert len(matches) > 80
    assert np.mean(error_px > 2.0) < 0.01
    centred_y = matches.ref_px[:, 1] - (world.ref.shape[0] - 1) / 2
    law_px = -1.2 - 0.006 * centred_y  # the content of src was moved down
    assert np.median(np.abs(matches.vertical_px - law_px)) < 0.3


def test_swapping_the_views_swaps_the_signs(world: RenderedPair, wide_src: FloatImage) -> None:
    forth, back = find_matches(world.ref, wide_src), find_matches(wide_src, world.ref)
    assert np.median(back.disparity_px) == pytest.approx(-np.median(forth.disparity_px), abs=1.5)
    assert np.median(back.vertical_px) == pytest.approx(-np.median(forth.vertical_px), abs=0.3)


@pytest.mark.parametrize("shift_px", [-30, 0, 41])
def test_a_shift_is_found_to_the_pixel_and_better(world: RenderedPair, shift_px: int) -> None:
    moved = np.roll(world.ref, -shift_px, axis=1)
    matches = find_matches(world.ref, moved)
    assert np.percentile(np.abs(matches.disparity_px - shift_px), 99) < 0.1  # the seam's own points left out


def test_views_of_two_scenes_have_no_matches(world: RenderedPair) -> None:
    other = world.src[::-1, ::-1].copy()
    assert len(find_matches(world.ref, other)) < 12


def test_a_flat_view_has_no_matches(world: RenderedPair) -> None:
    assert len(find_matches(world.ref, np.full_like(world.src, 0.5))) == 0


@pytest.mark.parametrize("hw", [(1, 1), (8, 8), (32, 40)])
def test_tiny_views_do_no_harm(world: RenderedPair, hw: tuple[int, int]) -> None:
    crop = (slice(0, hw[0]), slice(0, hw[1]))
    assert isinstance(find_matches(world.ref[crop], world.src[crop]), Matches)


def test_views_of_two_sizes_are_refused(world: RenderedPair) -> None:
    with pytest.raises(InputError, match="one size"):
        find_matches(world.ref, world.src[:-1])


def test_the_gate_finds_planted_outliers(rng: np.random.Generator) -> None:
    ref_px = rng.uniform((0, 0), (640, 320), (300, 2))
    disparity_px = 20 + 0.01 * ref_px[:, 0]
    vertical_px = 0.8 - 0.004 * ref_px[:, 1] + rng.normal(0, 0.2, 300)
    wrong = np.arange(300) < 90
    disparity_px[wrong] += rng.uniform(-60, 60, 90)
    vertical_px[wrong] += rng.uniform(-20, 20, 90)
    matches = Matches(ref_px, ref_px - np.column_stack([disparity_px, vertical_px]))
    kept = consistent_matches(matches)
    is_right = {tuple(p) for p in ref_px[~wrong]}
    n_right = sum(tuple(p) in is_right for p in kept.ref_px)
    assert n_right > 0.95 * 210
    assert len(kept) - n_right <= 2


@pytest.mark.parametrize("n", [0, 1, 3, 5])
def test_a_handful_of_scattered_matches_is_no_evidence(rng: np.random.Generator, n: int) -> None:
    assert len(consistent_matches(Matches(rng.uniform(0, 300, (n, 2)), rng.uniform(0, 300, (n, 2))))) == 0


def test_splitting_shares_out_every_match_once(rng: np.random.Generator) -> None:
    matches = Matches(rng.uniform(0, 300, (101, 2)), rng.uniform(0, 300, (101, 2)))
    fit, held_out = split_matches(matches, held_out_share=0.3, seed=3)
    again, _ = split_matches(matches, held_out_share=0.3, seed=3)
    assert len(held_out) == 30
    together = np.vstack([fit.ref_px, held_out.ref_px])
    assert {tuple(p) for p in together} == {tuple(p) for p in matches.ref_px}
    np.testing.assert_array_equal(fit.ref_px, again.ref_px)


@pytest.mark.parametrize("scene", ["Aloe", "Midd1", "Rocks1"])
def test_outliers_are_rare_on_photographs(data_root: Path, scene: str) -> None:
    truth = read_middlebury_2006(data_root / "middlebury_2006_third" / scene, scale_denominator=3)
    matches = find_matches(truth.left, shrink_and_enlarge(truth.right, factor=4.0))
    error_px = disparity_error_px(matches, truth.disparity_px)
    assert len(matches) > 100
    assert np.mean(error_px > 2.0) < 0.015
    assert np.median(error_px) < 0.4


@pytest.mark.parametrize("name", ["00", "14", "25"])
def test_a_phone_pair_has_hundreds_of_matches(data_root: Path, name: str) -> None:
    tele, wide = (
        cv2.imread(str(data_root / "p30" / name / f"{view}.png"))[..., ::-1].astype(np.float32) / 255
        for view in ("tele", "wide")
    )
    matches = find_matches(tele, wide)
    assert len(matches) >= 200
    assert np.percentile(matches.disparity_px, 1) > 15
    assert np.percentile(matches.disparity_px, 99) < 40
    assert -1.7 < np.median(matches.vertical_px) < 0.6


def test_a_drawn_pattern_has_no_more_points_than_are_asked_for() -> None:
    """Each corner of its squares is as strong as each."""
    y, x = np.mgrid[:240, :320]
    squares = (255 * ((x // 7 + y // 7) % 2)).astype(np.uint8)
    assert len(sift_features(squares, max_features=10_000, contrast_threshold=0.01)) > 800
    found = sift_features(squares, max_features=100, contrast_threshold=0.01)
    assert found.descriptor.shape == (100, 128)
