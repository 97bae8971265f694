"""Windows of disparities: what a picture can show of them, and what matches tell."""

from __future__ import annotations

import pytest

from telewide.errors import InputError
from telewide.matching.window import Window, check_window, measured_window, scaled_window, within_width


@pytest.mark.parametrize(
    ("window", "width_px", "expected"),
    [
        ((-8, 64), 128, (-8, 64)),
        ((0, 4096), 128, (0, 128)),
        ((-2048, 2048), 97, (-100, 100)),
        ((-4096, -96), 97, (-100, -96)),
    ],
)
def test_no_disparity_is_searched_beyond_the_picture(window: Window, width_px: int, expected: Window) -> None:
    assert within_width(window, width_px) == expected


def test_a_window_that_lies_beyond_the_picture_is_refused() -> None:
    with pytest.raises(InputError, match="4096 to 8192 px are to be searched in pictures 128 px wide"):
        within_width((4096, 8192), 128)


@pytest.mark.parametrize("scale", [0.5, 1.25, 1.5, 1 / 3])
@pytest.mark.parametrize("window", [(0, 4), (-4, 20), (-12, -4), (4, 44), (8, 64)])
def test_a_window_at_another_size_holds_its_disparities_and_few_more(window: Window, scale: float) -> None:
    d_min, d_max = scaled_window(window, scale)
    assert d_min <= scale * window[0] < d_min + 4
    assert d_max - 4 < scale * window[1] <= d_max
    check_window((d_min, d_max))


def test_the_window_covers_every_pair_with_a_margin() -> None:
    low, high = measured_window([(18, 26), None, (11, 35)])
    assert low <= 11 - 4
    assert high >= 35 + 4
    assert low % 4 == high % 4 == 0


@pytest.mark.parametrize("centre_px", [-50.0, 0.0, 3.0])
def test_the_window_is_wide_enough_and_of_any_sign(centre_px: float) -> None:
    low, high = measured_window([(centre_px - 1, centre_px + 1)])
    assert low < centre_px < high
    assert high - low >= 32
    assert low % 4 == high % 4 == 0


def test_without_any_measured_pair_no_window_is_guessed() -> None:
    with pytest.raises(InputError, match="no pair has consistent matches enough"):
        measured_window([None, None, None])
