"""Whether the file of a photo is whole: a copy that was cut off still states its lens and its time."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

from telewide.capture.exif import PhotoFacts
from telewide.capture.formats import read_photo
from telewide.capture.jpeg import has_too_many_scans
from telewide.capture.pillow_photos import load_photo, open_photo
from telewide.errors import InputError

CORRUPT = "cannot be read: the file is cut off or corrupt; copy it again from the phone"
_COARSE_PX = (16, 16)


def why_corrupt(path: Path, facts: PhotoFacts) -> str | None:
    """Tell what is wrong with the file of a photo.

    A JPEG is decoded, at an eighth of its size, which takes a fraction of the time; of other photos only what they
    state is looked at.

    Args:
        path: the photo.
        facts: what it states.

    Returns:
        What to tell its owner; None where nothing was found.
    """
    if facts.kind != "raw" and facts.hw is None:
        return CORRUPT
    try:
        return CORRUPT if facts.kind == "jpeg" and not _is_whole_jpeg(path) else None
    except InputError as error:
        return error.message.removeprefix(f"{path} ")


def _is_whole_jpeg(path: Path) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's remarks on odd EXIF and on large photos
            data, kind = read_photo(path)
            if kind != "JPEG":
                return True  # HEIC, which counts as JPEG elsewhere
            if has_too_many_scans(data):
                return False
            with open_photo(path, BytesIO(data), "JPEG") as photo:
                photo.draft("L", _COARSE_PX)
                load_photo(photo)
    except (OSError, SyntaxError, ValueError):
        return False
    return True
