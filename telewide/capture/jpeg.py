"""Segments and scans of a JPEG (ITU-T T.81, annex B), of which it may hold any number.

Pillow looks at each byte before the pixels, libjpeg at all pixels for each scan. A file of a few megabytes can ask for
hours: "Two Issues with the JPEG Standard", libjpeg-turbo, 2013.
"""

from __future__ import annotations

import os
import re
from typing import BinaryIO

from telewide.ranges import MAX_SCANS

MOST_SEGMENTS = 1 << 12
"""Before the pixels; a phone that writes depth into them needs some hundreds, of 64 kB each."""
_MOST_STRANGE_BYTES = 1 << 16
_SOS, _EOI = 0xDA, 0xD9
_WITHOUT_LENGTH = {0x01, 0xD8, *range(0xD0, 0xD8)}
# Within a scan 0xff is followed by a stuffed 0, by a mark of restart, or by more 0xff.
_NEXT_MARKER = re.compile(b"\xff[^\x00\xd0-\xd7\xff]")


def check_jpeg_head(stream: BinaryIO) -> None:
    """Refuse a JPEG that has its decoder walk through more than any phone writes before the pixels.

    Args:
        stream: the file, open for reading; it is left at its beginning.

    Raises:
        ValueError: there are too many segments, too much between them, or no pixels.
    """
    n_strange = 0
    stream.seek(2)
    for _ in range(MOST_SEGMENTS):
        marker, n_skipped = _next_marker(stream, most_bytes=_MOST_STRANGE_BYTES - n_strange)
        n_strange += n_skipped
        if marker in {_SOS, _EOI}:
            stream.seek(0)
            return
        if marker not in _WITHOUT_LENGTH:
            length = int.from_bytes(stream.read(2), "big")
            stream.seek(max(0, length - 2), os.SEEK_CUR)
    raise ValueError(f"more than {MOST_SEGMENTS} segments come before the pixels")


def _next_marker(stream: BinaryIO, *, most_bytes: int) -> tuple[int, int]:
    """The next marker, and how many bytes come before it: 0xff is one of them, and may be repeated."""
    is_marked = False
    for n_skipped in range(most_bytes):
        byte = stream.read(1)
        if not byte:
            raise ValueError("it ends before the pixels")
        if is_marked and byte not in {b"\x00", b"\xff"}:
            return byte[0], n_skipped
        is_marked = byte == b"\xff"
    raise ValueError(f"more than {_MOST_STRANGE_BYTES} bytes lie between its segments")


def has_too_many_scans(data: bytes) -> bool:
    """Tell whether a JPEG asks for more scans than any encoder makes.

    Args:
        data: the file.

    Returns:
        True for more than `MAX_SCANS` in its first picture; films and previews that phones append do not count.
    """
    if data.count(bytes((0xFF, _SOS))) <= MAX_SCANS:
        return False
    n_scans, at = 0, 2
    while n_scans <= MAX_SCANS and (found := _NEXT_MARKER.search(data, at)):
        marker, at = found[0][1], found.end()
        if marker == _EOI:
            return False
        n_scans += marker == _SOS
        at += int.from_bytes(data[at : at + 2], "big")  # what a segment holds may look like a marker
    return n_scans > MAX_SCANS
