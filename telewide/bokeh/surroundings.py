"""Surroundings of the tele photo, beyond its frame, as the wide photo shows them: a blur takes light from there too.

A pixel beyond the frame is taken to be as far away as the nearest pixel within it, so the rig tells where wide shows
it. Its colours are brought to tele's by what both photos show just within the frame. Where wide does not reach, the
world is mirrored.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from telewide.bokeh.layers import Box
from telewide.bokeh.wide_light import WideView, match_colours, seen_by_wide, wide_rays
from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import FloatImage, FloatMap, IntArray

CELL_SHARE = 0.008
"""Side of the cells in which colours are compared, of the frame's shorter side."""
RING_CELLS = 4
"""Width of the ring within the frame that both photos show, in cells."""
_LEAST_CELL_PX = 4
_POINTS_A_SIDE = 128
_SAME_PX = 0.5


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
    views = [seen_by_wide(wide, box, values_px, frame=frame) for box, values_px in zip(boxes, nearest_px, strict=True)]
    match = match_colours(photo, views, frame=frame, cell=cell)
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


def _is_undone(wide: WideView, frame: Box) -> bool:
    """Whether both lenses' distortion can be undone beyond the frame: far out, a polynomial folds the picture back."""
    margin_px, rig = frame.top, wide.rig
    y, x = (np.linspace(-margin_px, size + margin_px - 1, _POINTS_A_SIDE) for size in frame.hw)
    sides = [np.column_stack([x, np.full(len(x), end)]) for end in (y[0], y[-1])]
    sides += [np.column_stack([np.full(len(y), end), y]) for end in (x[0], x[-1])]
    outline_px = np.concatenate(sides)
    normalised = rig.tele.normalised(outline_px)
    again_px = rig.tele.project(np.column_stack([normalised, np.ones(len(normalised))]))
    rays = wide_rays(outline_px, wide.zero_px, wide)
    wide_px = rig.wide.project(rays)
    is_shown = ((wide_px >= 0) & (wide_px <= np.array(rig.wide.hw[::-1]) - 1)).all(axis=1)
    folded_px = rig.wide.f_px * (rig.wide.normalised(wide_px) - rays[:, :2] / rays[:, 2:])[is_shown]
    return bool((np.abs(again_px - outline_px) < _SAME_PX).all() and (np.abs(folded_px) < _SAME_PX).all())
