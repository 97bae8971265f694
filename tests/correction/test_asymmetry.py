from __future__ import annotations

import numpy as np
import pytest

from telewide.correction.asymmetry import blur_to_bandwidth, compare_factors, estimate_asymmetry, factor_from_exif
from telewide.simulate.degrade import shrink_and_enlarge
from telewide.simulate.layers import RenderedPair


@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0, 4.0, 6.0])
def test_asymmetry_is_the_factor_of_the_shrinking(world: RenderedPair, factor: float) -> None:
    coarse = shrink_and_enlarge(world.src, factor=factor)
    assert estimate_asymmetry(world.ref, coarse) == pytest.approx(factor, rel=0.25)


def test_swapped_views_give_the_inverse(world: RenderedPair) -> None:
    coarse = shrink_and_enlarge(world.src, factor=3.0)
    forth, back = estimate_asymmetry(world.ref, coarse), estimate_asymmetry(coarse, world.ref)
    assert forth is not None
    assert back is not None
    assert forth * back == pytest.approx(1.0, rel=1e-6)


def test_equal_views_have_no_asymmetry(world: RenderedPair) -> None:
    assert estimate_asymmetry(world.ref, world.src) == 1.0


def test_gain_and_offset_do_not_matter(world: RenderedPair) -> None:
    coarse = shrink_and_enlarge(world.src, factor=3.0)
    paler = (0.6 * coarse + 0.2).astype(np.float32)
    assert estimate_asymmetry(world.ref, paler) == pytest.approx(estimate_asymmetry(world.ref, coarse), rel=0.02)


def test_a_view_without_texture_tells_nothing(world: RenderedPair) -> None:
    assert estimate_asymmetry(world.ref, np.full_like(world.src, 0.5)) is None


@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_blurring_by_a_factor_reads_as_that_factor(world: RenderedPair, factor: float) -> None:
    blurred = blur_to_bandwidth(world.ref, factor=factor)
    assert estimate_asymmetry(world.ref, blurred) == pytest.approx(factor, rel=0.2)


def test_a_factor_of_one_changes_nothing(world: RenderedPair) -> None:
    assert blur_to_bandwidth(world.ref, factor=1.0) is world.ref


def test_a_rig_goes_before_matches_and_matches_before_exif() -> None:
    assert (compare_factors(rig=3.0, matches=3.02, exif=2.9).factor, compare_factors().factor) == (3.0, None)
    assert compare_factors(matches=3.02, exif=2.9).source == "matches"
    assert compare_factors(exif=2.9).source == "exif"
    assert compare_factors(rig=3.0, matches=3.02, exif=2.9).statements == ()


@pytest.mark.parametrize(("matches", "is_said"), [(3.08, False), (3.1, True), (2.92, False), (2.9, True)])
def test_three_percent_between_rig_and_matches_are_said(matches: float, is_said: bool) -> None:
    statements = compare_factors(rig=3.0, matches=matches).statements
    assert len(statements) == is_said
    assert all("3.000" in text and f"{matches:.3f}" in text for text in statements)


@pytest.mark.parametrize(("exif", "is_said"), [(3.4, False), (3.5, True), (2.5, True)])
def test_exif_is_doubted_beyond_fifteen_percent_only(exif: float, is_said: bool) -> None:
    assert len(compare_factors(matches=3.0, exif=exif).statements) == is_said
    assert len(compare_factors(rig=3.0, exif=exif).statements) == is_said


def test_exif_counts_the_sizes_of_the_photos() -> None:
    same = factor_from_exif(tele_f35_mm=80, wide_f35_mm=27, tele_hw=(3000, 4000), wide_hw=(4000, 3000))
    assert same == pytest.approx(80 / 27)
    half = factor_from_exif(tele_f35_mm=80, wide_f35_mm=27, tele_hw=(3000, 4000), wide_hw=(1500, 2000))
    assert half == pytest.approx(2 * 80 / 27)
    assert factor_from_exif(tele_f35_mm=None, wide_f35_mm=27, tele_hw=(3, 4), wide_hw=(3, 4)) is None
