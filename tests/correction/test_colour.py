"""Colour between two views, against gains, matrices, shading and tone that were put in, and colour-science."""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from telewide.capture.layout import find_captures
from telewide.capture.pair import read_pair
from telewide.correction.colour import (
    apply_colour,
    delta_e,
    fit_colour,
    light_ratio,
    matched_colours,
    registered_colours,
)
from telewide.correction.colour_model import (
    IDENTITY,
    ColourModel,
    colour_terms,
    places_of,
    transform_colours,
    transform_image,
)
from telewide.correction.correct import correct_pair
from telewide.geometry.arrays import FloatImage
from telewide.points.matches import Matches, find_matches, split_matches
from telewide.simulate.layers import RenderedPair
from telewide.srgb import linear_from_srgb, srgb_from_linear

MATRIX = ((0.86, 0.12, -0.03), (-0.05, 1.08, 0.02), (0.03, -0.16, 1.2))


@pytest.fixture(scope="module")
def matches(world: RenderedPair) -> Matches:
    return find_matches(world.ref, world.src)


def seen_by(src: FloatImage, *, matrix: object = None, shading: float = 0.0, gamma: float = 1.0) -> FloatImage:
    """A view as another camera gives it: mixed and shaded in linear light, then a curve."""
    light = linear_from_srgb(src)
    if matrix is not None:
        light = light @ np.asarray(matrix, dtype=np.float32).T
    height, width = src.shape[:2]
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    light = light * (1.0 - shading * (x * x + y * y) / 2)[..., None]
    seen = srgb_from_linear(np.clip(light, 0, 1).astype(np.float32))
    return np.asarray(np.clip(seen, 0, 1) ** np.float32(gamma), dtype=np.float32)


def left_over(world: RenderedPair, seen: FloatImage, matches: Matches) -> tuple[float, float]:
    """Mean DeltaE to the untouched view, of all its pixels, before the correction and after it."""
    fit, _ = split_matches(matches)
    corrected = apply_colour(seen, fit_colour(world.ref, seen, fit))
    truth = world.src[::3, ::3].reshape(-1, 3)
    before, after = (delta_e(truth, image[::3, ::3].reshape(-1, 3)).mean() for image in (seen, corrected))
    return float(before), float(after)


@pytest.mark.parametrize("gains", [(0.6, 1.0, 1.3), (0.75, 0.75, 0.75)])
def test_known_gains_of_light_are_undone(
    world: RenderedPair, matches: Matches, gains: tuple[float, float, float]
) -> None:
    seen = seen_by(world.src, matrix=np.diag(1 / np.array(gains)) * 0.6)
    fit = fit_colour(world.ref, seen, matches)
    np.testing.assert_allclose(np.diag(fit.model.mixing), np.array(gains) / 0.6, rtol=0.05)
    before, after = left_over(world, seen, matches)
    assert before > 4
    assert after < 0.8


def test_a_known_matrix_is_undone_and_gains_alone_are_not_enough(world: RenderedPair, matches: Matches) -> None:
    seen = seen_by(world.src, matrix=MATRIX)
    fit = fit_colour(world.ref, seen, matches)
    assert set(fit.parts) & {"matrix", "rootpoly"}
    before, after = left_over(world, seen, matches)
    assert before > 3
    assert after < 0.25 * before


def test_vignetting_is_found_and_undone(world: RenderedPair, matches: Matches) -> None:
    seen = seen_by(world.src, shading=0.6)
    fit = fit_colour(world.ref, seen, matches)
    assert "shading" in fit.parts
    before, after = left_over(world, seen, matches)
    assert after < 0.3 * before


def test_a_tone_curve_is_found_and_undone(world: RenderedPair, matches: Matches) -> None:
    seen = seen_by(world.src, gamma=1.35)
    assert "tone" in fit_colour(world.ref, seen, matches).parts
    before, after = left_over(world, seen, matches)
    assert after < 0.2 * before


