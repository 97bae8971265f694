"""Rectified geometry against ray-traced points: rows agree, disparities are closed form, everything goes back."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rigs import PLACES_OF_WIDE_M, in_wide, phone, points_in_view
from scipy import ndimage

from telewide.errors import InputError
from telewide.geometry.grids import dense_map
from telewide.geometry.rectification import rectified_geometry, rectifying_rotation, rig_at_sizes
from telewide.geometry.rig import rigid_transform

PLACES = sorted(PLACES_OF_WIDE_M)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("working_width_px", "doffs_px"), [(None, 0.0), (1280, 0.0), (900, -12.5)])
def test_points_come_to_one_row_at_the_disparity_of_their_depth(
    place: str, working_width_px: int | None, doffs_px: float, rng: np.random.Generator
) -> None:
    rig = phone(place)
    geometry = rectified_geometry(rig, working_width_px=working_width_px, doffs_px=doffs_px)
    points_m = points_in_view(rig, rng)
    ref_px = geometry.ref_from_tele(rig.tele.project(points_m))
    src_px = geometry.src_from_wide(rig.wide.project(in_wide(rig, points_m)))
    np.testing.assert_allclose(ref_px[:, 1], src_px[:, 1], atol=1e-6)
    z_rect_m = points_m @ geometry.rect_from_tele[2]
    expected_px = geometry.f_px * rig.baseline_m / z_rect_m - doffs_px
    np.testing.assert_allclose(ref_px[:, 0] - src_px[:, 0], expected_px, atol=1e-6)
    assert (ref_px[:, 0] - src_px[:, 0] + geometry.doffs_px).min() > 0
    assert geometry.doffs_px == pytest.approx(geometry.src_centre_px[0] - geometry.ref_centre_px[0])
    np.testing.assert_allclose(geometry.tele_depth_per_rectified_depth(ref_px), points_m[:, 2] / z_rect_m, rtol=1e-9)


@pytest.mark.parametrize("place", PLACES)
def test_points_go_there_and_back(place: str, rng: np.random.Generator) -> None:
    rig = phone(place)
    geometry = rectified_geometry(rig, working_width_px=1500)
    tele_px = rng.uniform(0, [4031, 3023], (300, 2))
    np.testing.assert_allclose(geometry.tele_from_ref(geometry.ref_from_tele(tele_px)), tele_px, atol=1e-5)
    wide_px = rig.wide.project(in_wide(rig, points_in_view(rig, rng)))
    np.testing.assert_allclose(geometry.wide_from_src(geometry.src_from_wide(wide_px)), wide_px, atol=1e-5)


@pytest.mark.parametrize("place", PLACES)
def test_tables_go_there_and_back_within_a_hundredth_of_a_pixel(place: str, rng: np.random.Generator) -> None:
    # What pictures and maps are resampled by, both ways, distortion included; the points are whole pixels of tele.
    rig = phone(place, shrink=4)
    geometry = rectified_geometry(rig)
    to_x, to_y = dense_map(geometry.ref_from_tele, hw=rig.tele.hw)
    rows, columns = rng.integers(0, rig.tele.hw[0], 500), rng.integers(0, rig.tele.hw[1], 500)
    there_px = np.column_stack([to_x[rows, columns], to_y[rows, columns]])
    back_x, back_y = dense_map(geometry.tele_from_ref, hw=geometry.hw)
    interior = np.all((there_px > 0) & (there_px < np.array(geometry.hw[::-1]) - 1), axis=1)
    at_y_x = there_px[interior].T[::-1]
    again_x, again_y = (ndimage.map_coordinates(table.astype(float), at_y_x, order=1) for table in (back_x, back_y))
    np.testing.assert_allclose(again_x, columns[interior], atol=0.01)
    np.testing.assert_allclose(again_y, rows[interior], atol=0.01)
    assert interior.mean() > 0.95


@pytest.mark.parametrize("place", PLACES)
def test_rotation_is_orthogonal_and_the_smallest(place: str) -> None:
    rect_from_tele = rectifying_rotation(phone(place))
    wide_m = np.array(PLACES_OF_WIDE_M[place])
    np.testing.assert_allclose(rect_from_tele @ rect_from_tele.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rect_from_tele @ wide_m, [np.linalg.norm(wide_m), 0, 0], atol=1e-12)
    is_vertical, is_reversed = place.startswith("vertical"), place.endswith("reversed")
    assert (np.linalg.det(rect_from_tele) < 0) == is_reversed
    upright = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) if is_vertical else np.eye(3)
    if not is_reversed:  # a mirror has no angle
        cosine = (np.trace(rect_from_tele @ upright.T) - 1) / 2
        assert cosine == pytest.approx(np.abs(upright @ wide_m)[0] / np.linalg.norm(wide_m), abs=1e-12)


def test_a_perfect_rig_keeps_the_tele_photo_as_it_is() -> None:
    rig = phone(is_distorted=False)
    square = np.array([[9000.0, 0, 2050], [0, 9000, 1500], [0, 0, 1]])
    rig = replace(
        rig,
        tele=replace(rig.tele, K=square),
        wide_from_tele=rigid_transform(rotation=np.eye(3), translation=np.array([-0.012, 0, 0])),
    )
    geometry = rectified_geometry(rig, disparity_margin_px=100)
    assert geometry.hw == (3024, 4032 + 100)
    points_px = np.array([[0.0, 0.0], [4031.0, 3023.0], [17.5, 33.25]])
    np.testing.assert_allclose(geometry.ref_from_tele(points_px), points_px + np.array([100, 0]), atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("working_width_px", [None, 1280, 1281, 1295, 640])
def test_the_whole_tele_photo_and_its_partners_are_on_the_canvas(
    place: str, working_width_px: int | None, rng: np.random.Generator
) -> None:
    rig = phone(place)
    geometry = rectified_geometry(rig, working_width_px=working_width_px)
    height, width = geometry.hw
    assert working_width_px in {None, width}
    tele_px = np.array([[x, y] for x in (0, 1000, 4031) for y in (0, 1500, 3023)], dtype=float)
    ref_px = geometry.ref_from_tele(tele_px)
    assert ref_px[:, 0].min() >= geometry.margin_px - 0.5
    assert ref_px.min() >= -0.5
    assert (ref_px - [width - 0.5, height - 0.5]).max() <= 0
    points_m = points_in_view(rig, rng)
    points_m *= np.maximum(1, geometry.f_px * rig.baseline_m / geometry.margin_px / points_m[:, 2:])
    src_px = geometry.src_from_wide(rig.wide.project(in_wide(rig, points_m)))
    assert src_px[:, 0].min() >= -1.5  # z is that of tele here, not the rectified one
    assert src_px[:, 0].max() <= width - 0.5


def test_rectified_focal_length_is_teles_unlike_opencvs() -> None:
    rig = phone(is_distorted=False)
    assert rectified_geometry(rig).f_px == pytest.approx(rig.tele.f_px)
    r, t, none = rig.wide_from_tele[:3, :3], rig.wide_from_tele[:3, 3:], np.zeros(5)
    _, _, projection, *_ = cv2.stereoRectify(rig.tele.K, none, rig.wide.K, none, rig.tele.hw[::-1], r, t)
    assert projection[0, 0] < 0.8 * rig.tele.f_px


def test_wide_pixels_before_rectifying_do_not_matter(rng: np.random.Generator) -> None:
    # The same rig with a wide photo of half the size: the same points of the world come to the same place.
    rig = phone("vertical")
    half = replace(rig, wide=rig.wide.resized((1224, 1632)))
    points_m = points_in_view(rig, rng)
    one, other = (
        rectified_geometry(each).src_from_wide(each.wide.project(in_wide(each, points_m))) for each in (rig, half)
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_photos_of_another_size_and_shape() -> None:
    rig = phone()
    halved = rig_at_sizes(rig, tele_hw=(1512, 2016), wide_hw=(2448, 3264))
    assert halved.tele.f_px == pytest.approx(rig.tele.f_px / 2)
    assert halved.wide is rig.wide
    assert rig_at_sizes(rig, tele_hw=(1008, 1344), wide_hw=(817, 1089)).wide.hw == (817, 1089)
    with pytest.raises(InputError, match="wide photo is 3264 x 1836"):
        rig_at_sizes(rig, tele_hw=(3024, 4032), wide_hw=(1836, 3264))


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_photos_in_portrait_and_a_rig_in_landscape(scale: float) -> None:
    """The sizes are exchanged, the names of who is turned are right, and the way out is named."""
    rig = phone()
    upright = {"tele": (4032, 3024), "wide": (3264, 2448)}
    tele_hw, wide_hw = (tuple(int(scale * side) for side in upright[name]) for name in ("tele", "wide"))
    with pytest.raises(InputError, match="both photos are turned by 90 degrees against the calibration") as both:
        rig_at_sizes(rig, tele_hw=tele_hw, wide_hw=wide_hw)
    assert f"{tele_hw[1]} x {tele_hw[0]} px" in both.value.message
    assert "4032 x 3024 px" in both.value.message
    assert "hold the phone as for the photos the rig was made from" in (both.value.hint or "")
    with pytest.raises(InputError, match="the wide photo is turned by 90 degrees against the tele photo") as one:
        rig_at_sizes(rig, tele_hw=rig.tele.hw, wide_hw=wide_hw)
    assert "turn wide back" in (one.value.hint or "")
    with pytest.raises(InputError, match="the tele photo is turned by 90 degrees against the wide photo"):
        rig_at_sizes(rig, tele_hw=tele_hw, wide_hw=rig.wide.hw)


@pytest.mark.parametrize(
    ("rotation", "place_m", "message"),
    [
        ((0, 0, 0), (0, 0, 0), "no baseline"),
        ((0, 0, 0), (0.001, 0, 0.02), "out of the picture plane"),
        ((0, 2.0, 0), (0.012, 0, 0), "do not both face"),
    ],
)
def test_rigs_that_cannot_be_rectified_are_refused(
    rotation: tuple[float, ...], place_m: tuple[float, ...], message: str
) -> None:
    turned = rigid_transform(rotation=np.array(rotation, dtype=float), translation=np.zeros(3))
    turned[:3, 3] = -turned[:3, :3] @ np.array(place_m)
    with pytest.raises(InputError, match=message):
        rectified_geometry(replace(phone(), wide_from_tele=turned))


def test_a_working_width_needs_room_for_its_margin() -> None:
    with pytest.raises(ValueError, match="no room"):
        rectified_geometry(phone(), working_width_px=100, disparity_margin_px=100)


def test_a_rig_whose_views_would_not_fit_into_memory_is_refused() -> None:
    rig = phone()
    squeezed = rig.tele.K.copy()
    squeezed[0, 0] *= 100
    with pytest.raises(InputError, match="rectified views of this rig would have"):
        rectified_geometry(replace(rig, tele=replace(rig.tele, K=squeezed)))
