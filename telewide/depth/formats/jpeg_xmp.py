"""XMP in a JPEG: a standard packet, and an extended one where 64 KB do not suffice.

Layout of Adobe's XMP specification, part 3: segments APP1 after JFIF and EXIF; the extended packet is cut into chunks,
each with the MD5 of the whole, its length and the chunk's place, and named by the standard packet.
"""

from __future__ import annotations

import base64
import hashlib
import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from xml.sax.saxutils import quoteattr

import numpy as np
from PIL import Image

from telewide.depth.formats.contents import levels
from telewide.geometry.arrays import FloatMap

_STANDARD = b"http://ns.adobe.com/xap/1.0/\0"
_EXTENDED = b"http://ns.adobe.com/xmp/extension/\0"
_MOST_SEGMENT_BYTES = 65533  # a segment states its length in two bytes, which count themselves
_CHUNK_BYTES = 65400
_QUALITY = 95
_NOTE = "http://ns.adobe.com/xmp/note/"
_WRAPPER = '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>{}<?xpacket end="w"?>'
_META = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about=""{attributes}>{inner}</rdf:Description></rdf:RDF></x:xmpmeta>'
)


def xmp_meta(namespaces: Mapping[str, str], properties: Mapping[str, str], *, inner: str = "") -> str:
    """Compose XMP of simple properties.

    Args:
        namespaces: prefix to address.
        properties: names with their prefixes, to values.
        inner: elements that follow.
    """
    spaces = [f" xmlns:{prefix}={quoteattr(address)}" for prefix, address in namespaces.items()]
    values = [f" {name}={quoteattr(value)}" for name, value in properties.items()]
    return _META.format(attributes="".join((*spaces, *values)), inner=inner)


def jpeg_with_xmp(
    jpeg: bytes,
    namespaces: Mapping[str, str],
    properties: Mapping[str, str],
    *,
    large: Mapping[str, bytes] | None = None,
) -> bytes:
    """Put properties into a JPEG.

    Args:
        jpeg: the file.
        namespaces: prefix to address.
        properties: names with their prefixes, to values.
        large: properties of any size; their bytes are written as base64.

    Returns:
        The file, its pixels as they were.
    """
    packets: list[bytes] = []
    stated = dict(properties)
    if large:
        extended = xmp_meta(
            namespaces, {name: base64.b64encode(data).decode() for name, data in large.items()}
        ).encode()
        name = hashlib.md5(extended, usedforsecurity=False).hexdigest().upper()
        packets = [*_extended_segments(extended, name)]
        namespaces, stated = {**namespaces, "xmpNote": _NOTE}, {**stated, "xmpNote:HasExtendedXMP": name}
    return jpeg_with_packet(jpeg, xmp_meta(namespaces, stated), after=packets)


def jpeg_with_packet(jpeg: bytes, meta: str, *, after: list[bytes] | None = None) -> bytes:
    """Put a standard packet into a JPEG, and further segments after it.

    Raises:
        ValueError: it is larger than one segment holds.
    """
    standard = _segment(_STANDARD + _WRAPPER.format(meta).encode())
    at = _after_first_segments(jpeg)
    return b"".join([jpeg[:at], standard, *(after or []), jpeg[at:]])


def grey_jpeg(values: FloatMap) -> bytes:
    """Encode a map in [0, 1] as a grey JPEG of the best quality."""
    stream = BytesIO()
    Image.fromarray(levels(values, bits=8).astype(np.uint8)).save(stream, "JPEG", quality=100)
    return stream.getvalue()


def photo_jpeg(image: FloatMap, *, exif: bytes = b"") -> bytes:
    """Encode a photo, sRGB in [0, 1], as a JPEG whose colours are not thinned out (4:4:4), with its EXIF."""
    stream = BytesIO()
    rgb = levels(np.nan_to_num(image), bits=8).astype(np.uint8)
    told = {"exif": exif} if exif else {}
    Image.fromarray(rgb).save(stream, "JPEG", quality=_QUALITY, subsampling=0, **told)
    return stream.getvalue()


def grey_png16(values: FloatMap) -> bytes:
    """Encode a map in [0, 1] as a grey PNG of 16 bits."""
    stream = BytesIO()
    Image.fromarray(levels(values, bits=16).astype(np.uint16)).save(stream, "PNG")
    return stream.getvalue()


def _extended_segments(packet: bytes, name: str) -> Iterator[bytes]:
    for start in range(0, len(packet), _CHUNK_BYTES):
        head = _EXTENDED + name.encode() + struct.pack(">II", len(packet), start)
        yield _segment(head + packet[start : start + _CHUNK_BYTES])


def _segment(content: bytes) -> bytes:
    if len(content) > _MOST_SEGMENT_BYTES:
        raise ValueError(f"a segment of {len(content)} bytes; a JPEG holds at most {_MOST_SEGMENT_BYTES} in one")
    return b"\xff\xe1" + struct.pack(">H", len(content) + 2) + content


def _after_first_segments(jpeg: bytes) -> int:
    """Place after the start of the file, JFIF and EXIF."""
    at = 2
    while jpeg[at : at + 2] == b"\xff\xe0" or (jpeg[at : at + 2] == b"\xff\xe1" and jpeg[at + 4 : at + 8] == b"Exif"):
        at += 2 + struct.unpack_from(">H", jpeg, at + 2)[0]
    return at
