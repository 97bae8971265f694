"""``depth.heic``: the photo as HEIC with a depth image beside it, as phones of Apple's keep it.

The auxiliary image is grey, 8 bits, disparity in 1/m stretched from black, far, to white, near; its XMP states both
ends. Without metres it is relative. Libraries for HEIF read such images but write none: pillow-heif (extra ``heif``)
encodes photo and map, and here both are put into one file, box by box (ISO/IEC 23008-12 and 14496-12). Unknown pixels
take their neighbour's value. Letters: H W image.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from telewide.capture.pictures import PictureFacts
from telewide.depth.formats.contents import Contents, WrittenDepth, levels, thinned
from telewide.depth.formats.jpeg_xmp import xmp_meta
from telewide.depth.nearest import fill_unknown
from telewide.files import replacing
from telewide.geometry.arrays import ByteImage, FloatMap

HEIC_NAME = "depth.heic"
MAP_LONGEST_PX = 1024
DEPTH_URN = "urn:mpeg:hevc:2015:auxid:2"  # ISO/IEC 23008-12: an auxiliary image that holds depth
_SPACES = {"apdi": "http://ns.apple.com/pixeldatainfo/1.0/", "depthData": "http://ns.apple.com/depthData/1.0/"}
_L008, _HDIS = 1278226488, 1751411059  # codes of four letters: grey of 8 bits, disparity of 16
_PRIMARY, _DEPTH, _XMP, _EXIF = 1, 2, 3, 4
_EXIF_HEAD = b"Exif\0\0"
_QUALITY = 90


def write_heic(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth.heic``."""
    result = contents.result
    if contents.image is None or not np.isfinite(result.disparity.disparity_px).any():
        return contents.left_out(HEIC_NAME, "nothing was measured")
    has_metres = result.depth_m is not None and bool(np.isfinite(result.depth_m).any())
    nearness = result.disparity.disparity_px
    if result.depth_m is not None and has_metres:
        nearness = np.asarray(1 / result.depth_m, dtype=np.float32)
    grey, low, high = _stretched(nearness)
    facts = contents.facts or PictureFacts(is_stripped=True)
    picture = contents.image if contents.own_colours is None else contents.own_colours
    photo = _encoded(
        levels(np.nan_to_num(picture), bits=8).astype(np.uint8),
        quality=_QUALITY,
        profile=facts.of_photo.picture_profile,
    )
    depth, xmp = _encoded(grey, quality=100), _xmp(low, high, is_absolute=has_metres)
    exif = facts.exif_bytes(wh=(picture.shape[1], picture.shape[0]))
    with replacing(folder / HEIC_NAME) as temporary:
        temporary.write_bytes(heic_with_depth(photo, depth, xmp=xmp, exif=exif))
    return WrittenDepth((folder / HEIC_NAME,))


def _stretched(nearness: FloatMap) -> tuple[ByteImage, float, float]:
    known = fill_unknown(thinned(nearness, longest_px=MAP_LONGEST_PX))
    low, high = float(known.min()), float(known.max())
    share = (known - low) / max(high - low, 1e-9)
    return levels(share, bits=8).astype(np.uint8), low, high


def _xmp(low: float, high: float, *, is_absolute: bool) -> bytes:
    told = {
        "apdi:AuxiliaryImageType": "disparity",
        "apdi:StoredFormat": str(_L008),
        "apdi:NativeFormat": str(_HDIS),
        "apdi:IntMinValue": "0",
        "apdi:IntMaxValue": "255",
        "apdi:FloatMinValue": f"{low:.7g}",
        "apdi:FloatMaxValue": f"{high:.7g}",
        "depthData:DepthDataVersion": "65541",
        "depthData:Accuracy": "absolute" if is_absolute else "relative",
        "depthData:Quality": "high",
        "depthData:Filtered": "True",
    }
    return xmp_meta(_SPACES, told).encode()


def _encoded(picture: ByteImage, *, quality: int, profile: bytes | None = None) -> bytes:
    import pillow_heif

    height, width = picture.shape[:2]
    mode = "L" if picture.ndim == 2 else "RGB"
    image = pillow_heif.from_bytes(mode=mode, size=(width, height), data=np.ascontiguousarray(picture).tobytes())
    stream = BytesIO()
    colours = {} if profile is None else {"icc_profile": profile}
    image.save(stream, quality=quality, enc_params={"preset": "ultrafast"}, **colours)
    return stream.getvalue()


@dataclass(frozen=True)
class _Property:
    """A property of a picture: a whole box, and whether a reader has to understand it."""

    box: bytes
    is_essential: bool


@dataclass(frozen=True)
class _Picture:
    """One picture of a HEIC: its coded bytes, and its properties."""

    coded: bytes
    properties: tuple[_Property, ...]


