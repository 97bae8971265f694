"""Matches of two photos as captured: unequal sizes, focal lengths and rotations, no row agrees yet.

Both photos are resampled to what one virtual camera would see if the rig were true, along its baseline and at a working
size; matched there; and every point is carried back to its photo by the exact inverse. Unlike
:func:`telewide.points.matches.find_matches`, no law of the rows is imposed: what moved, or was photographed from
elsewhere, stays among the matches.
Convention: ``ref_px`` is in tele's photo, ``src_px`` in wide's photo.
Letters: N matches, H W image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.geometry.grids import dense_map
from telewide.geometry.rectification import check_canvas, rectifying_rotation, rig_at_sizes
from telewide.geometry.resample import resample
from telewide.geometry.rig import Camera, StereoRig, rigid_transform
from telewide.points.epipolar import MATCHING_SIDE_PX
from telewide.points.matches import (
    Matches,
    align_matches,
    detect_points,
    match_descriptors,
    neighbour_support,
    to_one_bandwidth,
)
from telewide.points.similarity import find_overlap
from telewide.srgb import grey

_FEW_MATCHES = 150
_SUPPORTERS = 4
_REACH_X_SHARE = 0.25
_REACH_Y_SHARE = 0.05


@dataclass(frozen=True)
class _VirtualView:
    """One photo as the virtual camera sees it, and the way back.

    Attributes:
        image: (H, W) grey.
        camera: the real lens, at the photo's size.
        K: (3, 3) of the virtual camera.
        virtual_from_camera: (3, 3) rotation.
    """

    image: FloatImage
    camera: Camera
    K: FloatArray
    virtual_from_camera: FloatArray

    def photo_px(self, points_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the view to points of the photo."""
        return _photo_points(points_px, self.camera, K=self.K, virtual_from_camera=self.virtual_from_camera)


def find_photo_matches(
    tele: FloatImage, wide: FloatImage, *, rig: StereoRig, working_side_px: int = MATCHING_SIDE_PX
) -> Matches:
    """Match the two photos of one shot.

    SIFT points along the rig's rows within 5 % of the height, two-way, aligned to a fraction of a pixel, kept where
    neighbours moved alike. Where few are found, the views are first turned to the similarity between them.

    Args:
        tele: (H, W, 3) or (H, W) photo in [0, 1], upright.
        wide: (H', W', 3) or (H', W') likewise.
        rig: for photos of these sizes, right to a few degrees.
        working_side_px: longer side of the views that are matched, px.

    Returns:
        N matches, ``ref_px`` in tele's photo and ``src_px`` in wide's; also of things that moved, and a few wrong ones.

    Raises:
        InputError: the rig is for photos of another shape, or sees farther around than any lens.
    """
    rig = rig_at_sizes(rig, tele_hw=_hw(tele), wide_hw=_hw(wide))
    tele_view, wide_view = _virtual_views(grey(tele), grey(wide), rig, working_side_px)
    found = _match_views(tele_view, wide_view)
    if len(found) < _FEW_MATCHES:
        overlap = find_overlap(tele_view.image, wide_view.image)
        if overlap is not None:
            turned = _turned_rig(
                rig, roll_rad=np.radians(overlap.rotation_deg), pitch_rad=overlap.vertical_px / tele_view.K[0, 0]
            )
            again = _match_views(*_virtual_views(grey(tele), grey(wide), turned, working_side_px))
            found = again if len(again) > len(found) else found
    return found


def _hw(image: FloatImage) -> tuple[int, int]:
    return image.shape[0], image.shape[1]


def _turned_rig(rig: StereoRig, *, roll_rad: float, pitch_rad: float) -> StereoRig:
    """The rig with wide turned, in the rectified frame, so that a similarity of the views vanishes."""
    axes = rectifying_rotation(rig)
    turn = np.asarray(cv2.Rodrigues(np.array([[pitch_rad], [0.0], [roll_rad]]))[0], dtype=np.float64)
    rotation = rig.wide_from_tele[:3, :3] @ axes.T @ turn @ axes
    return replace(
        rig, wide_from_tele=rigid_transform(rotation=rotation, translation=rotation @ axes[0] * -rig.baseline_m)
    )


