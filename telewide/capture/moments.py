"""Times at which photos were taken, and which of two series are nearest to each other in time.

Letters: N, M photos of the two series.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, tzinfo

import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray

SAME_S = 1e-6
"""Intervals that differ by less are equal."""


def utc_seconds(moments: Sequence[datetime]) -> FloatArray:
    """Put moments of one camera on one time axis.

    A moment that states no time zone takes that of the moment nearest to it by the clock among those that state one;
    where none does, UTC.

    Args:
        moments: (N,) with and without time zone.

    Returns:
        (N,) s since 1970.
    """
    zoned = [(moment.replace(tzinfo=UTC).timestamp(), moment.tzinfo) for moment in moments if moment.tzinfo]
    clock_s = np.array([second for second, _ in zoned])

    def zone_of(moment: datetime) -> tzinfo | None:
        nearest = int(np.abs(clock_s - moment.replace(tzinfo=UTC).timestamp()).argmin())
        return zoned[nearest][1]

    if not zoned:
        return np.array([moment.replace(tzinfo=UTC).timestamp() for moment in moments], dtype=np.float64)
    return np.array([(m if m.tzinfo else m.replace(tzinfo=zone_of(m))).timestamp() for m in moments], dtype=np.float64)


def nearest_s(own_s: FloatArray, others_s: FloatArray) -> FloatArray:
    """Return how far each moment is from the nearest of the others.

    Args:
        own_s: (N,) s.
        others_s: (M,) s.

    Returns:
        (N,) s, 0 or more; inf where there are no others.
    """
    return np.array([np.abs(others_s - second).min(initial=np.inf) for second in own_s], dtype=np.float64)


def mutual_nearest(first_s: FloatArray, second_s: FloatArray, *, max_s: float) -> list[tuple[int, int]]:
    """Pair moments that are the nearest to each other; of equally near ones that which is still free.

    Of several equal intervals the earliest is paired first, so that photos taken in turns at equal intervals all find
    a partner.

    Args:
        first_s: (N,) s, in the order in which equal moments are to be taken.
        second_s: (M,) s, likewise.
        max_s: moments farther apart are no pair.

    Returns:
        Indices into both, each at most once, by the first.
    """
    to_second_s, to_first_s = nearest_s(first_s, second_s), nearest_s(second_s, first_s)

    def candidates(i: int, *, is_before: bool) -> NDArray[np.intp]:
        """Indices of those that i may go with, taken before it, or at its moment and after."""
        apart_s = np.abs(second_s - first_s[i])
        is_near = (apart_s <= np.minimum(max_s, to_second_s[i]) + SAME_S) & (apart_s <= to_first_s + SAME_S)
        return np.flatnonzero(is_near & ((second_s < first_s[i]) == is_before))

    # Not each with each: a roll whose clock stood still has as many equal intervals as pairs of photos.
    intervals = []
    for i in range(len(first_s)):
        for is_before in (True, False):
            found = candidates(i, is_before=is_before)
            if len(found):
                intervals.append((second_s[found].min() if is_before else first_s[i], i, is_before))
    pairs: dict[int, int] = {}
    is_free = np.ones(len(second_s), dtype=np.bool_)
    for _, i, is_before in sorted(intervals):
        found = candidates(i, is_before=is_before)
        free = found[is_free[found]]
        if i not in pairs and len(free):
            pairs[i] = int(free[0])
            is_free[free[0]] = False
    return sorted(pairs.items())
