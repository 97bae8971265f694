"""Regions of the scene that moved between two photos that were not taken at once.

A match of something that moved leaves the rows on which the rig says it lies. Wrong matches do too, but each in its own
way; what moved does so together. Motion along the baseline looks like depth, and is not seen.
Letters: N matches, K corners of an outline, H W tele photo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from telewide.correction.refinement import ShotRefinement, refined_rig
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import matching_unit_px, vertical_misfit_px
from telewide.points.matches import Matches
from telewide.points.robust import std_about_zero
from telewide.records import Figure, Points

_LEAST_MISFIT_PX = 1.5
_MISFIT_PER_STD = 4.0
_NEIGHBOURS = 8
_SUPPORTERS = 4
_LEAST_MATCHES = 6
_MAX_DISTANCE_SHARE = 0.1
_LIKE_SHARE = 0.3
_MARGIN_SHARE = 0.02
_MAX_OFF_SHARE = 0.5


@dataclass(frozen=True)
class MovedRegion:
    """A part of the tele photo that moved between the shots.

    Attributes:
        outline_px: (K, 2) convex outline of its matches, px of the tele photo.
        n: number of its matches.
        vertical_px: their median misfit across the baseline, tele px.
    """

    outline_px: Points
    n: int
    vertical_px: Figure


def find_moving(matches: Matches, refinement: ShotRefinement, *, rig: StereoRig) -> tuple[MovedRegion, ...]:
    """Find groups of neighbouring matches that leave their rows together.

    Args:
        matches: N of the photos as captured, no law imposed on their rows.
        refinement: this shot's correction.
        rig: it corrects.

    Returns:
        The regions, those with the most matches first; none where the matches are too few to tell, or so many leave
        their rows that the rig is to blame.
    """
    if len(matches) <= _NEIGHBOURS:
        return ()
    misfit_px = vertical_misfit_px(matches.ref_px, matches.src_px, rig=refined_rig(rig, refinement))
    is_off = np.abs(misfit_px) > _limit_px(misfit_px, matching_unit_px(rig.tele.hw))
    if is_off.mean() > _MAX_OFF_SHARE:
        return ()
    group = _groups(matches.ref_px, misfit_px, is_off, rig=rig)
    regions = [
        MovedRegion(_outline(matches.ref_px[members]), len(members), float(np.median(misfit_px[members])))
        for members in (np.flatnonzero(group == label) for label in range(int(group.max()) + 1))
        if len(members) >= _LEAST_MATCHES
    ]
    return tuple(sorted(regions, key=lambda region: -region.n))


def moving_mask(regions: Sequence[MovedRegion], *, hw: tuple[int, int]) -> NDArray[np.bool_]:
    """Mark the regions and a margin of 2 % of the longer side around them.

    Args:
        regions: what :func:`find_moving` found.
        hw: height and width of the tele photo.

    Returns:
        (H, W) bool, True where something moved.
    """
    mask = np.zeros(hw, dtype=np.uint8)
    margin_px = max(1, round(_MARGIN_SHARE * max(hw)))
    for region in regions:
        outline = np.round(region.outline_px).astype(np.int32)
        cv2.fillConvexPoly(mask, outline, (1,))
        cv2.polylines(mask, [outline], isClosed=True, color=(1,), thickness=2 * margin_px)
    return mask > 0


def moving_note(regions: Sequence[MovedRegion]) -> str | None:
    """Say what moved, in one sentence; None where nothing did."""
    if not regions:
        return None
    places = ", ".join("({:.0f}, {:.0f})".format(*region.outline_px.mean(axis=0)) for region in regions[:3])
    what = "something" if len(regions) == 1 else f"{len(regions)} things"
    return f"{what} moved between the two photos, around {places} px of tele: depth there is marked as unsure"


def _limit_px(misfit_px: FloatArray, unit_px: float) -> float:
    spread_px = std_about_zero(misfit_px)
    return max(_LEAST_MISFIT_PX * unit_px, _MISFIT_PER_STD * min(spread_px, unit_px))


def _groups(
    points_px: FloatArray, misfit_px: FloatArray, is_off: NDArray[np.bool_], *, rig: StereoRig
) -> NDArray[np.intp]:
    """(N,) number of the group each match moved with; -1 for all others."""
    n = len(points_px)
    distance_px, index = cKDTree(points_px).query(points_px, k=_NEIGHBOURS + 1)
    distance_px, index = distance_px[:, 1:], index[:, 1:]
    tolerance_px = matching_unit_px(rig.tele.hw) + _LIKE_SHARE * np.abs(misfit_px)
    is_alike = np.abs(misfit_px[index] - misfit_px[:, None]) <= tolerance_px[:, None]
    is_alike &= is_off[index] & is_off[:, None] & (distance_px <= _MAX_DISTANCE_SHARE * max(rig.tele.hw))
    is_core = is_alike.sum(axis=1) >= _SUPPORTERS
    linked = is_alike & is_core[:, None]
    row = np.repeat(np.arange(n), _NEIGHBOURS)[linked.ravel()]
    links = coo_array((np.ones(len(row)), (row, index.ravel()[linked.ravel()])), shape=(n, n))
    _, label = connected_components(links, directed=False)
    is_member = is_core.copy()
    is_member[index[linked]] = True
    group = np.full(n, -1, dtype=np.intp)
    group[is_member] = np.unique(label[is_member], return_inverse=True)[1]
    return group


def _outline(points_px: FloatArray) -> FloatArray:
    hull = cv2.convexHull(points_px.astype(np.float32))
    return np.asarray(hull, dtype=np.float64).reshape(-1, 2)
