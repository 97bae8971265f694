"""Chunks of a PNG, walked through without looking into them (PNG, third edition, 5.3)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

MOST_CHUNKS_BEFORE = 1 << 12
"""Of the pixels; programs write some ten."""
_MOST_CHUNKS = 1 << 18


def check_png_head(stream: BinaryIO) -> None:
    """Refuse a PNG that has its decoder walk through more than any program writes before the pixels.

    Args:
        stream: the file, open for reading; it is left at its beginning.

    Raises:
        ValueError: there are too many chunks.
    """
    for number, (kind, _) in enumerate(_chunks(stream)):
        if kind == b"IDAT":
            break
        if number >= MOST_CHUNKS_BEFORE:
            raise ValueError(f"more than {MOST_CHUNKS_BEFORE} chunks come before the pixels")
    stream.seek(0)


def exif_of_png(stream: BinaryIO, *, most_bytes: int) -> bytes:
    """Return the content of the chunk eXIf, wherever it stands; empty without one, or where it is too long.

    Args:
        stream: the file, open for reading.
        most_bytes: of the content.
    """
    found = next((length for kind, length in _chunks(stream) if kind == b"eXIf"), 0)
    return stream.read(found) if found <= most_bytes else b""


def _chunks(stream: BinaryIO) -> Iterator[tuple[bytes, int]]:
    """Kind and length of each chunk, with the stream at its content."""
    place = 8
    for _ in range(_MOST_CHUNKS):
        stream.seek(place)
        head = stream.read(8)
        if len(head) < 8:
            return
        length = int.from_bytes(head[:4], "big")
        yield head[4:], length
        place += length + 12  # with its check sum
