"""Coarseness of the second views of captures against the first, measured as on captures of a phone."""

from __future__ import annotations

from collections.abc import Sequence

from telewide.capture.layout import Capture
from telewide.capture.pair import PairReader
from telewide.correction.blur import damage_range, fit_blur
from telewide.points.matches import find_matches


def coarser_by(captures: Sequence[Capture]) -> tuple[float, float] | None:
    """Range of the factor by which second views are coarser; None where no pair says.

    Args:
        captures: to be measured.
    """
    reader, blurs = PairReader(max_bytes=0), []
    for capture in captures:
        pair = reader.read(capture)
        blur = fit_blur(pair.tele, pair.wide, find_matches(pair.tele, pair.wide))
        if blur is not None:
            blurs.append(blur)
    damage = damage_range(blurs)
    return None if damage is None else damage.factor
