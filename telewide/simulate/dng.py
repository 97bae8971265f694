"""Simulated photos as a phone writes them: RAW as DNG, developed as JPEG, both with EXIF.

The DNG (specification 1.4) holds the mosaic uncompressed, what turns it into colours, and the lens shading as a GainMap
in OpcodeList2. TIFF 6.0 little endian; opcode lists are big endian, as the specification wants them.
Letters: H W photo; V U rows and columns of a gain map; M its planes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, TiffImagePlugin

from telewide.files import replacing
from telewide.geometry.arrays import FloatImage
from telewide.simulate.sensor import RawFrame, Sensor, vignetting_at

Values = Sequence[int | float]

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL = 1, 2, 3, 4, 5, 7, 10
_PACKING = {_SHORT: "H", _LONG: "I", _RATIONAL: "I", _SRATIONAL: "i"}
_ENTRY_BYTES = 12
_CFA, _D65, _EXIF_IFD = 32803, 21, 34665
_MAKE, _MODEL, _DATE = 271, 272, 306
_EXIF_VERSION, _DATE_ORIGINAL, _OFFSET_ORIGINAL, _SUBSEC_ORIGINAL = 36864, 36867, 36881, 37521
_DISTANCE, _FOCAL_LENGTH, _F35 = 37382, 37386, 41989
_OPCODE_VERSION = 0x01030000
_GAIN_MAP = 9
_GAIN_POINTS_VU = (13, 17)
_INFINITY = 0xFFFFFFFF
_LARGEST_DENOMINATOR = 100_000  # numerators of up to 20 km stay within 32 bits
# CIE XYZ of linear sRGB under D65 (IEC 61966-2-1).
_XYZ_FROM_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@dataclass(frozen=True)
class ExifFacts:
    """Notes of a phone beside a photo.

    Attributes:
        make: of the phone.
        model: of the phone.
        focal_length_mm: physical: which lens.
        f35_mm: focal length of equal field of view on 36 x 24 mm; EXIF holds whole mm.
        taken: moment of exposure; its fractions of a second and time zone are written too.
        subject_distance_m: where the lens was focused, inf for infinity; None where the phone does not say.
    """

    make: str
    model: str
    focal_length_mm: float
    f35_mm: float
    taken: datetime
    subject_distance_m: float | None = None


def write_dng(path: Path, frame: RawFrame, *, facts: ExifFacts) -> None:
    """Write what a sensor counted as a DNG, whole or not at all.

    Args:
        path: the file to write or to replace.
        frame: the mosaic and its sensor.
        facts: for EXIF.

    Raises:
        TelewideError: the place cannot be written.
    """
    mosaic = np.ascontiguousarray(frame.bayer, dtype="<u2")
    exif = [_entry(tag, kind, values) for tag, (kind, values) in _exif_tags(facts).items()]
    # The lengths do not depend on the offsets: a first layout tells where things come to lie.
    first = _ifd([*_dng_entries(frame, facts, offset=0), _entry(_EXIF_IFD, _LONG, [0])], at=8)
    exif_at = 8 + len(first)
    exif_ifd = _ifd(exif, at=exif_at)
    mosaic_at = exif_at + len(exif_ifd)
    entries = [*_dng_entries(frame, facts, offset=mosaic_at), _entry(_EXIF_IFD, _LONG, [exif_at])]
    content = struct.pack("<2sHI", b"II", 42, 8) + _ifd(entries, at=8) + exif_ifd + mosaic.tobytes()
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_jpeg(path: Path, srgb: FloatImage, *, facts: ExifFacts, quality: int = 92) -> None:
    """Write a developed photo as a JPEG with EXIF, whole or not at all.

    Args:
        path: the file to write or to replace, ending in .jpg or .jpeg.
        srgb: (H, W, 3) sRGB in [0, 1].
        facts: for EXIF.
        quality: 1 to 100.

    Raises:
        TelewideError: the place cannot be written.
    """
    exif = Image.Exif()
    exif[_MAKE], exif[_MODEL], exif[_DATE] = facts.make, facts.model, _date(facts.taken)
    for tag, (kind, values) in _exif_tags(facts).items():
        exif.get_ifd(_EXIF_IFD)[tag] = _for_pillow(kind, values)
    levels = (np.clip(srgb, 0, 1) * 255 + 0.5).astype(np.uint8)
    with replacing(path) as temporary:
        Image.fromarray(levels).save(temporary, "JPEG", quality=quality, exif=exif)


def opcode_list(*opcodes: tuple[int, bytes], flags: int = 0) -> bytes:
    """Lay opcodes out as the tags OpcodeList1 to 3 hold them.

    Args:
        opcodes: ID and parameters of each.
        flags: of all; 1 says they may be left out.
    """
    body = b"".join(struct.pack(">IIII", kind, _OPCODE_VERSION, flags, len(data)) + data for kind, data in opcodes)
    return struct.pack(">I", len(opcodes)) + body


def gain_map(
    gains: NDArray[np.float32],
    *,
    area: tuple[int, int, int, int],
    pitch: tuple[int, int] = (1, 1),
    planes: tuple[int, int] = (0, 1),
    spacing: tuple[float, float] | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
) -> tuple[int, bytes]:
    """Lay a gain map out as an opcode.

    Args:
        gains: (V, U, M).
        area: top, left, bottom, right, px.
        pitch: it works on every so many rows and columns.
        planes: first plane and number of planes.
        spacing: of the grid's rows and columns, in heights and widths; None spans the image.
        origin: of the grid, likewise.

    Returns:
        ID and parameters, for `opcode_list`.
    """
    v, u, m = gains.shape
    spacing = spacing or (1 / max(v - 1, 1), 1 / max(u - 1, 1))
    head = struct.pack(">4I2I2I2I2d2dI", *area, *planes, *pitch, v, u, *spacing, *origin, m)
    return _GAIN_MAP, head + gains.astype(">f4").tobytes()


def _dng_entries(frame: RawFrame, facts: ExifFacts, *, offset: int) -> list[tuple[int, int, int, bytes]]:
    """Every tag of the first directory but the pointer to EXIF; `offset` is that of the mosaic."""
    (height, width), sensor = frame.bayer.shape, frame.sensor
    colours = bytes("RGB".index(colour) for colour in sensor.pattern)
    camera_from_xyz = sensor.colour_matrix @ np.linalg.inv(_XYZ_FROM_SRGB)
    return [
        _entry(254, _LONG, [0]),  # NewSubfileType: the photo itself
        _entry(256, _LONG, [width]),
        _entry(257, _LONG, [height]),
        _entry(258, _SHORT, [16]),
        _entry(259, _SHORT, [1]),  # no compression
        _entry(262, _SHORT, [_CFA]),
        _entry(_MAKE, _ASCII, facts.make),
        _entry(_MODEL, _ASCII, facts.model),
        _entry(273, _LONG, [offset]),
        _entry(274, _SHORT, [1]),
        _entry(277, _SHORT, [1]),
        _entry(278, _LONG, [height]),
        _entry(279, _LONG, [2 * height * width]),
        _entry(284, _SHORT, [1]),
        _entry(_DATE, _ASCII, _date(facts.taken)),
        _entry(33421, _SHORT, [2, 2]),
        _entry(33422, _BYTE, colours),
        _entry(50706, _BYTE, bytes([1, 4, 0, 0])),
        _entry(50707, _BYTE, bytes([1, 3, 0, 0])),  # the oldest reader that knows opcodes
        _entry(50708, _ASCII, f"{facts.make} {facts.model}"),
        _entry(50710, _BYTE, bytes([0, 1, 2])),  # CFAPlaneColor
        _entry(50711, _SHORT, [1]),  # CFALayout: rectangular
        _entry(50714, _SHORT, [sensor.black_level]),
        _entry(50717, _SHORT, [sensor.white_level]),
        _entry(50721, _SRATIONAL, camera_from_xyz.ravel().tolist()),
        _entry(50728, _RATIONAL, sensor.neutral),
        _entry(50778, _SHORT, [_D65]),
        _entry(51009, _UNDEFINED, _shading(sensor, hw=(height, width))),
    ]


def _shading(sensor: Sensor, *, hw: tuple[int, int]) -> bytes:
    """OpcodeList2 that takes the lens's darkening out of every colour."""
    rows, columns = (np.linspace(0, size, n) - 0.5 for size, n in zip(hw, _GAIN_POINTS_VU, strict=True))
    passed = vignetting_at(sensor.vignetting, (rows[:, None], columns[None]), hw=hw)
    return opcode_list(gain_map((1 / passed)[..., None].astype(np.float32), area=(0, 0, *hw)))


