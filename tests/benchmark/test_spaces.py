"""Spaces of features against closed forms and a plain loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from telewide.benchmark.spaces import match_features, space_psnr_db


def test_psnr_is_of_features_scaled_to_their_range(rng: np.random.Generator) -> None:
    sharp = rng.random((6, 7, 4), dtype=np.float32)
    sharp.flat[:2] = (0, 1)
    damaged = sharp + np.float32(0.1)
    assert space_psnr_db(sharp, damaged) == pytest.approx(20, abs=1e-3)
    assert space_psnr_db(50 * sharp - 7, 50 * damaged - 7) == pytest.approx(20, abs=1e-3)
    assert space_psnr_db(sharp, sharp) == math.inf
    assert math.isnan(space_psnr_db(np.ones_like(sharp), damaged))


@pytest.mark.parametrize("patch_px", [1, 3])
def test_the_nearest_feature_wins(rng: np.random.Generator, patch_px: int) -> None:
    ref, src = rng.random((2, 6, 12, 3), dtype=np.float32)
    window, reach = (-2, 4), patch_px // 2
    found_px = match_features(ref, src, window=window, patch_px=patch_px)
    for y in range(reach, 6 - reach):
        for x in range(4 + reach, 10 - reach):  # every disparity with its whole patch is inside
            costs = {}
            for d in range(*window):
                rows, columns = slice(y - reach, y + reach + 1), np.arange(x - reach, x + reach + 1)
                costs[d] = float(((ref[rows][:, columns] - src[rows][:, columns - d]) ** 2).sum())
            assert found_px[y, x] == min(costs, key=lambda d: costs[d])


def test_a_shifted_view_is_found_exactly(rng: np.random.Generator) -> None:
    canvas = rng.random((8, 40, 5), dtype=np.float32)
    for true_px, window in ((6, (0, 10)), (-6, (-10, 4))):
        ref, src = (canvas[:, :30], canvas[:, 6:36]) if true_px > 0 else (canvas[:, 6:36], canvas[:, :30])
        found_px = match_features(ref, src, window=window)
        assert (found_px[:, 6:24] == true_px).all()


def test_shapes_that_differ() -> None:
    with pytest.raises(ValueError, match="one shape"):
        match_features(np.zeros((2, 3, 1), np.float32), np.zeros((2, 4, 1), np.float32), window=(0, 1))
