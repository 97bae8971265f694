"""Tabulated mappings against asking for every pixel."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.geometry.arrays import FloatArray
from telewide.geometry.grids import dense_map


def all_pixels(hw: tuple[int, int]) -> FloatArray:
    columns, rows = np.meshgrid(np.arange(hw[1]), np.arange(hw[0]))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)


@pytest.mark.parametrize("bend", [0.0, 1e-5, 1e-4, 2e-2])
@pytest.mark.parametrize("hw", [(150, 211), (33, 64), (1, 7)])
def test_table_errs_by_less_than_allowed(hw: tuple[int, int], bend: float) -> None:
    def mapping(points_px: FloatArray) -> FloatArray:
        x, y = points_px.T
        return np.column_stack([0.3 * x + 40 + bend * (x - 80) * (x - y), y - 7 + bend * y**2])

    map_x, map_y = dense_map(mapping, hw=hw, max_error_px=0.01)
    exact = mapping(all_pixels(hw)).reshape(*hw, 2)
    np.testing.assert_allclose(map_x, exact[..., 0], atol=0.01 + 1e-4)
    np.testing.assert_allclose(map_y, exact[..., 1], atol=0.01 + 1e-4)
