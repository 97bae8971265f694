"""Timing several things side by side: their turns alternate, so that a machine that slows down slows all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Timing:
    """Durations of one thing.

    Attributes:
        median_s: over the repeats.
        q1_s: first quartile.
        q3_s: third quartile.
        repeats: how many were timed, the warm-up left out.
    """

    median_s: float
    q1_s: float
    q3_s: float
    repeats: int


def time_side_by_side(
    cases: Mapping[Key, Callable[[], None]], *, repeats: int, warm_up: int, synchronise: Callable[[], None]
) -> dict[Key, Timing]:
    """Time things in alternating turns.

    Args:
        cases: what to time, by a key.
        repeats: timed turns of each, at least 1.
        warm_up: turns of each before them, not timed.
        synchronise: waits until a device has finished what it was given.

    Returns:
        A timing for each key.
    """
    seconds: dict[Key, list[float]] = {key: [] for key in cases}
    for turn in range(-warm_up, repeats):
        for key, run in cases.items():
            synchronise()
            begun_s = time.perf_counter()
            run()
            synchronise()
            if turn >= 0:
                seconds[key].append(time.perf_counter() - begun_s)
    return {key: _summary(values) for key, values in seconds.items()}


def _summary(values_s: list[float]) -> Timing:
    q1_s, median_s, q3_s = (float(value) for value in np.percentile(values_s, (25, 50, 75)))
    return Timing(median_s, q1_s, q3_s, len(values_s))
