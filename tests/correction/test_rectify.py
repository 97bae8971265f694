"""Rectified pictures against a world that is known everywhere: a plane with an analytic texture, seen twice."""

from __future__ import annotations

import functools
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs import PLACES_OF_WIDE_M, phone

from telewide.correction.rectify import Rectification, rectify_pair
from telewide.errors import InputError
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera, StereoRig

PLANE_NORMAL = np.array([0.15, -0.1, 1.0])  # of tele's frame: PLANE_NORMAL . p = 1.2 m
PLANE_M = 1.2
SHRINK = 20.0


def pixels(hw: tuple[int, int]) -> FloatArray:
    columns, rows = np.meshgrid(np.arange(hw[1]), np.arange(hw[0]))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)


def texture(points_m: FloatArray) -> FloatArray:
    """Three colours of smooth waves, 20 px of tele and longer."""
    period_m = 20 * PLANE_M / (9000 / SHRINK)
    x, y = (2 * np.pi * points_m[:, axis] / period_m for axis in (0, 1))
    return np.column_stack(
        [
            0.5 + 0.2 * np.sin(0.6 * x + 0.5 * y) + 0.2 * np.sin(0.13 * x),
            0.5 + 0.4 * np.sin(0.9 * x),
            0.5 + 0.4 * np.cos(0.8 * y),
        ]
    )


def on_plane(rays: FloatArray, *, origin_m: FloatArray) -> FloatArray:
    """Where rays of tele's frame meet the plane."""
    return origin_m + rays * ((PLANE_M - PLANE_NORMAL @ origin_m) / (rays @ PLANE_NORMAL))[:, None]


def photo_of(camera: Camera, *, camera_from_tele: FloatArray) -> NDArray[np.float32]:
    rays = np.column_stack([camera.normalised(pixels(camera.hw)), np.ones(camera.hw[0] * camera.hw[1])])
    rotation = camera_from_tele[:3, :3]
    points_m = on_plane(rays @ rotation, origin_m=-rotation.T @ camera_from_tele[:3, 3])
    return texture(points_m).reshape(*camera.hw, 3).astype(np.float32)


