"""A small capture with metres: a near box before a slanted wall, something unmeasured, a sky too far to tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from telewide.capture.facts import CaptureFacts
from telewide.depth.result import DepthResult, depth_result
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap

HW = (60, 80)
BOX, WALL, SKY, UNMEASURED = np.s_[20:40, 30:50], np.s_[50:58, 5:25], np.s_[:6], np.s_[44:48, 60:70]
F_PX, BASELINE_M = 600.0, 0.012


def made_result(*, has_metres: bool = True) -> DepthResult:
    """Disparity of the scene, with its depth unless that is not known."""
    disparity_px = np.tile(np.linspace(2, 3, HW[1], dtype=np.float32), (HW[0], 1))
    disparity_px[BOX], disparity_px[SKY] = 9.0, -0.25
    valid = np.ones(HW, np.bool_)
    valid[UNMEASURED] = False
    disparity = DisparityMap(disparity_px, np.full(HW, 0.75, np.float32), valid)
    facts = CaptureFacts(f_px=F_PX, baseline_m=BASELINE_M) if has_metres else None
    return depth_result("shot", disparity, facts=facts)


def turned_result(rotated_deg: int) -> DepthResult:
    """Depth of the scene by photos that were turned counter-clockwise."""
    seen, facts = made_result().disparity, CaptureFacts(f_px=F_PX, baseline_m=BASELINE_M)
    maps = (turned(values, rotated_deg) for values in (seen.disparity_px, seen.confidence, seen.valid))
    return replace(depth_result("shot", DisparityMap(*maps), facts=facts), rotated_deg=rotated_deg)


def turned(values: Any, rotated_deg: int) -> Any:
    """Turn a map or a photo counter-clockwise."""
    return np.ascontiguousarray(np.rot90(values, k=rotated_deg // 90))


def made_photo() -> FloatMap:
    """Smooth colours, which a JPEG keeps."""
    y, x = np.mgrid[: HW[0], : HW[1]].astype(np.float32)
    return np.stack([x / HW[1], y / HW[0], 0.5 + 0 * x], axis=-1)


def depth_m() -> FloatMap:
    """Depth of the scene, m; NaN in the sky."""
    result = made_result()
    assert result.depth_m is not None
    return result.depth_m
