"""The simulated camera: noise by the law of photons, colours that come back, clipping, the same photo for one seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from simulate.cards import HW, QUIET, chart, grey

from telewide.simulate.sensor import PATTERNS, Sensor, developed, expose, phone_sensor, vignetting_at
from telewide.srgb import linear_from_srgb


@pytest.mark.parametrize("is_wide", [False, True])
@pytest.mark.parametrize("level", [0.05, 0.18, 0.6])
def test_a_grey_card_comes_out_grey(rng: np.random.Generator, is_wide: bool, level: float) -> None:
    sensor = phone_sensor(rng, is_wide=is_wide)
    srgb = developed(expose(grey(level, (256, 256)), sensor, rng=rng))
    mean = linear_from_srgb(srgb[64:192, 64:192]).mean(axis=(0, 1))
    assert mean.max() / mean.min() < 1.01
    middle = linear_from_srgb(srgb[120:136, 120:136]).mean()
    assert middle == pytest.approx(level * sensor.exposure, rel=0.02)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_colours_come_back(rng: np.random.Generator, pattern: str) -> None:
    """Of a quiet camera without shading: the patches of a chart, times the exposure."""
    sensor = replace(phone_sensor(rng, is_wide=True), vignetting=0.0, pattern=pattern, **QUIET)
    scene = chart()
    linear = linear_from_srgb(developed(expose(scene, sensor, rng=rng)))
    for top in (0, 32):
        for left in (0, 40, 80):
            patch = (slice(top + 8, top + 24), slice(left + 8, left + 32))
            np.testing.assert_allclose(
                linear[patch].mean(axis=(0, 1)), sensor.exposure * scene[patch].mean(axis=(0, 1)), atol=0.002
            )


def test_a_wrong_idea_of_grey_tints(rng: np.random.Generator) -> None:
    right = replace(phone_sensor(rng, is_wide=True), vignetting=0.0, **QUIET)
    red, green, blue = right.neutral
    wrong = replace(right, neutral=(red * 1.1, green, blue))
    before, after = (
        linear_from_srgb(developed(expose(grey(0.2), sensor, rng=rng))).mean(axis=(0, 1)) for sensor in (right, wrong)
    )
    ratio = np.linalg.solve(right.srgb_from_balanced, after) / np.linalg.solve(right.srgb_from_balanced, before)
    np.testing.assert_allclose(ratio, [1 / 1.1, 1, 1], rtol=0.01)


@pytest.mark.parametrize("level", [0.0, 0.02, 0.3, 0.8])
def test_noise_is_of_photons_and_of_reading(rng: np.random.Generator, level: float) -> None:
    """Electrons have the variance of their mean, and reading adds its own; rounding to counts a twelfth."""
    sensor = Sensor(full_well_e=4000, read_noise_e=4, black_level=256, white_level=4095)
    bayer = expose(grey(level, (300, 300)), sensor, rng=rng).bayer
    e_per_count = sensor.full_well_e / (sensor.white_level - sensor.black_level)
    electrons = (bayer.astype(np.float64) - sensor.black_level) * e_per_count
    assert electrons.mean() == pytest.approx(level * sensor.full_well_e, rel=0.01, abs=0.1)
    expected = level * sensor.full_well_e + sensor.read_noise_e**2 + e_per_count**2 / 12
    assert electrons.var() == pytest.approx(expected, rel=0.03)


def test_light_clips_at_the_white_level_and_never_below_zero(rng: np.random.Generator) -> None:
    sensor = Sensor(read_noise_e=200)
    assert (expose(grey(3.0), sensor, rng=rng).bayer == sensor.white_level).all()
    dark = expose(grey(0.0), sensor, rng=rng).bayer
    assert dark.min() == 0
    assert dark.dtype == np.uint16
    np.testing.assert_allclose(developed(expose(grey(3.0), replace(sensor, exposure=0.9), rng=rng)), 1, atol=1e-4)


def test_one_seed_one_photo() -> None:
    def photo(seed: int) -> NDArray[np.uint16]:
        rng = np.random.default_rng(seed)
        return expose(chart(), phone_sensor(rng, is_wide=True), rng=rng).bayer

    np.testing.assert_array_equal(photo(1), photo(1))
    assert (photo(1) != photo(2)).any()


def test_corners_darken_by_the_fourth_power_of_the_cosine() -> None:
    sensor = Sensor(vignetting=0.4)
    rows, columns = np.arange(HW[0])[:, None], np.arange(HW[1])[None]
    passed = vignetting_at(sensor.vignetting, (rows, columns), hw=HW)
    assert passed[0, 0] == pytest.approx(0.6)
    radius = np.hypot(rows - (HW[0] - 1) / 2, columns - (HW[1] - 1) / 2)
    f_px = radius[0, 0] / np.tan(np.arccos(0.6**0.25))
    np.testing.assert_allclose(passed, np.cos(np.arctan(radius / f_px)) ** 4, rtol=1e-9)


def test_shading_is_undone_in_part(rng: np.random.Generator) -> None:
    sensor = Sensor(vignetting=0.4, **QUIET)
    linear = linear_from_srgb(developed(expose(grey(0.3), sensor, rng=rng)))
    assert linear[0, 0].mean() / linear[48, 64].mean() == pytest.approx(0.6**0.2, rel=0.01)


def test_the_lens_blurs_by_so_much(rng: np.random.Generator) -> None:
    """The variance of the blurred line is that of the lens."""
    light = grey(0.0)
    light[:, 64] = 0.9
    mosaic = expose(light, Sensor(blur_px=1.5, white_level=65535, black_level=0, **QUIET), rng=rng).bayer
    profile = mosaic[40].astype(np.float64)
    columns = np.arange(HW[1])
    assert (profile * columns).sum() / profile.sum() == pytest.approx(64, abs=0.02)
    assert (profile * (columns - 64) ** 2).sum() / profile.sum() == pytest.approx(1.5**2, rel=0.05)


def test_wide_is_brighter_and_darker_in_its_corners(rng: np.random.Generator) -> None:
    for _ in range(20):
        tele, wide = (phone_sensor(rng, is_wide=is_wide) for is_wide in (False, True))
        assert wide.exposure > tele.exposure
        assert wide.vignetting > tele.vignetting
        assert wide.full_well_e >= tele.full_well_e
        assert wide.colour_from_srgb != tele.colour_from_srgb


def test_what_is_no_sensor_is_refused() -> None:
    for wrong in ({"vignetting": 1.0}, {"blur_px": -1.0}, {"exposure": 0.0}, {"white_level": 64}, {"pattern": "RGBW"}):
        with pytest.raises(ValueError, match=next(iter(wrong)).split("_")[0]):
            Sensor(**wrong)
