"""Write photos as a phone would: small, with the EXIF that tells lens and time."""

from __future__ import annotations

from datetime import datetime
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image, TiffImagePlugin

EXIF_IFD = 0x8769
MAKE, MODEL, ORIENTATION = 271, 272, 274
DATE, SUBSECOND, OFFSET = 36867, 37521, 36881
FOCAL_LENGTH, F35, DIGITAL_ZOOM, DISTANCE, LENS_MODEL = 37386, 41989, 41988, 37382, 42036

WIDE = {"focal": 4.25, "f35": 26}
TELE = {"focal": 6.0, "f35": 52}
ULTRA = {"focal": 1.54, "f35": 13}


def exif_of(
    *,
    focal: float | None = None,
    f35: int | None = None,
    second: float | None = None,
    model: str | None = "Phone 1",
    offset: str | None = None,
    zoom: float | None = None,
    distance: Fraction | None = None,
    orientation: int | None = None,
) -> Image.Exif:
    """EXIF of a photo taken so many seconds after noon."""
    exif = Image.Exif()
    inner = exif.get_ifd(EXIF_IFD)
    if model is not None:
        exif[MAKE], exif[MODEL] = "Maker", model
    if orientation is not None:
        exif[ORIENTATION] = orientation
    if second is not None:
        moment = datetime.fromtimestamp(43200 + second)
        noon = datetime(2026, 5, 1, 12) + (moment - datetime.fromtimestamp(43200))
        inner[DATE], inner[SUBSECOND] = noon.strftime("%Y:%m:%d %H:%M:%S"), f"{noon.microsecond // 1000:03d}"
    if offset is not None:
        inner[OFFSET] = offset
    for tag, value in ((FOCAL_LENGTH, focal), (DIGITAL_ZOOM, zoom), (DISTANCE, distance)):
        if value is not None:
            inner[tag] = TiffImagePlugin.IFDRational(Fraction(value).limit_denominator(1000))
    if f35 is not None:
        inner[F35] = f35
    return exif


def write_photo(path: Path, *, wh: tuple[int, int] = (48, 36), exif: Image.Exif | None = None) -> Path:
    """Write a JPEG or HEIC; its content follows from its name."""
    seed = sum(path.name.encode())
    levels = np.random.default_rng(seed).integers(0, 256, (wh[1], wh[0], 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(levels).save(path, exif=(exif or Image.Exif()).tobytes())
    return path
