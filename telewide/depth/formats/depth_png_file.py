"""``depth_mm.png``, 16 bits: whole millimetres, 0 unknown, as TUM and Open3D have it. Letters: H W image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.capture.images import write_png16
from telewide.depth.formats.contents import LARGEST_OF_16_BITS, NO_METRES, Contents, WrittenDepth, sixteen_bits
from telewide.geometry.arrays import FloatMap

MM_NAME = "depth_mm.png"
MM_IN_A_METRE = 1000


def write_depth_png(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth_mm.png``, where metres are known; it says how much lies farther than it can tell."""
    if contents.result.depth_m is None:
        return contents.left_out(MM_NAME, NO_METRES)
    depth_m = contents.result.depth_m
    write_png16(folder / MM_NAME, png_from_depth(depth_m))
    too_far = float((depth_m * MM_IN_A_METRE >= LARGEST_OF_16_BITS + 0.5).mean())
    told = f"{contents.result.name}: {too_far:.0%} of {MM_NAME} is 0: it lies farther than the 65.5 m that 16 bits hold"
    return WrittenDepth((folder / MM_NAME,), (told,) if too_far >= 0.005 else ())


def png_from_depth(depth_m: FloatMap) -> NDArray[np.uint16]:
    """Encode depth in whole millimetres; 0 where it is unknown or 65.5355 m and more.

    Args:
        depth_m: (H, W), m; NaN is unknown.

    Returns:
        (H, W) uint16, mm; a known value never becomes 0.
    """
    return sixteen_bits(depth_m, steps=MM_IN_A_METRE, below=(LARGEST_OF_16_BITS + 0.5) / MM_IN_A_METRE)
