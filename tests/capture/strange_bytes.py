"""Photos that no camera writes, in a few bytes."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import tifffile


def looped_tiff(*, n_directories: int = 1) -> bytes:
    """A TIFF whose directories follow each other round in a circle."""
    data = struct.pack("<2sHI", b"II", 42, 8)
    for number in range(n_directories):
        following = 8 + 18 * ((number + 1) % n_directories)
        data += struct.pack("<HHHIHHI", 1, 254, 4, 1, 1, 0, following)
    return data


def png_of_size(width: int, height: int) -> bytes:
    """The head of a PNG, and next to nothing after it."""
    chunks = [b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0), b"IDAT" + zlib.compress(bytes(100))]
    packed = [struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def overwrite_tag(path: Path, code: int, value: int) -> None:
    """Change a number in the first directory of a TIFF, as LONG."""
    with tifffile.TiffFile(path) as tiff:
        offset, order = tiff.pages.first.tags[code].offset, tiff.byteorder
    data = bytearray(path.read_bytes())
    struct.pack_into(f"{order}HII", data, offset + 2, 4, 1, value)
    path.write_bytes(data)


def progressive_jpeg(*, n_scans: int) -> bytes:
    """64 x 64 px of grey: the means of its blocks, then scans that add nothing to them."""
    tables = b"\xff\xdb\x00\x43\x00" + bytes([16] * 64)
    tables += b"\xff\xc2" + struct.pack(">HBHHB", 11, 8, 64, 64, 1) + bytes([1, 0x11, 0])
    tables += b"\xff\xc4" + struct.pack(">H", 20) + bytes([0x00, 1, *[0] * 15, 0])
    tables += b"\xff\xc4" + struct.pack(">H", 20) + bytes([0x10, 1, *[0] * 15, 0xE0])  # 2^14 blocks end here
    means = b"\xff\xda" + struct.pack(">HB", 8, 1) + bytes([1, 0, 0, 0, 0]) + bytes(8)
    nothing = b"\xff\xda" + struct.pack(">HB", 8, 1) + bytes([1, 0, 1, 63, 0]) + b"\x00\x01"
    return b"\xff\xd8" + tables + means + nothing * (n_scans - 1) + b"\xff\xd9"
