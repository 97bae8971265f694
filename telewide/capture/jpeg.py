"""Scans of a JPEG. A progressive one may hold any number, each of which is a walk over all pixels of the photo.

A file of a few megabytes can ask for hours: "Two Issues with the JPEG Standard", libjpeg-turbo, 2013.
"""

from __future__ import annotations

import re

from telewide.ranges import MAX_SCANS

_SOS, _EOI = 0xDA, 0xD9
# Within a scan 0xff is followed by a stuffed 0, by a mark of restart, or by more 0xff.
_NEXT_MARKER = re.compile(b"\xff[^\x00\xd0-\xd7\xff]")


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
