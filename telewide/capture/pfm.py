"""Disparity maps as PFM: rows from bottom to top, little endian, +inf for unknown on disk, NaN in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.capture.formats import read_bytes
from telewide.errors import InputError
from telewide.files import replacing
from telewide.geometry.arrays import FloatImage


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
