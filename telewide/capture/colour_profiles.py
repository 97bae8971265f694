"""Embedded colour profiles: photos become sRGB, or a warning says that they do not."""

from __future__ import annotations

import logging
import struct
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms

# A profile that moves no colour by more than this many 8-bit steps is sRGB, whatever its name.
_SRGB_TOLERANCE = 2
# Of a profile's header (ICC.1, 7.2): when it was made, and the MD5 of its bytes, which may be left out.
_DATE, _ID = slice(24, 36), slice(84, 100)
_log = logging.getLogger("telewide")


def srgb_from_photo(path: Path, photo: Image.Image, *, is_converted: bool = True) -> Image.Image:
    """Drop alpha, expand palettes, convert the embedded profile to sRGB unless colours stay its own."""
    profile = photo.info.get("icc_profile")
    photo = without_palette(photo)
    if photo.mode in {"RGBA", "LA"}:
        if photo.getchannel("A").getextrema()[0] != 255:
            _log.warning("%s has transparent pixels; they are read as opaque", path)
        photo = photo.convert(photo.mode[:-1])
    elif photo.mode not in {"L", "RGB", "CMYK"}:
        photo = photo.convert("L" if photo.mode == "1" else "RGB")
    if profile and is_converted:
        photo = _apply_profile(path, photo, profile)
    return photo if photo.mode == "RGB" else photo.convert("RGB")  # which copies


def without_palette(photo: Image.Image) -> Image.Image:
    """Expand a palette; any other photo is returned as it is."""
    if photo.mode not in {"P", "PA"}:
        return photo
    return photo.convert("RGBA" if "transparency" in photo.info or photo.mode == "PA" else "RGB")


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


def rgb_profile(profile_bytes: object) -> bytes | None:
    """Return an embedded profile if it is one of RGB colours that can be read."""
    if not isinstance(profile_bytes, bytes):
        return None
    try:
        profile = ImageCms.ImageCmsProfile(BytesIO(profile_bytes))
        return profile_bytes if profile.profile.xcolor_space.strip() == "RGB" else None
    except (ImageCms.PyCMSError, OSError, ValueError):
        return None


@cache
def srgb_profile() -> bytes:
    """Make a profile of sRGB; always of the same bytes, though its maker states the present time in it."""
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile[_DATE], profile[_ID] = struct.pack(">6H", 1999, 10, 1, 0, 0, 0), bytes(16)  # when sRGB became a standard
    return bytes(profile)


def is_other_than_srgb(profile_bytes: bytes) -> bool:
    """Whether colours of an RGB profile are others than those of sRGB."""
    return not _is_srgb(ImageCms.ImageCmsProfile(BytesIO(profile_bytes)))


def warn_unless_srgb(path: Path, profile_bytes: object) -> None:
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
