"""Matches of photos of two unequal lenses, against the rendered plane they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.correction.refinement import fit_shot
from telewide.errors import InputError
from telewide.points.epipolar import moved_rig, vertical_misfit_px
from telewide.points.photo_matches import find_photo_matches


@pytest.mark.parametrize("is_vertical", [False, True])
def test_photos_of_unequal_lenses_are_matched_in_their_own_pixels(rng: np.random.Generator, is_vertical: bool) -> None:
    rig = phone_rig(is_vertical=is_vertical, width_px=640)
    tele, wide = photos_of_a_plane(rig, rng)
    matches = find_photo_matches(tele, wide, rig=rig)
    assert len(matches) > 150
    # a plane across tele's axis at 1.5 m
    points = np.column_stack([rig.tele.normalised(matches.ref_px), np.ones(len(matches))]) * 1.5
    expected_px = rig.wide.project(points @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3])
    error_px = np.linalg.norm(expected_px - matches.src_px, axis=1)
    assert np.median(error_px) < 0.1
    assert np.mean(error_px > 0.5) < 0.02


def test_photos_of_a_wide_that_rolled_are_matched_too(rng: np.random.Generator) -> None:
    rig = phone_rig(width_px=640)
    rolled = moved_rig(rig, rotation_vector=np.radians([0.0, 0.0, 12.0]))
    tele, wide = photos_of_a_plane(rolled, rng)
    matches = find_photo_matches(tele, wide, rig=rig)
    assert len(matches) > 100
    assert np.median(np.abs(vertical_misfit_px(matches.ref_px, matches.src_px, rig=rolled))) < 0.3


def test_what_moved_is_found_from_photos(rng: np.random.Generator) -> None:
    rig = phone_rig(width_px=640)
    tele, wide = photos_of_a_plane(moved_rig(rig, offset_px=4.0, scale=1.004), rng)
    shot = fit_shot(find_photo_matches(tele, wide, rig=rig), rig=rig)
    assert shot.vertical_offset_px == pytest.approx(4.0, abs=0.1)
    assert shot.scale == pytest.approx(1.004, abs=0.0005)
    assert shot.residual_after_px < 0.15


def test_photos_of_another_shape_are_refused(rng: np.random.Generator) -> None:
    rig = phone_rig(width_px=640)
    with pytest.raises(InputError, match="turned by 90 degrees against the wide photo and against the calibration"):
        find_photo_matches(np.zeros((640, 480, 3), np.float32), np.zeros((480, 640, 3), np.float32), rig=rig)


def test_photos_without_texture_have_no_matches() -> None:
    rig = phone_rig(width_px=640)
    blank = np.full((480, 640, 3), 0.5, np.float32)
    assert len(find_photo_matches(blank, blank, rig=rig)) == 0


@pytest.mark.parametrize("k1", [1e6, -1e6])
def test_a_rig_whose_distortion_cannot_be_undone_is_refused(k1: float) -> None:
    rig = phone_rig(width_px=640)
    strange = replace(rig, tele=replace(rig.tele, distortion=np.array([k1, 0, 0, 0, 0, 0, 0, 0])))
    photos = [np.zeros((*camera.hw, 3), np.float32) for camera in (rig.tele, rig.wide)]
    with pytest.raises(InputError, match="cannot be undone at the border"):
        find_photo_matches(*photos, rig=strange)
