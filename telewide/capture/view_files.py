"""Files of a folder that show views: which a person put there, which belong together, which of several is taken.

Letter case does not matter, hidden files are not looked at. Of a RAW and its JPEG twin the RAW is taken, if every view
has one: the distortion of the two differs.
"""

from __future__ import annotations

import filecmp
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from telewide.capture.formats import HEIF_SUFFIXES, PHOTO_SUFFIXES, RAW_SUFFIXES, UNREAD_SUFFIXES
from telewide.errors import InputError
from telewide.files import is_file
from telewide.ranges import MAX_FILE_BYTES

VIEWS = ("tele", "wide")
# Of two files for one view the one that lost less is taken.
_SUFFIX_ORDER = (
    *(*sorted(RAW_SUFFIXES), ".tif", ".tiff", ".png"),
    *(*sorted(HEIF_SUFFIXES), ".webp", ".jpg", ".jpeg", ".mpo"),
)
_MAX_LISTED = 5

FilesByView = Mapping[str, Sequence[Path]]


def visible_entries(folder: Path) -> list[Path]:
    """Return the entries a person put there, sorted: no hidden files, nothing an archiver added.

    Raises:
        InputError: the folder cannot be opened.
    """
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder} cannot be opened: {error.strerror or error}") from error
    return [entry for entry in entries if not entry.name.startswith((".", "__MACOSX"))]


def is_picture(path: Path) -> bool:
    """Whether it is a file named like a photo or a film, of any kind that is read or told."""
    return path.suffix.lower() in PHOTO_SUFFIXES | UNREAD_SUFFIXES and is_file(path)


def is_photo_name(path: Path) -> bool:
    """Whether it is named like a photo that is read."""
    return path.suffix.lower() in PHOTO_SUFFIXES


def one_spelling(name: str) -> str:
    """Return one spelling for names that look the same: file systems disagree on composed letters."""
    return unicodedata.normalize("NFC", name)


def joined_by_case(groups: Mapping[str, Mapping[str, list[Path]]]) -> dict[str, dict[str, list[Path]]]:
    """Join groups of files whose names differ by letter case alone, where each has what the others miss.

    Args:
        groups: by name: files by role, tele and wide among the roles.

    Returns:
        The groups; a joined one has the name of that with the tele photo.
    """
    by_fold: dict[str, list[str]] = defaultdict(list)
    for name in sorted(groups):
        by_fold[name.casefold()].append(name)
    joined: dict[str, dict[str, list[Path]]] = {}
    for names in by_fold.values():
        roles = [role for name in names for role in groups[name]]
        if len(set(roles)) < len(roles):
            joined |= {name: dict(groups[name]) for name in names}
        else:
            named = next((name for name in names if "tele" in groups[name]), names[0])
            joined[named] = {role: files for name in names for role, files in groups[name].items()}
    return joined


def photos_among(paths: Iterable[Path]) -> list[Path]:
    """Return the photos among files, the one that lost least first."""
    return sorted(filter(is_photo_name, paths), key=lambda path: (_SUFFIX_ORDER.index(path.suffix.lower()), str(path)))


def best_photos(files: FilesByView) -> dict[str, Path]:
    """Choose the photo that lost least of each view; where there is a choice all are RAW or none is.

    Args:
        files: by view.

    Returns:
        A photo for each view that has one.
    """
    photos = {view: found for view, paths in files.items() if (found := photos_among(paths))}
    if not all(is_raw(found[0]) for found in photos.values()):
        photos = {view: [path for path in found if not is_raw(path)] or found for view, found in photos.items()}
    return {view: found[0] for view, found in photos.items()}


def passed_over(taken: Path, paths: Iterable[Path]) -> list[Path]:
    """Return the photos of a view that are not taken, but for the twin a phone writes: of a RAW a JPEG or HEIC."""
    return [
        path
        for path in photos_among(paths)
        if path != taken and (path.stem != taken.stem or is_raw(path) == is_raw(taken))
    ]


def is_raw(path: Path) -> bool:
    """Whether it is named like a RAW photo."""
    return path.suffix.lower() in RAW_SUFFIXES


def is_same_file(first: Path, second: Path) -> bool:
    """Tell whether two paths lead to one file, or to two files with the same bytes; those too large to be read differ.

    Args:
        first: an existing file.
        second: an existing file.
    """
    try:
        if first.samefile(second):
            return True
        is_read = first.stat().st_size <= MAX_FILE_BYTES
        return is_read and filecmp.cmp(first, second, shallow=False)
    except OSError:  # one of them cannot be opened: reading it says so in its own words
        return False


def listed(paths: Iterable[Path]) -> str:
    """Name some files, and how many more there are."""
    names = [path.name for path in paths]
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return ", ".join(names[:_MAX_LISTED]) + more
