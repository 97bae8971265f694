"""PNG and TIFF with 16 bits per channel, which Pillow would cut down to 8.

Letters: H W image.
"""

from __future__ import annotations

import math
import zlib
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from telewide.capture.colour_profiles import warn_unless_srgb
from telewide.capture.exif import believable_orientation
from telewide.capture.sizes import Samples, at_read_size, check_size
from telewide.capture.tiff_tags import check_directories
from telewide.errors import InputError
from telewide.ranges import MAX_PIXELS

if TYPE_CHECKING:
    import tifffile

_TAG_ORIENTATION, _TAG_ICC = 274, 34675
_MAX_CHANNELS = 4
# TIFF compressions whose length is bounded by what they are decoded to: none, PackBits; deflate is checked.
_DEFLATE, _DECODED_HERE = {8, 32946}, {1, 8, 32773, 32946}


def decode_deep_png(path: Path, data: bytes) -> Samples:
    """Decode a 16-bit PNG, in the size a photo is read in; alpha is dropped.

    Args:
        path: the photo, to be named.
        data: its bytes.

    Returns:
        (H, W) or (H, W, 3) RGB.

    Raises:
        InputError: it cannot be decoded.
    """
    samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if samples is None or samples.dtype != np.uint16:
        raise InputError(f"{path} is a 16-bit PNG that cannot be decoded")
    samples = at_read_size(path, np.asarray(samples, dtype=np.uint16), (samples.shape[0], samples.shape[1]))
    return samples if samples.ndim == 2 else samples[..., 2::-1]  # OpenCV's order is blue, green, red


def decode_deep_tiff(path: Path, data: bytes) -> tuple[Samples, int] | None:
    """Decode a 16-bit TIFF, in the size a photo is read in.

    Args:
        path: the photo, to be named.
        data: its bytes.

    Returns:
        The samples, and the EXIF orientation still to be applied; None leaves an 8-bit one to Pillow.

    Raises:
        InputError: it holds something else than one photo, or is compressed in a way that is not read.
        ValueError: its tags hold more numbers than any photo needs.
    """
    import tifffile

    check_directories(BytesIO(data))
    with tifffile.TiffFile(BytesIO(data)) as tiff:
        page = tiff.pages.first
        if page.dtype is None or page.dtype.kind not in "bu" or page.dtype.itemsize > 2:
            raise InputError(f"{path} has values of type {page.dtype}; TIFF with 8 or 16 bits per channel is read")
        if page.dtype != np.uint16:
            return None
        hw = (int(page.imagelength), int(page.imagewidth))
        check_size(path, hw)
        if math.prod(page.shape) > _MAX_CHANNELS * math.prod(hw):
            raise InputError(f"{path} states {' x '.join(map(str, page.shape))} values; one photo was expected")
        samples = _page_samples(path, data, page)
        axes, is_negative = page.axes, page.photometric == tifffile.PHOTOMETRIC.MINISWHITE
        orientation = believable_orientation(page.tags.valueof(_TAG_ORIENTATION))
        profile = page.tags.valueof(_TAG_ICC)
    if axes not in {"YX", "YXS", "SYX"} or samples.ndim != len(axes) or samples.size == 0:
        raise InputError(f"{path} is a TIFF with the axes {axes}; one photo was expected")
    warn_unless_srgb(path, profile)
    if axes == "SYX":
        samples = np.moveaxis(samples, 0, -1)
    samples = at_read_size(path, samples, hw)
    return (65535 - samples if is_negative else samples), orientation


def _page_samples(path: Path, data: bytes, page: tifffile.TiffPage) -> Samples:
    """Decode one page: by tifffile, or by OpenCV the compressions tifffile needs another package for (LZW)."""
    if page.compression in _DEFLATE:
        _check_segments(data, page)
    if page.compression in _DECODED_HERE:
        try:
            return np.asarray(page.asarray(), dtype=np.uint16)
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
    # OpenCV fails on turned pictures: it is shown a copy whose orientation says upright.
    upright = bytearray(data)
    tag = page.tags.get(_TAG_ORIENTATION)
    if tag is not None:
        upright[tag.valueoffset : tag.valueoffset + 2] = (1).to_bytes(2, "big" if data[:2] == b"MM" else "little")
    stored = cv2.imdecode(np.frombuffer(upright, np.uint8), cv2.IMREAD_UNCHANGED)
    if stored is None or stored.dtype != np.uint16 or page.axes == "SYX" or page.photometric not in {1, 2}:
        raise InputError(
            f"{path} is a 16-bit TIFF whose compression (number {int(page.compression)}) is not read",
            hint="save it without compression, or as PNG",
        )
    return np.asarray(stored if stored.ndim == 2 else stored[..., [2, 1, 0]], dtype=np.uint16)


def _check_segments(data: bytes, page: tifffile.TiffPage) -> None:
    """Refuse strips and tiles that decompress to more than they should hold: a thousand times their length."""
    if page.is_tiled:
        pixels = page.tilelength * page.tilewidth
    else:
        pixels = min(page.rowsperstrip, page.imagelength) * page.imagewidth
    most = min(pixels, MAX_PIXELS) * _MAX_CHANNELS * 2
    for offset, length in zip(page.dataoffsets, page.databytecounts, strict=False):
        if len(zlib.decompressobj().decompress(data[offset : offset + length], most + 1)) > most:
            raise ValueError("a part of it decompresses to more than it should hold")
