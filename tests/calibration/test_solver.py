"""A rig from corners, against the known rig that saw them, within the stated deviations; planted mistakes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from calibration.known_rig import World, camera, phone, rotation_error_rad

from telewide.boards.detection import BoardView
from telewide.boards.shots import DetectedShot
from telewide.calibration.quality import Check
from telewide.calibration.result import Calibration
from telewide.calibration.solver import calibrate_rig
from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig, rigid_transform


def normalised_errors(found: Calibration, true: StereoRig) -> FloatArray:
    """Errors over stated standard deviations: both lenses' f, cx, cy, the rotation, the translation, the baseline."""
    errors = []
    for mine, theirs, std in (
        (found.rig.tele, true.tele, found.tele_std),
        (found.rig.wide, true.wide, found.wide_std),
    ):
        errors.append((mine.f_px - theirs.f_px) / std.f_px)
        errors.extend((mine.K[:2, 2] - theirs.K[:2, 2]) / (std.cx_px, std.cy_px))
    errors.extend(np.degrees(rotation_error_rad(found.rig, true)) / found.transform_std.rotation_deg)
    shift_m = found.rig.wide_from_tele[:3, 3] - true.wide_from_tele[:3, 3]
    errors.extend(shift_m / found.transform_std.translation_m)
    errors.append((found.rig.baseline_m - true.baseline_m) / found.transform_std.baseline_m)
    return np.array(errors)


def check(calibration: Calibration, name: str) -> Check:
    return next(each for each in calibration.quality.checks if each.name == name)


def left_out(calibration: Calibration) -> set[str]:
    return {view.shot for view in calibration.views if not view.is_used}


def calibrated(world: World, shots: Sequence[DetectedShot]) -> Calibration:
    return calibrate_rig(shots, board_points_m=world.board_m)


@pytest.fixture(scope="module")
def world() -> World:
    return World()


@pytest.fixture(scope="module")
def shots(world: World) -> tuple[DetectedShot, ...]:
    return world.shots(np.random.default_rng(11), joint=14, tele_close=4, wide_close=4)


@pytest.fixture(scope="module")
def calibration(world: World, shots: tuple[DetectedShot, ...]) -> Calibration:
    return calibrated(world, shots)


def test_a_known_rig_is_recovered_within_its_stated_deviations(world: World, calibration: Calibration) -> None:
    errors = normalised_errors(calibration, world.rig)
    assert np.abs(errors).max() < 4
    assert 0.4 < np.sqrt(np.mean(errors**2)) < 1.8
    assert calibration.rig.tele.f_px == pytest.approx(9000, rel=1e-3)
    assert calibration.rig.wide.f_px == pytest.approx(3000, rel=1e-3)
    assert calibration.rig.baseline_m == pytest.approx(world.rig.baseline_m, rel=5e-3)
    assert calibration.quality.verdict == "good"
    assert not left_out(calibration)


def test_stated_noise_and_figures_are_those_of_the_corners(world: World, calibration: Calibration) -> None:
    quality = calibration.quality
    for rms_px in (quality.tele_rms_px, quality.wide_rms_px):
        assert rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.05)
    # 0.2 px in wide is 0.6 px in tele, and 0.2 px of its own: normal with deviation 0.632.
    assert quality.epipolar_p50_px == pytest.approx(0.632 * 0.6745, rel=0.15)
    assert quality.epipolar_p90_px == pytest.approx(0.632 * 1.645, rel=0.15)
    for view in calibration.views:
        assert view.rms_px == pytest.approx(np.sqrt(np.mean(np.sum(view.residuals_px**2, axis=1))))
        assert len(view.ids) == view.n == len(view.points_px) == len(view.residuals_px)


