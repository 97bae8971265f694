"""Choice of the two lenses that make the pairs of a camera roll.

A phone with four lenses offers six choices. The wide photo should be of the main lens, which is the best one and whose
picture holds that of every longer lens; and tele should see enough of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from telewide.capture.lenses import Lens
from telewide.capture.moments import mutual_nearest

# The lens that phones call 1x: 23 to 28 mm.
_MAIN_F35_MM = 25.0
_MAIN_RANGE_MM = (20.0, 32.0)
_USUAL_RATIO = 3.0
_RATIO_RANGE = (1.5, 6.0)
_MANY = 0.5
_SAME_CHOICE = 0.05


@dataclass(frozen=True)
class LensChoice:
    """Lenses to pair; None leaves it to the photos.

    Attributes:
        tele_mm: FocalLength of tele.
        wide_mm: FocalLength of wide.
        max_seconds: photos farther apart are no pair.
    """

    tele_mm: float | None = None
    wide_mm: float | None = None
    max_seconds: float = 10.0


@dataclass(frozen=True)
class LensPair:
    """Two lenses of one phone.

    Attributes:
        wide: the lens that sees more.
        tele: the other one.
        n_pairs: photos of the two that were taken together.
    """

    wide: Lens
    tele: Lens
    n_pairs: int

    @property
    def ratio(self) -> float | None:
        """Ratio of what wide sees to what tele sees, by the 35 mm equivalents; None where they are not stated."""
        return self.tele.f35_mm / self.wide.f35_mm if self.tele.f35_mm and self.wide.f35_mm else None


@dataclass(frozen=True)
class ChosenLenses:
    """The lenses whose photos are paired, and those that were not chosen.

    Attributes:
        chosen: the pair of lenses.
        others: other pairs of lenses that make pairs of photos, the next best first.
    """

    chosen: LensPair
    others: tuple[LensPair, ...]


def choose_lenses(seconds: Mapping[Lens, NDArray[np.float64]], choice: LensChoice) -> ChosenLenses | None:
    """Choose the two lenses of one camera whose photos are paired.

    Of the pairs of lenses that make at least half as many pairs of photos as any, the first by: wide is the main lens;
    tele sees a sixth of it or more; more pairs of photos; a ratio nearer to three; longer lenses.

    Args:
        seconds: moments of each lens's photos, s.
        choice: what is asked for.

    Returns:
        The choice; None where the lenses asked for are not both there.
    """
    ordered = sorted(seconds, key=lambda lens: (lens.f35_mm or 0.0, lens.focal_length_mm))
    main = _main_lens(ordered)
    possible = [
        LensPair(wide, tele, len(mutual_nearest(seconds[tele], seconds[wide], max_s=choice.max_seconds)))
        for wide, tele in combinations(ordered, 2)
    ]
    candidates = [
        pair
        for pair in possible
        if _is_asked_for(pair.tele, choice.tele_mm) and _is_asked_for(pair.wide, choice.wide_mm)
    ]
    if not candidates:
        return None
    most = max(pair.n_pairs for pair in candidates)

    def merit(pair: LensPair) -> tuple[object, ...]:
        ratio = pair.ratio
        suits = ratio is not None and _RATIO_RANGE[0] <= ratio <= _RATIO_RANGE[1]
        unusual = abs(math.log(ratio / _USUAL_RATIO)) if ratio else math.inf
        lengths = (ordered.index(pair.tele), ordered.index(pair.wide))
        return pair.n_pairs >= _MANY * most, pair.wide == main, suits, pair.n_pairs, -unusual, *lengths

    chosen = max(candidates, key=merit)
    others = sorted((pair for pair in possible if pair != chosen and pair.n_pairs), key=merit, reverse=True)
    return ChosenLenses(chosen, tuple(others))


def _main_lens(lenses: Sequence[Lens]) -> Lens | None:
    stated = [lens for lens in lenses if lens.f35_mm and _MAIN_RANGE_MM[0] <= lens.f35_mm <= _MAIN_RANGE_MM[1]]
    return min(stated, key=lambda lens: abs((lens.f35_mm or math.inf) - _MAIN_F35_MM), default=None)


def _is_asked_for(lens: Lens, asked_focal_mm: float | None) -> bool:
    return asked_focal_mm is None or lens.is_of(asked_focal_mm, tolerance=_SAME_CHOICE)
