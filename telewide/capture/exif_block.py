"""EXIF as a JPEG holds it, a small TIFF behind six letters: its types, and its directories inside a TIFF.

Letters of `struct`: H of 16 bits, I of 32.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

IFD_EXIF, IFD_GPS = 34665, 34853
_LETTERS = 6  # "Exif\0\0"; places in EXIF count from behind them
_UNDEFINED = {IFD_EXIF: {34856, 36864, 37121, 37510, 40960, 41728, 41729, 41730, 41995}, IFD_GPS: {27, 28}}
_SIGNED = {37377, 37379, 37380}  # ShutterSpeedValue, BrightnessValue, ExposureBiasValue
_BYTES_OF_TYPE = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
_ENTRY, _LONG = 12, 4
_MOST_INSIDE = 4  # bytes of a value that stands in the entry itself


def with_exif_types(exif: bytes) -> bytes:
    """Give tags the types of EXIF (CIPA DC-008, 4.6.2): Pillow writes some of type 7 as 1, and some of 10 as 5."""
    patched = bytearray(exif)
    order = "<" if exif[_LETTERS : _LETTERS + 2] == b"II" else ">"
    for directory, below in _directories(exif, order).items():
        for tag, kind, at in _entries(exif, order, below):
            if kind == 1 and tag in _UNDEFINED[directory]:
                struct.pack_into(f"{order}H", patched, at + 2, 7)
            elif kind == 5 and tag in _SIGNED and _is_signed_fraction(exif, order, at):
                struct.pack_into(f"{order}H", patched, at + 2, 10)
    return bytes(patched)


def append_directories(tiff: BinaryIO, exif: bytes) -> None:
    """Put EXIF and GPS behind a TIFF of one page, and a first directory that leads to them in place of the one it has.

    Args:
        tiff: the file, little-endian, with places of 32 bits, open for reading and writing.
        exif: little-endian, with the six letters before it.
    """
    end = tiff.seek(0, 2)
    start = end + end % 2  # directories begin at even places
    moved = bytearray(exif[_LETTERS:])
    directories = _directories(exif, "<")
    for below in directories.values():
        for _, kind, at in _entries(exif, "<", below):
            (n_values,) = struct.unpack_from("<I", exif, at + 4)
            if n_values * _BYTES_OF_TYPE[kind] > _MOST_INSIDE:
                (place,) = struct.unpack_from("<I", exif, at + 8)
                struct.pack_into("<I", moved, at + 8 - _LETTERS, start + place)
    tiff.seek(4)
    (first,) = struct.unpack("<I", tiff.read(4))
    tiff.seek(first)
    (count,) = struct.unpack("<H", tiff.read(2))
    entries = [tiff.read(_ENTRY) for _ in range(count)]
    entries += [struct.pack("<HHII", tag, _LONG, 1, start + below) for tag, below in directories.items()]
    entries.sort(key=lambda entry: struct.unpack_from("<H", entry))
    next_one = tiff.read(4)
    tiff.seek(end)
    tiff.write(bytes(end % 2) + moved + bytes(len(moved) % 2))
    anew = tiff.tell()
    tiff.write(struct.pack("<H", len(entries)) + b"".join(entries) + next_one)
    tiff.seek(4)
    tiff.write(struct.pack("<I", anew))


def _directories(exif: bytes, order: str) -> dict[int, int]:
    """Places of the EXIF and GPS directories by their tags."""
    (first,) = struct.unpack_from(f"{order}I", exif, _LETTERS + 4)
    return {
        tag: struct.unpack_from(f"{order}I", exif, at + 8)[0]
        for tag, _, at in _entries(exif, order, first)
        if tag in _UNDEFINED
    }


def _entries(exif: bytes, order: str, directory: int) -> Iterator[tuple[int, int, int]]:
    """Tag, type and place of each entry, this counted from the six letters."""
    (count,) = struct.unpack_from(f"{order}H", exif, directory + _LETTERS)
    for place in range(directory + 8, directory + 8 + _ENTRY * count, _ENTRY):
        yield *struct.unpack_from(f"{order}HH", exif, place), place


def _is_signed_fraction(exif: bytes, order: str, entry: int) -> bool:
    (place,) = struct.unpack_from(f"{order}I", exif, entry + 8)
    return bool(max(struct.unpack_from(f"{order}II", exif, place + _LETTERS)) < 1 << 31)
