"""Depth of one capture as the writers of its files need it: what may be in them, and what each format asks for.

Letters: H W image; h w after thinning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.pictures import PictureFacts
from telewide.depth.nearest import fill_unknown
from telewide.depth.result import DepthResult
from telewide.files import replacing
from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap

LARGEST_OF_16_BITS = 65535
NO_METRES = "its depth in metres is not known"


@dataclass(frozen=True)
class WrittenDepth:
    """Files written for one capture.

    Attributes:
        paths: of the files, in the order they were written.
        notes: sentences on what was left out, and why.
    """

    paths: tuple[Path, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Contents:
    """Everything that a file of one capture may hold.

    Attributes:
        result: its depth.
        image: (H, W, 3) float32, the tele photo, sRGB in [0, 1]; None where only the maps are at hand.
        facts: of the photo, and of the files themselves; None says nothing.
        own_colours: the photo in the colours of its own profile, where those are others than sRGB's.
    """

    result: DepthResult
    image: FloatMap | None = None
    facts: PictureFacts | None = None
    own_colours: FloatMap | None = None

    def left_out(self, what: str, why: str) -> WrittenDepth:
        """Say that a file cannot be made of this capture."""
        return WrittenDepth((), (f"{self.result.name}: no {what}, {why}",))

    @property
    def exif_without_place(self) -> bytes:
        """EXIF for files that are made to be handed on: camera, exposure and date; no GPS."""
        if self.facts is None or self.image is None:
            return b""
        facts = replace(self.facts, of_photo=replace(self.facts.of_photo, gps={}))
        return facts.exif_bytes(wh=(self.image.shape[1], self.image.shape[0]))

    @property
    def measured(self) -> BoolMap:
        """(H, W) bool, where disparity was measured, not filled in."""
        return self.result.disparity.valid & np.isfinite(self.result.disparity.disparity_px)

    @property
    def confidence(self) -> FloatMap:
        """(H, W) float32 in [0, 1], 0 where nothing was measured."""
        known = np.nan_to_num(self.result.disparity.confidence, nan=0.0)
        return np.where(self.measured, np.clip(known, 0, 1), 0).astype(np.float32)


@dataclass(frozen=True)
class InverseDepth:
    """A map for programs that blur: everywhere known, and linear in inverse depth.

    Attributes:
        share: (h, w) float32 in [0, 1]: 0 at the nearest, 1 at the farthest.
        confidence: (h, w) float32 in [0, 1], 0 where the depth was filled in.
        near_m: depth at 0.
        far_m: depth at 1.
    """

    share: FloatMap
    confidence: FloatMap
    near_m: float
    far_m: float


def inverse_depth(contents: Contents, *, longest_px: int) -> InverseDepth | None:
    """Stretch depth as GDepth and Dynamic Depth do (RangeInverse): ``v = far (z - near) / (z (far - near))``.

    Args:
        contents: of one capture.
        longest_px: of the longer side of the map; more is thinned out, each value as it was.

    Returns:
        The map; None without metres, or where all of it lies at one distance.
    """
    depth_m = contents.result.depth_m
    if depth_m is None or not np.isfinite(depth_m).any():
        return None
    near_m, far_m = float(np.nanmin(depth_m)), float(np.nanmax(depth_m))
    if not 0 < near_m < far_m:
        return None
    # What lies behind infinity or is unknown takes the depth of its neighbour, with no confidence.
    known_m = fill_unknown(thinned(depth_m, longest_px=longest_px)).astype(np.float64)
    share = far_m * (known_m - near_m) / (known_m * (far_m - near_m))
    confidence = np.where(np.isfinite(depth_m), contents.confidence, np.float32(0))
    return InverseDepth(
        np.clip(share, 0, 1).astype(np.float32), thinned(confidence, longest_px=longest_px), near_m, far_m
    )


def thinned(values: FloatMap, *, longest_px: int) -> FloatMap:
    """Take every k-th row and column, k as small as brings the longer side to a length; no value is averaged."""
    step = math.ceil(max(values.shape[:2]) / longest_px)
    return np.ascontiguousarray(values[step // 2 :: step, step // 2 :: step])


def positions_m(contents: Contents, *, longest_px: int) -> FloatMap | None:
    """Place each pixel in space.

    Args:
        contents: of one capture.
        longest_px: of the longer side; more is thinned out.

    Returns:
        (h, w, 3) float32, m, in tele's frame: x right, y down, z forward; NaN where unknown. None without metres.
    """
    result = contents.result
    if result.depth_m is None or result.K is None:
        return None
    rows, columns = (np.arange(size, dtype=np.float32) for size in result.depth_m.shape)
    x_px, y_px = np.meshgrid(columns, rows)
    at_px = np.stack([thinned(side, longest_px=longest_px) for side in (x_px, y_px)], axis=-1)
    depth_m = thinned(result.depth_m, longest_px=longest_px)
    ray = _rays(at_px, result.K, result.distortion)
    return np.asarray(np.concatenate([ray * depth_m[..., None], depth_m[..., None]], axis=-1), dtype=np.float32)


def _rays(at_px: FloatMap, K: FloatArray, distortion: FloatArray | None) -> FloatMap:
    """Slopes x/z and y/z (h, w, 2) of pixels; of a distorted photo by OpenCV's model."""
    flat = cv2.undistortPoints(at_px.reshape(-1, 1, 2), K, distortion)
    return np.asarray(flat, dtype=np.float32).reshape(at_px.shape)


def levels(values: FloatMap, *, bits: int) -> FloatMap:
    """Round values in [0, 1] to whole levels of 8 or 16 bits."""
    return np.asarray(np.round(np.clip(values, 0, 1) * np.float32(2**bits - 1)), dtype=np.float32)


def sixteen_bits(values: FloatMap, *, steps: int, below: float) -> NDArray[np.uint16]:
    """Encode a map in steps of its unit, in 16 bits; 0 where a value is unknown, or not above 0 and below a limit.

    Args:
        values: (H, W), NaN where unknown.
        steps: for one unit.
        below: limit, in the unit.

    Returns:
        (H, W) uint16; a known value never becomes 0.
    """
    holds = np.isfinite(values) & (values > 0) & (values < below)
    rounded = np.round(np.where(holds, values, 0).astype(np.float64) * steps)
    return np.where(holds, np.clip(rounded, 1, LARGEST_OF_16_BITS), 0).astype(np.uint16)


def written_whole(path: Path, encoded: object) -> WrittenDepth:
    """Write what a library has encoded, whole or not at all."""
    if not isinstance(encoded, bytes):  # as trimesh may return other formats
        raise TypeError(f"{path.name} was encoded as {type(encoded).__name__}")
    with replacing(path) as temporary:
        temporary.write_bytes(encoded)
    return WrittenDepth((path,))
