"""Read and write pictures.

Every picture in memory is (H, W, 3) RGB float32 in [0, 1], sRGB-encoded, upright (EXIF orientation applied). Read are
JPEG, WebP, AVIF, PNG and TIFF with 8 or 16 bits per channel, HEIC (8 bits, with the extra ``heif``), DNG and other RAW
(exposure and tone: see `telewide.capture.raw`); very large ones at half their size (`telewide.capture.sizes`). Grey,
palette, alpha and CMYK become RGB. An embedded colour profile other than sRGB is converted (8 bit) or named in a
warning (16 bit).
Letters: H W image.
"""

from __future__ import annotations

import re
import warnings
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from telewide.capture.colour_profiles import srgb_from_photo, warn_unless_srgb, without_palette
from telewide.capture.deep_images import decode_deep_png, decode_deep_tiff
from telewide.capture.exif import believable_orientation, read_photo_facts
from telewide.capture.formats import PhotoFormat, read_photo
from telewide.capture.jpeg import has_too_many_scans
from telewide.capture.pillow_photos import exif_of, load_photo, open_photo
from telewide.capture.raw import develop, show_as_srgb
from telewide.capture.sizes import Samples, at_read_size, is_read_halved
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import replacing
from telewide.geometry.arrays import FloatImage
from telewide.ranges import MAX_SCANS

_TAG_ORIENTATION = 274
_PILLOWS_COUNT = re.compile(r" \(\d+ bytes not processed\)")  # of its buffer, which nobody asked for
_REDUCED = {"L", "LA", "RGB", "RGBA", "CMYK"}


def read_image(path: Path, *, is_converted: bool = True) -> FloatImage:
    """Read a photo upright, as sRGB.

    Args:
        path: a JPEG, PNG, TIFF, WebP, HEIC, AVIF, DNG or other RAW file.
        is_converted: whether colours of another profile become sRGB; else they stay those of the profile.

    Returns:
        (H, W, 3) RGB float32 in [0, 1].

    Raises:
        UsageError: there is no such file.
        InputError: the file is empty, cut off, corrupt, or of another format.
        MissingPartError: a HEIC photo without the extra that reads it.
    """
    data, kind = read_photo(path)
    try:
        if kind == "RAW":
            return show_as_srgb(develop(path, data))
        return _decoded(path, data, kind, is_converted=is_converted)
    except MemoryError as error:
        raise InputError(f"{path} takes more memory than there is", hint="export the photo smaller") from error


