"""How far matches of two photos lie from the rows of a rig: the vertical misfit after an ideal rectification.

The rectified frame shares tele's lens centre: x from tele to wide, z as near to tele's optical axis as x allows. Both
views are thought at tele's focal length, so that a misfit is in tele's pixels; ``vertical_px = y_tele - y_wide``.
Letters: N matches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from telewide.geometry.rig import StereoRig

FloatArray = NDArray[np.float64]


def rectified_axes(rig: StereoRig) -> FloatArray:
    """Find the axes of the rectified frame.

    Args:
        rig: with a baseline that is not tele's optical axis.

    Returns:
        (3, 3), rows x, y, z in tele's frame: ``rectified_from_tele``, right-handed.

    Raises:
        ValueError: there is no baseline, or it is tele's optical axis.
    """
    wide_centre = -rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3]
    length = float(np.linalg.norm(wide_centre))
    if not length > 0:
        raise ValueError("a rig without a baseline cannot be rectified")
    x = wide_centre / length
    z = np.array([0.0, 0.0, 1.0]) - x[2] * x
    if np.linalg.norm(z) < 1e-6:
        raise ValueError("one lens stands in front of the other: such a rig cannot be rectified")
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


def rectified_points(tele_px: FloatArray, wide_px: FloatArray, *, rig: StereoRig) -> tuple[FloatArray, FloatArray]:
    """Where points of the photos lie in the rectified frame, as x/z and y/z.

    Args:
        tele_px: (N, 2) of tele's photo.
        wide_px: (N, 2) of wide's photo.
        rig: for photos of these sizes.

    Returns:
        (N, 2) of tele and (N, 2) of wide.
    """
    rectified_from_tele = rectified_axes(rig)
    rectified_from_wide = rectified_from_tele @ rig.wide_from_tele[:3, :3].T
    return _turned(rig.tele.normalised(tele_px), rectified_from_tele), _turned(
        rig.wide.normalised(wide_px), rectified_from_wide
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


def _turned(normalised: FloatArray, rotation: FloatArray) -> FloatArray:
    rays = np.column_stack([normalised, np.ones(len(normalised))]) @ rotation.T
    return np.asarray(rays[:, :2] / rays[:, 2:])
