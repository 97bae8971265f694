"""Read and write pictures and disparity maps.

Every picture in memory is (H, W, 3) RGB float32 in [0, 1], sRGB-encoded, upright (EXIF orientation applied). Read are
JPEG, WebP, AVIF, PNG and TIFF with 8 or 16 bits per channel, HEIC (8 bits, with the extra ``heif``), DNG and other RAW
(exposure and tone: see `telewide.capture.raw`); very large ones at half their size (`telewide.capture.sizes`). Grey,
palette, alpha and CMYK become RGB. An embedded colour profile other than sRGB is converted (8 bit) or named in a
warning (16 bit).
PFM: rows from bottom to top, little endian, +inf for unknown on disk, NaN in memory.
Letters: H W image.
"""

from __future__ import annotations

import logging
import math
import warnings
import zlib
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms, UnidentifiedImageError

from telewide.capture.exif import read_photo_facts
from telewide.capture.formats import PhotoFormat, photo_format, read_bytes
from telewide.capture.jpeg import has_too_many_scans
from telewide.capture.pillow_photos import open_photo
from telewide.capture.raw import develop, show_as_srgb
from telewide.capture.sizes import check_size, halved, is_read_halved, say_halved
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import replacing
from telewide.geometry.arrays import FloatImage
from telewide.ranges import MAX_PIXELS, MAX_SCANS

if TYPE_CHECKING:
    import tifffile

Samples = NDArray[np.integer]

_TAG_ORIENTATION, _TAG_ICC = 274, 34675
_ORIENTATION_OF_TURN = {0: 1, 90: 6, 180: 3, 270: 8}  # CIPA DC-008, by degrees clockwise
# A profile that moves no colour by more than this many 8-bit steps is sRGB, whatever its name.
_SRGB_TOLERANCE = 2
_MAX_CHANNELS = 4
# TIFF compressions whose length is bounded by what they are decoded to: none, PackBits; deflate is checked.
_DEFLATE, _DECODED_HERE = {8, 32946}, {1, 8, 32773, 32946}
_log = logging.getLogger("telewide")


def read_image(path: Path) -> FloatImage:
    """Read a photo upright, as sRGB.

    Args:
        path: a JPEG, PNG, TIFF, WebP, HEIC, AVIF, DNG or other RAW file.

    Returns:
        (H, W, 3) RGB float32 in [0, 1].

    Raises:
        UsageError: there is no such file.
        InputError: the file is empty, cut off, damaged, or of another format.
        MissingPartError: a HEIC photo without the extra that reads it.
    """
    data = read_bytes(path)
    kind = photo_format(path, data)
    try:
        if kind == "RAW":
            return show_as_srgb(develop(path, data))
        return _decoded(path, data, kind)
    except MemoryError as error:
        raise InputError(f"{path} takes more memory than there is", hint="export the photo smaller") from error