def _decoded(path: Path, data: bytes, kind: PhotoFormat, *, is_converted: bool) -> FloatImage:
    """Return a photo that is no RAW, upright."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's remarks on odd EXIF and on photos above 89 megapixels
            samples, orientation = _decode(path, data, kind, is_converted=is_converted)
    except (TelewideError, MemoryError):
        raise
    except Exception as error:  # the decoders fail on corrupt files in a dozen ways
        raise InputError(
            f"{path} cannot be read as an image, it is cut off or corrupt: {_reason(error)}",
            hint="copy the file again from the phone",
        ) from error
    scale = np.float32(1 / 65535 if samples.dtype == np.uint16 else 1 / 255)
    upright = _upright(_three_channels(samples), orientation)
    image: FloatImage = upright.astype(np.float32, order="C")
    np.multiply(image, scale, out=image)
    return image


def write_image(path: Path, image: FloatImage, *, quality: int = 92) -> None:
    """Write a picture with 8 bits per channel, whole or not at all.

    Args:
        path: ends in .png, .jpg or .jpeg.
        image: (H, W, 3) RGB or (H, W) grey, [0, 1]; values outside are clipped, NaN becomes 0.
        quality: of a JPEG, 1 to 100.

    Raises:
        UsageError: another suffix, or the place cannot be written.
    """
    levels = (np.clip(np.nan_to_num(image, nan=0.0), 0, 1) * 255 + 0.5).astype(np.uint8)
    suffix = path.suffix.lower()
    if suffix == ".png":
        _write_encoded(path, levels, [])
    elif suffix in {".jpg", ".jpeg"}:
        _write_encoded(path, levels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    else:
        raise UsageError(f"{path}: a picture is written as .png or .jpg, not as {suffix or 'a name without suffix'}")


def write_png16(path: Path, values: NDArray[np.uint16]) -> None:
    """Write a PNG with 16 bits per channel, whole or not at all.

    Args:
        path: ends in .png.
        values: (H, W) or (H, W, 3) RGB uint16.

    Raises:
        ValueError: the values are not uint16, or the file is no .png.
    """
    if values.dtype != np.uint16 or path.suffix.lower() != ".png":
        raise ValueError(f"a 16-bit .png holds uint16, got {values.dtype} for {path.name}")
    _write_encoded(path, values, [])


def resize_bicubic(image: FloatImage, *, wh: tuple[int, int]) -> FloatImage:
    """Resize by Keys' cubic convolution (a = -0.5), antialiased where it shrinks.

    Half-pixel rule: ``x' = (x + 0.5) s - 0.5``. Keys, Cubic convolution interpolation, IEEE TASSP 29(6), 1981.

    Args:
        image: (H, W, 3) or (H, W) float32 in [0, 1].
        wh: width and height of the result.

    Returns:
        (wh[1], wh[0], 3) or (wh[1], wh[0]) float32, clipped to [0, 1].
    """
    if image.ndim == 2:
        resized = np.asarray(Image.fromarray(image).resize(wh, Image.Resampling.BICUBIC))
        return np.asarray(np.clip(resized, 0, 1), dtype=np.float32)
    channels = [resize_bicubic(np.ascontiguousarray(image[..., i]), wh=wh) for i in range(image.shape[2])]
    return np.stack(channels, axis=-1)


def focal_length_mm(path: Path) -> float | None:
    """Physical focal length that a photo's EXIF states: which of a phone's lenses took it.

    Args:
        path: a photo.

    Returns:
        mm, or None where the file says nothing believable.
    """
    try:
        return read_photo_facts(path).focal_length_mm
    except TelewideError:
        return None


def _reason(error: Exception) -> str:
    """Return what a decoder says, in one line; Pillow names an object in memory where it knows no reason."""
    said = _PILLOWS_COUNT.sub("", str(error).strip().partition("\n")[0])
    return "nothing in it can be recognised" if isinstance(error, UnidentifiedImageError) or not said else said


def _decode(path: Path, data: bytes, kind: PhotoFormat, *, is_converted: bool) -> tuple[Samples, int]:
    """Return the samples, in the size a photo is read in, as sRGB, and the EXIF orientation still to be applied."""
    if kind == "TIFF":
        deep = decode_deep_tiff(path, data)
        if deep is not None:
            return deep
    if kind == "JPEG" and has_too_many_scans(data):
        raise InputError(f"{path} asks for more than {MAX_SCANS} scans of its pixels, which no encoder makes")
    with open_photo(path, BytesIO(data), kind) as photo:
        hw = (photo.height, photo.width)
        if is_read_halved(hw) and photo.format in {"JPEG", "MPO"}:
            photo.draft(photo.mode, (hw[1] // 2, hw[0] // 2))  # decodes half as many of each block's waves
        load_photo(photo)  # also finds cut-off files, which OpenCV lets pass
        # Pillow turns a TIFF itself when it loads it, and then forgets its tag.
        orientation = believable_orientation(exif_of(photo).get(_TAG_ORIENTATION))
        # Byte 24 of a PNG is the bit depth; Pillow would cut 16-bit colour down to 8.
        if photo.format == "PNG" and data[24] == 16:
            warn_unless_srgb(path, photo.info.get("icc_profile"))
            photo.close()  # a gigabyte of the largest
            return decode_deep_png(path, data), orientation
        shown: Image.Image = photo
        if is_read_halved(hw) and (photo.height, photo.width) == hw:
            shown = without_palette(photo)
            shown = shown.reduce(2) if shown.mode in _REDUCED else shown  # before anything else is copied
        shown = srgb_from_photo(path, shown, is_converted=is_converted)
        return at_read_size(path, np.asarray(shown), hw), orientation


def _three_channels(samples: Samples) -> Samples:
    if samples.ndim == 2 or samples.shape[2] <= 2:
        grey = samples if samples.ndim == 2 else samples[..., 0]
        return np.repeat(grey[..., None], 3, axis=2)
    return samples[..., :3]


def _upright(samples: Samples, orientation: int) -> Samples:
    """Apply an EXIF orientation (CIPA DC-008, tag 274): the sides where the stored row 0 and column 0 belong."""
    if orientation in {5, 6, 7, 8}:
        samples = samples.swapaxes(0, 1)
    if orientation in {2, 3, 6, 7}:
        samples = samples[:, ::-1]
    if orientation in {3, 4, 7, 8}:
        samples = samples[::-1]
    return samples


def _write_encoded(path: Path, levels: Samples, parameters: list[int]) -> None:
    stored = levels if levels.ndim == 2 else np.ascontiguousarray(levels[..., ::-1])
    done, encoded = cv2.imencode(path.suffix.lower(), stored, parameters)
    if not done:
        raise ValueError(f"{path}: an image of shape {levels.shape} and type {levels.dtype} cannot be encoded")
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())
