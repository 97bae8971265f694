"""Matchers: whatever makes disparity of two views, the networks and semi-global matching alike; free of torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window


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
        doubt: what is to be said before it is used.
        is_confidence_measured: whether its confidence was held against errors, and so tells how sure a disparity is.
    """

    name: str
    match: Match
    window: Window | None = None
    doubt: str | None = None
    is_confidence_measured: bool = True
