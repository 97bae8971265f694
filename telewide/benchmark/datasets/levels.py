"""Pictures of data sets: views also as PPM and PGM, disparities as whole numbers. Letters: H W image."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.formats import read_bytes
from telewide.capture.images import read_image
from telewide.errors import InputError
from telewide.files import is_file
from telewide.geometry.arrays import FloatImage, FloatMap

_PORTABLE = (".ppm", ".pgm")
_SUFFIXES = (".png", *_PORTABLE)


def picture_path(folder: Path, stem: str) -> Path | None:
    """Find a picture by its name without suffix, as PNG, PPM or PGM; None where there is none."""
    return next((path for suffix in _SUFFIXES if is_file(path := folder / f"{stem}{suffix}")), None)


def read_view(path: Path) -> FloatImage:
    """Read a view of a data set.

    Args:
        path: PNG, JPEG and what else photos come in, PPM or PGM.

    Returns:
        (H, W, 3) RGB float32 in [0, 1].

    Raises:
        UsageError: there is no such file.
        InputError: the file cannot be read.
    """
    if path.suffix.lower() not in _PORTABLE:
        return read_image(path)
    levels = _decoded(path)
    values = levels.astype(np.float32) / np.float32(255 if levels.dtype == np.uint8 else 65535)
    if values.ndim == 2:
        return np.repeat(values[..., None], 3, axis=2)
    return np.ascontiguousarray(values[..., ::-1])


def read_levels(path: Path, *, bits: Literal[8, 16] = 8) -> NDArray[np.uint16]:
    """Read a picture of whole numbers, such as a disparity map or a mask.

    Args:
        path: PNG, PPM or PGM.
        bits: that each number has in the file.

    Returns:
        (H, W) uint16, the numbers as stored.

    Raises:
        UsageError: there is no such file.
        InputError: the file cannot be read, is in colour, or has another number of bits.
    """
    levels = _decoded(path)
    if levels.ndim == 3 and not (levels[..., :3] == levels[..., :1]).all():
        raise InputError(f"{path} is a picture in colour; grey levels were expected")
    if levels.dtype.itemsize * 8 != bits:
        raise InputError(f"{path} has {levels.dtype.itemsize * 8} bits; a picture of {bits} bits was expected")
    return np.asarray(levels[..., 0] if levels.ndim == 3 else levels, dtype=np.uint16)


def read_scaled_disparity(path: Path, *, scale: float, bits: Literal[8, 16] = 8) -> FloatMap:
    """Read disparities stored as whole numbers, 0 for unknown.

    Args:
        path: see `read_levels`.
        scale: what the numbers are divided by.
        bits: that each number has in the file.

    Returns:
        (H, W) float32, px; NaN where unknown.
    """
    levels = read_levels(path, bits=bits)
    return np.where(levels > 0, levels / scale, np.nan).astype(np.float32)


def _decoded(path: Path) -> NDArray[np.generic]:
    """Decode to (H, W) or (H, W, C) in OpenCV's order, BGR; of 8 or 16 bits."""
    data = np.frombuffer(read_bytes(path), dtype=np.uint8)
    try:
        levels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        levels = None
    if levels is None or levels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path} cannot be read as a picture of 8 or 16 bits; it is corrupt or of another format")
    return levels
