"""Which source of the asymmetric factor is believed, and what is said where two contradict."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.correction.asymmetry import compare_factors, factor_from_exif


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


@pytest.mark.parametrize(("tele_px", "wide_px"), [(4000, 4000), (4000, 2000), (2000, 4000)])
def test_exchanged_photos_have_the_inverse_factor_whatever_their_sizes(tele_px: int, wide_px: int) -> None:
    """A lens's focal length counts in sizes of its photo: given in each other's place, the lenses trade those."""
    tele_sizes, wide_sizes = 2.4, 0.8
    rig = tele_sizes * tele_px / (wide_sizes * wide_px)
    matches = wide_sizes * tele_px / (tele_sizes * wide_px)
    size_ratio = wide_px / tele_px
    for known in ({"matches": matches}, {"exif": matches}, {"matches": matches, "exif": 1.1 * matches}):
        found = compare_factors(rig=rig, size_ratio=size_ratio, **known)
        assert "swapped" in str(found.swapped)
        assert found.statements == (), "nothing else explains them"
    assert compare_factors(rig=rig, matches=rig, size_ratio=size_ratio).swapped is None
    assert compare_factors(rig=rig, size_ratio=size_ratio).swapped is None
    assert compare_factors(rig=rig, matches=matches, exif=rig, size_ratio=size_ratio).swapped is None, "they contradict"


def test_lenses_that_hardly_differ_are_never_called_swapped() -> None:
    assert compare_factors(rig=1.05, matches=1 / 1.05).swapped is None


def test_exif_counts_the_sizes_of_the_photos() -> None:
    same = factor_from_exif(tele_f35_mm=80, wide_f35_mm=27, tele_hw=(3000, 4000), wide_hw=(4000, 3000))
    assert same == pytest.approx(80 / 27)
    half = factor_from_exif(tele_f35_mm=80, wide_f35_mm=27, tele_hw=(3000, 4000), wide_hw=(1500, 2000))
    assert half == pytest.approx(2 * 80 / 27)
    shapes = factor_from_exif(tele_f35_mm=80, wide_f35_mm=27, tele_hw=(3000, 4000), wide_hw=(2250, 4000))
    assert shapes == pytest.approx(80 / 27 * np.hypot(3000, 4000) / np.hypot(2250, 4000))  # equivalents by the diagonal
    assert factor_from_exif(tele_f35_mm=None, wide_f35_mm=27, tele_hw=(3, 4), wide_hw=(3, 4)) is None
