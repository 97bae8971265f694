"""A photo seen from beside, by its disparity: the second view of a pair whose truth is that disparity, exactly.

After Watson et al., *Learning Stereo from Single Images*, 2020: whether the disparity is that of the scene matters
little, for it is that of the pair. Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap

SURFACE_STEP_PX = 0.9
"""Neighbours of a row whose disparities differ by more lie on two surfaces, with a gap or something hidden between."""


@dataclass(frozen=True)
class SeenFromBeside:
    """Second view of a photo.

    Attributes:
        src: (H, W, 3) float32; what the photo does not show is continued from the farther surface beside it.
        occluded: (H, W) bool of the photo's pixels, hidden or outside in src.
    """

    src: FloatImage
    occluded: BoolMap


def seen_from_beside(photo: FloatImage, disparity_px: FloatMap) -> SeenFromBeside:
    """Render the view that shows pixel x of the photo at ``x - disparity``, the nearest surface where several meet.

    Args:
        photo: (H, W, 3) float32, ref.
        disparity_px: (H, W) float32, finite, px.
    """
    height, width = disparity_px.shape
    nearest_px = _disparity_of_src(disparity_px)
    x_ref = np.arange(width, dtype=np.float32) + _filled_from_farther(nearest_px)
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], (height, width))
    src = cv2.remap(photo, x_ref, np.ascontiguousarray(rows), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    x_src = np.arange(width) - disparity_px
    column = np.rint(x_src).astype(np.intp)
    there_px = np.take_along_axis(nearest_px, column.clip(0, width - 1), axis=1)
    occluded = (there_px > disparity_px + SURFACE_STEP_PX) | (x_src < 0) | (x_src > width - 1)
    return SeenFromBeside(src.clip(0, 1), occluded)


def _disparity_of_src(disparity_px: FloatMap) -> FloatMap:
    """(H, W) disparity of the nearest surface at each pixel of src; -inf where none is seen.

    Each pixel of ref covers its own width, to the middle between it and its neighbour of the same surface.
    """
    height, width = disparity_px.shape
    step_px = np.diff(disparity_px, axis=1)
    half_px = np.where(np.abs(step_px) <= SURFACE_STEP_PX, step_px / 2, 0).astype(np.float32)
    left_px, right_px = disparity_px.copy(), disparity_px.copy()
    left_px[:, 1:] -= half_px
    right_px[:, :-1] += half_px
    x = np.arange(width, dtype=np.float32)
    begin, end = x - 0.5 - left_px, x + 0.5 - right_px
    nearest_px = np.full(height * width, -np.inf, np.float32)
    first = np.ceil(begin)
    row_starts = np.arange(height)[:, None] * width
    for further in (0, 1):  # a pixel is at most 1.9 pixels of src wide
        column = first + further
        is_there = (column < end) & (column >= 0) & (column < width)
        share = ((column - begin) / np.maximum(end - begin, 1e-3))[is_there]
        value_px = left_px[is_there] + share * (right_px - left_px)[is_there]
        np.maximum.at(nearest_px, (row_starts + column.astype(np.intp))[is_there], value_px)
    return nearest_px.reshape(height, width)


def _filled_from_farther(nearest_px: FloatMap) -> FloatMap:
    """Continue the farther of the two surfaces beside each gap of a row: its texture goes on mirrored."""
    height, width = nearest_px.shape
    seen = np.isfinite(nearest_px)
    column = np.broadcast_to(np.arange(width), (height, width))
    left = np.maximum.accumulate(np.where(seen, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(seen, column, width)[:, ::-1], axis=1)[:, ::-1]
    left_px, right_px = (_taken(nearest_px, at, none=np.inf) for at in (left, right))
    border, border_px = np.where(left_px <= right_px, (left, left_px), (right, right_px))
    # Mirrored about the border: pixel border + k shows what border - k shows.
    mirrored_px = border_px + 2 * (border - column)
    return np.where(seen, nearest_px, np.where(np.isfinite(border_px), mirrored_px, 0)).astype(np.float32)


def _taken(values: FloatMap, column: np.ndarray, *, none: float) -> FloatMap:
    width = values.shape[1]
    taken = np.take_along_axis(values, column.clip(0, width - 1), axis=1)
    return np.where((column < 0) | (column >= width), none, taken).astype(np.float32)