def test_everything_at_once(world: RenderedPair, wide_src: FloatImage) -> None:
    seen = seen_by(wide_src, matrix=MATRIX, shading=0.4, gamma=1.2)
    fit_half, held_out = split_matches(find_matches(world.ref, seen))
    fit = fit_colour(world.ref, seen, fit_half, held_out=held_out)
    assert fit.delta_after < 0.5 * fit.delta_before
    samples = matched_colours(world.ref, apply_colour(seen, fit), held_out)
    again = delta_e(srgb_from_linear(samples.ref_light), srgb_from_linear(samples.src_light)).mean()
    assert again == pytest.approx(fit.delta_after, rel=0.1)


def test_plain_gains_are_not_dressed_up(world: RenderedPair, matches: Matches) -> None:
    seen = seen_by(world.src, matrix=np.diag((0.7, 0.9, 0.8)))
    model = fit_colour(world.ref, seen, matches).model
    changed = transform_image(seen, model)
    plain = transform_image(seen, ColourModel(np.diag((1 / 0.7, 1 / 0.9, 1 / 0.8)), IDENTITY.shading, IDENTITY.tone))
    assert delta_e(changed[::5, ::5].reshape(-1, 3), plain[::5, ::5].reshape(-1, 3)).mean() < 0.5


def test_an_equal_pair_is_left_alone(world: RenderedPair, matches: Matches) -> None:
    fit = fit_colour(world.ref, world.src, matches)
    assert fit.is_identity
    assert fit.delta_after == fit.delta_before < 1.0
    assert apply_colour(world.src, fit) is world.src


def test_a_change_no_eye_sees_is_not_made(world: RenderedPair, matches: Matches) -> None:
    assert fit_colour(world.ref, seen_by(world.src, matrix=np.eye(3) * 0.985), matches).is_identity


def test_clipped_highlights_are_not_fitted(world: RenderedPair, matches: Matches) -> None:
    exposed = seen_by(world.src, matrix=np.eye(3) * 2.2)
    assert (exposed.max(axis=2) > 0.999).mean() > 0.1
    fit = fit_colour(world.ref, exposed, matches)
    unclipped = exposed.max(axis=2) < 0.97
    corrected = apply_colour(exposed, fit)
    assert delta_e(world.src[unclipped][::7], corrected[unclipped][::7]).mean() < 1.0


def test_a_tenth_of_wrong_matches_does_not_bend_the_fit(
    rng: np.random.Generator, world: RenderedPair, matches: Matches
) -> None:
    src_px = matches.src_px.copy()
    n_wrong = len(matches) // 10
    src_px[:n_wrong] = rng.uniform((0, 0), world.src.shape[1::-1], (n_wrong, 2))
    seen = seen_by(world.src, matrix=np.eye(3) * 0.6)
    fit = fit_colour(world.ref, seen, Matches(matches.ref_px, src_px))
    corrected = apply_colour(seen, fit)
    assert delta_e(world.src[::3, ::3].reshape(-1, 3), corrected[::3, ::3].reshape(-1, 3)).mean() < 1.0


def test_few_shades_fit_a_gain(rng: np.random.Generator) -> None:
    ref = np.clip(0.5 + rng.normal(0, 0.004, (120, 160, 3)), 0, 1).astype(np.float32)
    src = np.clip(0.4 + rng.normal(0, 0.004, (120, 160, 3)), 0, 1).astype(np.float32)
    points = rng.uniform((12, 12), (148, 108), (100, 2))
    model = fit_colour(ref, src, Matches(points, points)).model
    step = np.full((1, 2, 3), 0.4, dtype=np.float32)
    step[0, 1] = 0.6
    out = transform_image(step, model)
    np.testing.assert_allclose(out[0, 0], 0.5, atol=0.01)
    gain = (linear_from_srgb(np.array(0.5)) / linear_from_srgb(np.array(0.4))) * linear_from_srgb(np.array(0.6))
    np.testing.assert_allclose(out[0, 1], srgb_from_linear(gain), atol=0.03)


@pytest.mark.parametrize("n", [0, 5, 11])
def test_too_few_matches_leave_the_colours_alone(world: RenderedPair, matches: Matches, n: int) -> None:
    fit = fit_colour(world.ref, (0.5 * world.src).astype(np.float32), matches.select(np.arange(90, 90 + n)))
    assert fit.is_identity
    assert np.isnan(fit.delta_before) == (n == 0)


