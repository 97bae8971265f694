"""``depth.npz``: everything that is known, unknown NaN; telewide itself reads it again. Letters: H W image."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from telewide.capture.sizes import MAX_WHOLE_PIXELS
from telewide.depth.formats.contents import Contents, WrittenDepth
from telewide.depth.result import DepthResult
from telewide.errors import InputError
from telewide.files import replacing
from telewide.geometry.stereo import DisparityMap
from telewide.npz import names_in_npz, read_npz

NPZ_FORMAT = 1
NPZ_NAME = "depth.npz"
# Maps that are read again, as they are written, and what those of the largest photo take with their headers.
_KINDS = {"disparity": np.dtype(np.float32), "confidence": np.dtype(np.float32), "valid": np.dtype(np.bool_)}
_MOST_BYTES = MAX_WHOLE_PIXELS * sum(kind.itemsize for kind in _KINDS.values()) + 4096


def write_npz(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth.npz``."""
    path = folder / NPZ_NAME
    _write_npz(path, npz_arrays(contents.result))
    return WrittenDepth((path,))


def read_disparity(path: Path) -> DisparityMap:
    """Read the disparity of a ``depth.npz``.

    Args:
        path: a ``depth.npz``.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt, or of another kind.
    """
    maps = read_npz(path, tuple(_KINDS), most_bytes=_MOST_BYTES)
    disparity_px, confidence, valid = maps
    if [one.dtype for one in maps] != [*_KINDS.values()]:
        raise InputError(f"{path} is corrupt: its maps are {', '.join(str(one.dtype) for one in maps)}")
    if disparity_px.ndim != 2 or any(one.shape != disparity_px.shape for one in maps) or not disparity_px.size:
        raise InputError(f"{path} is corrupt: its maps are not of one size")
    disparity_px, confidence = (one.astype(np.float32, copy=False) for one in (disparity_px, confidence))
    return DisparityMap(disparity_px, confidence, valid.astype(np.bool_, copy=False))


def read_result(path: Path, *, name: str) -> DepthResult:
    """Read the result that a ``depth.npz`` was written of, upright.

    Args:
        path: a ``depth.npz``.
        name: of the capture.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt, or of another kind.
    """
    disparity, lying = read_disparity(path), names_in_npz(path)
    hw = disparity.disparity_px.shape
    stated = {
        each: read_npz(path, (each,), most_bytes=_MOST_BYTES)[0] if each in lying else None
        for each in ("K", "baseline_m", "doffs_px", "depth_m", "depth_std_m", "distortion")
    }
    numbers = [stated[each] for each in ("K", "baseline_m", "doffs_px", "distortion")]
    if any(one is not None and one.dtype != np.float64 for one in numbers):
        raise InputError(f"{path} is corrupt: its camera is none")
    K, baseline_m, doffs_px, distortion = numbers
    maps_m = [stated["depth_m"], stated["depth_std_m"]]
    if any(one is not None and (one.shape != hw or one.dtype != np.float32) for one in maps_m):
        raise InputError(f"{path} is corrupt: its maps are not of one size")
    if K is None or K.shape != (3, 3) or any(one is not None and one.size != 1 for one in (baseline_m, doffs_px)):
        raise InputError(f"{path} is corrupt: its camera is none")
    depth_m, std_m = (None if one is None else one.astype(np.float32, copy=False) for one in maps_m)
    return DepthResult(
        name=name,
        disparity=disparity,
        K=K.astype(np.float64) if np.isfinite(K.astype(np.float64)).all() else None,
        baseline_m=None if baseline_m is None else float(baseline_m.astype(np.float64).item()),
        depth_m=depth_m,
        depth_std_m=std_m,
        distortion=None if distortion is None else distortion.astype(np.float64),
        doffs_px=0.0 if doffs_px is None else float(doffs_px.astype(np.float64).item()),
    )


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
