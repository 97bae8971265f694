"""``disparity.png``, 16 bits: px * 256, 0 unknown, as KITTI has it. Letters: H W image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.capture.images import write_png16
from telewide.depth.formats.contents import LARGEST_OF_16_BITS, Contents, WrittenDepth, sixteen_bits
from telewide.geometry.arrays import FloatMap

PNG_NAME = "disparity.png"
PNG_STEPS_PER_PX = 256


def write_disparity_png(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``disparity.png``, where it can hold what was measured."""
    if reason := png_refusal(contents):
        return contents.left_out(PNG_NAME, f"{reason}; disparity.pfm holds all values")
    write_png16(folder / PNG_NAME, png_from_disparity(contents.result.disparity.disparity_px))
    return WrittenDepth((folder / PNG_NAME,))


def png_refusal(contents: Contents) -> str | None:
    """Say why a 16-bit PNG cannot hold this map, or None where it can: all measured values must lie in (0, 256) px."""
    measured_px = contents.result.disparity.disparity_px[contents.measured]
    if measured_px.size == 0:
        return "nothing was measured"
    low, high = float(measured_px.min()), float(measured_px.max())
    if low > 0 and high < (LARGEST_OF_16_BITS + 1) / PNG_STEPS_PER_PX:
        return None
    return f"it holds 0 to 256 px and the disparities reach from {low:.1f} to {high:.1f} px"


def png_from_disparity(disparity_px: FloatMap) -> NDArray[np.uint16]:
    """Encode as KITTI does: ``round(256 d)``; 0 where ``d`` is unknown or not in (0, 256) px.

    Args:
        disparity_px: (H, W), px; NaN is unknown.

    Returns:
        (H, W) uint16, in 1/256 px; a known value never becomes 0.
    """
    return sixteen_bits(disparity_px, steps=PNG_STEPS_PER_PX, below=(LARGEST_OF_16_BITS + 1) / PNG_STEPS_PER_PX)
