"""Lamps that 8 bits clipped to white are bright again where they are blurred; white surfaces are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from telewide.bokeh.render import render_bokeh
from telewide.errors import UsageError
from telewide.srgb import linear_from_srgb, srgb_from_linear

LAMP_TIMES = 8.0
FAR = {"focus_disparity_px": 10.0, "radius_per_px": 1.0}  # a radius of 10 px


def lamp_at_night(*, radius_px: float, hw: tuple[int, int] = (160, 160)) -> np.ndarray:
    """Linear light of a lamp in the middle of the dark, seen by a lens as sharp as the pixels."""
    canvas = np.zeros((hw[0] * 8, hw[1] * 8), np.float32)
    cv2.circle(canvas, (hw[1] * 4, hw[0] * 4), round(radius_px * 8), 1.0, -1)
    lamp = cv2.resize(canvas, hw[::-1], interpolation=cv2.INTER_AREA)
    return np.repeat((0.01 + LAMP_TIMES * lamp)[..., None], 3, axis=2).astype(np.float32)


def in_8_bits(light: np.ndarray) -> np.ndarray:
    return np.round(np.clip(srgb_from_linear(light), 0, 1) * 255).astype(np.float32) / 255


def blurred(photo: np.ndarray, *, highlights: float) -> np.ndarray:
    return render_bokeh(photo, np.zeros(photo.shape[:2], np.float32), highlights=highlights, **FAR)


def test_a_clipped_lamp_is_as_bright_as_it_was() -> None:
    light = lamp_at_night(radius_px=3.0)
    photo = in_8_bits(light)
    truth = linear_from_srgb(blurred(srgb_from_linear(light), highlights=1))
    grey, recovered = (linear_from_srgb(blurred(photo, highlights=times)) for times in (1, LAMP_TIMES))
    middle = (slice(76, 84), slice(76, 84))
    assert grey[middle].mean() < 0.25 * truth[middle].mean()
    assert recovered[middle].mean() == pytest.approx(truth[middle].mean(), rel=0.3)


def test_white_surfaces_stay_as_they_are(rng: np.random.Generator) -> None:
    photo = rng.uniform(0, 0.9, (160, 160, 3)).astype(np.float32)
    photo[:60] = 1  # a clipped sky
    photo[100:104, 100:104] = 0.9  # bright, not clipped
    np.testing.assert_array_equal(blurred(photo, highlights=8), blurred(photo, highlights=1))


def test_what_was_recovered_before_stays() -> None:
    photo = srgb_from_linear(lamp_at_night(radius_px=3.0))
    whole = photo.max(axis=2) > 1
    photo[~whole] = 0.1
    np.testing.assert_array_equal(blurred(photo, highlights=8), blurred(photo, highlights=1))


@pytest.mark.parametrize("times", [0.5, -1.0, np.nan, np.inf, 1e6])
def test_factors_of_no_lamp_are_refused(times: float) -> None:
    with pytest.raises(UsageError, match="1 to 100"):
        blurred(np.ones((40, 40, 3), np.float32), highlights=times)
