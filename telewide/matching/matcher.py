"""Matchers: whatever makes disparity of two views, the networks and semi-global matching alike; free of torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window


class ConfidenceStd(NamedTuple):
    """Meaning of confidences: the standard deviation of a disparity of full and of no confidence, px."""

    sure_px: float
    unsure_px: float


SEMIGLOBAL_STD = ConfidenceStd(0.16, 9.0)
"""Fitted to the 68th and 95th percentile of semi-global matching's errors in ten classes of confidence, on eight
training scenes of Middlebury 2006 with src as it is and with src three times coarser: both come to 0.2, 0.4, 0.9 and
1.5 px at confidences of 0.95, 0.75, 0.55 and 0.35."""
LEARNED_STD = ConfidenceStd(0.3, 8.0)
"""Likewise of the network that comes with telewide: 0.3, 0.9, 1.3, 2.4 and 5.3 px at confidences of 0.95, 0.75, 0.55,
0.35 and 0.15."""
WITH_CONFIDENCE = frozenset({"guided"})
"""Networks that have learned how sure they are; here by name, so that none is built to tell."""


class Match(Protocol):
    """Makes disparity of two views."""

    def __call__(
        self, ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None
    ) -> DisparityMap:
        """Match views (H, W, 3) in [0, 1] within a window, px, where both were photographed; the disparity is ref's."""


@dataclass(frozen=True)
class Matcher:
    """A way to match, ready to use.

    Attributes:
        name: what tells it from others, as it stands in tables and records.
        match: (ref, src, window) to the disparity of ref.
        window: disparities it was trained for, px, searched beside what the pairs need; None where it was not trained.
        confidence_std: what its confidence says of a disparity; None where it was never held against errors.
        load: reads what it matches with, which the first match does otherwise.
    """

    name: str
    match: Match
    window: Window | None = None
    confidence_std: ConfidenceStd | None = SEMIGLOBAL_STD
    load: Callable[[], object] = lambda: None
