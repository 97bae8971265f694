"""What a rig from scenes does not know of the zero of disparity is in the deviation of its depths; it can be pinned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig

from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.rig_file import RigFacts, StoredRig
from telewide.calibration.scene_quality import ZERO_CHECK
from telewide.capture.pair import Capture, CaptureFacts
from telewide.correction.asymmetry import compare_factors
from telewide.correction.refinement import ShotRefinement
from telewide.correction.verdict import PairReport
from telewide.depth.pin import DistancePin, weigh_pin
from telewide.depth.precision import DepthPrecision, depth_std_m
from telewide.geometry.rectification import rectified_geometry, rig_at_sizes
from telewide.points.held_out import HeldOut
from telewide.stages.align import Alignment, shot_precision
from telewide.stages.pairs import PreparedPair, PreparedSet

RIG = phone_rig(has_distortion=False)
ZERO_PX = 24.0


def stored(*checks: Check) -> StoredRig:
    nan = float("nan")
    quality = CalibrationQuality(nan, nan, 0.3, 0.6, 1.0, 0.5, checks, "usable")
    return StoredRig(RIG, None, None, None, quality=quality, facts=RigFacts())


def alignment(*, shrink: int = 1, offset_px: float | None = None) -> Alignment:
    """Of photos of the rig's size, or of a part of it; with a vertical offset where matches showed one."""
    tele_hw, wide_hw = ((camera.hw[0] // shrink, camera.hw[1] // shrink) for camera in (RIG.tele, RIG.wide))
    geometry = rectified_geometry(rig_at_sizes(RIG, tele_hw=tele_hw, wide_hw=wide_hw))
    moved = ShotRefinement(vertical_offset_px=offset_px or 0.0, is_fitted=offset_px is not None)
    return Alignment(moved, (), compare_factors(rig=3.0), geometry)


def precision(rig: StoredRig, *, shrink: int = 1) -> DepthPrecision:
    shot = alignment(shrink=shrink)
    return shot_precision(shot, of_set=[shot], rig=rig)


SCENES = stored(Check(ZERO_CHECK, "warn", ZERO_PX, 1.0, "pin it"))
BOARD = stored(Check("tele coverage", "pass", 0.9, 0.6, ""))


def std_m(shared: DepthPrecision) -> float:
    one = np.ones((1, 1), np.float32)
    return float(depth_std_m(one, 0.5 * one, f_px=RIG.tele.f_px, baseline_m=RIG.baseline_m, precision=shared)[0, 0])


def test_depth_of_a_rig_from_scenes_is_less_sure_than_that_of_a_board() -> None:
    of_scenes, of_board = std_m(precision(SCENES)), std_m(precision(BOARD))
    shared_px = np.hypot(precision(BOARD).lens_shift_std_px, ZERO_PX)
    r = np.hypot(shared_px, 0.5) / (RIG.tele.f_px * RIG.baseline_m)  # of the disparity at 1 m
    assert of_scenes == pytest.approx(r * np.sqrt(1 + 8 * r**2), rel=1e-4)
    assert of_scenes > 5 * of_board


def test_the_zero_goes_with_the_size_of_the_photos() -> None:
    whole, half = (precision(SCENES, shrink=shrink).lens_shift_std_px for shrink in (1, 2))
    assert half == pytest.approx(whole / 2, rel=1e-3)


def test_shots_of_mixed_sizes_have_each_its_own_precision() -> None:
    """Whatever they are called: 12 and 48 megapixels of one phone, which moves its lens by the same share of both."""
    large, small = alignment(offset_px=8.0), alignment(shrink=2, offset_px=4.0)
    alone = shot_precision(large, of_set=[large, large, large], rig=BOARD)
    for of_set in ([large, small, small], [small, small, large]):
        whole = shot_precision(large, of_set=of_set, rig=BOARD)
        half = shot_precision(small, of_set=of_set, rig=BOARD)
        assert whole.lens_shift_std_px == pytest.approx(alone.lens_shift_std_px)
        assert half.lens_shift_std_px == pytest.approx(whole.lens_shift_std_px / 2)


def test_a_known_distance_takes_the_unknown_zero_out() -> None:
    geometry = rectified_geometry(RIG)
    shift_px = precision(SCENES).lens_shift_std_px
    pin = weigh_pin(DistancePin(30.0, 30.0, 0.4), geometry=geometry, lens_shift_std_px=shift_px)
    assert pin.correction_px == pytest.approx(30.0, rel=1e-3)  # the rig has next to no say
    pinned = replace(precision(SCENES), lens_shift_std_px=pin.std_px)
    assert std_m(pinned) < 1.1 * std_m(precision(BOARD))


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_an_unsure_zero_is_not_taken_for_small(share: float, rng: np.random.Generator) -> None:
    # At so far a distance that the zero's deviation is this share of the disparity.
    shift_px = 6.0
    disparity_px = shift_px / share
    gain = RIG.tele.f_px * RIG.baseline_m
    drawn_m = gain / (disparity_px + rng.normal(0, shift_px, 200_000))
    stated_m = depth_std_m(
        np.full((1, 1), gain / disparity_px, np.float32),
        np.zeros((1, 1), np.float32),
        f_px=RIG.tele.f_px,
        baseline_m=RIG.baseline_m,
        precision=DepthPrecision(lens_shift_std_px=shift_px),
    )
    assert stated_m[0, 0] == pytest.approx(np.std(drawn_m), rel=0.03)


def test_pairs_too_poor_to_measure_blur_are_rehearsed_at_the_factor_of_their_rig() -> None:
    nan = float("nan")
    report = PairReport("a", 0, nan, nan, nan, None, (nan, nan, nan), nan, nan, "doubtful", ())
    capture = Capture("a", Path("tele.png"), Path("wide.png"))
    held_out = HeldOut(capture, np.zeros((0, 2)), np.zeros(0))
    pair = PreparedPair(capture, capture, report, 1.0, held_out, alignment())
    prepared = PreparedSet((pair,), CaptureFacts(), None, (), root=Path("captures"))
    assert prepared.damage_factor == (3.0, 3.0)
    assert replace(prepared, pairs=(replace(pair, alignment=None),)).damage_factor is None
