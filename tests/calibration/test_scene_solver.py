"""A rig from matches of scenes, against the known rig that saw them; what such a rig cannot know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rig_worlds import angle_deg, measured, phone_rig, seen_points, wide_centre

from telewide.calibration.scene_rig import FocalPrior, stated_baseline_std_m
from telewide.calibration.scene_solver import first_rig, rig_from_scenes
from telewide.capture.images import read_image
from telewide.correction.refinement import fit_shot, refined_rig
from telewide.errors import InputError, UsageError
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import moved_rig, rectified_points, vertical_misfit_px
from telewide.points.matches import Matches
from telewide.points.photo_matches import find_photo_matches


def captures(rig: StereoRig, rng: np.random.Generator, *, n: int) -> tuple[list[Matches], list[Matches]]:
    """Exact and measured matches of n shots, each with its own lens movement and its own range of depth."""
    exact = []
    for _ in range(n):
        roll = np.array([0, 0, rng.normal(0, 0.001)])
        moved = moved_rig(rig, offset_px=rng.normal(0, 2), scale=1 + rng.normal(0, 0.002), rotation_vector=roll)
        nearest_m = rng.uniform(0.5, 1.0)
        exact.append(seen_points(moved, rng, n=250, nearest_m=nearest_m, farthest_m=nearest_m * rng.uniform(2, 5)))
    return exact, [measured(e, rng) for e in exact]


@pytest.mark.parametrize(("is_vertical", "side"), [(False, "right"), (True, "below")])
def test_a_rig_is_found_from_eight_captures(is_vertical: bool, side: str) -> None:
    rng = np.random.default_rng(5)
    rig = phone_rig(is_vertical=is_vertical, has_distortion=False)
    exact, matches = captures(rig, rng, n=9)
    focal = FocalPrior(tele_f_px=1.03 * rig.tele.f_px, wide_f_px=1.06 * rig.wide.f_px)
    found = rig_from_scenes(
        matches[:8],
        tele_hw=rig.tele.hw,
        wide_hw=rig.wide.hw,
        focal=focal,
        baseline_m=0.012,
        wide_side=side,  # type: ignore[arg-type]
    )
    assert found.n_scenes == 8
    assert found.rig.baseline_m == pytest.approx(0.012)
    assert found.rig.is_scale_known
    assert found.std.baseline_m == pytest.approx(0.0005)
    assert found.wide_side == side
    assert abs(found.rig.asymmetry / rig.asymmetry - 1) < 3 * found.std.ratio_share < 0.02
    assert angle_deg(wide_centre(found.rig), wide_centre(rig)) < 3 * np.degrees(found.std.direction_rad).max()
    assert (np.abs(found.rig.wide.K[:2, 2] - rig.wide.K[:2, 2]) < 3 * found.std.wide_centre_px).all()
    assert found.std.zero_px > 5
    assert any("zero of disparity" in note for note in found.notes)
    # the ninth capture was not seen: its own correction is fitted, its exact points judge the rig
    shot = fit_shot(matches[8], rig=found.rig)
    left_px = np.abs(vertical_misfit_px(exact[8].ref_px, exact[8].src_px, rig=refined_rig(found.rig, shot)))
    assert shot.residual_after_px < 0.5
    assert np.percentile(left_px, 50) < 0.15
    assert np.percentile(left_px, 99) < 0.5


def zero_px(found: StereoRig, truth: StereoRig) -> float:
    """Disparity that a rig gives what is infinitely far, in the middle of the tele photo."""
    middle = (np.array([truth.tele.hw[::-1]]) - 1) / 2
    rays = np.column_stack([truth.tele.normalised(middle), [1.0]]) @ truth.wide_from_tele[:3, :3].T
    tele, wide = rectified_points(middle, truth.wide.project(rays), rig=found)
    return float(found.tele.f_px * (tele - wide)[0, 0])


def test_distortion_is_not_taken_for_another_zero_of_disparity() -> None:
    rng = np.random.default_rng(8)
    rig = phone_rig(has_distortion=True)
    _, matches = captures(rig, rng, n=8)
    focal = FocalPrior(rig.tele.f_px, rig.wide.f_px)
    found = rig_from_scenes(matches, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=focal, wide_side="right")
    assert abs(zero_px(found.rig, rig)) < 2.5 * found.std.zero_px
    assert abs(found.rig.asymmetry / rig.asymmetry - 1) < 3 * found.std.ratio_share
    assert angle_deg(wide_centre(found.rig), wide_centre(rig)) < 3 * np.degrees(found.std.direction_rad).max()
    wanted = [camera.distortion[0] for camera in (rig.tele, rig.wide)]
    got = [camera.distortion[0] for camera in (found.rig.tele, found.rig.wide)]
    np.testing.assert_array_less(np.abs(np.subtract(got, wanted)), 3 * found.std.distortion)


def test_lenses_above_each_other_do_not_stand_side_by_side() -> None:
    rng = np.random.default_rng(5)
    rig = phone_rig(is_vertical=True, has_distortion=False)
    _, matches = captures(rig, rng, n=3)
    focal = FocalPrior(rig.tele.f_px, rig.wide.f_px)
    with pytest.raises(UsageError, match="right of tele"):
        rig_from_scenes(matches, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=focal, wide_side="right")


def test_only_one_side_puts_near_things_in_front(rng: np.random.Generator) -> None:
    rig = phone_rig(has_distortion=False)
    focal = FocalPrior(rig.tele.f_px, rig.wide.f_px)
    scenes = []
    for _ in range(3):  # so near that no principal point explains the shift away, and far things beside near ones
        near = seen_points(rig, rng, n=200, nearest_m=0.15, farthest_m=0.7)
        scenes.append(measured(near, rng))
    found = rig_from_scenes(scenes, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=focal)
    assert (found.wide_side, found.side_source) == ("right", "seen")
    stated = rig_from_scenes(scenes, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=focal, wide_side="left")
    assert (stated.wide_side, stated.side_source) == ("left", "contradicted")


@pytest.mark.parametrize(("baseline_m", "std_m"), [(0.009, 0.0005), (0.0123, 0.0005), (0.2, 0.002)])
def test_a_stated_baseline_is_as_sure_as_a_ruler_is(baseline_m: float, std_m: float) -> None:
    assert stated_baseline_std_m(baseline_m) == pytest.approx(std_m)


def test_without_a_baseline_depth_is_relative(rng: np.random.Generator) -> None:
    rig = phone_rig(has_distortion=False)
    _, matches = captures(rig, rng, n=3)
    focal = FocalPrior(rig.tele.f_px, rig.wide.f_px)
    found = rig_from_scenes(matches, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=focal, wide_side="left")
    assert not found.rig.is_scale_known
    assert wide_centre(found.rig)[0] < -0.9
    assert any("relative" in note for note in found.notes)


def test_too_few_captures_are_refused(rng: np.random.Generator) -> None:
    rig = phone_rig(has_distortion=False)
    _, matches = captures(rig, rng, n=3)
    scenes = [*matches[:2], matches[2].select(np.arange(20))]
    with pytest.raises(InputError, match="found 2"):
        rig_from_scenes(
            scenes, tele_hw=rig.tele.hw, wide_hw=rig.wide.hw, focal=FocalPrior(rig.tele.f_px, rig.wide.f_px)
        )


def test_the_first_guess_is_straight_ahead() -> None:
    rig = first_rig(tele_hw=(30, 40), wide_hw=(60, 80), focal=FocalPrior(100.0, 50.0))
    np.testing.assert_allclose(rig.wide_from_tele[:3, :3], np.eye(3))
    assert not rig.tele.distortion.any()
    np.testing.assert_allclose(rig.wide.K, [[50, 0, 39.5], [0, 50, 29.5], [0, 0, 1]])
    assert rig.asymmetry == pytest.approx(2.0)


@pytest.mark.slow
def test_two_lenses_of_a_phone_from_photos_alone(data_root: Path) -> None:
    folder = data_root / "phone_wide_ultra"
    focal = FocalPrior(tele_f_px=723.0, wide_f_px=393.0)
    scenes = []
    for motion in ("Forward_0-5-10-15_cm", "Left_0-5-10-15_cm", "Roll_Clockwise_0-10-20-30_degrees"):
        for tele_path in sorted((folder / motion).glob("wide_*.jpg"))[:3]:
            tele, wide = (
                read_image(path) for path in (tele_path, tele_path.with_name(tele_path.name.replace("wide_", "ultra_")))
            )
            guess = first_rig(tele_hw=tele.shape[:2], wide_hw=wide.shape[:2], focal=focal)
            scenes.append(find_photo_matches(tele, wide, rig=guess))
    found = rig_from_scenes(scenes[::2], tele_hw=tele.shape[:2], wide_hw=wide.shape[:2], focal=focal)
    # similarities between the photos show 1.84 to 1.87
    assert found.rig.asymmetry == pytest.approx(1.86, rel=0.03)
    # its authors state a translation of (-0.0136, 0.0098, 0.0097) m
    assert found.rig.wide_from_tele[0, 3] < -0.5
    assert found.rig.wide_from_tele[1, 3] > 0.5
    for scene in scenes[1::2]:
        shot = fit_shot(scene, rig=found.rig)
        assert shot.is_fitted
        assert shot.residual_after_px < 0.5
