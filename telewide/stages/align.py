"""With a rig: from two photos as captured to a rectified pair, corrected for what moved in this shot.

    photos ── match ── fit what moved ── rig of this shot ── rectify ── pair

What was fitted is recorded, so that results can be mapped back onto the photo.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from telewide.calibration.rig_file import StoredRig
from telewide.calibration.scene_quality import zero_std_px
from telewide.capture.exif import least_seconds_between, read_photo_facts
from telewide.capture.pair import Capture, PhotoPair
from telewide.correction.asymmetry import AsymmetryEstimate, compare_factors, factor_from_exif
from telewide.correction.moving import MovedRegion, find_moving, moving_note
from telewide.correction.rectify import Rectification, rectify_pair
from telewide.correction.refinement import ShotRefinement, fit_shot, refined_rig
from telewide.depth.precision import DepthPrecision, lens_shift_std_share
from telewide.geometry.rectification import RectifiedGeometry, rectified_geometry, rig_at_sizes
from telewide.geometry.rig import StereoRig
from telewide.points.photo_matches import find_photo_matches
from telewide.points.scale import estimate_scale
from telewide.records import Record, checked, parse_json, record_text

_log = logging.getLogger("telewide")


@dataclass(frozen=True)
class ShotFacts:
    """Facts that the two photos of a shot state about themselves.

    Attributes:
        seconds_between: between the exposures, at least; None where EXIF does not tell.
        asymmetry: the asymmetric factor by EXIF; None likewise.
    """

    seconds_between: float | None = None
    asymmetry: float | None = None


class ShotRecord(Record):
    """Content of ``shot.json``: what an alignment adds to its rig."""

    tele_hw: tuple[int, int]
    wide_hw: tuple[int, int]
    refinement: ShotRefinement
    asymmetry: AsymmetryEstimate
    moved: tuple[MovedRegion, ...]


@dataclass(frozen=True)
class Alignment:
    """Geometry between a rectified pair and the photos it was made from.

    Attributes:
        refinement: what moved in this shot.
        moved: parts of the tele photo that moved between the two exposures.
        asymmetry: the asymmetric factor, by every source of it.
        geometry: of the rectified views; its rig is this shot's, for photos of its sizes.
    """

    refinement: ShotRefinement
    moved: tuple[MovedRegion, ...]
    asymmetry: AsymmetryEstimate
    geometry: RectifiedGeometry

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for everything a person should know."""
        moved = moving_note(self.moved)
        return (*self.refinement.notes, *self.asymmetry.statements, *(() if moved is None else (moved,)))


def align_photos(
    photos: PhotoPair, *, rig: StereoRig, working_width_px: int | None, facts: ShotFacts, seed: int
) -> tuple[Rectification, Alignment]:
    """Correct a rig for one shot, and rectify the shot's photos with it.

    Args:
        photos: tele and wide as captured.
        rig: as calibrated.
        working_width_px: width of the rectified views at most; None for tele's resolution.
        facts: what the photos state about themselves.
        seed: of the split into matches to fit to and held-out ones.

    Returns:
        The rectified pair, and its geometry to the photos.

    Raises:
        InputError: the photos do not fit the rig, or it cannot be rectified.
    """
    as_calibrated = rig
    rig = rig_at_sizes(rig, tele_hw=photos.tele.shape[:2], wide_hw=photos.wide.shape[:2])
    matches = find_photo_matches(photos.tele, photos.wide, rig=rig)
    refinement = fit_shot(matches, rig=rig, seconds_between=facts.seconds_between, seed=seed)
    if rig.tele.hw != as_calibrated.tele.hw:
        refinement = replace(refinement, notes=(*refinement.notes, _resized_note(rig, as_calibrated)))
    rectified = rectify_pair(
        photos.tele,
        photos.wide,
        rig=refined_rig(rig, refinement),
        name=photos.name,
        working_width_px=working_width_px,
    )
    moved = find_moving(matches, refinement, rig=rig)
    of_matches = _factor_of_matches(photos, rig, refinement)
    sizes = math.hypot(*rig.wide.hw) / math.hypot(*rig.tele.hw)
    asymmetry = compare_factors(rig=rig.asymmetry, matches=of_matches, exif=facts.asymmetry, size_ratio=sizes)
    return rectified, Alignment(refinement, moved, asymmetry, rectified.geometry)


