"""Surroundings of the tele photo, beyond its frame, as the wide photo shows them: a blur takes light from there too.

A pixel beyond the frame is taken to be as far away as the nearest pixel within it, so the rig tells where wide shows
it. Its colours are brought to tele's by what both photos show just within the frame: a matrix and a curve, and what
these leave there, smoothed. Where wide does not reach, the world is mirrored.
Letters: H W image; h w in cells; N points; S cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.bokeh.layers import Box, shrunk
from telewide.correction.colour import CLIPPED_FROM
from telewide.correction.colour_model import ColourModel, fit_model, robust_gains, transform_colours, transform_image
from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import BoolMap, FloatArray, FloatImage, FloatMap, IntArray
from telewide.geometry.grids import dense_map
from telewide.geometry.resample import resample
from telewide.geometry.rig import StereoRig
from telewide.srgb import linear_from_srgb, srgb_from_linear

CELL_SHARE = 0.008
"""Side of the cells in which colours are compared, of the frame's shorter side."""
RING_CELLS = 4
"""Width of the ring within the frame that both photos show, in cells."""
SMOOTH_CELLS = 6.0
"""Over so many cells what the model leaves is smoothed; so few cells that agree count as much as none at all:"""
PRIOR_CELLS = 3.0
MIN_CELLS = 24
_COLOUR_PARTS = ("matrix", "tone")
_LEAST_CELL_PX = 4
_LEAST_KNOWN = 0.9  # of a cell
_ALIKE = 0.1  # cells that differ by more, encoded, show two things
_POINTS_A_SIDE = 128
_SAME_PX = 0.5
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
class Surroundings:
    """Surroundings of a frame, in four strips.

    Attributes:
        margin_px: how far it reaches on each side.
        boxes: of the strips, counted from the corner of the enlarged frame.
        strips: (H, W, 3) RGB of each, and (H, W) disparity, px, on which the frame itself means nothing.
    """

    margin_px: int
    boxes: tuple[Box, ...]
    strips: tuple[tuple[FloatImage, FloatMap], ...]

    @property
    def frame(self) -> tuple[slice, slice]:
        """Slices that cut the frame out of what is enlarged."""
        return slice(self.margin_px, -self.margin_px), slice(self.margin_px, -self.margin_px)

    def of(self, photo: FloatImage) -> FloatImage:
        """Enlarge the photo by the margin on each side."""
        return self._put_around(photo, [values for values, _ in self.strips])

    def of_map(self, disparity_px: FloatMap) -> FloatMap:
        """Enlarge its disparity likewise."""
        return self._put_around(disparity_px, [values_px for _, values_px in self.strips])

    def _put_around(self, inner: FloatMap, strips: list[FloatMap]) -> FloatMap:
        height, width = (size + 2 * self.margin_px for size in inner.shape[:2])
        whole = np.empty((height, width, *inner.shape[2:]), np.float32)
        for box, strip in zip(self.boxes, strips, strict=True):
            whole[box.slices] = strip
        whole[self.frame] = inner
        return whole


