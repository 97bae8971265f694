"""Bring what was found in a rectified pair back to the tele photo as it was taken.

Rotation, mirror, distortion and working size are undone. On the photo a disparity is what the tele photo's own camera
matrix makes of a depth, so that depth is z along the photo's optical axis and needs no further term:

    disparity_px = K[0, 0] * baseline_m / depth_m        (doffs_px = 0)

Between two surfaces nothing is averaged: a pixel there takes the nearest value.
Letters: h w photo; H W rectified views.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatMap
from telewide.geometry.grids import dense_map
from telewide.geometry.rectification import RectifiedGeometry
from telewide.geometry.stereo import DisparityMap

SURFACE_JUMP_PX = 1.0
"""Neighbours that differ by more, in px of the rectified views, lie on two surfaces."""


def disparity_on_tele(rectified: DisparityMap, *, geometry: RectifiedGeometry) -> DisparityMap:
    """Bring a disparity map with its confidence back to the tele photo, at its full resolution.

    ``D = K[0, 0] / f_px (d + doffs) z_rect / z_tele``, which is ``K[0, 0] baseline_m / z_tele``.

    Args:
        rectified: (H, W) maps of the rectified ref.
        geometry: the pair's.

    Returns:
        (h, w) maps of the tele photo, px of the photo, NaN where unknown; it has no doffs.

    Raises:
        ValueError: the map has another size than the rectified views.
    """
    if rectified.disparity_px.shape != geometry.hw:
        raise ValueError(f"a map of {geometry.hw} was expected, found {rectified.disparity_px.shape}")
    map_x, map_y = dense_map(geometry.ref_from_tele, hw=geometry.rig.tele.hw)
    tele_px = _seen_by_tele(rectified.disparity_px, geometry=geometry)
    near_edge = _is_near_edge(rectified.disparity_px)
    smooth_px = _fetch(np.nan_to_num(tele_px, nan=0.0), map_x, map_y, is_linear=True)
    nearest_px = _fetch(tele_px, map_x, map_y)
    is_mixed = _fetch(near_edge, map_x, map_y) > 0
    return DisparityMap(
        disparity_px=np.where(is_mixed, nearest_px, smooth_px).astype(np.float32),
        confidence=_fetch(rectified.confidence, map_x, map_y),
        valid=np.asarray(_fetch(rectified.valid, map_x, map_y) > 0),
    )


def _seen_by_tele(disparity_px: FloatMap, *, geometry: RectifiedGeometry) -> FloatMap:
    """Disparities with respect to tele's optical axis, px of the photo, still on the rectified grid."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    at_origin, at_x, at_y = geometry.tele_depth_per_rectified_depth(corners)  # it is linear in x and y
    rows, columns = (np.arange(size, dtype=np.float64) for size in geometry.hw)
    ratio = at_origin + (at_x - at_origin) * columns + ((at_y - at_origin) * rows)[:, None]
    gain = float(geometry.rig.tele.K[0, 0]) / geometry.f_px
    return np.asarray((disparity_px + geometry.doffs_px) * (gain / ratio), dtype=np.float32)


def _is_near_edge(disparity_px: FloatMap) -> BoolMap:
    """Pixels beside which another surface, or nothing known, lies."""
    known = np.isfinite(disparity_px)
    square = np.ones((3, 3), np.uint8)
    filled = np.where(known, disparity_px, np.float32(0))
    spread_px = cv2.dilate(filled, square) - cv2.erode(filled, square)
    return np.asarray((spread_px > SURFACE_JUMP_PX) | (cv2.erode(known.astype(np.uint8), square) == 0))


def _fetch(values: FloatMap | BoolMap, map_x: FloatMap, map_y: FloatMap, *, is_linear: bool = False) -> FloatMap:
    """Values of a map at given places, as float32; of the nearest pixel unless they may be averaged."""
    how = cv2.INTER_LINEAR if is_linear else cv2.INTER_NEAREST
    fetched = cv2.remap(values.astype(np.float32), map_x, map_y, how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(fetched, dtype=np.float32)
