"""Contact sheets: the warp obeys the sign of disparity, the difference sees errors and not exposure."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.pages.contact import ContactRow, contact_sheet, fetch_to_ref, strip, warped_difference

HW = (90, 140)


@pytest.fixture
def texture(rng: np.random.Generator) -> FloatMap:
    """Smooth noise, wider than a view by 40 px."""
    noise = rng.random((HW[0], HW[1] + 40, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip(0.5 + 3 * (smooth - 0.5), 0, 1).astype(np.float32)


def shifted_views(texture: FloatMap, *, disparity_px: int) -> tuple[FloatMap, FloatMap]:
    """Two views of a plane: a point at x in ref lies at x - d in src."""
    return texture[:, 20 : 20 + HW[1]], texture[:, 20 + disparity_px : 20 + disparity_px + HW[1]]


def row_of(texture: FloatMap, *, name: str = "a") -> ContactRow:
    tele, wide = shifted_views(texture, disparity_px=9)
    disparity = DisparityMap(np.full(HW, 9, np.float32), np.ones(HW, np.float32), np.ones(HW, np.bool_))
    return ContactRow(name, tele, wide, disparity)


@pytest.mark.parametrize("disparity_px", [-7, 0, 12])
def test_warp_brings_src_onto_ref(texture: FloatMap, disparity_px: int) -> None:
    ref, src = shifted_views(texture, disparity_px=disparity_px)
    warped = fetch_to_ref(src, np.full(HW, disparity_px, np.float32))
    x = np.arange(HW[1]) - disparity_px
    is_inside = (x >= 0) & (x <= HW[1] - 1)
    np.testing.assert_array_equal(warped[:, is_inside], ref[:, is_inside])
    assert np.isnan(warped[:, ~is_inside]).all()


def test_warp_agrees_with_opencv(texture: FloatMap, rng: np.random.Generator) -> None:
    src = texture[:, : HW[1]]
    disparity_px = cv2.GaussianBlur(rng.uniform(-30, 30, HW).astype(np.float32), (0, 0), 3)
    grid_x, grid_y = np.meshgrid(np.arange(HW[1], dtype=np.float32), np.arange(HW[0], dtype=np.float32))
    expected = cv2.remap(src, grid_x - disparity_px, grid_y, cv2.INTER_LINEAR)
    warped = fetch_to_ref(src, disparity_px)
    is_inside = np.isfinite(warped)
    assert is_inside.mean() > 0.8
    np.testing.assert_allclose(warped[is_inside], expected[is_inside], atol=0.01)  # OpenCV rounds to 1/32 px


def test_warp_leaves_out_what_is_unknown(texture: FloatMap) -> None:
    disparity_px = np.zeros(HW, np.float32)
    disparity_px[4:8, 5:9] = np.nan
    assert np.isnan(fetch_to_ref(texture[:, : HW[1]], disparity_px)[4:8, 5:9]).all()


def test_difference_is_blind_to_exposure_and_colour(texture: FloatMap) -> None:
    tele, wide = shifted_views(texture, disparity_px=9)
    duller = (0.7 * wide + np.array([0.05, 0.1, 0.0], np.float32)).astype(np.float32)
    difference = warped_difference(tele, duller, np.full(HW, 9, np.float32))
    inside = difference[:, 30:110]  # the blur reaches over the view's own border
    assert np.nanmax(inside) < 0.02


def test_difference_grows_with_the_error(texture: FloatMap) -> None:
    tele, wide = shifted_views(texture, disparity_px=9)
    means = [
        float(np.nanmean(warped_difference(tele, wide, np.full(HW, 9 + error_px, np.float32))))
        for error_px in (0, 1, 2, 4)
    ]
    assert means == sorted(means)
    assert means[-1] > 5 * means[0]


def test_difference_of_nothing_is_unknown(texture: FloatMap) -> None:
    tele, wide = shifted_views(texture, disparity_px=9)
    assert np.isnan(warped_difference(tele, wide, np.full(HW, np.nan, np.float32))).all()


@pytest.mark.parametrize("rotated_deg", [0, 90])
def test_sheet_is_bounded_and_grows_by_rows(texture: FloatMap, rotated_deg: int) -> None:
    row = replace(row_of(texture), rotated_deg=rotated_deg)
    sheets = [contact_sheet((row for _ in range(n)), title="all") for n in (1, 2, 7)]
    assert all(sheet.shape[1] <= 2400 for sheet in sheets)
    assert sheets[2].shape[0] > 2 * sheets[0].shape[0]
    assert all(sheet.min() >= 0 and sheet.max() <= 1 for sheet in sheets)


def test_sheet_bears_captures_of_unlike_shapes_and_empty_maps(texture: FloatMap) -> None:
    row = row_of(texture, name="a very long name of a capture that does not fit below its picture at all")
    unknown = DisparityMap(np.full(HW, np.nan, np.float32), np.zeros(HW, np.float32), np.zeros(HW, np.bool_))
    rows = [row, replace(row, rotated_deg=90), replace(row, disparity=unknown)]
    assert contact_sheet(rows, title="").shape[1] <= 2400


def test_sheet_needs_captures() -> None:
    with pytest.raises(ValueError, match="at least one capture"):
        contact_sheet([], title="none")


@pytest.mark.parametrize(("columns", "n_lines"), [(0, 1), (2, 2), (3, 2)])
def test_strip_has_the_width_asked_for(texture: FloatMap, columns: int, n_lines: int) -> None:
    image = texture[:, : HW[1]]
    page = strip([image] * 4, ["wide", "tele", "disparity", "bokeh"], width_px=1200, columns=columns)
    cell_width = 1200 / (columns or 4)
    assert page.shape[1] == 1200
    assert page.shape[0] == pytest.approx(n_lines * (cell_width * HW[0] / HW[1] + 30), rel=0.03)


def test_strip_needs_one_label_each(texture: FloatMap) -> None:
    with pytest.raises(ValueError, match="2 images and 1 labels"):
        strip([texture, texture], ["one"])