def _decoded(path: Path, data: bytes, kind: PhotoFormat) -> FloatImage:
    """Return a photo that is no RAW, upright."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's remarks on odd EXIF and on photos above 89 megapixels
            samples, orientation = _decode(path, data, kind)
    except (TelewideError, MemoryError):
        raise
    except Exception as error:  # the decoders fail on damaged files in a dozen ways
        raise InputError(
            f"{path} cannot be read as an image, it is cut off or damaged: {_reason(error)}",
            hint="copy the file again from the phone",
        ) from error
    scale = np.float32(1 / 65535 if samples.dtype == np.uint16 else 1 / 255)
    upright = _upright(_three_channels(samples), orientation)
    image: FloatImage = upright.astype(np.float32, order="C")
    np.multiply(image, scale, out=image)
    return image


def write_image(path: Path, image: FloatImage, *, quality: int = 92, shown_turned_deg: int = 0) -> None:
    """Write a picture with 8 bits per channel, whole or not at all.

    Args:
        path: ends in .png, .jpg or .jpeg.
        image: (H, W, 3) RGB or (H, W) grey, [0, 1]; values outside are clipped, NaN becomes 0.
        quality: of a JPEG, 1 to 100.
        shown_turned_deg: of a JPEG: how far viewers turn it clockwise (multiple of 90). Its EXIF says so, the pixels
            stay as they are.

    Raises:
        UsageError: another suffix, or the place cannot be written.
        ValueError: a picture that is no JPEG is to be turned.
    """
    levels = (np.clip(np.nan_to_num(image, nan=0.0), 0, 1) * 255 + 0.5).astype(np.uint8)
    suffix = path.suffix.lower()
    if suffix == ".png":
        if shown_turned_deg:
            raise ValueError(f"{path.name}: only a JPEG says how far it is to be turned")
        _write_encoded(path, levels, [])
    elif suffix in {".jpg", ".jpeg"}:
        exif = _turning_exif(shown_turned_deg) if shown_turned_deg else b""
        _write_encoded(path, levels, [cv2.IMWRITE_JPEG_QUALITY, quality], exif=exif)
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


def read_pfm(path: Path) -> FloatImage:
    """Read a disparity map from a PFM file.

    The scale in the header gives the byte order alone: Middlebury's files do not want it multiplied in.

    Args:
        path: a one-channel PFM.

    Returns:
        (H, W) float32, px; NaN where the file has infinity or NaN.

    Raises:
        UsageError: there is no such file.
        InputError: not a PFM, three channels, or cut off.
    """
    data = read_bytes(path)
    kind, *header = data.split(b"\n", 3)
    if kind.strip() != b"Pf":
        found = "a PFM with three channels" if kind.strip() == b"PF" else "no PFM"
        raise InputError(f"{path} is {found}; a one-channel PFM (it begins with Pf) was expected")
    try:
        size, scale_text, body = header
        width, height = (int(number) for number in size.split())
        scale = float(scale_text)
    except ValueError as error:
        raise InputError(f"{path} has a broken PFM header: width and height, then the scale were expected") from error
    expected = width * height * 4
    if width < 1 or height < 1 or len(body) != expected:
        raise InputError(f"{path} holds {len(body)} bytes of values; {width} x {height} floats need {expected}")
    values = np.frombuffer(body, dtype="<f4" if scale < 0 else ">f4").reshape(height, width)[::-1]
    return np.where(np.isfinite(values), values, np.float32(np.nan)).astype(np.float32)


def write_pfm(path: Path, disparity: FloatImage) -> None:
    """Write a disparity map as PFM: little endian, bottom row first, NaN as +inf; whole or not at all.

    Args:
        path: the file.
        disparity: (H, W) float32, px; NaN where unknown.
    """
    height, width = disparity.shape
    values = np.where(np.isnan(disparity), np.inf, disparity)[::-1].astype("<f4")
    with replacing(path) as temporary:
        temporary.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + values.tobytes())


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
    said = str(error).strip().partition("\n")[0]
    return "nothing in it can be recognised" if isinstance(error, UnidentifiedImageError) or not said else said


def _decode(path: Path, data: bytes, kind: PhotoFormat) -> tuple[Samples, int]:
    """Return the samples, in the size a photo is read in, as sRGB, and the EXIF orientation still to be applied."""
    if kind == "TIFF":
        deep = _decode_deep_tiff(path, data)
        if deep is not None:
            return deep
    if kind == "JPEG" and has_too_many_scans(data):
        raise InputError(f"{path} asks for more than {MAX_SCANS} scans of its pixels, which no encoder makes")
    with open_photo(path, BytesIO(data), kind) as photo:
        hw = (photo.height, photo.width)
        if is_read_halved(hw) and photo.format in {"JPEG", "MPO"}:
            photo.draft(photo.mode, (hw[1] // 2, hw[0] // 2))  # decodes half as many of each block's waves
        photo.load()  # also finds cut-off files, which OpenCV lets pass
        # Pillow turns a TIFF itself when it loads it, and then forgets its tag.
        orientation = int(photo.getexif().get(_TAG_ORIENTATION, 1) or 1)
        # Byte 24 of a PNG is the bit depth; Pillow would cut 16-bit colour down to 8.
        if photo.format == "PNG" and data[24] == 16:
            _warn_unless_srgb(path, photo.info.get("icc_profile"))
            return _at_read_size(path, _decode_deep_png(path, data), hw), orientation
        shown = _srgb_from_photo(path, photo)
        if is_read_halved(hw) and (shown.height, shown.width) == hw:
            shown = shown.reduce(2)  # before numpy holds it too
        return _at_read_size(path, np.asarray(shown), hw), orientation


def _at_read_size(path: Path, samples: Samples, hw: tuple[int, int]) -> Samples:
    """Halve what is read halved, unless its decoder has done so."""
    if not is_read_halved(hw):
        return samples
    say_halved(path, hw)
    return halved(samples) if samples.shape[:2] == hw else samples


def _decode_deep_png(path: Path, data: bytes) -> Samples:
    samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if samples is None or samples.dtype != np.uint16:
        raise InputError(f"{path} is a 16-bit PNG that cannot be decoded")
    if samples.ndim == 2:
        return np.asarray(samples, dtype=np.uint16)
    return np.asarray(samples[..., [2, 1, 0]], dtype=np.uint16)


def _decode_deep_tiff(path: Path, data: bytes) -> tuple[Samples, int] | None:
    """Decode a 16-bit TIFF; None leaves an 8-bit one to Pillow."""
    import tifffile

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
        orientation = page.tags.valueof(_TAG_ORIENTATION, default=1)
        profile = page.tags.valueof(_TAG_ICC)
    if axes not in {"YX", "YXS", "SYX"} or samples.ndim != len(axes) or samples.size == 0:
        raise InputError(f"{path} is a TIFF with the axes {axes}; one photo was expected")
    _warn_unless_srgb(path, profile)
    if axes == "SYX":
        samples = np.moveaxis(samples, 0, -1)
    samples = _at_read_size(path, samples, hw)
    return (65535 - samples if is_negative else samples), int(orientation)


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


def _srgb_from_photo(path: Path, photo: Image.Image) -> Image.Image:
    """Drop alpha, expand palettes, convert the embedded profile to sRGB."""
    profile = photo.info.get("icc_profile")
    if photo.mode in {"P", "PA"}:
        photo = photo.convert("RGBA" if "transparency" in photo.info or photo.mode == "PA" else "RGB")
    if photo.mode in {"RGBA", "LA"}:
        if photo.getchannel("A").getextrema()[0] != 255:
            _log.warning("%s has transparent pixels; they are read as opaque", path)
        photo = photo.convert(photo.mode[:-1])
    elif photo.mode not in {"L", "RGB", "CMYK"}:
        photo = photo.convert("L" if photo.mode == "1" else "RGB")
    if profile:
        photo = _apply_profile(path, photo, profile)
    return photo if photo.mode == "RGB" else photo.convert("RGB")  # which copies


def _apply_profile(path: Path, photo: Image.Image, profile_bytes: bytes) -> Image.Image:
    try:
        profile = ImageCms.ImageCmsProfile(BytesIO(profile_bytes))
        if profile.profile.xcolor_space.strip() == "RGB":
            photo = photo.convert("RGB")
            if _is_srgb(profile):
                return photo
        transform = _srgb_transform(profile, photo.mode)
        converted = ImageCms.applyTransform(photo, transform)
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        _log.warning("%s: its colour profile cannot be used (%s); the colours are read as sRGB", path, error)
        return photo
    return photo if converted is None else converted


def _srgb_transform(profile: ImageCms.ImageCmsProfile, mode: str) -> ImageCms.ImageCmsTransform:
    return ImageCms.buildTransform(
        profile,
        ImageCms.createProfile("sRGB"),
        mode,
        "RGB",
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
        flags=ImageCms.Flags.BLACKPOINTCOMPENSATION,
    )


def _is_srgb(profile: ImageCms.ImageCmsProfile) -> bool:
    """Tell by what the profile does to a grid of colours: names such as "sRGB IEC61966-2.1" come in dozens."""
    steps = np.linspace(0, 255, 9).round().astype(np.uint8)
    colours = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(27, 27, 3)
    converted = ImageCms.applyTransform(Image.fromarray(colours), _srgb_transform(profile, "RGB"))
    change = np.abs(np.asarray(converted, dtype=np.int16) - colours.astype(np.int16))
    return int(change.max()) <= _SRGB_TOLERANCE


def _warn_unless_srgb(path: Path, profile_bytes: object) -> None:
    """Warn of a profile that is not converted: Pillow's colour conversion has 8 bits."""
    if not isinstance(profile_bytes, bytes):
        return
    try:
        profile = ImageCms.ImageCmsProfile(BytesIO(profile_bytes))
        name = ImageCms.getProfileDescription(profile).strip()
        if profile.profile.xcolor_space.strip() == "RGB" and _is_srgb(profile):
            return
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        name = f"unreadable: {error}"
    _log.warning("%s has the colour profile %r; 16-bit colours are not converted but read as sRGB", path, name)


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


def _turning_exif(clockwise_deg: int) -> bytes:
    """The APP1 segment of a JPEG that viewers show turned."""
    exif = Image.Exif()
    exif[_TAG_ORIENTATION] = _ORIENTATION_OF_TURN[clockwise_deg]
    content = exif.tobytes()
    return b"\xff\xe1" + (len(content) + 2).to_bytes(2, "big") + content


def _write_encoded(path: Path, levels: Samples, parameters: list[int], *, exif: bytes = b"") -> None:
    """Encode and write; OpenCV before 4.12 writes no EXIF, so its segment goes in after a JPEG's first two bytes."""
    stored = levels if levels.ndim == 2 else np.ascontiguousarray(levels[..., ::-1])
    done, encoded = cv2.imencode(path.suffix.lower(), stored, parameters)
    if not done:
        raise ValueError(f"{path}: an image of shape {levels.shape} and type {levels.dtype} cannot be encoded")
    with replacing(path) as temporary:
        temporary.write_bytes(encoded[:2].tobytes() + exif + encoded[2:].tobytes())
