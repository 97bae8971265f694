"""A matched map brought to the tele photo as it was taken: its size, its edges, and metres where they are known.

Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.capture.pair import CaptureFacts
from telewide.correction.moving import MovedRegion, moving_mask
from telewide.depth.edges import follow_edges
from telewide.depth.pin import KnownDistance
from telewide.depth.precision import DepthPrecision
from telewide.depth.precision_notes import (
    hardly_known_notes,
    pinned_shot,
    without_depth_behind,
    without_meaningless_metres,
    without_unknown_std,
)
from telewide.depth.result import DepthResult, depth_result, depth_result_of_rig
from telewide.depth.unrectify import disparity_on_tele
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rectification import RectifiedGeometry
from telewide.geometry.stereo import DisparityMap, resize_disparity


@dataclass(frozen=True)
class ShotGeometry:
    """Geometry between the matched pair and the photos it was rectified from.

    Attributes:
        geometry: of the rectified views.
        precision: what all depths of the shot share.
        moved: parts of the tele photo that moved between the two exposures.
        known: a point of known distance; None without.
    """

    geometry: RectifiedGeometry
    precision: DepthPrecision
    moved: tuple[MovedRegion, ...] = ()
    known: KnownDistance | None = None


def depth_on_photo(
    working: DisparityMap, photo: FloatMap, *, name: str, facts: CaptureFacts, shot: ShotGeometry | None = None
) -> tuple[DepthResult, tuple[str, ...], str | None]:
    """Bring what was matched to the tele photo as it was taken, and into metres where the scale is known.

    Args:
        working: disparity of the views that were matched.
        photo: (H, W, 3) the tele photo, RGB in [0, 1].
        name: of the capture.
        facts: what the owner states; they count where no rig does. The views of a wide lens on the left were mirrored.
        shot: how the views lie to the photo; None for photos that were rectified when they came.

    Returns:
        The result, what a person should know of its metres, and why it has none where they would mean nothing.
    """
    if shot is None:
        given = _mirrored(working) if facts.wide_side == "left" else working
        stated = depth_result(name, on_photo(given, photo), facts=facts)
        result, told = without_depth_behind(stated, has_rig=False)
        is_withheld = stated.depth_m is not None and result.depth_m is None
        return result, () if told is None else (told,), told if is_withheld else None
    return _result_of_shot(name, working, photo, shot=shot)


def on_photo(working: DisparityMap, photo: FloatMap) -> DisparityMap:
    """Bring a map to the photo's size, and its edges to the photo's edges.

    Args:
        working: of the size the views were matched in.
        photo: (H, W, 3) the ref photo, RGB in [0, 1].

    Returns:
        (H, W) map; disparities are scaled to the photo's px.
    """
    wh = (photo.shape[1], photo.shape[0])
    disparity_px, confidence, valid = working.disparity_px, working.confidence, working.valid
    if disparity_px.shape != photo.shape[:2]:
        disparity_px = resize_disparity(disparity_px, wh=wh)
        # Of the same working pixel as the disparity.
        confidence = np.asarray(cv2.resize(confidence, wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)
        valid = cv2.resize(valid.astype(np.uint8), wh, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    followed_px = follow_edges(disparity_px, photo, confidence=confidence, valid=valid)
    return DisparityMap(followed_px, confidence, valid)


def _mirrored(disparity: DisparityMap) -> DisparityMap:
    """Maps with left and right exchanged; the disparities stay as they are, larger where something is nearer."""
    return DisparityMap(disparity.disparity_px[:, ::-1], disparity.confidence[:, ::-1], disparity.valid[:, ::-1])


def _result_of_shot(
    name: str, working: DisparityMap, photo: FloatMap, *, shot: ShotGeometry
) -> tuple[DepthResult, tuple[str, ...], str | None]:
    """Bring a map of the rectified view to the tele photo as it was taken, and into metres.

    Returns:
        The result, what to know of its metres, and why it has none where they would mean nothing.
    """
    pinned = pinned_shot(name, working.disparity_px, shot.known, geometry=shot.geometry, precision=shot.precision)
    geometry = pinned.geometry
    on_tele = disparity_on_tele(working, geometry=geometry)
    moved = moving_mask(shot.moved, hw=photo.shape[:2])
    confidence = np.where(moved, np.float32(0), on_tele.confidence)
    followed_px = follow_edges(on_tele.disparity_px, photo, confidence=confidence, valid=on_tele.valid & ~moved)
    disparity = DisparityMap(followed_px, confidence, on_tele.valid & ~moved)
    result = depth_result_of_rig(
        name, disparity, rig=geometry.rig, precision=pinned.precision, matched_scale=geometry.scale
    )
    has_metres = result.depth_m is not None
    result, doubt = without_depth_behind(result, has_rig=True)
    if doubt is None:
        result, doubt = without_meaningless_metres(result)
    doubts = hardly_known_notes(result) if doubt is None else (doubt,)
    result, unknown = without_unknown_std(result, precision=pinned.precision)
    return result, (*pinned.notes, *doubts, *unknown), doubt if has_metres and result.depth_m is None else None
