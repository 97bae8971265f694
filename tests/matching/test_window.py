"""Windows of disparities: what a picture can show of them."""

from __future__ import annotations

import pytest

from telewide.errors import InputError
from telewide.matching.window import Window, check_window, scaled_window, within_width


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
