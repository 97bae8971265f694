"""EXIF of a photo: which lens took it, when, and how (CIPA DC-008).

A lens is known by FocalLength, the physical one: LensModel has several spellings for one lens, and
FocalLengthIn35mmFilm includes digital crop. Numbers no camera has are taken as not stated.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from PIL import Image, TiffImagePlugin

from telewide.capture.formats import HEAD_BYTES, TAG_DNG_VERSION, PhotoFormat, format_by_head, open_tiff, read_bytes
from telewide.capture.pillow_photos import exif_of, open_photo
from telewide.capture.raw import stored_hw
from telewide.capture.sizes import read_hw
from telewide.capture.tiff_tags import read_tags
from telewide.errors import InputError, within_memory
from telewide.files import once_a_file, open_regular

_IFD_EXIF, _NEW_SUBFILE = 34665, 254
_MAKE, _MODEL, _ORIENTATION, _UNIQUE_MODEL = 271, 272, 274, 50708
_FOCAL_LENGTH, _F35, _DIGITAL_ZOOM, _DISTANCE = 37386, 41989, 41988, 37382
_SUBJECT_AREA, _WIDTH, _HEIGHT = 37396, 40962, 40963
# Date, its fraction of a second, its offset from UTC; the moment of exposure first.
_DATES = ((36867, 37521, 36881), (36868, 37522, 36882), (306, 37520, 36880))
_WANTED = {_MAKE, _MODEL, _ORIENTATION, _UNIQUE_MODEL, _FOCAL_LENGTH, _F35, _DIGITAL_ZOOM, _DISTANCE, TAG_DNG_VERSION}
_WANTED |= {_SUBJECT_AREA, _WIDTH, _HEIGHT}
_WANTED |= {tag for date in _DATES for tag in date}
_LONGEST_FOCAL_MM = 2000.0
_FIRST_YEAR, _LAST_YEAR = 1900, 2200
_FARTHEST_M = 10_000.0
_MOST_DIGITS, _LONGEST_TEXT = 9, 100
_INFINITY = 0xFFFFFFFF
_SAME_SHAPE = 0.02
_READ_ERRORS = (OSError, SyntaxError, ValueError, TypeError, KeyError, ZeroDivisionError, Image.DecompressionBombError)
_KINDS = {"JPEG": "jpeg", "WEBP": "jpeg", "HEIF": "jpeg", "AVIF": "jpeg", "PNG": "png", "TIFF": "tiff", "RAW": "raw"}

UPRIGHT_DEG: Mapping[int, int] = {1: 0, 6: 90, 3: 180, 8: 270}
"""Degrees clockwise from the stored photo to the upright one, by EXIF orientation; phones mirror no photo."""

Tags = Mapping[int, object]


@dataclass(frozen=True)
class PhotoFacts:
    """Facts that a photo states about itself; None where it says nothing believable.

    Attributes:
        kind: "raw", "jpeg" (WebP, HEIC and AVIF too: the same processing in the phone), "tiff" or "png".
        hw: height and width in which the photo is read, px, upright.
        make: of the phone.
        model: of the phone.
        focal_length_mm: physical: which lens.
        f35_mm: focal length of equal field of view on 36 x 24 mm, digital crop included.
        taken: moment of exposure; with a time zone where the photo states one.
        taken_step_s: what that moment is cut off to: 1 where the photo states whole seconds, 0.001 for three digits.
        orientation: EXIF orientation, 1 to 8.
        digital_zoom_ratio: 1 for none.
        subject_distance_m: where the lens was focused; inf for infinity.
        subject_uv: the place that was focused on, as shares of the upright photo's width and height.
    """

    kind: str
    hw: tuple[int, int] | None = None
    make: str | None = None
    model: str | None = None
    focal_length_mm: float | None = None
    f35_mm: float | None = None
    taken: datetime | None = None
    taken_step_s: float | None = None
    orientation: int = 1
    digital_zoom_ratio: float | None = None
    subject_distance_m: float | None = None
    subject_uv: tuple[float, float] | None = None

    @property
    def camera(self) -> str:
        """Make and model in one, the make not said twice; "unknown" where neither is stated."""
        make, model = self.make or "", self.model or ""
        both = model if model.casefold().startswith(make.casefold()) else f"{make} {model}"
        return both.strip() or make or "unknown"

    @property
    def pipeline(self) -> str:
        """See `image_pipeline`."""
        return f"{self.kind}:{self.camera}"

    @property
    def crop_35(self) -> float | None:
        """``f35 / f``: constant for a lens, larger where the photo is a digital crop."""
        return self.f35_mm / self.focal_length_mm if self.f35_mm and self.focal_length_mm else None


@once_a_file
def read_photo_facts(path: Path) -> PhotoFacts:
    """Read what a photo states about itself.

    Args:
        path: JPEG, HEIC, PNG, TIFF, DNG or another RAW that is built like a TIFF.

    Returns:
        The facts; a photo without EXIF states its size alone.

    Raises:
        UsageError: there is no such file.
        InputError: no photo.
        MissingPartError: a HEIC photo without the extra that reads it.
    """
    head = read_bytes(path, at_most=HEAD_BYTES)
    kind = format_by_head(path, head)
    with within_memory(str(path)), open_regular(path) as stream:
        if kind in {"TIFF", "RAW"}:
            tags, hw = _tags_of_tiff(stream)
            kind = "RAW" if TAG_DNG_VERSION in tags else kind
        else:
            tags, hw = _tags_of_photo(path, stream, kind)
    return _facts(_KINDS[kind], tags, hw)


def image_pipeline(path: Path) -> str:
    """Name the way from the sensor to a photo: a calibration holds for one such way only.

    Phones take the lens distortion out of JPEG and HEIC, and crop, but not of RAW.

    Args:
        path: a photo.

    Returns:
        ``<kind>:<make model>``, for instance "raw:Google Pixel 8 Pro" or "jpeg:Apple iPhone 11 Pro"; HEIC counts as
        "jpeg"; "jpeg:unknown" without EXIF.

    Raises:
        UsageError: there is no such file.
        InputError: no photo.
    """
    return read_photo_facts(path).pipeline


def pipeline_conflict(calibrated: str, found: str) -> str | None:
    """Tell why a calibration does not hold for a photo.

    Args:
        calibrated: `image_pipeline` of the calibration's photos.
        found: that of the photo.

    Returns:
        One sentence, or None where nothing speaks against it: one kind, and one camera where both name theirs.
    """
    (kind, _, camera), (found_kind, _, found_camera) = calibrated.partition(":"), found.partition(":")
    if (kind == "raw") != (found_kind == "raw"):
        return f"the calibration was made from {_spoken(kind)}, this photo is {_spoken(found_kind)}"
    if "unknown" not in (camera, found_camera) and camera != found_camera:
        return f"the calibration is of a {camera}, this photo of a {found_camera}"
    return None


def common_pipeline(paths: Iterable[Path]) -> str | None:
    """Name the one way in which all photos of a calibration were made: photos made in two ways have no rig in common.

    Args:
        paths: the photos; what is no photo has no say.

    Returns:
        `image_pipeline` of the first photo that names its camera, or of the first of all; None without photos.

    Raises:
        UsageError: there is no such file.
        InputError: two photos were made in different ways.
    """
    named: tuple[Path, str] | None = None
    for path in paths:
        try:
            found = image_pipeline(path)
        except InputError:
            continue
        if named is not None and pipeline_conflict(named[1], found) is not None:
            raise InputError(
                f"{named[0]} and {path} were not made in the same way ({named[1]}, {found}); no rig holds for both",
                hint="keep photos of one phone and of one kind, RAW or not, in the folder",
            )
        if named is None or named[1].endswith(":unknown"):
            named = path, found
    return named[1] if named is not None else None


def seconds_between(first: datetime, second: datetime) -> float:
    """Return how long after `first` `second` is, s; time zones count where both have one."""
    if (first.tzinfo is None) != (second.tzinfo is None):
        first, second = first.replace(tzinfo=None), second.replace(tzinfo=None)
    return (second - first).total_seconds()


def least_seconds_between(first: PhotoFacts, second: PhotoFacts) -> float | None:
    """Return how far apart two photos were taken at least, s: whole seconds may differ by 1 for photos taken at once.

    Args:
        first: a photo.
        second: another one.

    Returns:
        0 or more; None where one of them does not state its moment.
    """
    if first.taken is None or second.taken is None:
        return None
    step_s = max(first.taken_step_s or 0.0, second.taken_step_s or 0.0)
    return max(0.0, abs(seconds_between(first.taken, second.taken)) - step_s)


def _spoken(kind: str) -> str:
    return (
        "RAW" if kind == "raw" else f"{kind.upper()}, which the phone has processed" if kind == "jpeg" else kind.upper()
    )


def _tags_of_photo(path: Path, stream: BinaryIO, kind: PhotoFormat) -> tuple[Tags, tuple[int, int] | None]:
    """Return the tags and the stored height and width; nothing where the photo is corrupt."""
    with warnings.catch_warnings(), suppress(*_READ_ERRORS):
        warnings.simplefilter("ignore")  # Pillow's remarks on odd EXIF
        with open_photo(path, stream, kind) as photo:
            exif = exif_of(photo, stream=stream)
            found = (exif, exif.get_ifd(_IFD_EXIF))
            tags = {tag: value for ifd in found for tag in _WANTED if (value := ifd.get(tag)) is not None}
            return tags, read_hw((photo.height, photo.width))
    return {}, None


def _tags_of_tiff(stream: BinaryIO) -> tuple[Tags, tuple[int, int] | None]:
    """Return the same of a TIFF, a DNG or another RAW that is built like a TIFF."""
    tags = read_tags(stream, _WANTED)
    with suppress(InputError), open_tiff(stream) as tiff:
        first = tiff.pages.first
        is_plain = TAG_DNG_VERSION not in tags and first.tags.valueof(_NEW_SUBFILE, default=0) == 0
        return tags, read_hw((int(first.imagelength), int(first.imagewidth))) if is_plain else stored_hw(tiff)
    return tags, None


def believable_orientation(value: object) -> int:
    """Return an EXIF orientation, 1 to 8: 1, upright, for what is none.

    Args:
        value: of the tag, as a reader returns it.
    """
    number = _number(value)
    return int(number) if number is not None and 1 <= number <= 8 else 1


def _facts(kind: str, tags: Tags, hw: tuple[int, int] | None) -> PhotoFacts:
    orientation = believable_orientation(tags.get(_ORIENTATION))
    is_turned = orientation in {5, 6, 7, 8}
    zoom = _number(tags.get(_DIGITAL_ZOOM))
    taken, taken_step_s = _moment(tags)
    return PhotoFacts(
        kind=kind,
        hw=(hw[1], hw[0]) if hw and is_turned else hw,
        make=_text(tags.get(_MAKE)),
        model=_text(tags.get(_MODEL)) or _text(tags.get(_UNIQUE_MODEL)),
        focal_length_mm=_within(_number(tags.get(_FOCAL_LENGTH)), _LONGEST_FOCAL_MM),
        f35_mm=_within(_number(tags.get(_F35)), _LONGEST_FOCAL_MM),
        taken=taken,
        taken_step_s=taken_step_s,
        orientation=orientation,
        digital_zoom_ratio=1.0 if zoom == 0 else zoom,  # 0 states that there was none
        subject_distance_m=_distance_m(tags.get(_DISTANCE)),
        subject_uv=_subject_uv(tags, hw, orientation=orientation),
    )


def _subject_uv(tags: Tags, hw: tuple[int, int] | None, *, orientation: int) -> tuple[float, float] | None:
    """Centre of SubjectArea: a point, circle or box in pixels of the photo as it is stored (CIPA DC-008, 4.6.5).

    Of another shape than the photo, the sizes that EXIF states are those before somebody cut or turned it.
    """
    area = tags.get(_SUBJECT_AREA)
    if not isinstance(area, tuple | list) or not 2 <= len(area) <= 4 or hw is None:
        return None
    x, y, width, height = (_number(value) for value in (*area[:2], tags.get(_WIDTH, hw[1]), tags.get(_HEIGHT, hw[0])))
    if x is None or y is None or not width or not height:
        return None
    is_same_shape = abs(width * hw[0] / (height * hw[1]) - 1) < _SAME_SHAPE
    u, v = (x + 0.5) / width, (y + 0.5) / height
    if not (is_same_shape and 0 < u < 1 and 0 < v < 1):
        return None
    u, v = (v, u) if orientation in {5, 6, 7, 8} else (u, v)
    return 1 - u if orientation in {2, 3, 6, 7} else u, 1 - v if orientation in {3, 4, 7, 8} else v


def _fraction(value: object) -> tuple[float, float] | None:
    """Return numerator and denominator of what the readers return for a number."""
    if isinstance(value, tuple | list) and len(value) == 1:
        value = value[0]
    if isinstance(value, tuple | list) and len(value) == 2 and all(isinstance(part, int | float) for part in value):
        return float(value[0]), float(value[1])
    if isinstance(value, TiffImagePlugin.IFDRational):
        return float(value.numerator), float(value.denominator)
    return (float(value), 1.0) if isinstance(value, int | float) else None


def _number(value: object) -> float | None:
    fraction = _fraction(value)
    if fraction is None or fraction[1] == 0:
        return None
    with suppress(OverflowError):
        number = fraction[0] / fraction[1]
        return number if math.isfinite(number) else None
    return None


def _within(value: float | None, limit: float) -> float | None:
    return value if value is not None and 0 < value < limit else None


def _distance_m(value: object) -> float | None:
    fraction = _fraction(value)
    if fraction is not None and fraction[0] == _INFINITY:
        return math.inf
    return _within(_number(value), _FARTHEST_M)


def _text(value: object) -> str | None:
    """Return a text of one line, without the padding some cameras write."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    return (" ".join(value.replace("\0", " ").split())[:_LONGEST_TEXT] or None) if isinstance(value, str) else None


def _moment(tags: Tags) -> tuple[datetime | None, float | None]:
    """Return the moment of exposure, and what it is cut off to, s."""
    for date_tag, fraction_tag, offset_tag in _DATES:
        date = _text(tags.get(date_tag))
        if not date:
            continue
        try:
            taken = datetime.strptime(date, "%Y:%m:%d %H:%M:%S")
        except ValueError:
            continue
        if not _FIRST_YEAR <= taken.year <= _LAST_YEAR:
            continue
        fraction = _text(tags.get(fraction_tag)) or ""
        digits = fraction[:_MOST_DIGITS] if fraction.isascii() and fraction.isdecimal() else ""
        taken += timedelta(seconds=float(f"0.{digits}0"))
        with suppress(ValueError):
            taken = taken.replace(tzinfo=datetime.strptime(_text(tags.get(offset_tag)) or "", "%z").tzinfo)
        return taken, 10.0 ** -len(digits)
    return None, None
