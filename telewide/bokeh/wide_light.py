"""Light of the wide photo where, and in the colours in which, tele would have seen it.

Points of the tele photo at known disparity lie where the rig says. Colours are brought to tele's by what both photos
show: a matrix and a curve, and what these leave, smoothed.
Letters: H W image; h w in cells; N points; S cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.bokeh.layers import Box, shrunk
from telewide.correction.colour import CLIPPED_FROM
from telewide.correction.colour_model import ColourModel, fit_model, robust_gains, transform_colours, transform_image
from telewide.geometry.arrays import BoolMap, FloatArray, FloatImage, FloatMap, IntArray
from telewide.geometry.grids import dense_map
from telewide.geometry.resample import resample
from telewide.geometry.rig import StereoRig
from telewide.srgb import linear_from_srgb, srgb_from_linear

SMOOTH_CELLS = 6.0
"""Over so many cells what the model leaves is smoothed; so few cells that agree count as much as none at all:"""
PRIOR_CELLS = 3.0
MIN_CELLS = 24
_COLOUR_PARTS = ("matrix", "tone")
_LEAST_KNOWN = 0.9  # of a cell
_ALIKE = 0.1  # cells that differ by more, encoded, show two things
_TINY = np.float32(1e-6)


@dataclass(frozen=True)
class WideView:
    """The wide photo of a shot, and how it stands to tele.

    Attributes:
        photo: (H, W, 3) RGB, as it was taken.
        rig: this shot's, at the sizes of the photos.
        zero_px: disparity, px of the tele photo, that the map states of what lies infinitely far by the rig.
    """

    photo: FloatImage
    rig: StereoRig
    zero_px: float = 0.0


@dataclass(frozen=True)
class SeenPart:
    """A part of the tele photo, or of what lies around it, as wide shows it.

    Attributes:
        box: counted from the corner of the enlarged frame.
        values: (H, W, 3) in wide's own colours.
        is_seen: (H, W) where wide reaches.
    """

    box: Box
    values: FloatImage
    is_seen: BoolMap

    def is_seen_beyond(self, frame: Box) -> bool:
        """Whether anything is seen beyond the frame."""
        inside = self.box.within(frame).seen_from(self.box)
        return bool(self.is_seen.sum() > self.is_seen[inside.slices].sum())


def seen_by_wide(wide: WideView, box: Box, disparity_px: FloatMap, *, frame: Box, step_px: int = 1) -> SeenPart:
    """Read a part from the wide photo: where its farthest and nearest would lie tells where all between them does.

    Args:
        wide: the wide photo.
        box: the part, counted as the frame is.
        disparity_px: (H, W) of the part, px of the tele photo.
        frame: the tele photo.
        step_px: pixels of the tele photo for one of the part, along each side.
    """
    corner_px = np.array([box.left - frame.left, box.top - frame.top], dtype=np.float64)

    def in_wide(at_px: float) -> tuple[FloatMap, FloatMap]:
        return dense_map(
            lambda points: wide_from_tele((points + corner_px + 0.5) * step_px - 0.5, at_px, wide), hw=box.hw
        )

    far_px, near_px = float(disparity_px.min()), float(disparity_px.max())
    map_x, map_y = in_wide(far_px)
    if near_px > far_px:
        near_x, near_y = in_wide(near_px)
        share = (disparity_px - np.float32(far_px)) / np.float32(near_px - far_px)
        map_x += share * (near_x - map_x)
        map_y += share * (near_y - map_y)
    height, width = wide.photo.shape[:2]
    is_seen = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    shrink = step_px * wide.rig.wide.f_px / wide.rig.tele.f_px
    return SeenPart(box, resample(wide.photo, map_x, map_y, shrink=shrink), is_seen)


def wide_from_tele(points_px: FloatArray, disparity_px: float, wide: WideView) -> FloatArray:
    """Points (N, 2) of the tele photo, at one disparity, in the wide photo, px."""
    return wide.rig.wide.project(wide_rays(points_px, disparity_px, wide))


def wide_rays(points_px: FloatArray, disparity_px: float, wide: WideView) -> FloatArray:
    """Directions (N, 3) of such points as wide sees them."""
    rig = wide.rig
    rays = np.column_stack([rig.tele.normalised(points_px), np.ones(len(points_px))])
    per_m = (disparity_px - wide.zero_px) / (float(rig.tele.K[0, 0]) * rig.baseline_m)
    return np.asarray(rays @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3] * per_m)


@dataclass(frozen=True)
class ColourMatch:
    """Way from wide's colours to tele's: a model, and what it leaves in cells of the frame (h, w, 3), encoded."""

    model: ColourModel
    left: FloatMap
    frame: Box
    cell: int

    def of(self, view: SeenPart) -> FloatImage:
        """Colours of a part as tele would have taken them; what is too bright for wide is so for tele."""
        y, x = (
            np.clip((np.arange(first, last) - start + 0.5) / self.cell - 0.5, 0, size - 1).astype(np.float32)
            for first, last, start, size in (
                (view.box.top, view.box.bottom, self.frame.top, self.left.shape[0]),
                (view.box.left, view.box.right, self.frame.left, self.left.shape[1]),
            )
        )
        left = cv2.remap(self.left, *np.meshgrid(x, y), cv2.INTER_LINEAR)
        values = np.clip(transform_image(view.values, self.model) + left, 0, 1)
        bright = np.where(view.values >= CLIPPED_FROM, np.maximum(values, view.values), values)
        return np.asarray(bright, dtype=np.float32)


def match_colours(tele_srgb: FloatImage, views: list[SeenPart], *, frame: Box, cell: int) -> ColourMatch | None:
    """Compare what both photos show within the frame.

    Args:
        tele_srgb: (H, W, 3), the frame.
        views: what wide shows of it, and of what lies around it.
        frame: counted as those are.
        cell: side of the squares whose colours are compared, px.

    Returns:
        The way to tele's colours; None where what both show is too little, or not the same.
    """
    found = [_compared(tele_srgb, view, frame=frame, cell=cell) for view in views]
    at, tele, shown = (np.concatenate(some) for some in zip(*found, strict=True))
    if len(at) < MIN_CELLS:
        return None
    encoded = np.asarray(srgb_from_linear(tele), dtype=np.float64)
    nowhere = np.zeros((len(at), 2))
    model = fit_model(shown, encoded, place=nowhere, parts=_COLOUR_PARTS, start=robust_gains(shown, tele))
    left = encoded - transform_colours(shown, model, place=nowhere)
    apart = np.abs(left).max(axis=1)
    if np.median(apart) > _ALIKE:
        return None
    weight = 1 / (1 + (apart / _ALIKE) ** 2)
    total = np.zeros((-(-frame.hw[0] // cell), -(-frame.hw[1] // cell), 4), np.float32)
    total[at[:, 0], at[:, 1]] = np.column_stack([left * weight[:, None], weight])
    of_one = 2 * math.pi * SMOOTH_CELLS**2  # a Gaussian sums to 1: now its middle is 1
    total = cv2.GaussianBlur(total, (0, 0), SMOOTH_CELLS, borderType=cv2.BORDER_CONSTANT) * np.float32(of_one)
    return ColourMatch(model, total[..., :3] / (total[..., 3:] + np.float32(PRIOR_CELLS)), frame, cell)


def _compared(
    tele_srgb: FloatImage, view: SeenPart, *, frame: Box, cell: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Cells (S, 2) of the frame that tele and wide show, row and column; mean light (S, 3) of either."""
    ring = view.box.within(frame).seen_from(frame)
    top, left = (-(-side // cell) * cell for side in (ring.top, ring.left))
    whole = Box(top, max(ring.bottom // cell * cell, top), left, max(ring.right // cell * cell, left))
    if min(whole.hw) == 0:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    corner = Box(-frame.top, 0, -frame.left, 0)  # of the enlarged frame, counted from that of the frame
    there = whole.seen_from(corner).seen_from(view.box)
    views = tele_srgb[whole.slices], view.values[there.slices]
    is_known = view.is_seen[there.slices] & (np.maximum(*(values.max(axis=2) for values in views)) < CLIPPED_FROM)
    share = shrunk(is_known.astype(np.float32), cell)
    rows, columns = np.nonzero(share >= _LEAST_KNOWN)
    tele, shown = (
        (shrunk(linear_from_srgb(values) * is_known[..., None], cell) / np.maximum(share, _TINY)[..., None])[
            rows, columns
        ]
        for values in views
    )
    at = np.column_stack([rows + top // cell, columns + left // cell])
    return at, tele.astype(np.float64), shown.astype(np.float64)