def _exif_tags(facts: ExifFacts) -> dict[int, tuple[int, str | bytes | Values]]:
    """Type and values of the tags of the EXIF directory, sorted."""
    tags: dict[int, tuple[int, str | bytes | Values]] = {
        _EXIF_VERSION: (_UNDEFINED, b"0232"),
        _DATE_ORIGINAL: (_ASCII, _date(facts.taken)),
        _SUBSEC_ORIGINAL: (_ASCII, f"{facts.taken.microsecond:06d}"),
        _FOCAL_LENGTH: (_RATIONAL, [facts.focal_length_mm]),
        _F35: (_SHORT, [round(facts.f35_mm)]),
    }
    if facts.taken.tzinfo is not None:
        offset = facts.taken.strftime("%z")
        tags[_OFFSET_ORIGINAL] = (_ASCII, f"{offset[:3]}:{offset[3:5]}")
    if facts.subject_distance_m is not None:
        tags[_DISTANCE] = (_RATIONAL, [facts.subject_distance_m])
    return dict(sorted(tags.items()))


def _date(taken: datetime) -> str:
    return taken.strftime("%Y:%m:%d %H:%M:%S")


def _ratio(value: float) -> tuple[int, int]:
    """Numerator and denominator as EXIF counts them: infinity has a numerator of its own."""
    if math.isinf(value):
        return _INFINITY, 1
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return fraction.numerator, fraction.denominator