def shot_precision(alignment: Alignment, *, of_set: Sequence[Alignment], rig: StoredRig) -> DepthPrecision:
    """Sum up the uncertainty that all depths of a shot share: the rig's own, and the lens's unseen shift.

    A rig from scenes does not know where infinitely far things lie; that moves all disparities as the lens's shift
    does, and a known distance takes out both.

    Args:
        alignment: of the shot.
        of_set: of all shots, of any photo size, whose vertical offsets show how far the lens moves.
        rig: the shots were rectified with.
    """
    width_px = max(alignment.geometry.rig.tele.hw)
    shift_px = width_px * lens_shift_std_share([share for each in of_set if (share := _offset_share(each)) is not None])
    size = width_px / max(rig.rig.tele.hw)
    return DepthPrecision(
        baseline_std_m=0.0 if rig.transform_std is None else _known(rig.transform_std.baseline_m),
        f_std_px=0.0 if rig.tele_std is None else _known(rig.tele_std.f_px) * size,
        lens_shift_std_px=math.hypot(shift_px, zero_std_px(rig.quality) * size),
    )


def _offset_share(alignment: Alignment) -> float | None:
    """A shot's vertical offset over the longer side of its tele photo; a shot whose pose was fitted has none."""
    fit = alignment.refinement
    if not (fit.is_fitted and fit.is_at_once):
        return None
    return fit.vertical_offset_px / max(alignment.geometry.rig.tele.hw)


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _resized_note(rig: StereoRig, as_calibrated: StereoRig) -> str:
    (height, width), (rig_height, rig_width) = rig.tele.hw, as_calibrated.tele.hw
    return (
        f"tele is {width} x {height} px, the rig was made at {rig_width} x {rig_height} px: taken for the whole "
        "photo at another size; if it was cropped, its depth is wrong"
    )


def _factor_of_matches(photos: PhotoPair, rig: StereoRig, refinement: ShotRefinement) -> float | None:
    if refinement.is_fitted:
        return rig.asymmetry / refinement.scale  # it corrects the rig's focal ratio by what the matches show
    estimate = estimate_scale(photos.tele, photos.wide)
    return None if estimate is None else estimate.factor


def read_shot_facts(capture: Capture) -> ShotFacts:
    """Read what the two photos of a capture state about themselves."""
    tele, wide = (read_photo_facts(path) for path in (capture.tele_path, capture.wide_path))
    return ShotFacts(
        least_seconds_between(tele, wide),
        factor_from_exif(tele_f35_mm=tele.f35_mm, wide_f35_mm=wide.f35_mm, tele_hw=tele.hw, wide_hw=wide.hw),
    )


def plain_rig(rig: StereoRig) -> dict[str, object]:
    """Return a rig as plain data, to tell it from another."""
    cameras = {"tele": rig.tele, "wide": rig.wide}
    return {
        "wide_from_tele": rig.wide_from_tele.tolist(),
        "is_scale_known": rig.is_scale_known,
        **{
            name: {"hw": list(camera.hw), "K": camera.K.tolist(), "distortion": camera.distortion.tolist()}
            for name, camera in cameras.items()
        },
    }


def alignment_as_json(alignment: Alignment) -> str:
    """Write what an alignment adds to its rig, as JSON; :func:`alignment_from_json` undoes it exactly."""
    rig = alignment.geometry.rig
    record = ShotRecord(
        tele_hw=rig.tele.hw,
        wide_hw=rig.wide.hw,
        refinement=alignment.refinement,
        asymmetry=alignment.asymmetry,
        moved=alignment.moved,
    )
    return record_text(record)


def alignment_from_json(text: str, *, rig: StereoRig, working_width_px: int | None) -> Alignment:
    """Read what :func:`alignment_as_json` wrote.

    Args:
        text: as it was written.
        rig: as calibrated, the one the alignment was made with.
        working_width_px: the one it was made with.

    Raises:
        ValueError: a key is missing, or a value is of another kind.
        InputError: it is of photos that the rig does not fit.
    """
    record = checked(parse_json(text), ShotRecord)
    of_sizes = rig_at_sizes(rig, tele_hw=record.tele_hw, wide_hw=record.wide_hw)
    geometry = rectified_geometry(refined_rig(of_sizes, record.refinement), working_width_px=working_width_px)
    return Alignment(record.refinement, record.moved, record.asymmetry, geometry)