def heic_with_depth(photo: bytes, depth: bytes, *, xmp: bytes, exif: bytes = b"") -> bytes:
    """Put a depth image into a photo.

    Args:
        photo: a HEIC of one picture.
        depth: likewise, grey.
        xmp: about the depth.
        exif: of the photo, as in a JPEG, its six letters included; empty for none.

    Returns:
        A HEIC whose primary picture is the photo, bit by bit, with the depth as its auxiliary picture.

    Raises:
        ValueError: one of them holds more than one picture.
    """
    primary, auxiliary = (_only_picture(heic) for heic in (photo, depth))
    urn = _Property(_full_box(b"auxC", DEPTH_URN.encode() + b"\0"), is_essential=True)
    pictures = [primary, _Picture(auxiliary.coded, (*auxiliary.properties, urn))]
    parts = [primary.coded, auxiliary.coded, xmp]
    if exif:
        parts.append(struct.pack(">I", len(_EXIF_HEAD)) + exif)  # first of all, where TIFF begins (23008-12, annex A)
    kind = _box(b"ftyp", dict(_boxes(photo))[b"ftyp"])
    head = kind + _meta(pictures, parts, start=0)
    head = kind + _meta(pictures, parts, start=len(head) + 8)  # the places of the parts depend on its own length
    return b"".join([head, _box(b"mdat", b"".join(parts))])


def _meta(pictures: Sequence[_Picture], parts: Sequence[bytes], *, start: int) -> bytes:
    handler = _full_box(b"hdlr", struct.pack(">I4s12xx", 0, b"pict"))
    infos = [_info(_PRIMARY, b"hvc1"), _info(_DEPTH, b"hvc1"), _info(_XMP, b"mime", b"application/rdf+xml\0")]
    references = [
        _box(b"auxl", struct.pack(">HHH", _DEPTH, 1, _PRIMARY)),
        _box(b"cdsc", struct.pack(">HHH", _XMP, 1, _DEPTH)),
    ]
    if len(parts) == _EXIF:
        infos.append(_info(_EXIF, b"Exif"))
        references.append(_box(b"cdsc", struct.pack(">HHH", _EXIF, 1, _PRIMARY)))
    inner = [
        handler,
        _full_box(b"pitm", struct.pack(">H", _PRIMARY)),
        _locations(parts, start=start),
        _full_box(b"iinf", struct.pack(">H", len(infos)) + b"".join(infos)),
        _full_box(b"iref", b"".join(references)),
        _properties(pictures),
    ]
    return _full_box(b"meta", b"".join(inner))


def _info(item: int, kind: bytes, more: bytes = b"") -> bytes:
    return _full_box(b"infe", struct.pack(">HH4sx", item, 0, kind) + more, version=2)


def _locations(parts: Sequence[bytes], *, start: int) -> bytes:
    entries = []
    for item, part in enumerate(parts, start=1):
        entries.append(struct.pack(">HHHII", item, 0, 1, start, len(part)))
        start += len(part)
    return _full_box(b"iloc", struct.pack(">BBH", 0x44, 0, len(parts)) + b"".join(entries))


def _properties(pictures: Sequence[_Picture]) -> bytes:
    boxes, links, n_before = [], [], 0
    for item, picture in enumerate(pictures, start=1):
        own = [n_before + k | (0x80 if p.is_essential else 0) for k, p in enumerate(picture.properties, start=1)]
        links.append(struct.pack(">HB", item, len(own)) + bytes(own))
        boxes += [each.box for each in picture.properties]
        n_before += len(own)
    association = _full_box(b"ipma", struct.pack(">I", len(links)) + b"".join(links))
    return _box(b"iprp", _box(b"ipco", b"".join(boxes)) + association)


def _only_picture(heic: bytes) -> _Picture:
    """Take the one picture out of a HEIC as pillow-heif writes it."""
    meta = dict(_boxes(dict(_boxes(heic))[b"meta"][4:]))
    (n_items,) = struct.unpack_from(">H", meta[b"iinf"], 4)
    if n_items != 1 or meta[b"iloc"][0] != 0:
        raise ValueError(f"a HEIC of {n_items} items where one, in the file itself, was expected")
    offset, length = _only_location(meta[b"iloc"])
    containers = dict(_boxes(meta[b"iprp"]))
    known = [_box(kind, content) for kind, content in _boxes(containers[b"ipco"])]
    association = containers[b"ipma"]
    step = 2 if association[3] & 1 else 1
    count = association[10]
    links = (int.from_bytes(association[11 + k * step : 11 + (k + 1) * step], "big") for k in range(count))
    top = 1 << (8 * step - 1)
    return _Picture(
        heic[offset : offset + length], tuple(_Property(known[(link & ~top) - 1], bool(link & top)) for link in links)
    )


def _only_location(iloc: bytes) -> tuple[int, int]:
    """Place and length of the one part of the one item (version 0 of the box)."""
    offset_bytes, length_bytes, base_bytes = iloc[4] >> 4, iloc[4] & 15, iloc[5] >> 4
    at = 12  # after version and flags, sizes, number of items, the item and its file
    base = int.from_bytes(iloc[at : at + base_bytes], "big")
    at += base_bytes + 2  # and the number of its parts
    offset = int.from_bytes(iloc[at : at + offset_bytes], "big")
    at += offset_bytes
    return base + offset, int.from_bytes(iloc[at : at + length_bytes], "big")


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kinds and contents of the boxes that lie one after the other."""
    at = 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        head = 8
        if size == 1:
            (size,), head = struct.unpack_from(">Q", data, at + 8), 16
        end = len(data) if size == 0 else at + size
        yield kind, data[at + head : end]
        at = end


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", len(content) + 8, kind) + content


def _full_box(kind: bytes, content: bytes, *, version: int = 0) -> bytes:
    return _box(kind, struct.pack(">I", version << 24) + content)
