"""Who is nearest to whom in time, by the words of its definition; a clock that stood still costs no memory."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest

from telewide.capture.moments import SAME_S, mutual_nearest
from telewide.geometry.arrays import FloatArray


def by_definition(first_s: FloatArray, second_s: FloatArray, max_s: float) -> list[tuple[int, int]]:
    """Each with each: mutually nearest, of equal intervals the earliest first, each photo once."""
    if not len(first_s) or not len(second_s):
        return []
    apart_s = np.abs(first_s[:, None] - second_s[None])
    least_s = np.minimum(apart_s.min(axis=0)[None], apart_s.min(axis=1)[:, None])
    edges = [(int(i), int(j)) for i, j in np.argwhere(apart_s <= np.minimum(least_s, max_s) + SAME_S)]
    edges.sort(key=lambda edge: (min(first_s[edge[0]], second_s[edge[1]]), edge))
    pairs: dict[int, int] = {}
    for i, j in edges:
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return sorted(pairs.items())


@pytest.mark.parametrize("seed", range(40))
def test_pairs_are_those_of_the_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes, span = rng.integers(0, 25, size=2), int(rng.integers(1, 60))
    first_s, second_s = (rng.integers(0, span, size=n).astype(np.float64) for n in sizes)
    for max_s in (0.0, 1.0, 10.0):
        assert mutual_nearest(first_s, second_s, max_s=max_s) == by_definition(first_s, second_s, max_s)


def test_a_roll_whose_clock_stood_still_is_paired_in_its_order() -> None:
    moments_s = np.zeros(2000)
    tracemalloc.start()
    begun_s = time.process_time()
    pairs = mutual_nearest(moments_s, moments_s, max_s=10)
    assert time.process_time() - begun_s < 10
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
    assert pairs == [(number, number) for number in range(2000)]
