"""Zip archives that somebody else wrote: those of numpy and of torch.

Python builds an object of every entry when it opens one, so their number is limited by the length of the archive's
index, which is at its end. Format: APPNOTE.TXT 6.3.10 of PKWARE, 4.3.14 to 4.3.16.
"""

from __future__ import annotations

import struct
import zipfile
from typing import BinaryIO

MOST_INDEX_BYTES = 1 << 20
"""Of some ten thousand entries; a checkpoint of the largest network has two thousand."""
_END, _END_64, _LOCATOR_64 = struct.Struct("<4s4H2IH"), struct.Struct("<4sQ2H2I4Q"), struct.Struct("<4sIQI")
_LONGEST_COMMENT = 1 << 16


def open_archive(stream: BinaryIO) -> zipfile.ZipFile:
    """Open a zip archive whose index is of believable length.

    Args:
        stream: the file, open for reading; the archive does not close it.

    Returns:
        The archive, to be closed by the caller.

    Raises:
        ValueError: its index is too long.
        zipfile.BadZipFile: it is no archive.
    """
    n_bytes = _index_bytes(stream)
    if n_bytes > MOST_INDEX_BYTES:
        raise ValueError(f"an archive with {n_bytes} bytes of names")
    return zipfile.ZipFile(stream)


def _index_bytes(stream: BinaryIO) -> int:
    """Length of the index as its end states it; where it is not found, `zipfile` finds none either."""
    length = stream.seek(0, 2)
    first = stream.seek(max(0, length - _END.size - _LONGEST_COMMENT))
    tail = stream.read(length - first)
    at = len(tail) - _END.size
    if at < 0:
        return 0
    if not (tail.startswith(b"PK\5\6", at) and tail.endswith(b"\0\0")):  # not at the very end: a comment follows
        at = tail.rfind(b"PK\5\6")
    if at < 0 or at + _END.size > len(tail):
        return 0
    _, *_, stated, _, _ = _END.unpack_from(tail, at)
    return _index_bytes_64(stream, first + at) or int(stated)


def _index_bytes_64(stream: BinaryIO, end: int) -> int:
    """Length that an archive of 64 bits states before its end; 0 for one without."""
    if end < _LOCATOR_64.size + _END_64.size:
        return 0
    stream.seek(end - _LOCATOR_64.size)
    mark, *_ = _LOCATOR_64.unpack(stream.read(_LOCATOR_64.size))
    stream.seek(end - _LOCATOR_64.size - _END_64.size)  # where zipfile looks for it
    record = _END_64.unpack(stream.read(_END_64.size))
    return int(record[8]) if mark == b"PK\6\7" and record[0] == b"PK\6\6" else 0
