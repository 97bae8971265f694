"""What is told of a capture's metres: what a known distance changed, and where they are hardly known."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from rig_worlds import phone_rig

from telewide.depth.pin import KnownDistance, focused_at, pin_distance
from telewide.depth.precision import DepthPrecision
from telewide.depth.precision_notes import (
    hardly_known_notes,
    pinned_shot,
    without_depth_behind,
    without_meaningless_metres,
    without_unknown_std,
)
from telewide.depth.result import DepthResult, depth_result_of_rig
from telewide.geometry.rectification import rectified_geometry
from telewide.geometry.stereo import DisparityMap

RIG = phone_rig()
GEOMETRY = rectified_geometry(RIG, working_width_px=800)
KNOWN = KnownDistance(800.0, 600.0, 0.79)
SHIFT_PX = 24.0  # of the tele photo
SEEN_PX = np.full(GEOMETRY.hw, 70.0, np.float32)


def metres_by_the_rig() -> float:
    """What the rig's own zero of disparity makes of the point: its correction is what is missing."""
    pin = pin_distance(SEEN_PX, KNOWN, geometry=GEOMETRY)
    return KNOWN.distance_m * (1 + pin.correction_px / (float(SEEN_PX[0, 0]) + GEOMETRY.doffs_px))


@pytest.mark.parametrize("known", [KNOWN, focused_at(0.79, hw=RIG.tele.hw)])
def test_a_known_distance_says_what_it_changed(known: KnownDistance) -> None:
    precision = DepthPrecision(lens_shift_std_px=SHIFT_PX)
    pinned = pinned_shot("000", SEEN_PX, known, geometry=GEOMETRY, precision=precision)
    note = pinned.notes[0]
    assert note.startswith(f"000: x {known.x_px:.0f}, y {known.y_px:.0f} is taken to be 0.79 m away")
    assert ("EXIF" in note) == known.is_focus
    by_rig = re.search(r"the rig alone said ([0-9.]+) ± ([0-9.]+) m", note)
    assert by_rig
    alone_m, std_m = (float(number) for number in by_rig.groups())
    assert alone_m == pytest.approx(metres_by_the_rig(), abs=0.006)
    r = SHIFT_PX * alone_m / (RIG.tele.f_px * RIG.baseline_m)
    assert std_m == pytest.approx(alone_m * r * np.sqrt(1 + 8 * r**2), rel=0.05)
    moved_px = (pinned.geometry.doffs_px - GEOMETRY.doffs_px) / GEOMETRY.scale
    assert f"moved by {moved_px:+.1f} px" in note


@pytest.mark.parametrize("n_std", [1.0, 3.0, 6.0])
def test_a_distance_that_contradicts_the_rig_is_questioned(n_std: float) -> None:
    pin = pin_distance(SEEN_PX, KNOWN, geometry=GEOMETRY)
    shift_px = np.sqrt((pin.correction_px / n_std) ** 2 - pin.std_px**2) / GEOMETRY.scale
    precision = DepthPrecision(lens_shift_std_px=float(shift_px))
    notes = pinned_shot("000", SEEN_PX, KNOWN, geometry=GEOMETRY, precision=precision).notes
    questioned = [note for note in notes if "contradicts the rig" in note]
    assert questioned == (
        ["000: that contradicts the rig by 6 standard deviations: check the point and the distance"]
        if n_std > 4
        else []
    )


def test_a_point_beyond_infinity_has_no_metres_by_the_rig() -> None:
    behind_px = np.full(GEOMETRY.hw, -GEOMETRY.doffs_px - 2, np.float32)
    notes = pinned_shot("000", behind_px, KNOWN, geometry=GEOMETRY, precision=DepthPrecision(0, 0, SHIFT_PX)).notes
    assert "the rig alone said that it is beyond infinity" in notes[0]


def test_the_scale_that_a_known_distance_gives_is_told() -> None:
    relative = replace(GEOMETRY, rig=replace(RIG, is_scale_known=False))
    pinned = pinned_shot("000", SEEN_PX, KNOWN, geometry=relative, precision=DepthPrecision())
    assert f"its lenses are {pinned.geometry.rig.baseline_m * 1e3:.2f} mm apart" in pinned.notes[0]
    assert pinned.geometry.rig.is_scale_known


