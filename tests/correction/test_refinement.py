"""What moved in a shot, against simulated points of rigs that turned, tilted or refocused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from rig_worlds import measured, phone_rig, seen_points, wide_centre

from telewide.capture.images import read_image
from telewide.correction.refinement import ShotRefinement, fit_shot, refined_rig
from telewide.correction.rows import fit_vertical
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.points.epipolar import epipolar_misfit_px, moved_rig, vertical_misfit_px
from telewide.points.matches import Matches, find_matches, split_matches
from telewide.points.photo_matches import find_photo_matches


def left_px(exact: Matches, rig: StereoRig) -> np.ndarray:
    return np.abs(vertical_misfit_px(exact.ref_px, exact.src_px, rig=rig))


@pytest.mark.parametrize("is_vertical", [False, True])
def test_a_rig_fits_the_points_it_sees(rng: np.random.Generator, is_vertical: bool) -> None:
    rig = phone_rig(is_vertical=is_vertical)
    assert left_px(seen_points(rig, rng), rig).max() < 1e-5


def test_no_refinement_is_the_rig_itself() -> None:
    rig = phone_rig()
    same = refined_rig(rig, ShotRefinement())
    np.testing.assert_allclose(same.wide_from_tele, rig.wide_from_tele, atol=1e-15)
    np.testing.assert_array_equal(same.wide.K, rig.wide.K)
    assert same.is_scale_known


@pytest.mark.parametrize("is_vertical", [False, True])
def test_offset_is_what_the_points_lie_apart_across_the_baseline(rng: np.random.Generator, is_vertical: bool) -> None:
    rig = phone_rig(is_vertical=is_vertical, has_distortion=False)
    seen = seen_points(refined_rig(rig, ShotRefinement(vertical_offset_px=3.0)), rng)
    misfit_px = vertical_misfit_px(seen.ref_px, seen.src_px, rig=rig)
    np.testing.assert_allclose(misfit_px, 3.0, atol=0.15)


def test_a_turn_moves_no_lens_and_a_tilt_not_the_middle() -> None:
    rig = phone_rig()
    moved = moved_rig(rig, rotation_vector=np.array([0.01, -0.02, 0.03]), tilt_rad=np.array([0.02, 0.01]))
    centres = [-r.wide_from_tele[:3, :3].T @ r.wide_from_tele[:3, 3] for r in (rig, moved)]
    np.testing.assert_allclose(centres[0], centres[1], atol=1e-15)
    tilted = moved_rig(rig, tilt_rad=np.array([0.02, 0.01]))
    forward = np.linalg.inv(rig.wide_from_tele[:3, :3])[:, 2]
    at_px = tilted.wide.project((tilted.wide_from_tele[:3, :3] @ forward)[None])
    np.testing.assert_allclose(at_px[0], rig.wide.K[:2, 2], atol=0.02)


def test_epipolar_misfit_is_the_vertical_one_for_a_baseline_across(rng: np.random.Generator) -> None:
    rig = phone_rig()
    seen = seen_points(moved_rig(rig, offset_px=2.0), rng)
    rays = rig.tele.normalised(seen.ref_px), rig.wide.normalised(seen.src_px)
    misfit_px = epipolar_misfit_px(*rays, wide_from_tele=rig.wide_from_tele, f_px=rig.tele.f_px)
    np.testing.assert_allclose(np.abs(misfit_px), np.abs(left_px(seen, rig)), rtol=0.06)


def test_what_a_shot_moved_is_recovered_within_its_deviations() -> None:
    deviations = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rig = phone_rig(is_vertical=seed % 2 == 1)
        offset_px, roll_rad, scale = rng.normal(0, 10), rng.normal(0, 0.003), 1 + rng.uniform(-0.005, 0.005)
        truth = moved_rig(rig, offset_px=offset_px, scale=scale, rotation_vector=np.array([0, 0, roll_rad]))
        exact = seen_points(truth, rng)
        found = fit_shot(measured(exact, rng), rig=rig)
        assert found.is_fitted
        assert found.is_at_once
        assert not found.notes
        assert found.residual_after_px < 0.5 < found.residual_before_px
        assert np.median(left_px(exact, refined_rig(rig, found))) < 0.1
        deviations += [
            (found.vertical_offset_px - offset_px) / found.vertical_offset_std_px,
            (found.rotation_vector[2] - roll_rad) / found.rotation_std_rad[2],
            (found.scale - scale) / found.scale_std,
        ]
    # 24 numbers of unit variance, were the deviations right: their root mean square is within 0.6 and 1.5
    assert 0.6 < np.sqrt(np.mean(np.square(deviations))) < 1.5
    assert np.abs(deviations).max() < 4


def test_a_shot_in_which_nothing_moved_is_left_alone(rng: np.random.Generator) -> None:
    rig = phone_rig()
    exact = seen_points(rig, rng)
    found = fit_shot(measured(exact, rng), rig=rig)
    assert abs(found.vertical_offset_px) < 4 * found.vertical_offset_std_px < 0.5
    assert found.residual_after_px < 1.1 * found.residual_before_px
    assert left_px(exact, refined_rig(rig, found)).max() < 0.3


def test_a_tilted_lens_is_fitted_only_where_it_shows(rng: np.random.Generator) -> None:
    rig = phone_rig()
    exact = seen_points(moved_rig(rig, tilt_rad=np.array([0.0, 0.03])), rng)
    found = fit_shot(measured(exact, rng), rig=rig)
    assert abs(found.tilt_rad[1] - 0.03) < 4 * found.tilt_std_rad[1]
    assert np.median(left_px(exact, refined_rig(rig, found))) < 0.1
    assert fit_shot(measured(seen_points(rig, rng), rng), rig=rig).tilt_rad == (0.0, 0.0)


def test_too_few_matches_keep_the_rig_and_say_so(rng: np.random.Generator) -> None:
    rig = phone_rig()
    few = seen_points(rig, rng, n=12)
    kept = fit_shot(few, rig=rig)
    assert not kept.is_fitted
    assert "the rig is kept" in kept.notes[0]
    np.testing.assert_allclose(refined_rig(rig, kept).wide_from_tele, rig.wide_from_tele, atol=1e-15)
    wrong = Matches(rng.uniform(0, 1100, (60, 2)), rng.uniform(0, 1100, (60, 2)))
    assert not fit_shot(wrong, rig=rig).is_fitted


def test_shots_apart_in_time_have_no_scale(rng: np.random.Generator) -> None:
    rig = phone_rig()
    late = fit_shot(measured(seen_points(rig, rng), rng), rig=rig, seconds_between=2.0)
    assert not late.is_at_once
    assert "relative" in late.notes[0]
    assert not refined_rig(rig, late).is_scale_known
    assert fit_shot(measured(seen_points(rig, rng), rng), rig=rig, seconds_between=0.02).is_at_once


def test_what_a_correction_leaves_is_told_with_what_was_expected_and_what_to_do(rng: np.random.Generator) -> None:
    rig = phone_rig()
    left = fit_shot(measured(seen_points(rig, rng), rng, noise_px=1.0), rig=rig)
    assert left.is_fitted
    assert left.is_at_once
    for words in (f"{left.residual_after_px:.2f} px off", "at most 0.50 px", "take them again", "calibrate again"):
        assert words in left.notes[0]


def test_large_photos_keep_their_scale_where_small_ones_do(rng: np.random.Generator) -> None:
    for width_px in (1600, 4000):
        rig = phone_rig(width_px=width_px)
        elsewhere = moved_rig(rig, wide_centre=wide_centre(rig) + np.array([0, 0, 0.2]))
        unit_px = width_px / 1600
        found = fit_shot(measured(seen_points(elsewhere, rng), rng, noise_px=0.1 * unit_px), rig=rig)
        assert 0.3 < found.residual_after_px / unit_px < 0.5
        assert found.is_at_once


def test_the_same_seed_gives_the_same_fit(rng: np.random.Generator) -> None:
    rig = phone_rig()
    matches = measured(seen_points(rig, rng), rng)
    first, second = (dataclasses.asdict(fit_shot(matches, rig=rig, seed=3)) for _ in range(2))
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name])


def plain_rig(hw: tuple[int, int], *, f_px: float = 3000.0) -> StereoRig:
    camera = Camera(hw, np.array([[f_px, 0, (hw[1] - 1) / 2], [0, f_px, (hw[0] - 1) / 2], [0, 0, 1]]), np.zeros(0))
    return StereoRig(camera, camera, rigid_transform(rotation=np.eye(3), translation=np.array([-0.012, 0, 0])))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["00", "05", "14", "25"])
def test_rectified_photos_gain_as_by_the_vertical_fit(data_root: Path, name: str) -> None:
    tele, wide = (read_image(data_root / "p30" / name / f"{view}.png") for view in ("tele", "wide"))
    rig = plain_rig(tele.shape[:2])
    shot = fit_shot(find_photo_matches(tele, wide, rig=rig), rig=rig)
    assert shot.is_at_once
    to_fit, held_out = split_matches(find_matches(tele, wide))
    fit = fit_vertical(to_fit, hw=tele.shape[:2])
    by_rows = held_out.vertical_px - fit.misfit_px(held_out.src_px[:, 0], held_out.ref_px[:, 1])
    by_shot = vertical_misfit_px(held_out.ref_px, held_out.src_px, rig=refined_rig(rig, shot))
    assert np.median(np.abs(by_shot)) < 1.05 * np.median(np.abs(by_rows)) + 0.01
    assert np.median(np.abs(by_shot)) < 0.6 * np.median(np.abs(held_out.vertical_px))
    slope = np.polyfit(held_out.ref_px[:, 1], by_shot, 1)[0]
    assert abs(slope) < 0.0005


@pytest.mark.slow
def test_a_phones_photos_of_two_lenses_are_registered(data_root: Path) -> None:
    folder = data_root / "phone_tele_wide_exif"
    tele, wide = (
        cv2.resize(read_image(folder / f"IMG_20_{view}.jpg"), (2016, 1512), interpolation=cv2.INTER_AREA)
        for view in ("tele", "wide")
    )
    diagonal_px = float(np.hypot(2016, 1512))
    tele_f, wide_f = (mm / np.hypot(36, 24) * diagonal_px for mm in (52, 26))
    base = plain_rig((1512, 2016))
    lenses = [
        dataclasses.replace(base.tele, K=np.array([[f, 0, 1007.5], [0, f, 755.5], [0, 0, 1]])) for f in (tele_f, wide_f)
    ]
    rig = dataclasses.replace(base, tele=lenses[0], wide=lenses[1])
    matches = find_photo_matches(tele, wide, rig=rig)
    assert len(matches) > 150
    shot = fit_shot(matches, rig=rig)
    assert shot.is_fitted
    # EXIF says 2.0, the matches of the photos 1.956
    assert refined_rig(rig, shot).asymmetry == pytest.approx(1.956, rel=0.01)
    assert shot.residual_after_px < 0.5 * shot.residual_before_px
