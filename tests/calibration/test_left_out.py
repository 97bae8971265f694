"""Views that do not take part: which ones, and what is said of them. The oracle is a rig known in every number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from calibration.known_rig import World, camera, phone

from telewide.boards.detection import BoardView
from telewide.boards.shots import DetectedShot
from telewide.calibration.intrinsics import agrees, largest_agreeing_px
from telewide.calibration.quality import Check
from telewide.calibration.result import Calibration, ViewResult
from telewide.calibration.solver import calibrate_rig
from telewide.geometry.rig import Camera, StereoRig, rigid_transform


def joint_shots(world: World, count: int, *, seed: int = 3) -> list[DetectedShot]:
    return list(world.shots(np.random.default_rng(seed), joint=count, tele_close=0, wide_close=0))


def calibrated(shots: Sequence[DetectedShot]) -> Calibration:
    return calibrate_rig(shots, board_points_m=World().board_m)


def left_out(calibration: Calibration) -> list[ViewResult]:
    return [view for view in calibration.views if not view.is_used]


def check(calibration: Calibration, name: str) -> Check:
    return next(each for each in calibration.quality.checks if each.name == name)


def noisier(view: BoardView | None, noise_px: float) -> BoardView | None:
    rng = np.random.default_rng(5)
    return view and replace(view, points_px=view.points_px + noise_px * rng.normal(size=view.points_px.shape))


def test_square_photos_are_not_turned() -> None:
    rig = phone()
    square = StereoRig(
        camera(6000, (3000, 3000), (25, -18), (0.12, -0.4)),
        camera(2500, (3000, 3000), (-14, 22), (0.09, -0.16)),
        rig.wide_from_tele,
    )
    found = calibrated(joint_shots(World(rig=square), 12))
    assert left_out(found) == []
    assert found.rig.baseline_m == pytest.approx(rig.baseline_m, rel=0.05)


def test_views_are_judged_against_the_noise_of_their_set() -> None:
    """Sharp photos with some less sharp ones among them, as near and far boards are; a tenth of a pixel is no fault."""
    shots = joint_shots(replace(World(), noise_px=0.02), 14)
    for k, noise_px in enumerate((0.06, 0.08, 0.09)):
        shots[k] = replace(shots[k], tele=noisier(shots[k].tele, noise_px), wide=noisier(shots[k].wide, noise_px))
    assert left_out(calibrated(shots)) == []


def test_the_figure_of_a_view_left_out_is_said_with_what_would_have_agreed() -> None:
    shots = joint_shots(World(), 14)
    shots[0] = replace(shots[0], tele=noisier(shots[0].tele, 0.85))
    shots[1] = replace(shots[1], tele=noisier(shots[1].tele, 5.0))
    slightly, much = left_out(calibrated(shots))
    assert (slightly.shot, much.shot) == ("joint00", "joint01")
    for view in (slightly, much):
        assert "typical error along x or y is" in view.reason
        assert "would agree" in view.reason
    assert "another board" not in slightly.reason
    assert "another board" in much.reason


@pytest.mark.parametrize("n_ruined", [0, 1, 4])
@pytest.mark.parametrize("spread", [0.05, 0.5])
def test_a_third_of_ruined_views_is_found_among_views_that_differ(n_ruined: int, spread: float) -> None:
    errors_px = 0.2 * np.exp(spread * np.linspace(-1.3, 1.3, 12 - n_ruined))
    errors_px = np.concatenate([errors_px, np.full(n_ruined, 5.0), [np.nan]])
    assert agrees(errors_px).tolist() == [True] * (12 - n_ruined) + [False] * (n_ruined + 1)
    assert largest_agreeing_px(np.array([np.nan])) == 0
    assert largest_agreeing_px(errors_px / 100) == 0.1


def turned_by_pixels(view: BoardView | None) -> BoardView | None:
    """A photo that lies on its side and says nothing of it."""
    if view is None:
        return None
    points_px = np.stack([view.hw[0] - 1 - view.points_px[:, 1], view.points_px[:, 0]], axis=1)
    return BoardView(view.ids, points_px, view.hw[::-1])


@pytest.mark.parametrize("n_close", [0, 6])
def test_of_shots_held_in_two_ways_both_lenses_take_the_same_ones(n_close: int) -> None:
    """Half of the shots are turned: each lens by itself might choose the other half."""
    world = World()
    shots = [*joint_shots(world, 14), *world.shots(np.random.default_rng(4), joint=0, tele_close=n_close, wide_close=0)]
    for k in (1, 3, 5, 7, 9, 11, 13, *range(14, 14 + n_close)):
        shots[k] = replace(shots[k], tele=turned_by_pixels(shots[k].tele), wide=turned_by_pixels(shots[k].wide))
    found = calibrated(shots)
    assert sum(view.is_used for view in found.views) == 14
    assert all("the photo is turned" in view.reason for view in left_out(found))
    advice = check(found, "photos left out").advice
    assert "could not take part" in advice
    assert "disagree" not in advice
    assert "anew" not in advice


def enlarged_wide(rig: StereoRig) -> StereoRig:
    """What a phone gives where its tele lens cannot focus: the middle of the wide photo, as large as a tele photo."""
    wide, zoom = rig.wide, rig.tele.f_px / rig.wide.f_px
    middle = (np.array(wide.hw[::-1]) - 1) / 2
    K = np.diag([wide.f_px * zoom, wide.f_px * zoom, 1.0])
    K[:2, 2] = (wide.K[:2, 2] - middle) * zoom + middle
    still = rigid_transform(rotation=np.zeros(3), translation=np.array([1e-5, 0, 0]))
    return StereoRig(Camera(wide.hw, K, wide.distortion), wide, still)


@pytest.mark.parametrize("n_true", [pytest.param(7, marks=pytest.mark.slow), 5])
def test_shots_through_one_lens_twice_are_told_from_those_through_two(n_true: int) -> None:
    """Fewer true shots than false ones: more agree on a baseline of nothing."""
    world = World()
    true = [replace(shot, name=f"true {shot.name}") for shot in joint_shots(world, n_true)]
    cropped = joint_shots(replace(world, rig=enlarged_wide(world.rig)), 14 - n_true, seed=1)
    found = calibrated([*true, *cropped])
    assert found.rig.baseline_m == pytest.approx(world.rig.baseline_m, rel=0.05)
    assert {view.shot for view in left_out(found)} == {shot.name for shot in cropped}
    assert all(view.reason.startswith("the same lens twice") for view in left_out(found))


def test_a_baseline_that_no_phone_has_is_the_same_lens_twice() -> None:
    world = World()
    found = calibrated(joint_shots(replace(world, rig=enlarged_wide(world.rig)), 12))
    distance = check(found, "distance of the lenses")
    assert (distance.status, distance.unit) == ("fail", "mm")
    assert "the same lens twice" in distance.advice
    assert found.quality.verdict == "insufficient"
    assert not any("nearer and tilted" in each.advice for each in found.quality.checks)
