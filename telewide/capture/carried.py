"""Facts that a picture takes over from its photo: EXIF, XMP and colour profile.

Left out is what would be false of the picture: thumbnails, turns, places counted in stored pixels, maker's notes (their
offsets break, and some name other files), and of XMP whatever points at data of the photo's own file (motion, depth).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree

from PIL import Image

from telewide.capture.colour_profiles import rgb_profile, srgb_profile
from telewide.capture.exif_block import IFD_EXIF, IFD_GPS, with_exif_types
from telewide.capture.formats import HEAD_BYTES, TAG_DNG_VERSION, format_by_head, read_bytes
from telewide.capture.pillow_photos import exif_of, has_wider_colours, open_photo
from telewide.capture.tiff_tags import stated_bytes
from telewide.files import open_regular

_ORIENTATION, _SOFTWARE, _XMP, _PHOTOMETRIC, _PROFILE = 274, 305, 700, 262, 34675
_RGB = 2
_MOST_TAG_BYTES = 1 << 24
_CHANNELS, _WIDTH, _HEIGHT, _CUSTOM_RENDERED = 37121, 40962, 40963, 41985
_COLOUR_SPACE, _OTHER_SPACES = 40961, {2, 65535}  # Adobe RGB, as some cameras say, and uncalibrated
# ImageDescription, Make, Model, resolution and its unit, DateTime, Artist, Copyright.
_LASTING = (270, 271, 272, 282, 283, 296, 306, 315, 33432)
# MakerNote, SubjectArea, SubjectLocation, Interoperability, ImageUniqueID, CompressedBitsPerPixel, RelatedSoundFile.
_FALSE_OF_A_PICTURE = {37500, 37396, 41492, 40965, 42016, 37122, 40964}
# What EXIF 2.32 wants of every JPEG: 72 px an inch, chroma sited between pixels; the versions, channels Y Cb Cr, sRGB.
_REQUIRED = {282: 72.0, 283: 72.0, 296: 2, 531: 1}
_REQUIRED_OF_EXIF = {36864: b"0232", _CHANNELS: b"\1\2\3\0", 40960: b"0100", 40961: 1}
_REQUIRED_OF_GPS = {0: b"\2\3\0\0"}
_MOST_EXIF_BYTES, _MOST_XMP_BYTES = 65000, 60000

_RDF, _META = "http://www.w3.org/1999/02/22-rdf-syntax-ns#", "adobe:ns:meta/"
_HISTORY, _EVENT = "http://ns.adobe.com/xap/1.0/mm/", "http://ns.adobe.com/xap/1.0/sType/ResourceEvent#"
_LASTING_SPACES = {
    "dc": "http://purl.org/dc/elements/1.1/",
    "xmp": "http://ns.adobe.com/xap/1.0/",
    "xmpRights": "http://ns.adobe.com/xap/1.0/rights/",
    "photoshop": "http://ns.adobe.com/photoshop/1.0/",
    "Iptc4xmpCore": "http://iptc.org/std/Iptc4xmpCore/1.0/xmlns/",
    "Iptc4xmpExt": "http://iptc.org/std/Iptc4xmpExt/2008-02-29/",
    "aux": "http://ns.adobe.com/exif/1.0/aux/",
    "lr": "http://ns.adobe.com/lightroom/1.0/",
}
_FALSE_OF_XMP = {f"{{{_LASTING_SPACES['xmp']}}}Thumbnails"}
_SPELLED = {**_LASTING_SPACES, "rdf": _RDF, "x": _META, "xmpMM": _HISTORY, "stEvt": _EVENT}
_BEGIN = '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n'
_READ_ERRORS = (OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError)


@dataclass(frozen=True)
class CarriedFacts:
    """Facts of a photo that hold of a picture made from it.

    Attributes:
        lasting: tags of the first directory of its EXIF.
        exif: tags of the EXIF directory.
        gps: tags of the GPS directory.
        xmp: its packet, as it stands in the file; empty where there is none.
        profile: its colour profile (ICC); None where it has none, or one that is not of RGB.
        has_other_colours: whether it has no profile, and says all the same that its colours are not those of sRGB.
    """

    lasting: Mapping[int, object]
    exif: Mapping[int, object]
    gps: Mapping[int, object]
    xmp: bytes = b""
    profile: bytes | None = None
    has_other_colours: bool = False

    @property
    def picture_profile(self) -> bytes | None:
        """Colour profile of a picture made from it: its own, else that of sRGB; None where its colours have no name."""
        return self.profile or (None if self.has_other_colours else srgb_profile())

    def exif_bytes(self, *, wh: tuple[int, int] | None, software: str) -> bytes:
        """Write EXIF of an upright picture.

        Args:
            wh: width and height, px; None for a TIFF, which states them and its channels elsewhere.
            software: what made it.
        """
        exif = Image.Exif()
        exif.endian = "<"
        for tag, value in {**_REQUIRED, **self.lasting}.items():
            exif[tag] = value
        exif[_ORIENTATION], exif[_SOFTWARE] = 1, software
        own: dict[int, object] = {**_REQUIRED_OF_EXIF, **self.exif, _CUSTOM_RENDERED: 1}
        if wh is None:
            own = {tag: value for tag, value in own.items() if tag not in {_CHANNELS, _WIDTH, _HEIGHT}}
        else:
            own |= {_WIDTH: wh[0], _HEIGHT: wh[1]}
        exif[IFD_EXIF] = own
        if self.gps:
            exif[IFD_GPS] = {**_REQUIRED_OF_GPS, **self.gps}
        return with_exif_types(exif.tobytes())

    def xmp_packet(self, *, software: str, done: str) -> bytes:
        """Write XMP of a picture: what holds of the photo, and what was done.

        Args:
            software: what made it.
            done: in words.
        """
        root = ElementTree.Element(f"{{{_META}}}xmpmeta")
        rdf = ElementTree.SubElement(root, f"{{{_RDF}}}RDF")
        rdf.extend(_lasting_descriptions(self.xmp))
        about = ElementTree.SubElement(rdf, f"{{{_RDF}}}Description", {f"{{{_RDF}}}about": ""})
        events = ElementTree.SubElement(ElementTree.SubElement(about, f"{{{_HISTORY}}}History"), f"{{{_RDF}}}Seq")
        event = ElementTree.SubElement(events, f"{{{_RDF}}}li", {f"{{{_RDF}}}parseType": "Resource"})
        for name, said in (("action", "filtered"), ("softwareAgent", software), ("parameters", done)):
            ElementTree.SubElement(event, f"{{{_EVENT}}}{name}").text = said
        for prefix, space in _SPELLED.items():
            ElementTree.register_namespace(prefix, space)
        return f'{_BEGIN}{ElementTree.tostring(root, encoding="unicode")}\n<?xpacket end="w"?>'.encode()


def read_carried(path: Path) -> CarriedFacts:
    """Read what a photo says of itself that will hold of a picture made from it.

    Args:
        path: a photo; of one that is corrupt, what can be read.

    Raises:
        UsageError: there is no such file.
        InputError: no photo.
    """
    kind = format_by_head(path, read_bytes(path, at_most=HEAD_BYTES))
    with open_regular(path) as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's remarks on odd EXIF
        with suppress(*_READ_ERRORS):
            if kind in {"RAW", "TIFF"}:
                return _carried_of_tiff(stream)
            with open_photo(path, stream, kind) as photo:
                stated = photo.info.get("xmp", photo.info.get("XML:com.adobe.xmp"))
                exif, profile = exif_of(photo, stream=stream), photo.info.get("icc_profile")
                return _carried_of_picture(exif, stated, profile, is_wider=has_wider_colours(photo))
    return CarriedFacts({}, {}, {})


def _carried_of_tiff(stream: BinaryIO) -> CarriedFacts:
    if stated_bytes(stream) > _MOST_TAG_BYTES:
        return CarriedFacts({}, {}, {})
    exif = Image.Exif()
    exif.load_from_fp(stream)
    is_raw = TAG_DNG_VERSION in exif or exif.get(_PHOTOMETRIC) != _RGB
    if is_raw:  # what it says of colours is of its camera's JPEG; developed here, they are those of sRGB
        facts = _carried(exif, exif.get(_XMP), None)
        return replace(facts, exif={tag: value for tag, value in facts.exif.items() if tag != _COLOUR_SPACE})
    return _carried_of_picture(exif, exif.get(_XMP), exif.get(_PROFILE))


def _carried_of_picture(exif: Image.Exif, xmp: object, profile: object, *, is_wider: bool = False) -> CarriedFacts:
    space = exif.get_ifd(IFD_EXIF).get(_COLOUR_SPACE)
    has_others = not profile and (is_wider or space in _OTHER_SPACES)
    return replace(_carried(exif, xmp, rgb_profile(profile)), has_other_colours=has_others)


def _carried(exif: Image.Exif, xmp: object, profile: bytes | None) -> CarriedFacts:
    own = {tag: exif[tag] for tag in _LASTING if tag in exif}
    facts = CarriedFacts(
        lasting=_writable(own),
        exif=_writable({t: v for t, v in exif.get_ifd(IFD_EXIF).items() if t not in _FALSE_OF_A_PICTURE}, IFD_EXIF),
        gps=_writable(exif.get_ifd(IFD_GPS), IFD_GPS),
        xmp=_as_packet(xmp),
        profile=profile,
    )
    is_short = len(facts.exif_bytes(wh=(1, 1), software="")) <= _MOST_EXIF_BYTES
    return facts if is_short else replace(facts, lasting={}, exif={}, gps={})


def _as_packet(xmp: object) -> bytes:
    packet = xmp.encode() if isinstance(xmp, str) else xmp
    return packet if isinstance(packet, bytes) and len(packet) <= _MOST_XMP_BYTES else b""


def _writable(tags: Mapping[int, object], directory: int | None = None) -> dict[int, object]:
    """Leave out what no EXIF can hold: a corrupt value is found when it is written."""
    kept = {}
    for tag, value in tags.items():
        exif = Image.Exif()
        with suppress(Exception):  # in a dozen ways
            if directory is None:
                exif[tag] = value
            else:
                exif[directory] = {tag: value}
            exif.tobytes()
            kept[tag] = value
    return kept


def _lasting_descriptions(packet: bytes) -> list[ElementTree.Element]:
    """Descriptions in lasting terms; nothing of a packet that declares entities, which may grow without end."""
    if not packet or b"<!" in packet:
        return []
    try:
        root = ElementTree.fromstring(packet.strip(b"\0 \r\n\t\xef\xbb\xbf"))
    except (ElementTree.ParseError, ValueError, LookupError):
        return []
    kept = []
    for description in root.iter(f"{{{_RDF}}}Description"):
        lasting = ElementTree.Element(description.tag, {f"{{{_RDF}}}about": ""})
        lasting.attrib.update({name: text for name, text in description.attrib.items() if _is_lasting(name)})
        lasting.extend(child for child in description if _is_lasting(child.tag))
        if len(lasting) or len(lasting.attrib) > 1:
            kept.append(lasting)
    return kept


def _is_lasting(name: str) -> bool:
    return name[1:].partition("}")[0] in _LASTING_SPACES.values() and name not in _FALSE_OF_XMP
