"""Verdicts on pairs, by one thing put wrong at a time."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from telewide.capture.facts import CaptureFacts
from telewide.capture.pair import RectifiedPair
from telewide.correction.verdict import PairReport, Verdict, inspect_pair
from telewide.simulate.layers import RenderedPair
from telewide.srgb import linear_from_srgb, srgb_from_linear

FACTS = CaptureFacts(asymmetry=3.0, rectified=True)
SILENT = CaptureFacts()


def swapped(pair: RectifiedPair) -> RectifiedPair:
    return RectifiedPair(pair.name, pair.wide, pair.tele)


def test_a_good_pair_is_called_good(pair: RectifiedPair) -> None:
    report = inspect_pair(pair, facts=FACTS)
    assert report.verdict == "good"
    assert report.reasons == ()
    assert report.n_matches > 80
    assert report.asymmetry == pytest.approx(3.0, rel=0.25)
    assert report.vertical_offset_px == pytest.approx(-1.2, abs=0.2)
    assert report.vertical_slope == pytest.approx(-0.006, abs=0.0015)
    assert 7 < report.disparity_p02_px < 10
    assert 20 < report.disparity_p98_px < 25
    assert report.colour_ratio[0] > report.colour_ratio[1] > 1 > report.colour_ratio[2]


@pytest.mark.parametrize(("stops", "is_said"), [(2.0, True), (1.2, True), (0.5, False), (-2.0, True)])
def test_more_than_a_stop_between_the_views_is_said(pair: RectifiedPair, stops: float, *, is_said: bool) -> None:
    light = 0.25 * linear_from_srgb(pair.tele)
    dim = dataclasses.replace(
        pair,
        tele=srgb_from_linear(light).astype(np.float32),
        wide=srgb_from_linear(np.clip(0.25 * linear_from_srgb(pair.wide) * 2**-stops, 0, 1)).astype(np.float32),
    )
    report = inspect_pair(dim, facts=FACTS)
    told = [reason for reason in report.reasons if "brightness more than twofold" in reason]
    assert len(told) == is_said
    assert all(("tele" if stops > 0 else "wide") in reason for reason in told)


def test_swapped_views_are_doubted(pair: RectifiedPair) -> None:
    report = inspect_pair(swapped(pair), facts=SILENT)
    assert report.verdict == "doubtful"
    assert "swapped" in report.reasons[0]
    assert report.asymmetry is not None
    assert report.asymmetry < 0.5


def test_swapped_views_are_refused_where_the_facts_contradict(pair: RectifiedPair) -> None:
    report = inspect_pair(swapped(pair), facts=FACTS)
    assert report.verdict == "refused"
    assert "captures.yaml" in report.reasons[0]


def test_equally_sharp_views_are_no_reason(world: RenderedPair) -> None:
    assert inspect_pair(RectifiedPair("equal", world.ref, world.src), facts=SILENT).verdict == "good"


def test_another_asymmetry_than_stated_is_said(world: RenderedPair) -> None:
    report = inspect_pair(RectifiedPair("equal", world.ref, world.src), facts=FACTS)
    assert report.verdict == "usable"
    assert "asymmetry of 3" in report.reasons[0]


def test_two_scenes_are_doubted(pair: RectifiedPair, rng: np.random.Generator) -> None:
    noise = cv2.GaussianBlur(rng.random(pair.wide.shape, dtype=np.float32), (0, 0), 2.0)
    report = inspect_pair(dataclasses.replace(pair, wide=noise), facts=FACTS)
    assert report.verdict == "doubtful"
    assert "no common scene" in report.reasons[0]
    assert np.isnan(report.disparity_p02_px)


def test_a_view_without_texture_is_doubted(pair: RectifiedPair) -> None:
    report = inspect_pair(dataclasses.replace(pair, wide=np.full_like(pair.wide, 0.3)), facts=FACTS)
    assert report.verdict == "doubtful"
    assert report.asymmetry is None


@pytest.mark.parametrize("shift_px", [-40, 55])
def test_rows_far_apart_are_refused_with_the_distance(pair: RectifiedPair, shift_px: int) -> None:
    report = inspect_pair(dataclasses.replace(pair, wide=np.roll(pair.wide, shift_px, axis=0)), facts=SILENT)
    assert report.verdict == "refused"
    words = next(r for r in report.reasons if "px apart" in r).split()
    assert float(words[words.index("rows") + 1]) == pytest.approx(-shift_px, abs=4)


@pytest.mark.parametrize(("share", "is_refused"), [(0.02, True), (0.008, False)])
def test_rows_that_disagree_are_no_rectified_pair_as_soon_as_many_matches_show_it(
    pair: RectifiedPair, share: float, *, is_refused: bool
) -> None:
    """Beyond 1.5 % of the height; up to there the rows are corrected."""
    shift_px = round(share * pair.wide.shape[0])
    report = inspect_pair(dataclasses.replace(pair, wide=np.roll(pair.wide, -shift_px, axis=0)), facts=FACTS)
    assert report.n_matches > 30
    assert (report.verdict == "refused") == is_refused
    assert any("rows disagree by up to" in reason for reason in report.reasons) == is_refused


def test_a_turned_view_is_refused(pair: RectifiedPair) -> None:
    report = inspect_pair(dataclasses.replace(pair, wide=pair.wide[::-1, ::-1].copy()), facts=SILENT)
    assert report.verdict == "refused"
    assert any("turned by" in r and "180" in r for r in report.reasons)


def test_views_of_two_scales_are_refused(world: RenderedPair, rng: np.random.Generator) -> None:
    height, width = world.ref.shape[:2]
    crop = world.ref[height // 4 : -height // 4, width // 4 : -width // 4]
    enlarged = cv2.resize(crop, (width, height), interpolation=cv2.INTER_CUBIC)
    uncropped = inspect_pair(RectifiedPair("uncropped", enlarged, world.src), facts=SILENT)
    assert uncropped.verdict == "refused"
    assert any("larger in tele" in r for r in uncropped.reasons)
    grain = rng.standard_normal(world.src.shape, dtype=np.float32)  # which makes a view look finer
    noisy = np.clip(world.src + 0.05 * grain, 0, 1)
    report = inspect_pair(RectifiedPair("noisy", enlarged, noisy), facts=SILENT)
    assert report.asymmetry is not None
    assert report.asymmetry < 0.8
    assert any("larger in tele" in r for r in report.reasons)
    assert not any("swapped" in r for r in report.reasons), "matches show that they are not"
    confused = inspect_pair(RectifiedPair("confused", world.src, enlarged), facts=SILENT)
    assert any("larger in wide" in r for r in confused.reasons)


def test_stated_as_unrectified_and_nothing_to_tell_otherwise(pair: RectifiedPair) -> None:
    flat = dataclasses.replace(pair, wide=np.full_like(pair.wide, 0.3))
    assert inspect_pair(flat, facts=CaptureFacts(rectified=False)).verdict == "refused"


def test_swapped_views_are_refused_where_exif_contradicts(pair: RectifiedPair) -> None:
    refused = inspect_pair(swapped(pair), facts=SILENT, focal_lengths_mm=(4.2, 9.0))
    assert refused.verdict == "refused"
    assert "4.2 mm for tele" in refused.reasons[-1]
    assert inspect_pair(swapped(pair), facts=SILENT, focal_lengths_mm=(9.0, 4.2)).verdict == "doubtful"


@pytest.mark.parametrize(
    ("range_px", "n", "verdict", "is_told"),
    [
        ((10.0, 20.0), 100, "good", True),
        ((-300.0, 300.0), 100, "refused", False),
        ((-200.0, -100.0), 5, "doubtful", False),
        ((float("nan"), float("nan")), 0, "doubtful", False),
    ],
)
def test_disparities_are_told_where_matches_show_them(
    range_px: tuple[float, float], n: int, verdict: Verdict, *, is_told: bool
) -> None:
    nan = float("nan")
    report = PairReport("x", n, nan, nan, nan, None, (nan, nan, nan), *range_px, verdict, ())
    assert report.disparity_range_px == (range_px if is_told else None)