def _virtual_views(
    tele: FloatImage, wide: FloatImage, rig: StereoRig, working_side_px: int
) -> tuple[_VirtualView, _VirtualView]:
    """Both photos seen by one camera that holds all of tele's frame."""
    tele_turn = rectifying_rotation(rig)
    wide_turn = tele_turn @ rig.wide_from_tele[:3, :3].T
    height, width = rig.tele.hw
    rim_px = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    rays = np.column_stack([rig.tele.normalised(rim_px), np.ones(4)]) @ tele_turn.T
    low, high = (rays[:, :2] / rays[:, 2:]).min(axis=0), (rays[:, :2] / rays[:, 2:]).max(axis=0)
    f_px = rig.tele.f_px * min(1.0, working_side_px / max(height, width))
    K = np.array([[f_px, 0, -f_px * low[0]], [0, f_px, -f_px * low[1]], [0, 0, 1.0]])
    check_canvas(f_px * (high - low) + 1, rig)
    wh = np.ceil(f_px * (high - low)).astype(int) + 1
    return tuple(  # type: ignore[return-value]
        _VirtualView(_resampled(photo, camera, K=K, turn=turn, wh=(int(wh[0]), int(wh[1]))), camera, K, turn)
        for photo, camera, turn in ((tele, rig.tele, tele_turn), (wide, rig.wide, wide_turn))
    )


def _resampled(
    photo: FloatImage, camera: Camera, *, K: FloatArray, turn: FloatArray, wh: tuple[int, int]
) -> FloatImage:
    """A photo as the virtual camera sees it."""

    def photo_px(points_px: FloatArray) -> FloatArray:
        return _photo_points(points_px, camera, K=K, virtual_from_camera=turn)

    map_x, map_y = dense_map(photo_px, hw=(wh[1], wh[0]))
    return resample(photo, map_x, map_y, shrink=camera.f_px / float(K[0, 0]))


def _photo_points(
    points_px: FloatArray, camera: Camera, *, K: FloatArray, virtual_from_camera: FloatArray
) -> FloatArray:
    rays = np.column_stack([(points_px - K[:2, 2]) / K[0, 0], np.ones(len(points_px))])
    return camera.project(rays @ virtual_from_camera)


def _match_views(tele: _VirtualView, wide: _VirtualView) -> Matches:
    """Matches of the two virtual views, in photo pixels."""
    height, width = tele.image.shape
    tele_grey, wide_grey = to_one_bandwidth(tele.image, wide.image)
    reach_px = (_REACH_X_SHARE * width, max(8.0, _REACH_Y_SHARE * height))
    views = [detect_points(image, max_features=4000) for image in (tele_grey, wide_grey)]
    found = _supported(align_matches(tele_grey, wide_grey, match_descriptors(views[0], views[1], reach_px=reach_px)))
    photos = Matches(tele.photo_px(found.ref_px), wide.photo_px(found.src_px))
    return photos.select(_is_inside(photos.ref_px, tele.camera.hw) & _is_inside(photos.src_px, wide.camera.hw))


def _supported(matches: Matches) -> Matches:
    """The matches whose shift agrees with at least four of the twelve nearest."""
    shift_px = matches.ref_px - matches.src_px
    return matches.select(neighbour_support(matches.ref_px, shift_px, supporters=_SUPPORTERS))


def _is_inside(points_px: FloatArray, hw: tuple[int, int]) -> NDArray[np.bool_]:
    return np.asarray(((points_px >= 0) & (points_px <= [hw[1] - 1, hw[0] - 1])).all(axis=1))