def find_surroundings(
    photo: FloatImage, disparity_px: FloatMap, wide: WideView, *, margin_px: int
) -> Surroundings | None:
    """Find in the wide photo what lies around the tele photo.

    Args:
        photo: (H, W, 3) float32, tele.
        disparity_px: (H, W) float32 on it, px; what is not finite is filled from its nearest neighbour.
        wide: the wide photo.
        margin_px: how far to look on each side; less than the photo's shorter side.

    Returns:
        The surroundings; None where wide shows nothing of them, or too little of the frame to match colours by.
    """
    frame = _frame(photo, margin_px)
    if margin_px < 1 or not _is_undone(wide, frame):
        return None
    cell = max(_LEAST_CELL_PX, round(CELL_SHARE * min(frame.hw)))
    boxes = tuple(_strips(frame, ring_px=min(RING_CELLS * cell, min(frame.hw) // 2)))
    filled_px = fill_unknown(disparity_px)
    nearest_px = [_beyond(filled_px, box, frame, is_mirrored=False) for box in boxes]
    views = [_seen_by_wide(wide, box, values_px, frame=frame) for box, values_px in zip(boxes, nearest_px, strict=True)]
    match = _match_colours(photo, views, frame=frame, cell=cell)
    if match is None or not any(view.is_seen_beyond(frame) for view in views):
        return None
    strips = []
    for view, values_px in zip(views, nearest_px, strict=True):
        is_seen = view.is_seen
        light = np.where(is_seen[..., None], match.of(view), _beyond(photo, view.box, frame, is_mirrored=True))
        if not is_seen.all():
            values_px = np.where(is_seen, values_px, _beyond(filled_px, view.box, frame, is_mirrored=True))
        strips.append((light, values_px))
    return Surroundings(margin_px, boxes, tuple(strips))


def _frame(photo: FloatMap, margin_px: int) -> Box:
    """The frame counted from the corner of the enlarged one."""
    return Box(margin_px, margin_px + photo.shape[0], margin_px, margin_px + photo.shape[1])


def _strips(frame: Box, *, ring_px: int) -> Iterator[Box]:
    """Cut the margin, with a ring within the frame, into four boxes."""
    height, width = frame.bottom + frame.top, frame.right + frame.left
    top, left = frame.top + ring_px, frame.left + ring_px
    yield Box(0, top, 0, width)
    yield Box(height - top, height, 0, width)
    yield Box(top, height - top, 0, left)
    yield Box(top, height - top, width - left, width)


def _beyond(values: FloatMap, box: Box, frame: Box, *, is_mirrored: bool) -> FloatMap:
    """Values in a box, of the frame: mirrored beyond it, or those of its nearest pixel."""
    rows, columns = (
        _within(np.arange(first, last) - start, size, is_mirrored=is_mirrored)
        for first, last, start, size in (
            (box.top, box.bottom, frame.top, frame.hw[0]),
            (box.left, box.right, frame.left, frame.hw[1]),
        )
    )
    return values[rows[:, None], columns[None]]


def _within(index: IntArray, size: int, *, is_mirrored: bool) -> IntArray:
    if not is_mirrored:
        return np.asarray(np.clip(index, 0, size - 1))
    index = np.where(index < 0, -1 - index, index)
    return np.asarray(np.where(index >= size, 2 * size - 1 - index, index))


@dataclass(frozen=True)
class _Strip:
    """A box of the enlarged photo as wide shows it: (H, W, 3), in its own colours; where it reaches, (H, W)."""

    box: Box
    values: FloatImage
    is_seen: BoolMap

    def is_seen_beyond(self, frame: Box) -> bool:
        """Whether anything is seen beyond the frame."""
        inside = self.box.within(frame).seen_from(self.box)
        return bool(self.is_seen.sum() > self.is_seen[inside.slices].sum())


def _seen_by_wide(wide: WideView, box: Box, disparity_px: FloatMap, *, frame: Box) -> _Strip:
    """Read a box from the wide photo: where its farthest and nearest would lie tells where all between them does."""
    corner_px = np.array([box.left - frame.left, box.top - frame.top], dtype=np.float64)
    far_px, near_px = float(disparity_px.min()), float(disparity_px.max())
    map_x, map_y = dense_map(lambda points: _wide_from_tele(points + corner_px, far_px, wide), hw=box.hw)
    if near_px > far_px:
        near_x, near_y = dense_map(lambda points: _wide_from_tele(points + corner_px, near_px, wide), hw=box.hw)
        share = (disparity_px - np.float32(far_px)) / np.float32(near_px - far_px)
        map_x += share * (near_x - map_x)
        map_y += share * (near_y - map_y)
    height, width = wide.photo.shape[:2]
    is_seen = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    return _Strip(box, resample(wide.photo, map_x, map_y, shrink=wide.rig.wide.f_px / wide.rig.tele.f_px), is_seen)


def _wide_from_tele(points_px: FloatArray, disparity_px: float, wide: WideView) -> FloatArray:
    """Points (N, 2) of the tele photo, at one disparity, in the wide photo, px."""
    return wide.rig.wide.project(_wide_rays(points_px, disparity_px, wide))


def _wide_rays(points_px: FloatArray, disparity_px: float, wide: WideView) -> FloatArray:
    """Directions (N, 3) of such points as wide sees them."""
    rig = wide.rig
    rays = np.column_stack([rig.tele.normalised(points_px), np.ones(len(points_px))])
    per_m = (disparity_px - wide.zero_px) / (float(rig.tele.K[0, 0]) * rig.baseline_m)
    return np.asarray(rays @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3] * per_m)


def _is_undone(wide: WideView, frame: Box) -> bool:
    """Whether both lenses' distortion can be undone beyond the frame: far out, a polynomial folds the picture back."""
    margin_px, rig = frame.top, wide.rig
    y, x = (np.linspace(-margin_px, size + margin_px - 1, _POINTS_A_SIDE) for size in frame.hw)
    sides = [np.column_stack([x, np.full(len(x), end)]) for end in (y[0], y[-1])]
    sides += [np.column_stack([np.full(len(y), end), y]) for end in (x[0], x[-1])]
    outline_px = np.concatenate(sides)
    normalised = rig.tele.normalised(outline_px)
    again_px = rig.tele.project(np.column_stack([normalised, np.ones(len(normalised))]))
    rays = _wide_rays(outline_px, wide.zero_px, wide)
    wide_px = rig.wide.project(rays)
    is_shown = ((wide_px >= 0) & (wide_px <= np.array(rig.wide.hw[::-1]) - 1)).all(axis=1)
    folded_px = rig.wide.f_px * (rig.wide.normalised(wide_px) - rays[:, :2] / rays[:, 2:])[is_shown]
    return bool((np.abs(again_px - outline_px) < _SAME_PX).all() and (np.abs(folded_px) < _SAME_PX).all())


@dataclass(frozen=True)
class _ColourMatch:
    """Way from wide's colours to tele's: a model, and what it leaves in cells of the frame (h, w, 3), encoded."""

    model: ColourModel
    left: FloatMap
    frame: Box
    cell: int

    def of(self, view: _Strip) -> FloatImage:
        """Colours of a strip as tele would have taken them; what is too bright for wide is so for tele."""
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


def _match_colours(tele_srgb: FloatImage, views: list[_Strip], *, frame: Box, cell: int) -> _ColourMatch | None:
    """Compare what both photos show within the frame; None where that is too little, or not the same."""
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
    return _ColourMatch(model, total[..., :3] / (total[..., 3:] + np.float32(PRIOR_CELLS)), frame, cell)


def _compared(tele_srgb: FloatImage, view: _Strip, *, frame: Box, cell: int) -> tuple[IntArray, FloatArray, FloatArray]:
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
