"""PNGs of 16 bits, 0 unknown: ``disparity.png``, px * 256 (KITTI), and ``depth_mm.png``, mm (TUM, Open3D).

Letters: H W image.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telewide.capture.images import write_png16
from telewide.depth.formats.contents import NO_METRES, Contents, WrittenDepth
from telewide.geometry.arrays import FloatMap

PNG_NAME, MM_NAME = "disparity.png", "depth_mm.png"
PNG_STEPS_PER_PX = 256
MM_IN_A_METRE = 1000
_PNG_LARGEST = 65535


def write_disparity_png(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``disparity.png``, where it can hold what was measured."""
    if reason := png_refusal(contents):
        return contents.left_out(PNG_NAME, f"{reason}; disparity.pfm holds all values")
    write_png16(folder / PNG_NAME, png_from_disparity(contents.result.disparity.disparity_px))
    return WrittenDepth((folder / PNG_NAME,))


def write_depth_png(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth_mm.png``, where metres are known; it says how much lies farther than it can tell."""
    if contents.result.depth_m is None:
        return contents.left_out(MM_NAME, NO_METRES)
    depth_m = contents.result.depth_m
    write_png16(folder / MM_NAME, png_from_depth(depth_m))
    too_far = float((depth_m * MM_IN_A_METRE >= _PNG_LARGEST + 0.5).mean())
    told = f"{contents.result.name}: {too_far:.0%} of {MM_NAME} is 0: it lies farther than the 65.5 m that 16 bits hold"
    return WrittenDepth((folder / MM_NAME,), (told,) if too_far >= 0.005 else ())


def png_refusal(contents: Contents) -> str | None:
    """Say why a 16-bit PNG cannot hold this map, or None where it can: all measured values must lie in (0, 256) px."""
    measured_px = contents.result.disparity.disparity_px[contents.measured]
    if measured_px.size == 0:
        return "nothing was measured"
    low, high = float(measured_px.min()), float(measured_px.max())
    if low > 0 and high < (_PNG_LARGEST + 1) / PNG_STEPS_PER_PX:
        return None
    return f"it holds 0 to 256 px and the disparities reach from {low:.1f} to {high:.1f} px"


def png_from_disparity(disparity_px: FloatMap) -> NDArray[np.uint16]:
    """Encode as KITTI does: ``round(256 d)``; 0 where ``d`` is unknown or not in (0, 256) px.

    Args:
        disparity_px: (H, W), px; NaN is unknown.

    Returns:
        (H, W) uint16, in 1/256 px; a known value never becomes 0.
    """
    return _steps(disparity_px, steps=PNG_STEPS_PER_PX, below=(_PNG_LARGEST + 1) / PNG_STEPS_PER_PX)


def png_from_depth(depth_m: FloatMap) -> NDArray[np.uint16]:
    """Encode depth in whole millimetres; 0 where it is unknown or 65.5355 m and more.

    Args:
        depth_m: (H, W), m; NaN is unknown.

    Returns:
        (H, W) uint16, mm; a known value never becomes 0.
    """
    return _steps(depth_m, steps=MM_IN_A_METRE, below=(_PNG_LARGEST + 0.5) / MM_IN_A_METRE)


def _steps(values: FloatMap, *, steps: int, below: float) -> NDArray[np.uint16]:
    holds = np.isfinite(values) & (values > 0) & (values < below)
    rounded = np.round(np.where(holds, values, 0).astype(np.float64) * steps)
    return np.where(holds, np.clip(rounded, 1, _PNG_LARGEST), 0).astype(np.uint16)
