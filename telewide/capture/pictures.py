"""Write pictures to keep: JPEG with whole colours, 16-bit TIFF, linear EXR; with what the photo said of itself.

Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from telewide.capture.carried import CarriedFacts
from telewide.capture.exif_block import append_directories
from telewide.capture.exr_attributes import exr_attributes
from telewide.errors import UsageError
from telewide.files import replacing
from telewide.geometry.arrays import FloatImage
from telewide.srgb import linear_from_srgb

QUALITY = 95
_ORIENTATION, _XMP = 274, 700
_BYTE, _ASCII, _SHORT = 1, 2, 3
_STRIP_ROWS = 128
Level = TypeVar("Level", np.uint8, np.uint16)
_TEXTS = (270, 271, 272, 306, 315, 33432)


@dataclass(frozen=True)
class PictureFacts:
    """Facts that a picture states of itself.

    Attributes:
        software: what made it; empty says nothing.
        done: what was done to the photo, in words.
        of_photo: what holds of the photo it was made from.
        is_stripped: whether it says nothing but its colour profile.
    """

    software: str = ""
    done: str = ""
    of_photo: CarriedFacts = field(default_factory=lambda: CarriedFacts({}, {}, {}))
    is_stripped: bool = False

    def exif_bytes(self, *, wh: tuple[int, int] | None) -> bytes:
        """Write EXIF of an upright picture; empty for one that is stripped.

        Args:
            wh: width and height, px; None for a TIFF, which states them elsewhere.
        """
        return b"" if self.is_stripped else self.of_photo.exif_bytes(wh=wh, software=self.software)

    def exr_attributes(self) -> dict[str, str | float]:
        """Attributes of an EXR; none for one that is stripped."""
        if self.is_stripped:
            return {}
        software: dict[str, str | float] = {"software": self.software} if self.software else {}
        return software | exr_attributes(self.of_photo, done=self.done)


def write_picture(path: Path, image: FloatImage, *, facts: PictureFacts) -> None:
    """Write an upright picture, whole or not at all.

    Args:
        path: ends in .jpg (8 bits, no colour subsampled), .tif (16 bits, not compressed) or .exr (linear light, half
            floats).
        image: (H, W, 3) RGB in [0, 1], encoded as the photo's profile says, for EXR as sRGB; values outside are
            clipped, in EXR those below 0 alone.
        facts: what it says of itself.

    Raises:
        UsageError: another suffix, or the place cannot be written.
    """
    writers = {".jpg": _write_jpeg, ".tif": _write_tiff, ".exr": _write_exr}
    if path.suffix not in writers:
        *others, last = writers
        raise UsageError(f"{path}: a picture is written as {', '.join(others)} or {last}")
    with replacing(path) as temporary:
        writers[path.suffix](temporary, image, facts)


def _write_jpeg(path: Path, image: FloatImage, facts: PictureFacts) -> None:
    told: dict[str, bytes] = {}
    of_photo = facts.of_photo
    if not facts.is_stripped:
        told["exif"] = facts.exif_bytes(wh=(image.shape[1], image.shape[0]))
        told["xmp"] = of_photo.xmp_packet(software=facts.software, done=facts.done)
    if of_photo.picture_profile is not None:
        told["icc_profile"] = of_photo.picture_profile
    Image.fromarray(_levels(image, np.uint8)).save(path, "JPEG", quality=QUALITY, subsampling=0, **told)


def _levels(image: FloatImage, kind: type[Level]) -> NDArray[Level]:
    """Round to whole levels, strip by strip: between its steps the formula leaves a few times the picture."""
    levels = np.empty(image.shape, kind)
    for top in range(0, len(image), _STRIP_ROWS):
        strip = np.clip(np.nan_to_num(image[top : top + _STRIP_ROWS], nan=0.0), 0, 1)
        levels[top : top + _STRIP_ROWS] = (strip * np.iinfo(kind).max + 0.5).astype(kind)
    return levels


def _write_exr(path: Path, image_srgb: FloatImage, facts: PictureFacts) -> None:
    """Write linear light of Rec. 709 primaries, which are sRGB's and those of an EXR that states none."""
    import OpenEXR

    light = linear_from_srgb(np.maximum(np.nan_to_num(image_srgb, nan=0.0), 0)).astype(np.float16)
    header: dict[str, object] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= facts.exr_attributes()
    OpenEXR.File(header, {"RGB": light}).write(str(path))


def _write_tiff(path: Path, image: FloatImage, facts: PictureFacts) -> None:
    """Write what every reader knows: deflating saves a fifth, and is no part of TIFF 6.0."""
    told, of_photo = b"", facts.of_photo
    tags: list[tuple[int, int, int, object, bool]] = []
    if not facts.is_stripped:
        packet = of_photo.xmp_packet(software=facts.software, done=facts.done)
        tags += [(_XMP, _BYTE, len(packet), packet, True), (_ORIENTATION, _SHORT, 1, 1, True)]
        texts = {tag: text for tag in _TEXTS if isinstance(text := of_photo.lasting.get(tag), str) and text.isascii()}
        tags.extend((tag, _ASCII, len(text) + 1, text, True) for tag, text in texts.items())
        told = replace(facts, of_photo=replace(of_photo, lasting={})).exif_bytes(wh=None)
    tifffile.imwrite(
        path,
        _levels(image, np.uint16),
        byteorder="<",
        photometric="rgb",
        rowsperstrip=_STRIP_ROWS,
        software=False if facts.is_stripped else facts.software,
        metadata=None,
        iccprofile=of_photo.picture_profile,
        extratags=tags,
    )
    if told:
        with path.open("r+b") as stream:
            append_directories(stream, told)