def test_matches_on_one_line_do_no_harm(world: RenderedPair) -> None:
    points = np.column_stack([np.linspace(20, 300, 40), np.full(40, 100.0)])
    fit = fit_colour(world.ref, seen_by(world.ref, matrix=np.eye(3) * 0.7), Matches(points, points))
    np.testing.assert_allclose(np.diag(fit.model.mixing), 1 / 0.7, rtol=0.03)


def test_no_match_has_no_ratio(world: RenderedPair) -> None:
    none = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
    assert np.isnan(light_ratio(world.ref, world.src, none)).all()


@pytest.mark.parametrize("stops", [-2.0, -0.5, 1.0])
def test_a_stop_is_a_factor_of_two_in_light(world: RenderedPair, matches: Matches, stops: float) -> None:
    light = linear_from_srgb(world.src) * 0.45 * 2**stops
    ref, src = srgb_from_linear(0.45 * linear_from_srgb(world.ref)), srgb_from_linear(np.clip(light, 0, 1))
    np.testing.assert_allclose(
        light_ratio(ref.astype(np.float32), src.astype(np.float32), matches), 2**-stops, rtol=0.04
    )


def test_samples_come_from_surfaces_that_both_views_see(world: RenderedPair, matches: Matches) -> None:
    samples = registered_colours(world.ref, world.src, matches)
    assert len(samples) > 40
    assert np.percentile(delta_e(srgb_from_linear(samples.ref_light), srgb_from_linear(samples.src_light)), 95) < 3.0


def test_image_and_samples_are_transformed_alike(rng: np.random.Generator) -> None:
    image = rng.random((40, 60, 3), dtype=np.float32)
    mixing = np.column_stack([np.asarray(MATRIX), np.full((3, 3), 0.02)])
    model = ColourModel(mixing, np.array([0.1, -0.05, -0.2, 0.03, -0.1]), np.full((3, 3), 0.03))
    y, x = np.mgrid[:40, :60]
    place = places_of(np.column_stack([x.ravel(), y.ravel()]).astype(np.float64), hw=(40, 60))
    samples = transform_colours(linear_from_srgb(image.reshape(-1, 3).astype(np.float64)), model, place=place)
    np.testing.assert_allclose(transform_image(image, model).reshape(-1, 3), np.clip(samples, 0, 1), atol=2e-4)


def test_the_root_polynomial_is_that_of_colour_science(rng: np.random.Generator) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from colour.characterisation import polynomial_expansion_Finlayson2015

    light = rng.random((20, 3))
    expected = polynomial_expansion_Finlayson2015(light, 2, root_polynomial_expansion=True)
    np.testing.assert_allclose(np.sort(colour_terms(light, n=6), axis=1), np.sort(expected, axis=1), atol=1e-9)


def test_black_and_white_differ_by_a_hundred_and_equals_by_nothing() -> None:
    values = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, 0.7]])
    np.testing.assert_allclose(delta_e(values, values), 0.0, atol=1e-9)
    assert delta_e(np.zeros((1, 3)), np.ones((1, 3)))[0] == pytest.approx(100.0, abs=0.1)


@pytest.mark.parametrize("name", ["00", "13", "25"])
def test_colours_of_phone_pairs_come_together(data_root: Path, name: str) -> None:
    captures = find_captures(data_root / "p30")
    pair = read_pair(next(c for c in captures.captures if c.name == name), facts=captures.facts)
    corrected = correct_pair(pair)
    assert corrected.colour.delta_after < (0.7 if name == "00" else 0.55) * corrected.colour.delta_before
    assert corrected.colour.delta_after < 3.0


@pytest.mark.slow
def test_colour_takes_half_a_second(data_root: Path) -> None:
    captures = find_captures(data_root / "p30")
    pair = read_pair(captures.captures[4], facts=captures.facts)
    found = find_matches(pair.tele, pair.wide)
    fit_colour(pair.tele, pair.wide, found)
    start_s = time.process_time()
    apply_colour(pair.wide, fit_colour(pair.tele, pair.wide, found))
    assert time.process_time() - start_s < 1.0
