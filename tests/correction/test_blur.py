"""The blur between two views, against kernels that were put in."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from textures import textured

from telewide.capture.layout import find_captures
from telewide.capture.pair import read_pair
from telewide.correction.blur import (
    BlurEstimate,
    damage_range,
    factor_from_sigma,
    fit_blur,
    sigma_from_factor,
)
from telewide.correction.colour import apply_colour, fit_colour
from telewide.correction.correct import correct_pair
from telewide.geometry.arrays import FloatImage
from telewide.points.matches import Matches, find_matches
from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.layers import Layer, LayeredScene, RenderedPair, render_pair


@pytest.fixture(scope="module")
def room() -> RenderedPair:
    """A slanted wall with a box before it, sharp in both views."""
    rng = np.random.default_rng(7)
    wall = Layer(textured(rng, hw=(400, 640)), None, (-20, 0), (8.0, 0.0, 0.01))
    box = Layer(textured(rng, hw=(150, 180)), np.ones((150, 180), dtype=np.float32), (120, 80), (24.0, 0.0, 0.0))
    return render_pair(LayeredScene((wall, box), (400, 560)))


@pytest.fixture(scope="module")
def matches(room: RenderedPair) -> Matches:
    return find_matches(room.ref, room.src)


def equivalent_sigma_px(sharp: FloatImage, dull: FloatImage) -> float:
    """Width of the Gaussian that turns one picture into another best: a search of its own, without registration."""
    first, second = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[16:-16, 16:-16] for image in (sharp, dull))

    def left(sigma_px: float) -> float:
        return float(((cv2.GaussianBlur(first, (0, 0), sigma_px) - second)[12:-12, 12:-12] ** 2).mean())

    return float(minimize_scalar(left, bounds=(0.2, 6.0), method="bounded").x)


def measured(room: RenderedPair, damage: Degradation, matches: Matches) -> BlurEstimate:
    src = degrade(room.src, damage, rng=np.random.default_rng(0))
    found = fit_blur(room.ref, src, matches)
    assert found is not None
    return found


@pytest.mark.parametrize("factor", [2.0, 3.0, 4.0, 6.0, 8.0])
def test_fewer_pixels_read_as_their_equivalent_blur(room: RenderedPair, matches: Matches, factor: float) -> None:
    damage = Degradation(factor=factor)
    truth_px = equivalent_sigma_px(room.src, degrade(room.src, damage, rng=np.random.default_rng(0)))
    found = measured(room, damage, matches)
    assert found.mean_sigma_px == pytest.approx(truth_px, rel=0.1)
    assert found.factor == pytest.approx(factor, rel=0.15)


@pytest.mark.parametrize("sigma_px", [0.7, 1.2, 2.0, 3.0])
def test_a_round_blur_is_recovered(room: RenderedPair, matches: Matches, sigma_px: float) -> None:
    found = measured(room, Degradation(blur_sigma_px=(sigma_px, sigma_px)), matches)
    assert found.sigma_px == pytest.approx((sigma_px, sigma_px), rel=0.1)
    assert found.residual < 0.3


@pytest.mark.parametrize("angle_rad", [0.0, 0.6, 2.5])
def test_an_elongated_blur_is_recovered(room: RenderedPair, matches: Matches, angle_rad: float) -> None:
    found = measured(room, Degradation(blur_sigma_px=(2.0, 1.0), blur_angle_rad=angle_rad), matches)
    assert found.sigma_px == pytest.approx((2.0, 1.0), rel=0.1)
    assert abs((found.angle_rad - angle_rad + np.pi / 2) % np.pi - np.pi / 2) < 0.08


def test_noise_and_colour_cast_do_not_matter(room: RenderedPair) -> None:
    plain = Degradation(blur_sigma_px=(1.5, 1.5))
    cast = replace(plain, noise_std=0.02, gain=(0.8, 1.0, 1.1), gamma=1.1)
    src = degrade(room.src, cast, rng=np.random.default_rng(0))
    found = find_matches(room.ref, src)
    kernel = fit_blur(room.ref, apply_colour(src, fit_colour(room.ref, src, found)), found)
    assert kernel is not None
    assert kernel.mean_sigma_px == pytest.approx(1.5, rel=0.1)


def test_equal_views_have_no_blur(room: RenderedPair, matches: Matches) -> None:
    found = fit_blur(room.ref, room.src, matches)
    assert found is not None
    assert found.mean_sigma_px < 0.3
    assert found.factor == 1.0


def test_rests_of_the_registration_do_not_pass_for_blur(
    rng: np.random.Generator, room: RenderedPair, matches: Matches
) -> None:
    shaken = Matches(matches.ref_px, matches.src_px + rng.normal(0, 0.25, matches.src_px.shape))
    sharp = measured(room, Degradation(blur_sigma_px=(1.0, 1.0)), shaken)
    assert sharp.mean_sigma_px == pytest.approx(1.0, rel=0.1)


def test_too_few_matches_tell_no_kernel(room: RenderedPair, matches: Matches) -> None:
    assert fit_blur(room.ref, room.src, matches.select(np.arange(5))) is None
    assert fit_blur(room.ref, room.src, matches.select(np.arange(0))) is None


def test_factor_and_width_are_inverse() -> None:
    for factor in (1.5, 2.0, 8.0):
        assert factor_from_sigma(sigma_from_factor(factor)) == pytest.approx(factor)
    assert (factor_from_sigma(0.0), sigma_from_factor(1.0)) == (1.0, 0.0)


def kernel(sigma_px: float) -> BlurEstimate:
    return BlurEstimate((sigma_px, sigma_px), 0.0, (0.0, 0.0), 0.1, 20)


def test_a_rehearsal_is_damaged_around_what_was_measured() -> None:
    assert damage_range([]) is None
    drawn = damage_range([kernel(sigma_from_factor(f)) for f in (2.8, 3.0, 3.2)])
    assert drawn is not None
    assert 2.0 < drawn.factor[0] < 2.8
    assert 3.2 < drawn.factor[1] < 4.0
    assert drawn.blur_sigma_px == (0.0, 0.0)


def test_a_kernel_that_explains_little_has_no_say() -> None:
    good, bad = kernel(1.2), replace(kernel(4.0), residual=0.7)
    assert damage_range([good, bad]) == damage_range([good])
    assert damage_range([bad]) is not None


def test_what_the_pixels_do_not_explain_is_the_lens() -> None:
    width_px = float(np.hypot(sigma_from_factor(3.0), 1.0))
    drawn = damage_range([kernel(width_px)], asymmetry=3.0, margin=0.0)
    assert drawn is not None
    assert drawn.factor == pytest.approx((3.0, 3.0))
    assert drawn.blur_sigma_px == pytest.approx((1.0, 1.0))
    sharper = damage_range([kernel(sigma_from_factor(2.0))], asymmetry=3.0, margin=0.0)
    assert sharper is not None
    assert sharper.factor == pytest.approx((2.0, 2.0))
    assert sharper.blur_sigma_px == pytest.approx((0.0, 0.0))


@pytest.mark.slow
def test_phone_pairs_have_a_blur_in_time(data_root: Path) -> None:
    captures = find_captures(data_root / "p30")
    corrected = correct_pair(read_pair(captures.captures[4], facts=captures.facts))
    start_s = time.process_time()
    found = fit_blur(corrected.pair.tele, corrected.pair.wide, corrected.matches_fit)
    assert time.process_time() - start_s < 1.0
    assert found is not None
    assert 1.5 < found.factor < 8.0
