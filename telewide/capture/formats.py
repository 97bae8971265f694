"""Format of a photo file, and its bytes.

The content decides before the suffix does: phones hand out JPEGs named .heic. What TIFF-like content is (a TIFF, a DNG,
another RAW) is told by the suffix and the tag DNGVersion.
"""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

from telewide.capture.tiff_tags import MOST_DIRECTORIES, check_directories
from telewide.errors import InputError
from telewide.files import open_regular
from telewide.ranges import MAX_FILE_BYTES, MAX_PACKED_BYTES

if TYPE_CHECKING:
    import tifffile

PhotoFormat = Literal["JPEG", "PNG", "TIFF", "WEBP", "HEIF", "AVIF", "RAW"]

JPEG_SUFFIXES = frozenset({".jpg", ".jpeg", ".mpo"})
IMAGE_SUFFIXES = JPEG_SUFFIXES | {".png", ".tif", ".tiff", ".webp"}
RAW_SUFFIXES = frozenset(
    {
        *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos", ".mrw"),
        *(".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
    }
)
HEIF_SUFFIXES = frozenset({".heic", ".heif", ".hif", ".avif"})
PHOTO_SUFFIXES = IMAGE_SUFFIXES | RAW_SUFFIXES | HEIF_SUFFIXES
UNREAD_SUFFIXES = frozenset(
    {
        *(".bmp", ".dib", ".exr", ".gif", ".hdr", ".j2k", ".jp2", ".jpf", ".jxl", ".jxr", ".pbm", ".pgm", ".pnm"),
        *(".ppm", ".psd", ".svg", ".tga", ".xcf", ".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm"),
    }
)
"""Pictures and films that are told, not read."""
READ_KINDS = "JPEG, PNG, TIFF, WebP, HEIC, AVIF, DNG and other RAW"

HEAD_BYTES = 64
"""Of a file, by which its format is told."""
TIFF_MAGICS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
TAG_DNG_VERSION = 50706
TAG_OPCODES = {1: 51008, 2: 51009, 3: 51022}
"""Lists of corrections of a DNG, by their number."""

_PACKED = {"JPEG", "WEBP", "HEIF", "AVIF"}
# What parsing a corrupt file can raise.
_READ_ERRORS = (ValueError, OSError, IndexError, KeyError, TypeError, AttributeError, ZeroDivisionError, OverflowError)
_PNG = b"\x89PNG\r\n\x1a\n"


def read_bytes(path: Path, *, at_most: int = -1) -> bytes:
    """Read a file of the user.

    Args:
        path: the file.
        at_most: bytes from its beginning; -1 for all.

    Returns:
        Its content, never empty.

    Raises:
        UsageError: there is no such file.
        InputError: it is no regular file, is empty, or cannot be opened.
    """
    try:
        with open_regular(path) as stream:
            n_bytes = os.fstat(stream.fileno()).st_size  # so much is set aside at once
            data = stream.read(at_most if at_most < 0 else min(at_most, n_bytes + 1))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    if not data:
        raise InputError(f"{path} is empty (0 bytes)", hint="copy the file again from the phone")
    return data


def read_photo(path: Path) -> tuple[bytes, PhotoFormat]:
    """Read the file of a photo, and tell its format.

    Args:
        path: the file; its suffix tells a TIFF from a RAW.

    Returns:
        Its content and its format; RAW for a DNG of any suffix.

    Raises:
        UsageError: there is no such file.
        InputError: no photo that can be read, or too large for its format.
    """
    kind = format_by_head(path, read_bytes(path, at_most=HEAD_BYTES))
    most_bytes = MAX_PACKED_BYTES if kind in _PACKED else MAX_FILE_BYTES
    data = read_bytes(path, at_most=most_bytes + 1)
    if len(data) > most_bytes:
        raise InputError(f"{path} is larger than {most_bytes >> 20} MiB, which no photo of its format is")
    return data, "RAW" if kind == "TIFF" and _is_dng(data) else kind


def format_by_head(path: Path, head: bytes) -> PhotoFormat:
    """Tell the format of a photo by its beginning.

    Args:
        path: its suffix tells a TIFF from a RAW.
        head: its first bytes, 12 or more.

    Returns:
        The format; TIFF also for a DNG that is named .tif.

    Raises:
        InputError: no photo that can be read.
    """
    if head.startswith(b"\xff\xd8"):
        return "JPEG"
    if head.startswith(_PNG):
        return "PNG"
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return "WEBP"
    is_raw_name = path.suffix.lower() in RAW_SUFFIXES
    if head[4:8] == b"ftyp" and head[8:12] != b"crx " and not is_raw_name:
        return "AVIF" if head[8:12] in {b"avif", b"avis"} else "HEIF"
    if is_raw_name or head[4:8] == b"ftyp":
        return "RAW"
    if head.startswith(TIFF_MAGICS):
        return "TIFF"
    expected = f"{READ_KINDS} are read"
    raise InputError(f"{path} is no photo that can be read; {expected}", hint="export it as JPEG, PNG or TIFF")


@contextmanager
def open_tiff(stream: BinaryIO) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF, a DNG, or a RAW that is built like one, without tifffile's remarks on what cameras write.

    Args:
        stream: the file, open for reading.

    Yields:
        The open file.

    Raises:
        InputError: it cannot be parsed, or states what no photo needs.
    """
    import tifffile

    remarks = logging.getLogger("tifffile")
    was_disabled, remarks.disabled = remarks.disabled, True
    try:
        check_directories(stream, judged_later=TAG_OPCODES.values())
        # Files of microscopes and scanners are walked through in ways of their own.
        with tifffile.TiffFile(stream, is_lsm=False, is_scanimage=False, is_ndpi=False) as tiff:
            yield tiff
    except (tifffile.TiffFileError, struct.error, *_READ_ERRORS) as error:
        raise InputError(f"not built like a TIFF: {error}") from error
    finally:
        remarks.disabled = was_disabled


def tiff_pages(tiff: tifffile.TiffFile) -> Iterator[tifffile.TiffPage]:
    """Go through the directories of a TIFF: each page, and those below it.

    Args:
        tiff: open.

    Yields:
        Each directory once, at most 64 in all: the chain of a malicious file has no end.
    """
    import tifffile

    seen: set[int] = set()
    for above in tiff.pages:
        if above.offset in seen:
            return
        below = above.pages if isinstance(above, tifffile.TiffPage) else None
        for page in (above, *islice(below or (), MOST_DIRECTORIES)):
            if page.offset not in seen and isinstance(page, tifffile.TiffPage):
                seen.add(page.offset)
                yield page
            if len(seen) >= MOST_DIRECTORIES:
                return


def _is_dng(data: bytes) -> bool:
    try:
        with open_tiff(BytesIO(data)) as tiff:
            return TAG_DNG_VERSION in tiff.pages.first.tags
    except InputError:
        return False  # corrupt: its decoder says so in its own words
