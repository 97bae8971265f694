"""Disparity maps as PFM: rows from bottom to top, little endian, +inf for unknown on disk, NaN in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.capture.formats import read_bytes
from telewide.capture.sizes import MAX_WHOLE_PIXELS
from telewide.errors import InputError
from telewide.files import replacing
from telewide.geometry.arrays import FloatImage

_MOST_HEADER_BYTES = 256


def read_pfm(path: Path) -> FloatImage:
    """Read a disparity map from a PFM file.

    The scale in the header gives the byte order alone: Middlebury's files do not want it multiplied in.

    Args:
        path: a one-channel PFM.

    Returns:
        (H, W) float32, px; NaN where the file has infinity or NaN.

    Raises:
        UsageError: there is no such file.
        InputError: not a PFM, three channels, cut off, or of more pixels than photos are read with.
    """
    most_bytes = MAX_WHOLE_PIXELS * 4 + _MOST_HEADER_BYTES
    data = read_bytes(path, at_most=most_bytes + 1)
    if len(data) > most_bytes:
        raise InputError(f"{path} is larger than the disparities of any photo that is read")
    kind, *header = data[:_MOST_HEADER_BYTES].split(b"\n", 3)
    if kind.strip() != b"Pf":
        found = "a PFM with three channels" if kind.strip() == b"PF" else "no PFM"
        raise InputError(f"{path} is {found}; a one-channel PFM (it begins with Pf) was expected")
    try:
        size, scale_text, _ = header
        width, height = (int(number) for number in size.split())
        scale = float(scale_text)
    except ValueError as error:
        raise InputError(f"{path} has a broken PFM header: width and height, then the scale were expected") from error
    first = sum(len(line) + 1 for line in (kind, size, scale_text))
    expected = width * height * 4
    if width < 1 or height < 1 or len(data) - first != expected:
        raise InputError(f"{path} holds {len(data) - first} bytes of values; {width} x {height} floats need {expected}")
    stored = np.frombuffer(data, dtype="<f4" if scale < 0 else ">f4", offset=first).reshape(height, width)
    values: FloatImage = stored[::-1].astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    return values


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
