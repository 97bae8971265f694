"""Checks say in plain words what was found and what would pass."""

from __future__ import annotations

import numpy as np
import pytest
from rig_worlds import phone_rig

from telewide.calibration.checks import Evidence, quality_of
from telewide.calibration.quality import SHARE, at_least, at_most, verdict_of
from telewide.calibration.result import CameraStd, TransformStd


@pytest.mark.parametrize(("value", "status"), [(0.3, "pass"), (0.31, "warn"), (0.9, "warn"), (0.91, "fail")])
def test_small_values_pass(value: float, status: str) -> None:
    check = at_most("error", value, (0.3, 0.9), advice="hold still", unit="px")
    assert check.status == status
    assert check.advice == ("" if status == "pass" else "hold still")
    assert check.limit_words == "at most 0.3 px"


@pytest.mark.parametrize(("value", "status"), [(12, "pass"), (11, "warn"), (5, "warn"), (4, "fail")])
def test_large_values_pass(value: float, status: str) -> None:
    check = at_least("photos used", value, (12, 5), advice="take more", unit="photos")
    assert check.status == status
    assert (check.found_words, check.limit_words) == (f"{value} photos", "at least 12 photos")


def test_shares_are_told_in_per_cent() -> None:
    check = at_most("focal length", 0.00128, (0.002, 0.02), advice="", unit=SHARE)
    assert (check.found_words, check.limit_words) == ("0.128 %", "at most 0.2 %")
    assert at_least("coverage", 1.0, (0.6, 0.2), advice="", unit=SHARE).found_words == "100 %"


def test_a_number_without_unit_and_an_unknown_one() -> None:
    assert at_least("something", 1234.5, (1000, 1), advice="").found_words == "1234"
    check = at_most("error", float("nan"), (0.3, 0.9), advice="take more", unit="px")
    assert (check.status, check.found_words, check.limit_words) == ("warn", "unknown", "at most 0.3 px")


@pytest.mark.parametrize(
    ("values", "verdict"),
    [((), "good"), ((0.1, 0.2), "good"), ((0.1, 0.5), "usable"), ((0.5, 0.95, 0.1), "insufficient")],
)
def test_the_worst_check_decides(values: tuple[float, ...], verdict: str) -> None:
    """Up to 0.3 passes, up to 0.9 warns, beyond it fails."""
    assert verdict_of([at_most("error", value, (0.3, 0.9), advice="hold still") for value in values]) == verdict


@pytest.mark.parametrize(("error_wide_px", "status"), [(0.5, "pass"), (1.5, "warn"), (5.0, "fail")])
def test_board_photos_with_more_pixels_are_judged_alike(error_wide_px: float, status: str) -> None:
    """12 and 50 megapixels of one sensor: errors have twice the px, and are no larger."""
    three = np.zeros(3)
    for width_px in (4032, 8064):
        rig, std = phone_rig(width_px=width_px), CameraStd(1.0, 1.0, 1.0, np.zeros(0))
        errors_px = np.full(50, error_wide_px * rig.asymmetry * width_px / 4032)
        evidence = Evidence(
            (), rig, None, errors_px, (std, std), TransformStd(three, three, 1e-4, np.zeros((6, 6))), 1.0
        )
        (found,) = (each for each in quality_of(evidence).checks if each.name == "held-out epipolar error of 90 %")
        assert found.status == status