def _for_pillow(kind: int, values: str | bytes | Values) -> object:
    if isinstance(values, str | bytes):
        return values
    return TiffImagePlugin.IFDRational(*_ratio(values[0])) if kind == _RATIONAL else values[0]


def _entry(tag: int, kind: int, values: str | bytes | Values) -> tuple[int, int, int, bytes]:
    """Tag, type, count and content of one field of a directory."""
    if isinstance(values, str):
        values = values.encode() + b"\0"
    if isinstance(values, bytes):
        return tag, kind, len(values), values
    flat = [part for value in values for part in _ratio(value)] if kind in {_RATIONAL, _SRATIONAL} else values
    return tag, kind, len(values), struct.pack(f"<{len(flat)}{_PACKING[kind]}", *flat)


def _ifd(entries: Sequence[tuple[int, int, int, bytes]], *, at: int) -> bytes:
    """A directory that lies at an offset of the file, followed by what does not fit into its fields."""
    entries = sorted(entries)
    beyond_at = at + 2 + _ENTRY_BYTES * len(entries) + 4
    fields, beyond = b"", b""
    for tag, kind, count, content in entries:
        fields += struct.pack("<HHI", tag, kind, count)
        if len(content) <= 4:
            fields += content.ljust(4, b"\0")
        else:
            fields += struct.pack("<I", beyond_at + len(beyond))
            beyond += content + b"\0" * (len(content) % 2)
    return struct.pack("<H", len(entries)) + fields + struct.pack("<I", 0) + beyond
