"""The sRGB curve against colour-science, its slope against differences."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from telewide.srgb import linear_from_srgb, srgb_from_linear, srgb_slope

with warnings.catch_warnings():  # that matplotlib is missing, which nothing here draws with
    warnings.simplefilter("ignore")
    from colour.models import eotf_inverse_sRGB, eotf_sRGB

LEVELS = np.linspace(0, 1, 256)


def test_the_curve_is_that_of_the_standard() -> None:
    np.testing.assert_allclose(linear_from_srgb(LEVELS), eotf_sRGB(LEVELS), atol=1e-7)
    np.testing.assert_allclose(srgb_from_linear(LEVELS), eotf_inverse_sRGB(LEVELS), atol=1e-7)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_there_and_back_is_where_it_began_above_white_too(dtype: type) -> None:
    values = np.linspace(0, 3, 300).astype(dtype)
    there = linear_from_srgb(values)
    assert there.dtype == dtype
    np.testing.assert_allclose(srgb_from_linear(there), values, atol=1e-5)


def test_the_slope_is_that_of_the_curve() -> None:
    linear = np.linspace(0.01, 1, 100)
    differences = (srgb_from_linear(linear + 1e-6) - srgb_from_linear(linear - 1e-6)) / 2e-6
    np.testing.assert_allclose(srgb_slope(linear), differences, rtol=1e-5)
