"""The asymmetric factor: how many times finer tele resolves the scene than wide.

Three sources know it of photos as captured: a rig's intrinsics, the scale of matches, EXIF. They are compared here, and
disagreement is said. On rectified views, enlarged to one size, only sharpness still tells of it: see
:mod:`telewide.points.bandwidth`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from telewide.geometry.camera import focal_px_from_f35
from telewide.records import Line

RIG_TOLERANCE = 0.03
"""A rig and the matches of one pair that differ by more are not of one state of the lenses."""
EXIF_TOLERANCE = 0.15
"""EXIF rounds to whole millimetres, and its numbers are nominal: only more than this speaks against it."""


@dataclass(frozen=True)
class AsymmetryEstimate:
    """``f_tele_px / f_wide_px`` of photos as captured, from each source that knows it.

    Attributes:
        rig: from the intrinsics of a calibrated rig.
        matches: from the scale of matches of one pair of photos.
        exif: from the focal lengths EXIF states.
        factor: the one to use; None where no source knows it.
        source: whose it is.
        statements: one sentence for every disagreement.
        swapped: the sentence that says so where tele and wide look exchanged; None elsewhere.
    """

    rig: float | None
    matches: float | None
    exif: float | None
    factor: float | None
    source: Literal["rig", "matches", "exif"] | None
    statements: tuple[Line, ...]
    swapped: Line | None = None


def compare_factors(
    *, rig: float | None = None, matches: float | None = None, exif: float | None = None, size_ratio: float = 1.0
) -> AsymmetryEstimate:
    """Choose the asymmetric factor and say where the sources disagree.

    A rig is trusted over matches, matches over EXIF.

    Args:
        rig: :attr:`~telewide.geometry.rig.StereoRig.asymmetry`.
        matches: scale of the matches of one pair.
        exif: what :func:`factor_from_exif` says.
        size_ratio: size of wide's photo over that of tele's: photos of any sizes can be exchanged.

    Returns:
        The comparison: rig and matches more than 3 % apart are reported, EXIF only more than 15 % off the chosen one.
    """
    factor, source = _first_known(rig, matches, exif)
    swapped = None if rig is None else _swapped(rig, matches, exif, size_ratio=size_ratio)
    if swapped is not None:
        return AsymmetryEstimate(
            rig=rig, matches=matches, exif=exif, factor=factor, source=source, statements=(), swapped=swapped
        )
    statements = []
    if rig is not None and matches is not None and abs(matches / rig - 1.0) > RIG_TOLERANCE:
        statements.append(
            f"the rig states an asymmetric factor of {rig:.3f}, the matches of this pair show {matches:.3f}, "
            f"{abs(matches / rig - 1.0):.1%} off: other lenses, a digital zoom, or photos of another size"
        )
    if exif is not None and factor is not None and abs(exif / factor - 1.0) > EXIF_TOLERANCE:
        named = {"rig": "the rig states", "matches": "the matches show"}[source or "rig"]
        statements.append(
            f"EXIF states an asymmetric factor of {exif:.2f}, {named} {factor:.2f}: a digital zoom or a crop"
        )
    return AsymmetryEstimate(
        rig=rig, matches=matches, exif=exif, factor=factor, source=source, statements=tuple(statements)
    )


def _swapped(rig: float, matches: float | None, exif: float | None, *, size_ratio: float) -> str | None:
    """Say that the views look swapped where all that is known of these photos is the inverse of the rig's factor.

    Of photos of two sizes it is the factor per share of the photo that is inverted.
    """
    known = {"the matches show": matches, "EXIF states": exif}
    stated = {source: factor for source, factor in known.items() if factor is not None}
    of_rig = rig * size_ratio
    if not stated or of_rig < 1 + EXIF_TOLERANCE:
        return None
    if any(abs(factor * size_ratio * of_rig - 1) > EXIF_TOLERANCE for factor in stated.values()):
        return None
    told = " and ".join(f"{source} {factor:.2f}" for source, factor in stated.items())
    return f"the views look swapped: {told} for tele over wide, and the rig {rig:.2f}; exchange the two photos"


def factor_from_exif(
    *,
    tele_f35_mm: float | None,
    wide_f35_mm: float | None,
    tele_hw: tuple[int, int] | None,
    wide_hw: tuple[int, int] | None,
) -> float | None:
    """Asymmetric factor from 35 mm equivalents; see `telewide.geometry.camera.focal_px_from_f35`.

    Args:
        tele_f35_mm: FocalLengthIn35mmFilm of tele.
        wide_f35_mm: of wide.
        tele_hw: size of tele's photo.
        wide_hw: of wide's.

    Returns:
        The factor; None where something is not stated.
    """
    if not tele_f35_mm or not wide_f35_mm or tele_hw is None or wide_hw is None:
        return None
    return focal_px_from_f35(tele_f35_mm, hw=tele_hw) / focal_px_from_f35(wide_f35_mm, hw=wide_hw)


def _first_known(
    rig: float | None, matches: float | None, exif: float | None
) -> tuple[float | None, Literal["rig", "matches", "exif"] | None]:
    if rig is not None:
        return rig, "rig"
    if matches is not None:
        return matches, "matches"
    return exif, None if exif is None else "exif"
