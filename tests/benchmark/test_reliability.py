"""Reliability by its definition: made-up maps whose confidence, errors and hidden pixels are known by construction."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.benchmark.reliability import (
    N_BINS,
    count_reliability,
    hidden_row,
    reliability_rows,
    reliability_tables,
)
from telewide.geometry.arrays import BoolMap
from telewide.geometry.stereo import DisparityMap

HW = (200, 300)


@pytest.fixture
def calibrated(rng: np.random.Generator) -> tuple[DisparityMap, np.ndarray]:
    """A map that is right as often as it says, and its truth."""
    truth_px = rng.uniform(5, 50, HW).astype(np.float32)
    confidence = rng.uniform(0, 1, HW).astype(np.float32)
    off_px = np.where(rng.uniform(0, 1, HW) < confidence, 0.5, 2.0).astype(np.float32)
    return DisparityMap(truth_px + off_px, confidence, np.ones(HW, np.bool_)), truth_px


def test_a_calibrated_map_is_right_as_often_as_it_is_sure(calibrated: tuple[DisparityMap, np.ndarray]) -> None:
    rows = reliability_rows("made up", count_reliability(*calibrated, occluded=None))
    assert len(rows) == N_BINS
    for row in rows:
        assert row["from"] <= row["mean_confidence"] <= row["to"]  # type: ignore[operator]
        assert row["right_1px"] == pytest.approx(row["mean_confidence"], abs=0.03)
        assert row["share"] == pytest.approx(0.1, abs=0.01)
    assert sum(float(str(row["share"])) for row in rows) == pytest.approx(1)


def test_parts_of_a_map_add_up_to_the_whole(
    calibrated: tuple[DisparityMap, np.ndarray], rng: np.random.Generator
) -> None:
    found, truth_px = calibrated
    occluded = rng.uniform(0, 1, HW) < 0.1

    def part(rows: slice) -> tuple[DisparityMap, np.ndarray, BoolMap]:
        cut = DisparityMap(found.disparity_px[rows], found.confidence[rows], ~occluded[rows])
        return cut, truth_px[rows], occluded[rows]

    halves = [part(rows) for rows in (slice(0, 70), slice(70, None))]
    first, second = (count_reliability(cut, truth, occluded=hidden) for cut, truth, hidden in halves)
    cut, truth, hidden = part(slice(None))
    whole = count_reliability(cut, truth, occluded=hidden)
    for name in ("in_bins", "confidence_in_bins", "right_in_bins"):
        np.testing.assert_allclose(getattr(first + second, name), getattr(whole, name))
    assert hidden_row("a", first + second) == hidden_row("a", whole)


def test_unknown_truth_and_left_out_columns_count_nowhere(calibrated: tuple[DisparityMap, np.ndarray]) -> None:
    found, truth_px = calibrated
    truth_px[:50] = np.nan
    counted = count_reliability(found, truth_px, occluded=np.ones(HW, np.bool_), left_out_columns=100)
    assert counted.in_bins.sum() == counted.hidden == 150 * 200


def test_a_confidence_of_one_lies_in_the_last_bin() -> None:
    found = DisparityMap(np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32), np.ones((2, 2), np.bool_))
    counted = count_reliability(found, np.zeros((2, 2), np.float32), occluded=None)
    assert counted.in_bins.tolist() == [0] * (N_BINS - 1) + [4]


def test_an_error_of_a_pixel_is_right_and_a_larger_one_is_not() -> None:
    off_px = np.array([[1.0, 1.01, -1.0, -1.01]], np.float32)
    found = DisparityMap(off_px, np.full((1, 4), 0.55, np.float32), np.ones((1, 4), np.bool_))
    assert count_reliability(found, np.zeros((1, 4), np.float32), occluded=None).right_in_bins[5] == 2


def test_recall_and_precision_of_hidden_pixels() -> None:
    """Ten pixels: four hidden, five called so, three of them rightly."""
    occluded = np.array([[True] * 4 + [False] * 6])
    called = np.array([[True] * 3 + [False] + [True] * 2 + [False] * 4])
    flat = np.zeros((1, 10), np.float32)
    row = hidden_row("m", count_reliability(DisparityMap(flat, flat, ~called), flat, occluded=occluded))
    assert (row["recall"], row["precision"]) == (3 / 4, 3 / 5)


def test_nothing_is_said_of_what_does_not_occur() -> None:
    flat = np.zeros((1, 4), np.float32)
    found = DisparityMap(flat, flat, np.ones((1, 4), np.bool_))
    for occluded in (None, np.zeros((1, 4), np.bool_)):
        counted = count_reliability(found, flat, occluded=occluded)
        assert hidden_row("m", counted) == {"matcher": "m", "recall": None, "precision": None}
        shown = reliability_tables(reliability_rows("m", counted), [hidden_row("m", counted)])
        assert shown.splitlines()[-1].split("|")[2:4] == ["        - ", "           - "]
