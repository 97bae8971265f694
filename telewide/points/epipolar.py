"""Epipolar misfit of matches of two photos, off the rows of a rig: the vertical misfit after an ideal rectification.

The rectified frame is that of :mod:`telewide.geometry.rectification`, x from tele to wide; both views are thought at
tele's focal length, so that a misfit is in tele's pixels; ``vertical_px = y_tele - y_wide``.
Letters: N matches.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rectification import rectifying_rotation
from telewide.geometry.rig import StereoRig, rigid_transform

MATCHING_SIDE_PX = 1600
"""Longer side of the views that are matched, whatever the photos' size."""


def rectified_points(tele_px: FloatArray, wide_px: FloatArray, *, rig: StereoRig) -> tuple[FloatArray, FloatArray]:
    """Where points of the photos lie in the rectified frame, as x/z and y/z.

    Args:
        tele_px: (N, 2) of tele's photo.
        wide_px: (N, 2) of wide's photo.
        rig: for photos of these sizes.

    Returns:
        (N, 2) of tele and (N, 2) of wide.
    """
    rect_from_tele = rectifying_rotation(rig)
    rect_from_wide = rect_from_tele @ rig.wide_from_tele[:3, :3].T
    return (
        turned_points(rig.tele.normalised(tele_px), rotation=rect_from_tele),
        turned_points(rig.wide.normalised(wide_px), rotation=rect_from_wide),
    )


def vertical_misfit_px(tele_px: FloatArray, wide_px: FloatArray, *, rig: StereoRig) -> FloatArray:
    """Vertical misfit of matches under a rig.

    Args:
        tele_px: (N, 2) of tele's photo.
        wide_px: (N, 2) of wide's photo, the same points.
        rig: for photos of these sizes.

    Returns:
        (N,) ``f_tele (y_tele - y_wide)`` in the rectified frame, tele px.
    """
    tele, wide = rectified_points(tele_px, wide_px, rig=rig)
    return np.asarray(rig.tele.f_px * (tele[:, 1] - wide[:, 1]))


def epipolar_misfit_px(tele: FloatArray, wide: FloatArray, *, wide_from_tele: FloatArray, f_px: float) -> FloatArray:
    """Misfit of matches for any direction of the baseline, also one along the optical axis.

    The square root of 2 times Sampson's distance: where the baseline lies across, the same as the vertical misfit up to
    its sign.

    Args:
        tele: (N, 2) x/z and y/z of the rays of tele.
        wide: (N, 2) of wide, the same points.
        wide_from_tele: (4, 4) rigid transform; the length of its translation does not count.
        f_px: focal length the misfit is stated at.

    Returns:
        (N,) signed, px.
    """
    tele_rays, wide_rays = (np.column_stack([points, np.ones(len(points))]) for points in (tele, wide))
    x, y, z = wide_from_tele[:3, 3] / np.linalg.norm(wide_from_tele[:3, 3])
    E = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ wide_from_tele[:3, :3]
    wide_lines, tele_lines = tele_rays @ E.T, wide_rays @ E
    squared = (wide_lines[:, :2] ** 2).sum(axis=1) + (tele_lines[:, :2] ** 2).sum(axis=1)
    distance = (wide_rays * wide_lines).sum(axis=1) / np.sqrt(np.maximum(squared, 1e-24))
    return np.asarray(f_px * np.sqrt(2.0) * distance)


def moved_rig(
    rig: StereoRig,
    *,
    offset_px: float = 0.0,
    scale: float = 1.0,
    rotation_vector: FloatArray | None = None,
    tilt_rad: FloatArray | None = None,
    wide_centre: FloatArray | None = None,
) -> StereoRig:
    """Move wide of a rig, tele and the baseline's length staying.

    Args:
        rig: as calibrated.
        offset_px: vertical misfit to take out by shifting wide's principal point across the baseline, tele px.
        scale: what wide's focal length is multiplied with.
        rotation_vector: (3,) rad, turn of wide about its lens centre, in wide's frame; None is none.
        tilt_rad: (2,) turns about the axes along and across the baseline, the principal point moving with them so that
            the middle of the photo stays; None is none.
        wide_centre: (3,) direction from tele to wide, in tele's frame; None keeps it.

    Returns:
        The rig of a shot.
    """
    rotation = rig.wide_from_tele[:3, :3]
    K = rig.wide.K.copy()
    K[:2, :2] *= scale
    if offset_px:
        K[:2, 2] -= offset_px / rig.asymmetry * across_in_wide(rig)
    if tilt_rad is not None and np.any(tilt_rad):
        tilt = _turn((rotation @ rectifying_rotation(rig)[:2].T) @ tilt_rad)
        middle = tilt[:2, 2] / tilt[2, 2]
        K[:2, 2] -= K[:2, :2] @ middle
        rotation = tilt @ rotation
    if rotation_vector is not None:
        rotation = _turn(rotation_vector) @ rotation
    translation_m = rotation @ rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3]
    if wide_centre is not None:
        translation_m = -rig.baseline_m / float(np.linalg.norm(wide_centre)) * (rotation @ wide_centre)
    return replace(
        rig,
        wide=replace(rig.wide, K=K),
        wide_from_tele=rigid_transform(rotation=rotation, translation=translation_m),
    )


def _turn(rotation_vector: FloatArray) -> FloatArray:
    return rigid_transform(rotation=rotation_vector, translation=np.zeros(3))[:3, :3]


def across_in_wide(rig: StereoRig) -> FloatArray:
    """(2,) unit vector across the baseline, in the photo of wide."""
    across = (rig.wide_from_tele[:3, :3] @ rectifying_rotation(rig)[1])[:2]
    return np.asarray(across / np.linalg.norm(across))


def matching_unit_px(tele_hw: tuple[int, int]) -> float:
    """Tele pixels in one pixel of the views that are matched: above 1 for photos larger than those views."""
    return max(1.0, max(tele_hw) / MATCHING_SIDE_PX)


def turned_points(normalised: FloatArray, *, rotation: FloatArray) -> FloatArray:
    """Turn (N, 2) rays x/z, y/z by a (3, 3) orthogonal matrix."""
    rays = np.column_stack([normalised, np.ones(len(normalised))]) @ rotation.T
    return np.asarray(rays[:, :2] / rays[:, 2:])
