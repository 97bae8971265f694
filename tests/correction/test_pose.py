"""Where wide stood in a shot, against simulated shots that moved, within the stated deviations."""

from __future__ import annotations

import numpy as np
import pytest
from rig_worlds import angle_deg, measured, phone_rig, seen_points, wide_centre

from telewide.correction.moving import find_moving, moving_mask, moving_note
from telewide.correction.pose import fit_pose
from telewide.correction.refinement import ShotRefinement, fit_shot, refined_rig
from telewide.points.epipolar import moved_rig, vertical_misfit_px


@pytest.mark.parametrize(("seed", "is_vertical"), [(0, False), (1, True), (2, False)])
def test_where_wide_stood_is_recovered_within_its_deviations(seed: int, is_vertical: bool) -> None:
    rng = np.random.default_rng(seed)
    rig = phone_rig(is_vertical=is_vertical)
    turn_rad, centre = np.radians(rng.normal(0, 1, 3)), wide_centre(rig) + rng.normal(0, [0.6, 0.6, 0.2])
    truth = moved_rig(rig, scale=1.001, rotation_vector=turn_rad, wide_centre=centre)
    exact = seen_points(truth, rng, n=600, nearest_m=0.6, farthest_m=3)
    found = fit_pose(measured(exact, rng), rig=rig)
    error_deg = angle_deg(-found.translation_direction, -truth.wide_from_tele[:3, 3] / truth.baseline_m)
    error_deg = 180 - error_deg if error_deg > 90 else error_deg
    assert error_deg < max(1.0, 3 * np.degrees(found.direction_std_rad))
    assert (np.abs(found.rotation_vector - turn_rad) < 4 * found.rotation_std_rad).all()
    assert abs(found.scale - 1.001) < 4 * found.scale_std


def test_a_far_scene_leaves_the_direction_open_and_says_so(rng: np.random.Generator) -> None:
    rig = phone_rig()
    far = seen_points(rig, rng, nearest_m=200, farthest_m=1000)
    found = fit_pose(measured(far, rng), rig=rig)
    assert found.direction_std_rad > np.radians(15)
    assert "known to" in found.notes[0]


def test_a_shot_from_elsewhere_is_noticed_without_its_time(rng: np.random.Generator) -> None:
    rig = phone_rig()
    truth = moved_rig(rig, rotation_vector=np.radians([0.5, -0.4, 1.0]), wide_centre=np.array([1.0, 0.8, 0.1]))
    exact = seen_points(truth, rng, nearest_m=0.6, farthest_m=3)
    shot = fit_shot(measured(exact, rng), rig=rig)
    assert not shot.is_at_once
    assert shot.residual_after_px < 0.5 < shot.residual_before_px
    of_shot = refined_rig(rig, shot)
    assert not of_shot.is_scale_known
    assert np.median(np.abs(vertical_misfit_px(exact.ref_px, exact.src_px, rig=of_shot))) < 0.1


def test_something_that_moved_is_found_where_it_is(rng: np.random.Generator) -> None:
    rig = phone_rig()
    exact = seen_points(rig, rng, n=900)
    matches = measured(exact, rng, wrong_share=0.1)
    is_moved = (np.abs(exact.ref_px - [1000, 400]) < [160, 120]).all(axis=1)
    matches.src_px[is_moved] = exact.src_px[is_moved] + [1.0, 3.0]
    regions = find_moving(matches, ShotRefinement(), rig=rig)
    assert len(regions) == 1
    assert regions[0].vertical_px == pytest.approx(-9.0, abs=0.5)
    mask = moving_mask(regions, hw=rig.tele.hw)
    assert mask[350:450, 930:1070].all()
    assert mask.sum() < 3 * 320 * 240
    assert "moved between" in (moving_note(regions) or "")


def test_wrong_matches_are_not_taken_for_motion(rng: np.random.Generator) -> None:
    rig = phone_rig()
    matches = measured(seen_points(rig, rng, n=900), rng, wrong_share=0.2)
    assert find_moving(matches, ShotRefinement(), rig=rig) == ()
    assert moving_note(()) is None
    assert find_moving(matches.select(np.arange(5)), ShotRefinement(), rig=rig) == ()