def test_without_a_known_distance_nothing_changes() -> None:
    pinned = pinned_shot("000", SEEN_PX, None, geometry=GEOMETRY, precision=DepthPrecision())
    assert (pinned.geometry, pinned.precision, pinned.notes) == (GEOMETRY, DepthPrecision(), ())


@pytest.mark.parametrize(("share", "n_notes"), [(0.4, 0), (0.64, 1)])
def test_depth_that_is_hardly_known_says_so_and_what_helps(share: float, n_notes: int) -> None:
    depth_m = np.linspace(0.3, 3, 20, dtype=np.float32).reshape(4, 5)
    depth_m[0, 0] = np.nan
    disparity = DisparityMap(1 / depth_m, np.ones_like(depth_m), np.isfinite(depth_m))
    result = DepthResult("000", disparity, depth_m=depth_m, depth_std_m=np.float32(share) * depth_m)
    notes = hardly_known_notes(result)
    assert len(notes) == n_notes
    assert all(words in note for note in notes for words in ("000", "64%", "`distance`", "board"))
    assert hardly_known_notes(replace(result, depth_std_m=None)) == ()


@pytest.mark.parametrize(("share", "is_kept"), [(0.9, True), (1.1, False), (216.56, False)])
def test_metres_that_mean_nothing_are_taken_away_and_no_absurd_figure_is_told(share: float, *, is_kept: bool) -> None:
    depth_m = np.full((3, 4), 2.0, np.float32)
    disparity = DisparityMap(1 / depth_m, np.ones_like(depth_m), np.ones_like(depth_m, dtype=np.bool_))
    result = DepthResult("000", disparity, depth_m=depth_m, depth_std_m=np.float32(share) * depth_m)
    left, told = without_meaningless_metres(result)
    assert (left.depth_m is not None) == (left.depth_std_m is not None) == is_kept
    assert left.disparity is disparity
    assert (told is None) == is_kept
    if told is not None:
        assert "no depth in metres" in told
        assert "%" not in told
        assert "`distance`" in told


@pytest.mark.parametrize(("has_rig", "advice"), [(False, "wide_side: left"), (True, "held otherwise")])
def test_depth_behind_the_cameras_is_taken_away(*, has_rig: bool, advice: str) -> None:
    disparity_px = np.linspace(-30, 1, 40, dtype=np.float32).reshape(5, 8)
    depth_m = np.where(disparity_px > 0, 2, np.nan).astype(np.float32)
    result = DepthResult("000", DisparityMap(disparity_px, np.ones_like(depth_m), disparity_px > 0), depth_m=depth_m)
    left, told = without_depth_behind(result, has_rig=has_rig)
    assert left.depth_m is None
    assert told is not None
    assert advice in told
    assert without_depth_behind(replace(result, doffs_px=10.0), has_rig=has_rig)[1] is None


def test_a_deviation_that_nothing_tells_is_left_out_and_metres_are_still_judged() -> None:
    """Of a network alone: what rig and lens are unsure by is the least the deviation can be."""
    disparity = DisparityMap(*(np.full((4, 5), value, kind) for value, kind in ((6.0, "f4"), (0.9, "f4"), (1, "?"))))
    for shift_px, has_metres in ((1.0, True), (40.0, False)):
        precision = DepthPrecision(lens_shift_std_px=shift_px, confidence_std=None)
        result = depth_result_of_rig("000", disparity, rig=RIG, precision=precision)
        judged, _ = without_meaningless_metres(result)
        left, told = without_unknown_std(judged, precision=precision)
        assert (left.depth_m is not None) == has_metres
        assert left.depth_std_m is None
        assert len(told) == has_metres
    sure = depth_result_of_rig("000", disparity, rig=RIG, precision=DepthPrecision(lens_shift_std_px=1.0))
    assert sure.depth_std_m is not None
    assert result.depth_std_m is not None
    assert without_unknown_std(sure, precision=DepthPrecision()) == (sure, ())


def test_a_rig_that_does_not_know_a_distance_does_not_state_one() -> None:
    near_zero_px = np.full(GEOMETRY.hw, -GEOMETRY.doffs_px + 0.5, np.float32)
    (note,) = pinned_shot("000", near_zero_px, KNOWN, geometry=GEOMETRY, precision=DepthPrecision(0, 0, SHIFT_PX)).notes
    assert "the rig alone said that it does not know" in note
