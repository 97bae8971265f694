"""Path costs against their definition, pixel by pixel; strips against the whole; the memory of a large search."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.benchmark.memory import SGM, MemoryCase, measure_peak
from telewide.geometry.arrays import FloatMap
from telewide.matching.path_costs import CostVolume, summed_over_paths


def volume(rng: np.random.Generator, shape: tuple[int, int, int]) -> tuple[CostVolume, FloatMap]:
    """Costs as those of views with nothing in common, and a guide with edges."""
    height, _, width = shape
    guide = 255 * (rng.random((height, width, 3), dtype=np.float32) > 0.7)
    return rng.integers(0, 420, shape, dtype=np.uint16), guide.astype(np.float32)


def summed(cost_HDW: CostVolume, guide: FloatMap, *, whole_cells: int) -> CostVolume:
    total_HDW, n_strips = np.zeros_like(cost_HDW), 0
    levels = cost_HDW.shape[1]
    for rows, total in summed_over_paths(lambda at: cost_HDW[at], guide, levels=levels, whole_cells=whole_cells):
        assert not total_HDW[rows].any(), "each row comes once"
        total_HDW[rows], n_strips = total, n_strips + 1
    assert (n_strips == 1) == (whole_cells >= cost_HDW.size or len(cost_HDW) == 1)
    return total_HDW


def by_definition(cost_HDW: CostVolume, guide: FloatMap) -> CostVolume:
    """``L(p, d)`` along eight directions; beyond the sides a path goes on in the outermost column, as if mirrored."""
    height, levels, width = cost_HDW.shape
    total = np.zeros(cost_HDW.shape, dtype=int)
    for dy, dx in ((1, -1), (1, 0), (1, 1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (0, -1)):
        path = np.zeros(cost_HDW.shape, dtype=int)
        for y in range(height)[:: dy or 1]:
            for x in range(width)[:: -1 if dy == 0 and dx < 0 else 1]:
                y_before, x_before = y - dy, x - dx if dy == 0 else min(max(x - dx, 0), width - 1)
                path[y, :, x] = cost_HDW[y, :, x]
                if not (0 <= y_before < height and 0 <= x_before < width):
                    continue
                before = path[y_before, :, x_before]
                edge = np.abs(guide[y, x] - guide[y_before, x_before]).sum()
                large = int(max(3000 / (1 + edge / 6), 300))
                for d in range(levels):
                    beside = [before[k] + 180 for k in (d - 1, d + 1) if 0 <= k < levels]
                    path[y, d, x] += min(before[d], *beside, before.min() + large) - before.min()
        total += path
    return total.astype(np.uint16)


@pytest.mark.parametrize("whole_cells", [1 << 28, 1])
def test_sums_are_those_of_the_definition(whole_cells: int, rng: np.random.Generator) -> None:
    cost_HDW, guide = volume(rng, (9, 6, 7))
    np.testing.assert_array_equal(summed(cost_HDW, guide, whole_cells=whole_cells), by_definition(cost_HDW, guide))


@pytest.mark.parametrize("height", [1, 2, 3, 64, 301])
def test_strips_give_what_the_whole_gives(height: int, rng: np.random.Generator) -> None:
    cost_HDW, guide = volume(rng, (height, 12, 31))
    whole = summed(cost_HDW, guide, whole_cells=cost_HDW.size)
    np.testing.assert_array_equal(summed(cost_HDW, guide, whole_cells=cost_HDW.size - 1), whole)


@pytest.mark.slow
def test_a_search_through_a_third_of_the_width_takes_less_than_a_gigabyte() -> None:
    # As a whole it would take 1.7 GB; noise has nothing in common.
    assert measure_peak(MemoryCase(SGM, "float32", (576, 1536), (-236, 236))).process_bytes < 1e9
