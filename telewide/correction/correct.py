"""Correction of one pair: wide's rows and colours brought to tele's, by fits to half of the matches."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from telewide.correction.colour import ColourFit, apply_colour, fit_colour
from telewide.correction.rows import (
    VerticalFit,
    apply_vertical,
    apply_vertical_to_mask,
    corrected_matches,
    fit_vertical,
)
from telewide.geometry.stereo import ValidMasks
from telewide.points.matches import Matches, find_matches, split_matches

if TYPE_CHECKING:
    from telewide.capture.pair import RectifiedPair


@dataclass(frozen=True)
class CorrectedPair:
    """A pair whose src agrees with ref in rows and colours.

    Attributes:
        pair: tele as it was, wide corrected.
        vertical: the vertical fit that was applied.
        colour: the colour fit that was applied.
        matches_fit: the matches both were fitted to, in corrected coordinates.
        matches_held_out: matches that no fit has seen, in corrected coordinates: the judge.
    """

    pair: RectifiedPair
    vertical: VerticalFit
    colour: ColourFit
    matches_fit: Matches
    matches_held_out: Matches


def correct_pair(
    pair: RectifiedPair,
    *,
    matches: Matches | None = None,
    seed: int = 0,
    has_vertical: bool = True,
    has_colour: bool = True,
) -> CorrectedPair:
    """Bring wide's rows and colours to tele's, fitted to half of the matches.

    Args:
        pair: the two views, of one size.
        matches: matches already found on this pair; None finds them.
        seed: seed of the split into matches to fit to and held-out ones.
        has_vertical: correct the rows.
        has_colour: correct the colours.

    Returns:
        The corrected pair, the fits and both halves of the matches; the split does not depend on what is corrected.
    """
    found = find_matches(pair.tele, pair.wide) if matches is None else matches
    fit_half, held_out = split_matches(found, seed=seed)
    vertical = fit_vertical(fit_half if has_vertical else fit_half.select(np.arange(0)), hw=pair.tele.shape[:2])
    fit_half, held_out = corrected_matches(fit_half, vertical), corrected_matches(held_out, vertical)
    wide = apply_vertical(pair.wide, vertical)
    valid = pair.valid and ValidMasks(pair.valid.ref, apply_vertical_to_mask(pair.valid.src, vertical))
    colour = fit_colour(pair.tele, wide, fit_half if has_colour else fit_half.select(np.arange(0)), held_out=held_out)
    corrected = dataclasses.replace(pair, wide=apply_colour(wide, colour), valid=valid)
    return CorrectedPair(
        pair=corrected, vertical=vertical, colour=colour, matches_fit=fit_half, matches_held_out=held_out
    )
