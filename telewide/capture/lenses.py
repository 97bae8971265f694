"""Lens that took a photo, and whether a photo from "tele" is only an enlarged piece of wide.

Phones answer "2x" with a crop of the wide lens where tele cannot focus or it is dark. Its FocalLength gives it away,
and its 35 mm equivalent: for one lens f35 / f is constant, and a digital crop raises it.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from telewide.capture.exif import PhotoFacts, read_photo_facts
from telewide.capture.layout import Capture, CaptureSet, Problem
from telewide.errors import TelewideError

# Whole millimetres of f35 at 13 mm, and 4:3 against 16:9 of one sensor, stay below; the mildest crop offered is 1.16.
_CROP_TOLERANCE = 1.12
_ZOOM_TOLERANCE = 1.05
# Steps in which one lens states its focal length as it focuses; jumps this large only where f35 stays.
_SAME_FOCAL = 0.02
_SAME_LENS_FOCAL = 0.1
_SAME_F35 = 0.05


@dataclass(frozen=True)
class Lens:
    """One lens of one phone model.

    Attributes:
        camera: make and model.
        focal_length_mm: physical, the smallest that its photos state.
        longest_focal_mm: the largest: some lenses state another one at every distance of focus.
        crop_35: ``f35 / f`` without digital crop; None where no photo states f35.
        f35_mm: focal length of equal field of view on 36 x 24 mm, without digital crop; None likewise.
    """

    camera: str
    focal_length_mm: float
    longest_focal_mm: float
    crop_35: float | None
    f35_mm: float | None

    @property
    def focal_words(self) -> str:
        """The focal lengths that its photos state: "4.25 mm", "13 to 13.8 mm"."""
        shortest, longest = f"{self.focal_length_mm:.4g}", f"{self.longest_focal_mm:.4g}"
        is_one = self.longest_focal_mm <= self.focal_length_mm * (1 + _SAME_FOCAL)
        return f"{shortest} mm" if is_one else f"{shortest} to {longest} mm"

    def is_of(self, focal_length_mm: float, *, tolerance: float = _SAME_FOCAL) -> bool:
        """Tell whether a focal length is one of this lens's.

        Args:
            focal_length_mm: physical.
            tolerance: share by which it may lie beyond what the lens's photos state.
        """
        return self.focal_length_mm * (1 - tolerance) <= focal_length_mm <= self.longest_focal_mm * (1 + tolerance)


def find_lenses(photos: Iterable[PhotoFacts]) -> tuple[Lens, ...]:
    """Tell the lenses that took a set of photos apart.

    Args:
        photos: of any cameras; those without FocalLength are passed over.

    Returns:
        The lenses, by camera and then by field of view, widest first.
    """
    by_camera: dict[str, list[PhotoFacts]] = defaultdict(list)
    for photo in photos:
        if photo.focal_length_mm:
            by_camera[photo.camera].append(photo)
    lenses = [_lens(camera, group) for camera in sorted(by_camera) for group in _focal_groups(by_camera[camera])]
    return tuple(sorted(lenses, key=lambda lens: (lens.camera, lens.f35_mm or 0.0, lens.focal_length_mm)))


def lens_of(photo: PhotoFacts, lenses: Sequence[Lens]) -> Lens | None:
    """Return the lens that took a photo, by camera and FocalLength.

    Args:
        photo: what it states.
        lenses: from `find_lenses`.
    """
    candidates = [lens for lens in lenses if lens.camera == photo.camera]
    if not candidates or photo.focal_length_mm is None:
        return None
    focal_mm = photo.focal_length_mm
    nearest = min(candidates, key=lambda lens: max(lens.focal_length_mm - focal_mm, focal_mm - lens.longest_focal_mm))
    return nearest if nearest.is_of(focal_mm) else None


def why_cropped(photo: PhotoFacts, lens: Lens | None) -> str | None:
    """Tell why a photo is a digital crop.

    Args:
        photo: what it states.
        lens: its lens, from a set of photos of which one at least is uncropped.

    Returns:
        The reason, or None where nothing speaks for it.
    """
    if photo.digital_zoom_ratio is not None and photo.digital_zoom_ratio > _ZOOM_TOLERANCE:
        return f"a digital crop: DigitalZoomRatio is {photo.digital_zoom_ratio:.2f}"
    if lens is None or lens.crop_35 is None or lens.f35_mm is None or photo.crop_35 is None or photo.f35_mm is None:
        return None
    # A lens that states several focal lengths changes one of the two without any crop.
    if photo.crop_35 > lens.crop_35 * _CROP_TOLERANCE and photo.f35_mm > lens.f35_mm * _CROP_TOLERANCE:
        return (
            f"a digital crop of the {photo.focal_length_mm:g} mm lens: {photo.f35_mm:g} mm equivalent, "
            f"where other photos of it have {lens.f35_mm:.0f}"
        )
    return None


def check_lenses(captures: Sequence[Capture]) -> tuple[Problem, ...]:
    """Find captures whose photos do not come from two lenses of one phone, by their EXIF.

    Args:
        captures: all of a set: a lens is known by its other photos.

    Returns:
        What is wrong, by capture: a digital crop is left out (``is_skipped``), different cameras and one lens for both
        are said only. Photos without EXIF raise no problem.
    """
    facts = {path: _facts(path) for capture in captures for path in (capture.tele_path, capture.wide_path)}
    lenses = find_lenses(facts.values())
    return tuple(problem for capture in captures for problem in _check_capture(capture, facts, lenses))


def with_checked_lenses(captures: CaptureSet) -> CaptureSet:
    """Leave out captures whose tele photo is a digital crop; see `check_lenses`.

    Args:
        captures: what was found.

    Returns:
        The captures that are left, perhaps none, and what was found among the problems.
    """
    problems = check_lenses(captures.captures)
    refused = {problem.name for problem in problems if problem.is_skipped}
    left = tuple(capture for capture in captures.captures if capture.name not in refused)
    return dataclasses.replace(captures, captures=left, problems=(*captures.problems, *problems))


def _check_capture(capture: Capture, facts: Mapping[Path, PhotoFacts], lenses: Sequence[Lens]) -> Iterable[Problem]:
    tele, wide = facts[capture.tele_path], facts[capture.wide_path]
    is_one_lens = _is_one_lens(tele, wide, lenses)
    if is_one_lens and (fake := _why_fake(tele, wide)):
        yield Problem(capture.name, f"{capture.tele_path} is no tele photo but {fake}")
        return
    for path, photo in ((capture.tele_path, tele), (capture.wide_path, wide)):
        if reason := why_cropped(photo, lens_of(photo, lenses)):
            yield Problem(capture.name, f"{path} is {reason}; photograph without digital zoom")
            return
    if doubt := _doubt(tele, wide, is_one_lens=is_one_lens):
        yield Problem(capture.name, f"{capture.tele_path} and {capture.wide_path} {doubt}", is_skipped=False)


def _why_fake(tele: PhotoFacts, wide: PhotoFacts) -> str | None:
    """Tell why a tele photo is a crop of the lens that took the wide one."""
    if tele.f35_mm is None or wide.f35_mm is None or tele.f35_mm <= wide.f35_mm * _CROP_TOLERANCE:
        return None
    return (
        f"a digital crop of the wide lens: {_stated(tele, wide)}, with {tele.f35_mm:g} and {wide.f35_mm:g} mm "
        "equivalent; step back or give more light, so that the phone uses its tele lens"
    )


def _stated(tele: PhotoFacts, wide: PhotoFacts) -> str:
    """The focal lengths of two photos of one lens."""
    if tele.focal_length_mm == wide.focal_length_mm:
        return f"both state {tele.focal_length_mm:g} mm"
    return f"they state {tele.focal_length_mm:g} and {wide.focal_length_mm:g} mm"


def _doubt(tele: PhotoFacts, wide: PhotoFacts, *, is_one_lens: bool) -> str | None:
    if "unknown" not in (tele.camera, wide.camera) and tele.camera != wide.camera:
        return f"were taken with different cameras: {tele.camera}, {wide.camera}"
    if is_one_lens:
        return f"{_stated(tele, wide)}: are they from two lenses?"
    if (tele.kind == "raw") != (wide.kind == "raw"):
        return "are a RAW and a processed photo, whose lens distortion differs"
    return None


def _is_one_lens(first: PhotoFacts, second: PhotoFacts, lenses: Sequence[Lens]) -> bool:
    lens = lens_of(first, lenses)
    return lens is not None and lens == lens_of(second, lenses)


def _focal_groups(photos: Sequence[PhotoFacts]) -> list[list[PhotoFacts]]:
    """Split the photos of one camera where the focal length jumps, but not where one field of view stays."""
    groups: list[list[PhotoFacts]] = []
    for photo in sorted(photos, key=lambda photo: photo.focal_length_mm or 0.0):
        if groups and _is_next(groups[-1][-1], photo, tolerance=_SAME_FOCAL):
            groups[-1].append(photo)
        else:
            groups.append([photo])
    lenses: list[list[PhotoFacts]] = []
    for group in groups:
        if (
            lenses
            and _is_next(lenses[-1][-1], group[0], tolerance=_SAME_LENS_FOCAL)
            and _is_one_view(lenses[-1], group)
        ):
            lenses[-1] += group
        else:
            lenses.append(group)
    return lenses


def _is_next(photo: PhotoFacts, longer: PhotoFacts, *, tolerance: float) -> bool:
    return (longer.focal_length_mm or 0.0) <= (photo.focal_length_mm or 0.0) * (1 + tolerance)


def _is_one_view(first: Sequence[PhotoFacts], second: Sequence[PhotoFacts]) -> bool:
    """Whether two groups have one field of view where it is widest; False where one does not state it."""
    widest = [min((photo.f35_mm for photo in group if photo.f35_mm), default=None) for group in (first, second)]
    if widest[0] is None or widest[1] is None:
        return False
    return abs(widest[0] - widest[1]) <= _SAME_F35 * max(widest[0], widest[1])


def _lens(camera: str, photos: Sequence[PhotoFacts]) -> Lens:
    focal_mm = [photo.focal_length_mm for photo in photos if photo.focal_length_mm]
    return Lens(
        camera,
        min(focal_mm),
        max(focal_mm),
        crop_35=min((photo.crop_35 for photo in photos if photo.crop_35), default=None),
        f35_mm=min((photo.f35_mm for photo in photos if photo.f35_mm), default=None),
    )


def _facts(path: Path) -> PhotoFacts:
    try:
        return read_photo_facts(path)
    except TelewideError:  # reading the photo says so in its own words
        return PhotoFacts("unknown")
