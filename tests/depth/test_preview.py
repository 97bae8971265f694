"""Previews: colours say what the numbers say, scales are rounded and stand where they belong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from telewide.depth.preview import colourise, display_range_px, preview, scale_ticks
from telewide.depth.result import DepthResult
from telewide.drawing import fitted_text, hatched, number_labels, rounded_ticks, text_width_px, upright
from telewide.geometry.stereo import DisparityMap, depth_from_disparity


def ramp_result(*, low_px: float = 10.0, high_px: float = 30.0, hw: tuple[int, int] = (120, 160)) -> DepthResult:
    disparity_px = np.tile(np.linspace(low_px, high_px, hw[1], dtype=np.float32), (hw[0], 1))
    return DepthResult("ramp", DisparityMap(disparity_px, np.ones(hw, np.float32), np.ones(hw, np.bool_)))


def metric(result: DepthResult, *, f_px: float, baseline_m: float, doffs_px: float) -> DepthResult:
    depth_m = depth_from_disparity(result.disparity.disparity_px, f_px=f_px, baseline_m=baseline_m, doffs_px=doffs_px)
    return replace(result, K=np.diag([f_px, f_px, 1.0]), baseline_m=baseline_m, depth_m=depth_m, doffs_px=doffs_px)


def test_far_is_blue_near_is_red_unknown_is_grey() -> None:
    red, green, blue = 0, 1, 2
    colours = colourise(np.array([[10.0, 30.0, np.nan]], np.float32), range_px=(10, 30))
    assert colours[0, 0].argmax() == blue
    assert colours[0, 1].argmax() == red
    assert colours[0, 2, red] == colours[0, 2, green] == colours[0, 2, blue]


def test_values_beyond_the_range_take_its_end_colours() -> None:
    colours = colourise(np.array([[-50.0, 10.0, 30.0, 900.0]], np.float32), range_px=(10, 30))
    np.testing.assert_array_equal(colours[0, 0], colours[0, 1])
    np.testing.assert_array_equal(colours[0, 2], colours[0, 3])


def test_colours_do_not_change_when_all_disparities_shift(rng: np.random.Generator) -> None:
    disparity_px = rng.uniform(0, 64, (30, 40)).astype(np.float32)
    np.testing.assert_allclose(colourise(disparity_px), colourise(disparity_px - 40), atol=0.05)


def test_a_few_outliers_do_not_set_the_range() -> None:
    disparity_px = np.tile(np.linspace(10, 30, 200, dtype=np.float32), (50, 1))
    disparity_px[0, :40] = 500
    low_px, high_px = display_range_px(disparity_px)
    assert 10 <= low_px < 11
    assert 29 < high_px <= 30


def test_filled_values_do_not_set_the_range() -> None:
    disparity_px = np.tile(np.linspace(10, 30, 200, dtype=np.float32), (50, 1))
    disparity_px[:, :80] = 90
    valid = disparity_px < 90
    assert display_range_px(disparity_px, valid=valid)[1] <= 30


@pytest.mark.parametrize("value", [np.nan, 7.0])
def test_flat_or_unknown_maps_have_a_range(value: float) -> None:
    low_px, high_px = display_range_px(np.full((8, 8), value, np.float32))
    assert high_px - low_px >= 2


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 17.9), (1234.5, 1236.0), (0.0021, 0.0072), (-40.0, -7.0)])
def test_ticks_are_rounded_and_inside(low: float, high: float) -> None:
    ticks = rounded_ticks(low, high, n_wanted=5)
    assert 3 <= len(ticks) <= 10
    assert low - 1e-9 <= ticks[0]
    assert ticks[-1] <= high + 1e-9
    step = ticks[1] - ticks[0]
    np.testing.assert_allclose(np.diff(ticks), step, rtol=1e-6)
    mantissa = step / 10 ** np.floor(np.log10(step) + 1e-6)
    assert min(abs(mantissa - nice) for nice in (1, 2, 5)) < 1e-3


@pytest.mark.parametrize(("low", "high"), [(3.0, 3.0), (5.0, 1.0), (np.nan, 1.0), (0.0, np.inf)])
def test_no_ticks_without_a_range(low: float, high: float) -> None:
    assert rounded_ticks(low, high) == []


def test_labels_tell_numbers_apart() -> None:
    assert number_labels([0.5, 1.0, 1.5]) == ["0.5", "1.0", "1.5"]
    assert number_labels([-20, 0, 20]) == ["-20", "0", "20"]


def test_pixel_marks_stand_at_their_disparity() -> None:
    result = ramp_result()
    low_px, high_px = display_range_px(result.disparity.disparity_px)
    unit, ticks = scale_ticks(result)
    assert unit == "px"
    assert len(ticks) >= 3
    for tick in ticks:
        assert low_px + tick.position * (high_px - low_px) == pytest.approx(float(tick.label))


@pytest.mark.parametrize("doffs_px", [0.0, 25.0, -8.0])
@pytest.mark.parametrize("low_px", [10.0, 28.0])
def test_metre_marks_stand_where_their_depth_is(doffs_px: float, low_px: float) -> None:
    result = metric(ramp_result(low_px=low_px), f_px=1500.0, baseline_m=0.012, doffs_px=doffs_px)
    low_px, high_px = display_range_px(result.disparity.disparity_px)
    unit, ticks = scale_ticks(result)
    assert unit == "m"
    assert len(ticks) >= 3
    for tick in ticks:
        shown_px = low_px + tick.position * (high_px - low_px)
        assert 1500.0 * 0.012 / (shown_px + doffs_px) == pytest.approx(float(tick.label), rel=1e-6)
        assert 0 <= tick.position <= 1


def test_metre_marks_bear_a_horizon_at_infinity() -> None:
    result = metric(ramp_result(low_px=-2.0, high_px=30.0), f_px=1500.0, baseline_m=0.012, doffs_px=0.0)
    unit, ticks = scale_ticks(result)
    assert unit == "m"
    assert len(ticks) >= 3
    assert all(0 <= tick.position <= 1 for tick in ticks)


@pytest.mark.parametrize("hw", [(48, 64), (640, 320), (320, 640), (60, 600)])
def test_preview_shows_photo_and_depth_whole(hw: tuple[int, int]) -> None:
    page = preview(np.full((*hw, 3), 0.5, np.float32), ramp_result(hw=hw))
    assert page.dtype == np.float32
    assert page.min() >= 0
    assert page.max() <= 1
    n_panels_wide = 1 if hw[1] >= 1.5 * hw[0] else 2
    assert page.shape[1] >= n_panels_wide * hw[1]
    is_photo = np.all(np.abs(page - 0.5) < 0.01, axis=2)
    assert is_photo.sum() >= hw[0] * hw[1]
    used = (page.shape[0] * page.shape[1]) / (2 * is_photo.sum())
    assert used < 2.2  # margins, caption and scale are small beside the two pictures


def test_preview_of_a_large_photo_is_bounded() -> None:
    hw = (900, 2600)
    assert max(preview(np.zeros((*hw, 3), np.float32), ramp_result(hw=hw)).shape) <= 1400


def test_preview_is_upright() -> None:
    turned = replace(ramp_result(hw=(160, 320)), rotated_deg=90)
    marker = np.zeros((160, 320, 3), np.float32)
    marker[:, :20] = (0.0, 1.0, 0.0)  # counter-clockwise turning brought the top edge to the left
    page = preview(marker, turned)
    is_marker = (page[..., 1] > 0.9) & (page[..., 0] < 0.1) & (page[..., 2] < 0.1)
    rows, _ = np.nonzero(is_marker)
    assert page.shape[0] > 320
    assert rows.mean() < page.shape[0] / 8


@pytest.mark.parametrize("rotated_deg", [0, 90, 180, 270])
def test_upright_undoes_a_counter_clockwise_turn(rng: np.random.Generator, rotated_deg: int) -> None:
    image = rng.random((5, 7, 3)).astype(np.float32)
    np.testing.assert_array_equal(upright(np.rot90(image, k=rotated_deg // 90), rotated_deg=rotated_deg), image)


def test_hatching_is_light_and_stays_inside_the_mask() -> None:
    image = np.full((64, 64, 3), 0.3, np.float32)
    mask = np.zeros((64, 64), np.bool_)
    mask[16:48, 16:48] = True
    result = hatched(image, mask)
    changed = np.any(result != image, axis=2)
    assert not changed[~mask].any()
    assert 0.1 < changed[mask].mean() < 0.4


@pytest.mark.parametrize("name", ["a", "holiday_2026_07_18_morning_at_the_lake_0001_burst", "", "Straße", "\u732b"])
def test_any_name_fits_its_place(name: str) -> None:
    shown = fitted_text(name, width_px=120, size_px=16)
    assert text_width_px(shown, size_px=16) <= 120
    assert shown[:1] == name[:1]


@pytest.mark.parametrize("hw", [(40, 1000), (1000, 40), (2000, 8), (8, 2000), (1, 1), (3, 900)])
def test_photos_of_any_shape_have_a_preview(hw: tuple[int, int]) -> None:
    page = preview(np.zeros((*hw, 3), np.float32), ramp_result(hw=hw))
    assert page.shape[0] > 100
    assert page.shape[1] > 100
    bar = page[-60:].reshape(-1, 3)
    assert np.ptp(bar, axis=0).max() > 0.5  # the scale is there
