"""Depth into files other programs read.

``disparity.pfm`` float px, unknown +inf, rows bottom up (Middlebury). ``disparity.png`` 16 bit, value / 256 px, 0 none
(KITTI). ``depth.npz`` everything, unknown NaN. ``preview.png`` for people.
The disparity files hold the filled map; ``valid`` in the npz says which of it was measured.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from telewide.capture.images import write_image, write_png16
from telewide.capture.pfm import write_pfm
from telewide.capture.sizes import MAX_WHOLE_PIXELS
from telewide.depth.preview import preview
from telewide.depth.result import DepthResult, stood_upright
from telewide.errors import InputError
from telewide.files import replacing
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.npz import read_npz

NPZ_FORMAT = 1
NPZ_NAME = "depth.npz"
PNG_STEPS_PER_PX = 256
_PNG_LARGEST = 65535
# Maps that are read again, as they are written, and what those of the largest photo take with their headers.
_KINDS = {"disparity": np.dtype(np.float32), "confidence": np.dtype(np.float32), "valid": np.dtype(np.bool_)}
_MOST_BYTES = MAX_WHOLE_PIXELS * sum(kind.itemsize for kind in _KINDS.values()) + 4096


@dataclass(frozen=True)
class WrittenDepth:
    """Files written for one capture.

    Attributes:
        paths: of the files, in the order they were written.
        notes: sentences on what was left out, and why.
    """

    paths: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def write_depth(folder: Path, result: DepthResult, *, image: FloatMap | None = None) -> WrittenDepth:
    """Write the depth of one capture upright, each file atomically.

    Args:
        folder: is made if it is not there.
        result: of one capture.
        image: (H, W, 3) the ref photo, RGB in [0, 1], turned as the result is, for the preview; without it none is
            written.

    Returns:
        The paths and what to know about them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture = None if image is None else preview(image, result)
    result = stood_upright(result)
    paths, notes = [folder / "disparity.pfm"], []
    write_pfm(paths[0], result.disparity.disparity_px)
    png_path = folder / "disparity.png"
    if reason := png_refusal(result):
        png_path.unlink(missing_ok=True)  # one of an earlier run would belong to another map
        notes.append(f"{result.name}: no disparity.png, {reason}; disparity.pfm holds all values")
    else:
        write_png16(png_path, png_from_disparity(result.disparity.disparity_px))
        paths.append(png_path)
    paths.append(folder / NPZ_NAME)
    _write_npz(paths[-1], npz_arrays(result))
    if picture is not None:
        paths.append(folder / "preview.png")
        write_image(paths[-1], picture)
    return WrittenDepth(paths=tuple(paths), notes=tuple(notes))


def read_disparity(path: Path) -> DisparityMap:
    """Read the disparity that `write_depth` wrote.

    Args:
        path: a ``depth.npz``.

    Raises:
        UsageError: there is no such file.
        InputError: it is damaged, or of another kind.
    """
    maps = read_npz(path, tuple(_KINDS), most_bytes=_MOST_BYTES)
    disparity_px, confidence, valid = maps
    if [one.dtype for one in maps] != [*_KINDS.values()]:
        raise InputError(f"{path} is damaged: its maps are {', '.join(str(one.dtype) for one in maps)}")
    if disparity_px.ndim != 2 or any(one.shape != disparity_px.shape for one in maps) or not disparity_px.size:
        raise InputError(f"{path} is damaged: its maps are not of one size")
    return DisparityMap(disparity_px.astype(np.float32), confidence.astype(np.float32), valid.astype(np.bool_))


def png_refusal(result: DepthResult) -> str | None:
    """Say why a 16-bit PNG cannot hold this map, or None where it can: all measured values must lie in (0, 256) px."""
    disparity_px = result.disparity.disparity_px
    measured_px = disparity_px[result.disparity.valid & np.isfinite(disparity_px)]
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
    largest_px = (_PNG_LARGEST + 1) / PNG_STEPS_PER_PX
    holds = np.isfinite(disparity_px) & (disparity_px > 0) & (disparity_px < largest_px)
    steps = np.round(np.where(holds, disparity_px, 0).astype(np.float64) * PNG_STEPS_PER_PX)
    return np.where(holds, np.clip(steps, 1, _PNG_LARGEST), 0).astype(np.uint16)


def npz_arrays(result: DepthResult) -> dict[str, NDArray[np.generic]]:
    """Gather what ``depth.npz`` holds.

    Returns:
        ``format``; ``disparity`` (H, W) float32 px; ``confidence`` (H, W) float32; ``valid`` (H, W) bool; ``K`` (3, 3)
        float64 px, NaN where not known; where known ``distortion`` (n,) OpenCV coefficients, ``baseline_m``,
        ``doffs_px``, ``depth_m`` (H, W) float32 and its standard deviation ``depth_std_m`` (H, W) float32.
    """
    arrays: dict[str, NDArray[np.generic]] = {
        "format": np.array(NPZ_FORMAT),
        "disparity": result.disparity.disparity_px.astype(np.float32),
        "confidence": result.disparity.confidence.astype(np.float32),
        "valid": result.disparity.valid.astype(np.bool_),
        "K": np.full((3, 3), np.nan) if result.K is None else result.K.astype(np.float64),
    }
    if result.baseline_m is not None:
        arrays["baseline_m"] = np.array(result.baseline_m)
    if result.depth_m is not None:
        arrays["depth_m"] = result.depth_m.astype(np.float32)
        arrays["doffs_px"] = np.array(result.doffs_px)
    if result.depth_std_m is not None:
        arrays["depth_std_m"] = result.depth_std_m.astype(np.float32)
    if result.distortion is not None and result.distortion.size:
        arrays["distortion"] = result.distortion.astype(np.float64)
    return arrays


def _write_npz(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    with replacing(path) as temporary, temporary.open("wb") as file:  # a file, for numpy would add .npz to a name
        np.savez_compressed(file, **cast(dict[str, Any], arrays))  # its types take a name for an option