def test_noise_free_points_lie_on_their_epipolar_lines(world: World, calibration: Calibration) -> None:
    rng = np.random.default_rng(1)
    clean = replace(world, noise_px=0.0)
    distances = []
    rig = calibration.rig
    t, R = rig.wide_from_tele[:3, 3], rig.wide_from_tele[:3, :3]
    for shot in clean.shots(rng, joint=6, tele_close=0, wide_close=0):
        assert shot.tele is not None
        assert shot.wide is not None
        common, in_tele, in_wide = np.intersect1d(shot.tele.ids, shot.wide.ids, return_indices=True)
        rays = [
            np.column_stack([lens.normalised(view.points_px[index]), np.ones(len(common))])
            for lens, view, index in ((rig.tele, shot.tele, in_tele), (rig.wide, shot.wide, in_wide))
        ]
        lines = np.cross(R.T @ -t, rays[1] @ R)  # through the wide lens's centre and along its ray, in the tele frame
        across = np.abs(np.sum(lines * rays[0], axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
        distances.append(across * rig.tele.f_px)
    assert np.percentile(np.concatenate(distances), 90) < 0.3


@pytest.mark.slow
def test_the_same_photos_give_the_same_rig(
    world: World, shots: tuple[DetectedShot, ...], calibration: Calibration
) -> None:
    again = calibrated(world, shots)
    np.testing.assert_array_equal(again.rig.wide_from_tele, calibration.rig.wide_from_tele)
    assert again.quality == calibration.quality


@pytest.mark.slow
def test_joint_views_alone_are_enough(world: World, shots: tuple[DetectedShot, ...]) -> None:
    found = calibrated(world, [shot for shot in shots if shot.name.startswith("joint")])
    assert np.abs(normalised_errors(found, world.rig)).max() < 4.5
    assert found.quality.verdict != "insufficient"


@pytest.mark.slow
def test_equal_lenses_work_too() -> None:
    tele = camera(3000, (1500, 2000), (10, 5), (-0.2, 0.05, 0, 0))
    wide = camera(3020, (1500, 2000), (-8, 3), (-0.19, 0.04, 0, 0))
    shift = rigid_transform(rotation=np.zeros(3), translation=np.array([-0.06, 0, 0]))
    world = World(rig=StereoRig(tele, wide, shift))
    found = calibrated(world, world.shots(np.random.default_rng(2), joint=14, tele_close=0, wide_close=0))
    assert np.abs(normalised_errors(found, world.rig)).max() < 4.5
    assert found.rig.asymmetry == pytest.approx(world.rig.asymmetry, rel=2e-3)


@pytest.mark.slow
def test_unequal_photo_sizes_and_an_upright_wide_work() -> None:
    rig = replace(phone(), wide=camera(1100, (1600, 1200), (5, -9), (0.05, -0.1, 0, 0)))
    world = World(rig=rig)
    found = calibrated(world, world.shots(np.random.default_rng(3), joint=14, tele_close=4, wide_close=4))
    assert np.abs(normalised_errors(found, world.rig)).max() < 4.5
    assert found.rig.wide.hw == (1600, 1200)


def blurred(view: BoardView, rng: np.random.Generator) -> BoardView:
    return replace(view, points_px=view.points_px + 3 * rng.normal(size=view.points_px.shape))


def test_ruined_shots_are_named_and_do_no_harm(world: World) -> None:
    """A third is ruined: blurred, tele and wide exchanged, another board, a photo of another shot."""
    rng = np.random.default_rng(4)
    shots = list(world.shots(rng, joint=18, tele_close=0, wide_close=0))
    stretched = replace(world, board_m=world.board_m * (1.15, 1, 1))
    first, second = shots[0], shots[1]
    assert first.tele is not None
    assert second.wide is not None
    shots[0] = replace(first, tele=blurred(first.tele, rng))
    shots[1] = replace(second, wide=blurred(second.wide, rng))
    shots[2] = replace(shots[2], tele=shots[2].wide, wide=shots[2].tele)
    shots[3] = replace(shots[3], tele=shots[3].wide, wide=shots[3].tele)
    shots[4] = replace(stretched.shots(rng, joint=1, tele_close=0, wide_close=0)[0], name=shots[4].name)
    shots[5] = replace(shots[5], wide=shots[9].wide)
    found = calibrated(world, shots)
    assert left_out(found) == {f"joint{k:02d}" for k in range(6)}
    assert all(view.reason for view in found.views if not view.is_used)
    assert all(view.rms_px > 1 for view in found.views if "fit a board" in view.reason)
    assert np.abs(normalised_errors(found, world.rig)).max() < 4.5
    assert check(found, "photos left out").status == "warn"
    assert "joint00" in check(found, "photos left out").advice


def test_shots_paired_in_the_wrong_order_are_refused(world: World, shots: tuple[DetectedShot, ...]) -> None:
    joint = [shot for shot in shots if shot.name.startswith("joint")]
    wides = [shot.wide for shot in joint]
    wrong = [replace(shot, wide=wide) for shot, wide in zip(joint, wides[5:] + wides[:5], strict=True)]
    with pytest.raises(InputError, match="contradict"):
        calibrated(world, wrong)


def test_exchanged_lenses_are_refused(world: World, shots: tuple[DetectedShot, ...]) -> None:
    with pytest.raises(InputError, match="show more") as caught:
        calibrated(world, [replace(shot, tele=shot.wide, wide=shot.tele) for shot in shots])
    assert "exchanged" in str(caught.value.hint)


@pytest.mark.slow
def test_a_board_never_tilted_is_not_enough(world: World) -> None:
    flat = replace(world, tilt_deg=2.0)
    found = calibrated(flat, flat.shots(np.random.default_rng(7), joint=12, tele_close=3, wide_close=3))
    assert found.quality.verdict == "insufficient"
    assert check(found, "tele photos of a tilted board").status == "fail"
    assert (
        "tilt" in check(found, "tele photos of a tilted board").advice
        or "turned" in check(found, "tele photos of a tilted board").advice
    )


def test_few_small_and_crowded_views_are_told(world: World) -> None:
    rng = np.random.default_rng(8)
    far = replace(world, board_m=world.board_m / 10)  # squares of 4 mm
    found = calibrated(far, far.shots(rng, joint=6, tele_close=0, wide_close=0))
    for name in (
        "shots with the board in both photos",
        "tele photos used",
        "wide photos used",
        "size of a square in the wide photos",
        "tele coverage",
    ):
        assert check(found, name).status != "pass", name
        assert check(found, name).advice
    assert found.quality.verdict != "good"


def test_too_few_views_are_refused_with_what_to_do(world: World, shots: tuple[DetectedShot, ...]) -> None:
    with pytest.raises(InputError, match="2 usable tele photos") as caught:
        calibrated(world, [replace(shot, tele=shot.tele if k < 2 else None) for k, shot in enumerate(shots)])
    assert caught.value.hint
    alone = [shot for shot in shots if not shot.name.startswith("joint")]
    with pytest.raises(InputError, match="both the tele and the wide"):
        calibrated(world, alone)


@pytest.mark.slow
def test_a_photo_of_another_size_is_left_out_with_the_reason(world: World, shots: tuple[DetectedShot, ...]) -> None:
    tele = shots[0].tele
    assert tele is not None
    odd = replace(shots[0], tele=replace(tele, hw=(4000, 3000)))
    found = calibrated(world, [odd, *shots[1:]])
    view = next(each for each in found.views if each.shot == odd.name and each.camera == "tele")
    assert not view.is_used
    assert "the photo is turned: 3000 x 4000" in view.reason
    assert next(each for each in found.views if each.shot == odd.name and each.camera == "wide").is_used


@pytest.mark.slow
def test_stated_deviations_are_honest(world: World) -> None:
    """Over a dozen seeds errors over stated deviations spread like a standard normal variable."""
    errors = np.stack(
        [
            normalised_errors(calibrated(world, world.shots(np.random.default_rng(100 + seed))), world.rig)
            for seed in range(12)
        ]
    )
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.4
    assert 0.88 <= np.mean(np.abs(errors) < 1.96) <= 1.0
