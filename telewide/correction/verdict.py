"""Is this pair fit for depth, and what does it need? A look at one capture before anything is trained or matched.

The report is measured on the two views, ref = tele and src = wide. Doubts are said in words; a pair is refused only
where hard evidence speaks against it: what ``captures.yaml`` states, or more than 30 consistent matches.
Convention: ``disparity_px = x_tele - x_wide``, ``vertical_px = y_tele - y_wide``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from telewide.correction.colour import light_ratio
from telewide.correction.rows import VerticalFit, fit_vertical
from telewide.points.bandwidth import estimate_asymmetry
from telewide.points.matches import Matches, find_matches
from telewide.points.similarity import Overlap, find_overlap
from telewide.records import Figure, Line, Name

if TYPE_CHECKING:
    from telewide.capture.facts import CaptureFacts
    from telewide.capture.pair import RectifiedPair

Verdict = Literal["good", "usable", "doubtful", "refused"]

MIN_COMMON_MATCHES = 12
"""Fewer consistent matches than this and the views may not show one scene."""
MIN_EVIDENCE_MATCHES = 30
"""More consistent matches than this are hard evidence."""
MIN_GOOD_MATCHES = 50
SWAPPED_BELOW = 0.8
"""An asymmetry below this says that wide is the sharper view."""
_FINER_STATED = 1.5
_ROW_MISFIT_USABLE_PX = 3.0
_ROW_MISFIT_DOUBTFUL_SHARE = 0.015
_SCALE_TOLERANCE = 0.06
_ROTATION_TOLERANCE_DEG = 3.0
_EVEN_COLOUR = (0.5, 2.0)
_VERDICTS: tuple[Verdict, ...] = ("good", "usable", "doubtful", "refused")


@dataclass(frozen=True)
class PairReport:
    """Measurements of one pair, and a verdict.

    Attributes:
        name: name of the capture.
        n_matches: consistent matches found.
        vertical_offset_px: vertical misfit at the image's centre, px; NaN where it could not be fitted.
        vertical_slope: its growth with the row, px per px; NaN likewise.
        vertical_residual_px: median absolute vertical misfit as captured, px; NaN without matches.
        asymmetry: how many times finer tele resolves the scene, measured; None where the views have no texture.
        colour_ratio: light of tele over that of wide at the matches, R G B, linear; NaN without matches.
        disparity_p02_px: 2nd percentile of the matches' disparities; NaN without matches.
        disparity_p98_px: 98th percentile likewise.
        verdict: good; usable (something is corrected or scarce); doubtful (look at it); refused.
        reasons: one sentence for every reason the verdict is not good.
    """

    name: Name
    n_matches: int
    vertical_offset_px: Figure
    vertical_slope: Figure
    vertical_residual_px: Figure
    asymmetry: float | None
    colour_ratio: tuple[Figure, Figure, Figure]
    disparity_p02_px: Figure
    disparity_p98_px: Figure
    verdict: Verdict
    reasons: tuple[Line, ...]

    @property
    def disparity_range_px(self) -> tuple[float, float] | None:
        """Least and largest disparity by its matches; None where it is refused or they are too few to tell."""
        is_measured = math.isfinite(self.disparity_p02_px + self.disparity_p98_px)
        if self.verdict == "refused" or self.n_matches < MIN_COMMON_MATCHES or not is_measured:
            return None
        return self.disparity_p02_px, self.disparity_p98_px


@dataclass(frozen=True)
class _Finding:
    verdict: Verdict
    reason: str


def inspect_pair(
    pair: RectifiedPair,
    *,
    facts: CaptureFacts,
    matches: Matches | None = None,
    focal_lengths_mm: tuple[float | None, float | None] = (None, None),
) -> PairReport:
    """Measure a pair and judge it.

    Args:
        pair: the two views, of one size.
        facts: what the owner states about the captures.
        matches: matches already found on this pair; None finds them.
        focal_lengths_mm: of the lenses of tele and wide as EXIF states them, where it does.

    Returns:
        The report; it never raises for a bad pair, it says what is wrong.
    """
    found = find_matches(pair.tele, pair.wide) if matches is None else matches
    vertical = fit_vertical(found, hw=pair.tele.shape[:2])
    asymmetry = estimate_asymmetry(pair.tele, pair.wide)
    overlap = None if len(found) > MIN_EVIDENCE_MATCHES else find_overlap(pair.tele, pair.wide)
    ratio = light_ratio(pair.tele, pair.wide, found)
    findings = [
        *_findings_of_scene(found, overlap),
        *_findings_of_rows(vertical, overlap, facts, height=pair.tele.shape[0]),
        *([] if _is_tele_larger(overlap) else _findings_of_sharpness(asymmetry, facts, focal_lengths_mm)),
        *_findings_of_colour(ratio),
    ]
    nan = float("nan")
    p02_px, p98_px = np.percentile(found.disparity_px, (2, 98)) if len(found) else (nan, nan)
    return PairReport(
        name=pair.name,
        n_matches=len(found),
        vertical_offset_px=vertical.offset_px if vertical.is_fitted else nan,
        vertical_slope=vertical.slope_y if vertical.is_fitted else nan,
        vertical_residual_px=vertical.residual_before_px,
        asymmetry=asymmetry,
        colour_ratio=ratio,
        disparity_p02_px=float(p02_px),
        disparity_p98_px=float(p98_px),
        verdict=max((f.verdict for f in findings), key=_VERDICTS.index, default="good"),
        reasons=tuple(f.reason for f in findings),
    )


def _findings_of_scene(matches: Matches, overlap: Overlap | None) -> list[_Finding]:
    """Whether the views show one scene, with texture enough to judge them."""
    if len(matches) >= MIN_GOOD_MATCHES:
        return []
    if len(matches) >= MIN_COMMON_MATCHES:
        return [_Finding("usable", f"only {len(matches)} consistent matches: little to correct and judge by")]
    if overlap is not None and overlap.n > MIN_EVIDENCE_MATCHES:
        return []  # one scene, seen otherwise: the rows or the scale are to blame
    return [_Finding("doubtful", f"{len(matches)} consistent matches: no common scene, or one without texture")]


def _findings_of_rows(
    vertical: VerticalFit, overlap: Overlap | None, facts: CaptureFacts, *, height: int
) -> list[_Finding]:
    """Whether the rows of the two views agree."""
    findings = []
    if overlap is not None and overlap.n > MIN_EVIDENCE_MATCHES:
        findings = _findings_of_overlap(overlap, height=height)
    misfit_px = vertical.largest_misfit_px
    if not findings and misfit_px > _ROW_MISFIT_DOUBTFUL_SHARE * height:
        # A slope may have been drawn out to the corners from few matches: they themselves must be off.
        is_evidence = vertical.n > MIN_EVIDENCE_MATCHES and vertical.residual_before_px > _ROW_MISFIT_USABLE_PX
        told = f"rows disagree by up to {misfit_px:.1f} px"
        findings.append(
            _Finding("refused", f"{told}, as {vertical.n} matches show: the pair is not rectified")
            if is_evidence
            else _Finding("doubtful", f"{told}: the pair does not look rectified")
        )
    elif not findings and misfit_px > _ROW_MISFIT_USABLE_PX:
        findings.append(_Finding("usable", f"rows disagree by up to {misfit_px:.1f} px, which is corrected"))
    if facts.rectified is False and vertical.n <= MIN_EVIDENCE_MATCHES:
        findings.append(_Finding("refused", "captures.yaml states that the pair is not rectified"))
    return findings


def _findings_of_overlap(overlap: Overlap, *, height: int) -> list[_Finding]:
    """Findings of a free similarity between the views against a rectified pair."""
    seen = f"{overlap.n} matches show"
    if abs(overlap.rotation_deg) > _ROTATION_TOLERANCE_DEG:
        return [_Finding("refused", f"{seen} one view turned by {overlap.rotation_deg:.0f} deg against the other")]
    if overlap.scale > 1 + _SCALE_TOLERANCE:
        text = f"{seen} the scene {overlap.scale:.2f} times larger in wide than in tele: the views are swapped"
        return [_Finding("refused", text)]
    if _is_tele_larger(overlap):
        text = f"{seen} the scene {1 / overlap.scale:.2f} times larger in tele: wide is not cropped to it"
        return [_Finding("refused", text)]
    if abs(overlap.vertical_px) > 2 * _ROW_MISFIT_DOUBTFUL_SHARE * height:
        return [_Finding("refused", f"{seen} rows {overlap.vertical_px:.0f} px apart: the pair is not rectified")]
    return []


def _is_tele_larger(overlap: Overlap | None) -> bool:
    """Whether tele shows the scene larger, as it does before wide is cropped: their sharpness then tells nothing."""
    return overlap is not None and overlap.n > MIN_EVIDENCE_MATCHES and overlap.scale < 1 - _SCALE_TOLERANCE


def _findings_of_sharpness(
    asymmetry: float | None, facts: CaptureFacts, focal_lengths_mm: tuple[float | None, float | None]
) -> list[_Finding]:
    """Whether tele is the sharper view, as its name says."""
    if asymmetry is None:
        return [_Finding("doubtful", "one view has no texture at all")]
    stated = facts.asymmetry
    if asymmetry < SWAPPED_BELOW:
        text = f"wide is {1 / asymmetry:.1f} times sharper than tele: the views look swapped, or tele is out of focus"
        if stated is not None and stated >= _FINER_STATED:
            return [_Finding("refused", f"{text}; captures.yaml states tele to be {stated:g} times finer")]
        tele_mm, wide_mm = focal_lengths_mm
        if tele_mm is not None and wide_mm is not None and tele_mm < wide_mm:
            return [_Finding("refused", f"{text}; EXIF names {tele_mm:g} mm for tele and {wide_mm:g} mm for wide")]
        return [_Finding("doubtful", text)]
    if stated is not None and not 0.5 < asymmetry / stated < 2.0:
        return [_Finding("usable", f"captures.yaml states an asymmetry of {stated:g}, measured is {asymmetry:.1f}")]
    return []


def _findings_of_colour(ratio: tuple[float, float, float]) -> list[_Finding]:
    if all(not _EVEN_COLOUR[0] <= r <= _EVEN_COLOUR[1] for r in ratio if np.isfinite(r)) and np.isfinite(ratio[0]):
        light = float(np.median(ratio))
        which, times = ("tele", light) if light > 1 else ("wide", 1 / light)
        told = f"the views differ in brightness more than twofold: {which} has {times:.1f} times the light"
        return [_Finding("usable", told)]
    return []
