"""Rectify a pair of photos: both on one grid, corresponding points on one row, each photo resampled exactly once.

ref is tele, src is wide. ``disparity_px = x_ref - x_src``, and ``disparity_px + doffs_px > 0`` in front of the cameras,
whatever way the phone was held. How the views are laid out: `telewide.geometry.rectification`.
Letters: H W rectified views.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from telewide.capture.pair import RectifiedPair
from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap
from telewide.geometry.grids import dense_map
from telewide.geometry.rectification import RectifiedGeometry, rectified_geometry, rig_at_sizes
from telewide.geometry.resample import resample
from telewide.geometry.rig import Camera, StereoRig
from telewide.geometry.stereo import ValidMasks


@dataclass(frozen=True)
class Rectification:
    """A rectified pair, and what it takes to understand it.

    Attributes:
        pair: the two views, with where the photos reach; beyond, their borders are continued.
        f_px: focal length of both views, px.
        doffs_px: ``cx_src - cx_ref``, px.
        baseline_m: distance of the lenses; None where the scale is not known.
        geometry: maps points and results between photos and rectified views.
    """

    pair: RectifiedPair
    f_px: float
    doffs_px: float
    baseline_m: float | None
    geometry: RectifiedGeometry


def rectify_pair(
    tele: FloatMap,
    wide: FloatMap,
    *,
    rig: StereoRig,
    name: str = "",
    working_width_px: int | None = None,
    disparity_margin_px: int | None = None,
    doffs_px: float = 0.0,
) -> Rectification:
    """Rectify two photos of unequal lenses at tele's resolution, or at a working resolution.

    Args:
        tele: (h, w, 3) float32 in [0, 1], the photo as it was taken.
        wide: likewise, of its own size.
        rig: the two cameras, with this shot's own correction where there is one.
        name: of the capture.
        working_width_px: width of the rectified views, margin included; None for tele's own resolution.
        disparity_margin_px: largest disparity whose partner in src is kept, px of the rectified views; None for a
            sixteenth of the width.
        doffs_px: what is to be taken off every disparity, px of the rectified views.

    Returns:
        The pair, of one size.

    Raises:
        InputError: the photos do not fit the rig, or the rig cannot be rectified.
    """
    fitted = rig_at_sizes(rig, tele_hw=tele.shape[:2], wide_hw=wide.shape[:2])
    geometry = rectified_geometry(
        fitted, working_width_px=working_width_px, disparity_margin_px=disparity_margin_px, doffs_px=doffs_px
    )
    ref, tele_valid = _rectified(tele, geometry.tele_from_ref, camera=fitted.tele, geometry=geometry)
    src, wide_valid = _rectified(wide, geometry.wide_from_src, camera=fitted.wide, geometry=geometry)
    return Rectification(
        pair=RectifiedPair(name, ref, src, ValidMasks(tele_valid, wide_valid)),
        f_px=geometry.f_px,
        doffs_px=geometry.doffs_px,
        baseline_m=fitted.baseline_m if fitted.is_scale_known else None,
        geometry=geometry,
    )


def _rectified(
    photo: FloatMap,
    photo_from_view: Callable[[FloatArray], FloatArray],
    *,
    camera: Camera,
    geometry: RectifiedGeometry,
) -> tuple[FloatMap, BoolMap]:
    map_x, map_y = dense_map(photo_from_view, hw=geometry.hw)
    height, width = photo.shape[:2]
    # A pixel ends half a pixel from its centre.
    is_inside = (map_x >= -0.5) & (map_x <= width - 0.5) & (map_y >= -0.5) & (map_y <= height - 0.5)
    return resample(photo, map_x, map_y, shrink=camera.f_px / geometry.f_px), is_inside
