"""Which photo format a file has, and its bytes.

The content decides before the suffix does: phones hand out JPEGs named .heic. What TIFF-like content is (a TIFF, a DNG,
another RAW) is told by the suffix and the tag DNGVersion.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

from telewide.errors import InputError
from telewide.records import open_regular

if TYPE_CHECKING:
    import tifffile

PhotoFormat = Literal["JPEG", "PNG", "TIFF", "HEIF", "AVIF", "RAW"]

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
RAW_SUFFIXES = frozenset(
    {
        *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos", ".mrw"),
        *(".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
    }
)
HEIF_SUFFIXES = frozenset({".heic", ".heif", ".hif", ".avif"})
PHOTO_SUFFIXES = IMAGE_SUFFIXES | RAW_SUFFIXES | HEIF_SUFFIXES

TIFF_MAGICS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
TAG_DNG_VERSION = 50706

# What parsing a damaged file can raise.
_DAMAGES = (ValueError, OSError, IndexError, KeyError, TypeError, AttributeError, ZeroDivisionError, OverflowError)
_PNG = b"\x89PNG\r\n\x1a\n"
_READ = "JPEG, PNG, TIFF, HEIC, DNG and other RAW are read"


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
            data = stream.read(at_most)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    if not data:
        raise InputError(f"{path} is empty (0 bytes)", hint="copy the file again from the phone")
    return data


def photo_format(path: Path, data: bytes) -> PhotoFormat:
    """Tell the format of a photo.

    Args:
        path: its suffix tells a TIFF from a RAW.
        data: its content.

    Returns:
        The format; RAW for a DNG of any suffix.

    Raises:
        InputError: no photo that can be read.
    """
    kind = format_by_head(path, data)
    return "RAW" if kind == "TIFF" and _is_dng(data) else kind


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
    is_raw_name = path.suffix.lower() in RAW_SUFFIXES
    if head[4:8] == b"ftyp" and head[8:12] != b"crx " and not is_raw_name:
        return "AVIF" if head[8:12] in {b"avif", b"avis"} else "HEIF"
    if is_raw_name or head[4:8] == b"ftyp":
        return "RAW"
    if head.startswith(TIFF_MAGICS):
        return "TIFF"
    raise InputError(f"{path} is no photo that can be read; {_READ}", hint="export it as JPEG, PNG or TIFF")


@contextmanager
def open_tiff(stream: BinaryIO) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF, a DNG, or a RAW that is built like one, without tifffile's remarks on what cameras write.

    Args:
        stream: the file, open for reading.

    Yields:
        The open file.

    Raises:
        InputError: it cannot be parsed.
    """
    import tifffile

    remarks = logging.getLogger("tifffile")
    was_disabled, remarks.disabled = remarks.disabled, True
    try:
        with tifffile.TiffFile(stream) as tiff:
            yield tiff
    except (tifffile.TiffFileError, struct.error, *_DAMAGES) as error:
        raise InputError(f"not built like a TIFF: {error}") from error
    finally:
        remarks.disabled = was_disabled


def _is_dng(data: bytes) -> bool:
    try:
        with open_tiff(BytesIO(data)) as tiff:
            return TAG_DNG_VERSION in tiff.pages.first.tags
    except InputError:
        return False  # damaged: its decoder says so in its own words
