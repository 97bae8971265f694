"""Correction of a pair: misfits that were put in are gone, equal and hopeless pairs stay as they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from telewide.capture.facts import CaptureFacts
from telewide.capture.layout import find_captures
from telewide.capture.pair import RectifiedPair, read_pair
from telewide.correction.correct import correct_pair
from telewide.correction.verdict import inspect_pair
from telewide.simulate.layers import RenderedPair


def test_correction_brings_rows_and_colours_together(pair: RectifiedPair) -> None:
    corrected = correct_pair(pair)
    assert corrected.pair.tele is pair.tele
    assert corrected.vertical.is_fitted
    assert np.median(np.abs(corrected.matches_held_out.vertical_px)) < 0.3
    assert corrected.colour.delta_after < 0.3 * corrected.colour.delta_before
    report = inspect_pair(corrected.pair, facts=CaptureFacts(asymmetry=3.0, rectified=True))
    assert report.vertical_residual_px < 0.3
    np.testing.assert_allclose(report.colour_ratio, 1.0, atol=0.02)


def test_correction_leaves_an_equal_pair_alone(world: RenderedPair) -> None:
    corrected = correct_pair(RectifiedPair("equal", world.ref, world.src))
    assert corrected.pair.wide is world.src


def test_correction_leaves_a_hopeless_pair_alone(pair: RectifiedPair) -> None:
    flat = dataclasses.replace(pair, wide=np.full_like(pair.wide, 0.3))
    corrected = correct_pair(flat)
    assert corrected.pair.wide is flat.wide
    assert len(corrected.matches_held_out) == 0


@pytest.mark.parametrize("name", ["10", "27"])
def test_correction_lessens_the_misfit_of_phone_pairs(data_root: Path, name: str) -> None:
    captures = find_captures(data_root / "p30")
    capture = next(c for c in captures.captures if c.name == name)
    corrected = correct_pair(read_pair(capture, facts=captures.facts))
    assert np.median(np.abs(corrected.matches_held_out.vertical_px)) < 0.45
    assert corrected.vertical.residual_before_px > 0.5
    assert corrected.colour.delta_after < 0.5 * corrected.colour.delta_before
