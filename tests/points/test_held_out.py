"""Errors at held-out matches, by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from telewide.capture.layout import Capture
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors


def held_out(points_px: list[tuple[float, float]], disparities_px: list[float]) -> HeldOut:
    capture = Capture("some", Path("tele.png"), Path("wide.png"))
    return HeldOut(capture, np.array(points_px, dtype=np.float64).reshape(-1, 2), np.array(disparities_px))


def test_a_map_is_read_between_its_pixels() -> None:
    """On a ramp of 2 px a column the point at x = 2.5 has 5 px."""
    ramp_px = np.tile(2 * np.arange(8, dtype=np.float32), (5, 1))
    errors_px = match_errors_px(ramp_px, held_out([(2.5, 1.0), (4.0, 3.5)], [5.0, 6.5]))
    np.testing.assert_allclose(errors_px, (0.0, 1.5), atol=1e-5)


def test_shares_and_means_by_hand() -> None:
    """Of 0.5, 2, 4 and 50 px three are over 1, two over 3; clipped at 3 px their mean is 8.5 / 4."""
    summary = summarise_errors(np.array([0.5, 2.0, 4.0, 50.0]))
    expected = {"off_1px": 0.75, "off_3px": 0.5, "mean_px": 14.125, "clipped_px": 2.125, "matches": 4.0}
    assert summary == pytest.approx(expected)


def test_without_matches_nothing_is_known() -> None:
    summary = summarise_errors(match_errors_px(np.zeros((4, 4), np.float32), held_out([], [])))
    assert summary["matches"] == 0
    assert all(math.isnan(value) for name, value in summary.items() if name != "matches")


def test_a_strip_keeps_the_matches_right_of_a_column() -> None:
    strip = held_out([(1.0, 0.0), (5.0, 0.0), (6.0, 0.0)], [1.0, 2.0, 3.0]).beyond(5.0)
    assert strip.disparity_px.tolist() == [2.0, 3.0]
