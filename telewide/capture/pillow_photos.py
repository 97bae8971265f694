"""Photos that Pillow decodes, HEIC among them: that one needs the extra ``heif`` (pillow-heif).

HEIC turns itself upright when it is decoded, and its EXIF then says upright.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

from PIL import Image, features

from telewide.capture.formats import PhotoFormat
from telewide.capture.jpeg import check_jpeg_head
from telewide.capture.png import check_png_head, exif_of_png
from telewide.capture.sizes import check_size
from telewide.errors import InputError, MissingPartError, extra_hint
from telewide.ranges import MAX_PIXELS

_SDR_SRGB_PRIMARIES = {0, 1, 2}
_MOST_EXIF_BYTES = 1 << 22
_HDR_TRANSFERS = {16: "PQ", 18: "HLG"}
_log = logging.getLogger("telewide")


def open_photo(path: Path, stream: BinaryIO, kind: PhotoFormat) -> Image.Image:
    """Open a photo without decoding its pixels yet.

    Args:
        path: to be named in messages.
        stream: the file, open for reading.
        kind: its format, not RAW.

    Returns:
        The photo; to be closed by the caller.

    Raises:
        MissingPartError: HEIC, and the extra is not installed.
        InputError: its size cannot be believed; AVIF, and this Pillow cannot read it.
        OSError: corrupt.
        ValueError: no picture begins where one should.
    """
    if kind == "HEIF":
        if find_spec("pillow_heif") is None:
            raise MissingPartError(
                f"{path} is a HEIC photo; reading it needs a part that is not installed",
                hint=f"{extra_hint('heif')}; or export it as JPEG",
            )
        import pillow_heif

        pillow_heif.register_heif_opener()
        photo = _opened(path, stream, "HEIF")
        _warn_of_colours(path, photo)
        return photo
    if kind == "AVIF" and not features.check("avif"):
        raise InputError(f"{path} is an AVIF photo, which this Pillow cannot read", hint="export it as JPEG or PNG")
    return _opened(path, stream, kind)


def load_photo(photo: Image.Image) -> None:
    """Decode the pixels of a photo.

    Args:
        photo: as :func:`open_photo` returned it.

    Raises:
        Exception: corrupt, in a dozen ways; a tile of a TIFF is larger than any photo.
    """
    with _limit_of_pillow(MAX_PIXELS // 2):  # it warns of more, and refuses twice as many
        photo.load()


@contextmanager
def _limit_of_pillow(pixels: int | None) -> Iterator[None]:
    """Let Pillow have another limit of sizes than its own, which lies below what phones make."""
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, pixels
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def exif_of(photo: Image.Image, *, stream: BinaryIO | None = None) -> Image.Exif:
    """Return the EXIF of a photo; none where it is too long to be any, since each number in it becomes an object.

    Args:
        photo: open.
        stream: its file, where it has not been decoded: Pillow would decode a PNG to look for EXIF behind the pixels.

    Raises:
        Exception: corrupt EXIF, in a dozen ways.
    """
    if photo.format == "PNG" and stream is not None and (found := exif_of_png(stream, most_bytes=_MOST_EXIF_BYTES)):
        photo.info["exif"] = found
    stated = photo.info.get("exif")
    if isinstance(stated, bytes) and len(stated) > _MOST_EXIF_BYTES:
        return Image.Exif()
    return Image.Image.getexif(photo) if photo.format == "PNG" else photo.getexif()


def _opened(path: Path, stream: BinaryIO, kind: PhotoFormat) -> Image.Image:
    """Open a photo whose head and size can be believed."""
    check_head = {"JPEG": check_jpeg_head, "PNG": check_png_head}.get(kind)
    if check_head is not None:
        check_head(stream)
    with _limit_of_pillow(None):
        photo = Image.open(stream, formats=(kind,))
    check_size(path, (photo.height, photo.width))
    return photo


def has_wider_colours(photo: Image.Image) -> bool:
    """Whether a photo without a profile states, by numbers of ITU-T H.273, other colours than those of sRGB."""
    numbers = photo.info.get("nclx_profile")
    return isinstance(numbers, dict) and int(numbers.get("color_primaries", 2)) not in _SDR_SRGB_PRIMARIES


def _warn_of_colours(path: Path, photo: Image.Image) -> None:
    """Say which colours are read wrongly: those told by numbers (ITU-T H.273) instead of by a profile."""
    numbers = photo.info.get("nclx_profile")
    if not isinstance(numbers, dict) or photo.info.get("icc_profile"):
        return
    transfer = _HDR_TRANSFERS.get(int(numbers.get("transfer_characteristics", 2)))
    if transfer:
        _log.warning("%s is an HDR photo (%s); its tones are read as sRGB", path, transfer)
    elif has_wider_colours(photo):
        _log.warning("%s has wider colours than sRGB; they are read as sRGB", path)
