"""A known distance, against rigs whose zero of disparity or scale was moved on purpose: depth comes back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rig_worlds import phone_rig

from telewide.depth.pin import (
    DistancePin,
    KnownDistance,
    focused_at,
    parse_known_distance,
    pin_distance,
    pin_scale,
    weigh_pin,
)
from telewide.errors import InputError, UsageError
from telewide.geometry.rectification import RectifiedGeometry, rectified_geometry
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import across_in_wide

SHIFT_PX = 4.0


def geometry_and_disparity(rig: StereoRig, *, known: KnownDistance) -> tuple[RectifiedGeometry, np.ndarray]:
    """A wall through the known point, across the rectified view, seen by a wide that shifted along the baseline."""
    geometry = rectified_geometry(rig, working_width_px=800)
    ray = np.append(rig.tele.normalised(np.array([[known.x_px, known.y_px]]))[0], 1.0)
    point_m = geometry.rect_from_tele @ ray * known.distance_m / np.linalg.norm(ray)
    disparity_px = geometry.f_px * rig.baseline_m / point_m[2] - SHIFT_PX
    return geometry, np.full(geometry.hw, disparity_px, dtype=np.float32)


@pytest.mark.parametrize("is_vertical", [False, True])
def test_a_known_distance_brings_back_the_zero_of_disparity(is_vertical: bool) -> None:
    known = KnownDistance(1200.0, 300.0, 1.5)
    geometry, disparity_px = geometry_and_disparity(phone_rig(is_vertical=is_vertical), known=known)
    pin = pin_distance(disparity_px, known, geometry=geometry)
    assert pin.correction_px == pytest.approx(SHIFT_PX, abs=1e-3)
    pinned = dataclasses.replace(geometry, doffs_px=pin.doffs_px)
    again = pin_distance(disparity_px, known, geometry=pinned)
    assert again.correction_px == pytest.approx(0.0, abs=1e-9)
    assert pin.std_px > 0.01 * geometry.f_px * geometry.rig.baseline_m / 1.6


def test_a_known_distance_brings_back_the_scale() -> None:
    known = KnownDistance(500.0, 700.0, 2.0)
    rig = phone_rig()
    geometry, disparity_px = geometry_and_disparity(rig, known=known)
    seen_px = disparity_px + np.float32(SHIFT_PX)
    sure, unsure = (pin_scale(seen_px, known, geometry=geometry, lens_shift_std_px=shift) for shift in (0.0, 3.0))
    assert sure.baseline_m == unsure.baseline_m == pytest.approx(rig.baseline_m, rel=1e-4)
    d_px = float(seen_px[0, 0]) + geometry.doffs_px
    assert sure.std_m == pytest.approx(rig.baseline_m * np.hypot(0.01, 0.1 / d_px), rel=1e-3)
    assert unsure.std_m == pytest.approx(rig.baseline_m * np.sqrt(0.01**2 + (0.1**2 + 3**2) / d_px**2), rel=1e-3)


def test_the_middle_of_the_photo_is_in_focus() -> None:
    geometry, _ = geometry_and_disparity(phone_rig(), known=KnownDistance(800.0, 600.0, 1.0))
    assert focused_at(0.7, hw=geometry.rig.tele.hw) == KnownDistance(799.5, 599.5, 0.7, 0.1, is_focus=True)


@pytest.mark.parametrize(("shift_std_px", "decides"), [(1e3, "pin"), (1e-3, "rig")])
def test_the_surer_one_decides(shift_std_px: float, decides: str) -> None:
    geometry, _ = geometry_and_disparity(phone_rig(), known=KnownDistance(800.0, 600.0, 1.0))
    pin = DistancePin(geometry.doffs_px + 5.0, 5.0, 0.5)
    both = weigh_pin(pin, geometry=geometry, lens_shift_std_px=shift_std_px)
    assert both.correction_px == pytest.approx(5.0 if decides == "pin" else 0.0, abs=1e-3)
    assert both.std_px <= min(pin.std_px, shift_std_px)
    assert both.doffs_px == pytest.approx(geometry.doffs_px + both.correction_px)


def test_equally_sure_ones_meet_in_the_middle() -> None:
    geometry, _ = geometry_and_disparity(phone_rig(), known=KnownDistance(800.0, 600.0, 1.0))
    both = weigh_pin(DistancePin(geometry.doffs_px + 4.0, 4.0, 2.0), geometry=geometry, lens_shift_std_px=2.0)
    assert both.correction_px == pytest.approx(2.0)
    assert both.std_px == pytest.approx(np.sqrt(2.0))


def test_what_cannot_be_pinned_is_refused() -> None:
    known = KnownDistance(800.0, 600.0, 1.0)
    rig = phone_rig()
    geometry, disparity_px = geometry_and_disparity(rig, known=known)
    with pytest.raises(InputError, match="not in the tele photo"):
        pin_distance(disparity_px, KnownDistance(5000.0, 600.0, 1.0), geometry=geometry)
    with pytest.raises(InputError, match="no disparity"):
        pin_distance(np.full_like(disparity_px, np.nan), known, geometry=geometry)
    with pytest.raises(InputError, match="infinity"):
        pin_scale(np.zeros_like(disparity_px), known, geometry=geometry)
    relative = dataclasses.replace(geometry, rig=dataclasses.replace(rig, is_scale_known=False))
    with pytest.raises(InputError, match="without a scale"):
        pin_distance(disparity_px, known, geometry=relative)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "1,2,0", "1,2,-1", "1,2,nan", "1,2,1e4"])
def test_a_known_distance_is_three_numbers(text: str) -> None:
    assert parse_known_distance("12, 34.5,1.2") == KnownDistance(12.0, 34.5, 1.2)
    with pytest.raises(UsageError, match="known distance"):
        parse_known_distance(text)


def test_across_is_at_right_angles_to_the_baseline_as_wide_sees_it() -> None:
    for is_vertical in (False, True):
        rig = phone_rig(is_vertical=is_vertical)
        along = rig.wide_from_tele[:2, 3] / np.linalg.norm(rig.wide_from_tele[:2, 3])
        assert abs(along @ across_in_wide(rig)) < 0.01
