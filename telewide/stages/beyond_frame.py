"""The wide photo of one capture, for what lies beyond the tele photo's frame; read when a bokeh picture needs it.

Letters: H W image; N matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from telewide.bokeh.wide_light import WideView
from telewide.capture.images import read_image
from telewide.capture.pair import Capture
from telewide.capture.photo_store import PhotoStore
from telewide.depth.result import DepthResult
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import RectifiedGeometry
from telewide.points.held_out import HeldOut
from telewide.stages.photo_depth import ShotGeometry

MIN_MATCHES = 12
"""Fewer matches than this do not tell where the zero of a map lies."""


@dataclass(frozen=True)
class BeyondFrame:
    """Finder of the wide photo of a capture that was rectified with a rig.

    Attributes:
        held_out: matches of the pair.
        shot: how it lies to its photos.
        photos: where the wide photo may be kept.
    """

    held_out: HeldOut
    shot: ShotGeometry
    photos: PhotoStore

    def wide_view(self, source: Capture, result: DepthResult, *, is_converted: bool) -> WideView:
        """Read the wide photo.

        Args:
            source: the photos as taken.
            result: depth of the capture.
            is_converted: whether its colours become sRGB; else they stay those of its profile.

        Raises:
            InputError: it cannot be read.
        """
        path, geometry = source.wide_path, self.shot.geometry
        photo = self.photos.read(path) if is_converted else read_image(path, is_converted=False)
        # A known distance moved the zero of the map, not that of the photos.
        zero_px = (
            0.0 if self.shot.known is None else zero_by_matches(result.disparity.disparity_px, self.held_out, geometry)
        )
        return WideView(photo, geometry.rig, zero_px)


def beyond_frame(held_out: HeldOut, shot: ShotGeometry | None, photos: PhotoStore) -> BeyondFrame | None:
    """Say how to see beyond the frame; None for photos that came rectified: there wide ends where tele does."""
    return None if shot is None else BeyondFrame(held_out, shot, photos)


def zero_by_matches(disparity_px: FloatMap, held_out: HeldOut, geometry: RectifiedGeometry) -> float:
    """Find which disparity a map states of what lies infinitely far by the rig.

    Args:
        disparity_px: (H, W) on the tele photo, px.
        held_out: N matches of the rectified pair.
        geometry: of the pair, as the rig has it.

    Returns:
        px of the tele photo; 0 where too few matches tell.
    """
    columns, rows = np.round(geometry.tele_from_ref(held_out.ref_px)).astype(np.int64).T
    inside = (rows >= 0) & (rows < disparity_px.shape[0]) & (columns >= 0) & (columns < disparity_px.shape[1])
    gain = float(geometry.rig.tele.K[0, 0]) / geometry.f_px
    ratio = geometry.tele_depth_per_rectified_depth(held_out.ref_px)
    seen_px = (held_out.disparity_px + geometry.doffs_px) * gain / ratio
    off_px = disparity_px[rows[inside], columns[inside]] - seen_px[inside]
    off_px = off_px[np.isfinite(off_px)]
    return float(np.median(off_px)) if len(off_px) >= MIN_MATCHES else 0.0