@functools.cache
def plane_photos(place: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return photos(phone(place, shrink=SHRINK))


def photos(rig: StereoRig) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return photo_of(rig.tele, camera_from_tele=np.eye(4)), photo_of(rig.wide, camera_from_tele=rig.wide_from_tele)


def seen_in(made: Rectification, *, is_src: bool) -> tuple[FloatArray, FloatArray]:
    """What a rectified view should show (H, W, 3), and the rectified depth there (H, W)."""
    geometry = made.geometry
    centre_px = geometry.src_centre_px if is_src else geometry.ref_centre_px
    rays = np.column_stack(
        [(pixels(geometry.hw) - centre_px) / geometry.f_px, np.ones(geometry.hw[0] * geometry.hw[1])]
    )
    origin_m = geometry.rect_from_tele.T @ np.array([geometry.rig.baseline_m if is_src else 0.0, 0.0, 0.0])
    points_m = on_plane(rays @ geometry.rect_from_tele, origin_m=origin_m)
    z_m = points_m @ geometry.rect_from_tele[2]
    return texture(points_m).reshape(*geometry.hw, 3), z_m.reshape(geometry.hw)


@pytest.mark.parametrize("working_width_px", [None, 110])
@pytest.mark.parametrize("place", sorted(PLACES_OF_WIDE_M))
def test_both_views_show_the_plane_where_it_is(place: str, working_width_px: int | None) -> None:
    rig = phone(place, shrink=SHRINK)
    made = rectify_pair(*plane_photos(place), rig=rig, name="plane", working_width_px=working_width_px)
    for view, valid, is_src in (
        (made.pair.tele, made.pair.valid.ref, False),
        (made.pair.wide, made.pair.valid.src, True),
    ):
        assert view.dtype == np.float32
        assert view.shape == (*made.geometry.hw, 3)
        assert valid.shape == made.geometry.hw
        assert np.isfinite(view).all()
        expected, _ = seen_in(made, is_src=is_src)
        inside = valid & shifted(valid, 3)
        # Half the size leaves waves of 8 px, of which the antialiasing takes some contrast.
        tolerance = 0.02 if working_width_px is None else 0.06
        np.testing.assert_allclose(view[inside], expected[inside], atol=tolerance)


def shifted(valid: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    """Pixels whose surroundings are valid too."""
    rows_ok = np.logical_and.reduce([np.roll(valid, s, axis=0) for s in range(-reach_px, reach_px + 1)])
    return np.logical_and.reduce([np.roll(rows_ok, s, axis=1) for s in range(-reach_px, reach_px + 1)])


@pytest.mark.parametrize("place", sorted(PLACES_OF_WIDE_M))
def test_the_views_match_at_the_known_disparity(place: str) -> None:
    rig = phone(place, shrink=SHRINK)
    made = rectify_pair(*plane_photos(place), rig=rig, disparity_margin_px=16, doffs_px=2.0)
    _, z_m = seen_in(made, is_src=False)
    assert made.baseline_m is not None
    disparity_px = made.f_px * made.baseline_m / z_m - made.doffs_px
    columns = np.arange(made.geometry.hw[1])
    errors, shares = {}, {}
    for shift_px in (-1.0, 0.0, 1.0):
        at_px = columns - disparity_px - shift_px
        matched = np.stack(
            [
                np.stack([np.interp(at, columns, line) for at, line in zip(at_px, channel, strict=True)])
                for channel in np.moveaxis(made.pair.wide, 2, 0)
            ],
            axis=-1,
        )
        both = shifted(made.pair.valid.ref, 3) & (at_px > 3) & (at_px < columns[-1] - 3)
        errors[shift_px] = np.abs(matched - made.pair.tele)[both].mean()
        shares[shift_px] = both.sum() / made.pair.valid.ref.sum()
    assert errors[0.0] < 0.01
    assert min(errors[-1.0], errors[1.0]) > 5 * errors[0.0]
    assert shares[0.0] > 0.9


def test_no_border_of_tele_is_lost() -> None:
    rig = phone("horizontal", shrink=SHRINK)
    made = rectify_pair(*plane_photos("horizontal"), rig=rig)
    # Every tele pixel of the plane has its partner on the canvas, and wide sees it.
    _, z_m = seen_in(made, is_src=False)
    partner = np.round(np.arange(made.geometry.hw[1]) - made.f_px * rig.baseline_m / z_m).astype(int)
    rows = np.broadcast_to(np.arange(made.geometry.hw[0])[:, None], partner.shape)
    assert partner[made.pair.valid.ref].min() >= 0
    assert made.pair.valid.src[rows[made.pair.valid.ref], partner[made.pair.valid.ref]].all()
    assert not made.pair.valid.ref[:, : made.geometry.margin_px - 1].any()


def test_a_photo_that_ends_is_marked_and_continued() -> None:
    rig = phone("horizontal", shrink=SHRINK)
    tele, wide = plane_photos("horizontal")
    # Of wide only the upper half was kept, and its camera knows.
    half = replace(rig, wide=replace(rig.wide, hw=(60, 163)))
    made = rectify_pair(tele, wide[:60], rig=half)
    assert 0.3 < made.pair.valid.src.mean() < 0.7
    assert np.isfinite(made.pair.wide).all()
    expected, _ = seen_in(made, is_src=True)
    inside = shifted(made.pair.valid.src, 6)
    np.testing.assert_allclose(made.pair.wide[inside], expected[inside], atol=0.04)


def test_without_a_known_scale_there_is_no_baseline() -> None:
    rig = replace(phone("horizontal", shrink=SHRINK), is_scale_known=False)
    assert rectify_pair(*plane_photos("horizontal"), rig=rig).baseline_m is None


def test_turned_photos_are_refused() -> None:
    rig = phone("horizontal", shrink=SHRINK)
    tele, wide = plane_photos("horizontal")
    with pytest.raises(InputError, match=r"turned by 90 degrees against the calibration: .* made with 202 x 151"):
        rectify_pair(np.rot90(tele), np.rot90(wide), rig=rig)


def test_photos_resized_since_the_calibration_are_rectified_alike() -> None:
    rig = phone("vertical", shrink=SHRINK)
    full = replace(rig, tele=rig.tele.resized((302, 404)), wide=rig.wide.resized((244, 326)))
    made, expected = (rectify_pair(*plane_photos("vertical"), rig=each) for each in (full, rig))
    np.testing.assert_allclose(made.pair.wide, expected.pair.wide, atol=1e-3)
    assert made.f_px == pytest.approx(expected.f_px)


@pytest.mark.slow
def test_a_pair_of_12_megapixels_takes_seconds(rng: np.random.Generator) -> None:
    rig = phone("vertical")
    tele, wide = rng.random((*rig.tele.hw, 3), np.float32), rng.random((*rig.wide.hw, 3), np.float32)
    rectify_pair(tele, wide, rig=rig)
    begun_s = time.process_time()
    rectify_pair(tele, wide, rig=rig)
    assert time.process_time() - begun_s < 5  # of all threads; 1.4 s measured
