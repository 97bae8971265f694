"""Light that nearer things hide from tele and leave open to wide, which stands a little to their side.

Behind an edge, on the side towards the wide lens, the farther surface goes on as far as the two disparities differ. It
is read from wide where nothing nearer stands before it there, by the same rig and in the same colours as what lies
beyond the frame. Wide is coarse, so all this is found in steps of tele's pixels as large as wide's are.
Letters: H W photo; h w in steps; N pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.bokeh.layers import Box
from telewide.bokeh.wide_light import WideView, match_colours, seen_by_wide
from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import FloatArray, FloatImage, FloatMap, IntArray

CELL_SHARE = 0.016
"""Side of the cells in which colours are compared, of the photo's shorter side."""
JUMP_PX = 2.0
"""Surfaces whose disparities differ by less hide nothing of each other."""
MOST_STEPS = 80
"""Distance behind an edge to which anything is looked for."""
GUARD_STEPS = 3
"""Side of the square that each point of a thing fills in wide, whose pixels mix its rim with what is behind."""
NEARER_SHARE = 0.5
"""Of a step from one surface to the next: what stands so much nearer in wide hides the farther one."""
_LEAST_CELL = 4
_SAME_PX = 2.0


@dataclass(frozen=True)
class Uncovered:
    """Pixels of a photo behind which wide shows something, row by row.

    Attributes:
        y: (N,) rows.
        x: (N,) columns.
        colour: (N, 3) float32 of what lies behind, sRGB in [0, 1].
        disparity_px: (N,) float32, of it.
    """

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    colour: FloatMap
    disparity_px: FloatMap


def find_uncovered(photo: FloatImage, disparity_px: FloatMap, wide: WideView) -> Uncovered | None:
    """Find light that the photo hides and wide shows.

    Args:
        photo: (H, W, 3) float32, tele.
        disparity_px: (H, W) float32 on it, px; what is not finite is filled from its nearest neighbour.
        wide: the wide photo.

    Returns:
        The pixels; None where there are none, or colours cannot be compared.
    """
    step_px = max(1, int(wide.rig.tele.f_px / wide.rig.wide.f_px))
    box = Box(0, photo.shape[0] // step_px, 0, photo.shape[1] // step_px)
    cut, middle = np.s_[: box.bottom * step_px, : box.right * step_px], step_px // 2
    own_px = np.ascontiguousarray(fill_unknown(disparity_px)[cut][middle::step_px, middle::step_px])
    way = towards_wide(wide) / step_px
    behind_px = disparity_behind(own_px, way)
    is_behind = np.isfinite(behind_px)
    if not is_behind.any():
        return None
    shown_px = np.where(is_behind, behind_px, own_px)
    seen = seen_by_wide(wide, box, shown_px, frame=box, step_px=step_px)
    limit_px = np.where(is_behind, shown_px + NEARER_SHARE * (own_px - shown_px), shown_px + _SAME_PX)
    is_open = seen.is_seen & (_nearest_in_wide(own_px, shown_px, way) < limit_px)
    small = np.asarray(cv2.resize(photo[cut], box.hw[::-1], interpolation=cv2.INTER_AREA), dtype=np.float32)
    cell = max(_LEAST_CELL, round(CELL_SHARE * min(box.hw)))
    match = match_colours(small, [replace(seen, is_seen=is_open & ~is_behind)], frame=box, cell=cell)
    rows, columns = np.nonzero(is_open & is_behind)
    if match is None or not len(rows):
        return None
    return _at_every_pixel(rows, columns, match.of(seen), behind_px, step_px=step_px)


def towards_wide(wide: WideView) -> FloatArray:
    """Way (x, y) that a point of the tele photo is seen to move, px a px of disparity, from where wide stands."""
    back = wide.rig.wide_from_tele[:3, :3].T @ wide.rig.wide_from_tele[:3, 3]
    return np.asarray(back[:2] / np.linalg.norm(back))


def disparity_behind(disparity_px: FloatMap, way: FloatArray) -> FloatMap:
    """Disparity of what wide may show behind each pixel.

    Args:
        disparity_px: (H, W).
        way: pixels, (x, y), by which a point moves a px of disparity.

    Returns:
        (H, W), that of the nearest surface beyond the edge on wide's side that reaches behind the pixel; else NaN.
    """
    height, width = disparity_px.shape
    behind_px = np.full(disparity_px.shape, np.nan, np.float32)
    is_open = np.ones(disparity_px.shape, bool)
    pace_px = 1 / max(float(np.linalg.norm(way)), 1e-6)  # of disparity, for one step along the way
    reach = min(int(np.ptp(disparity_px) / pace_px) + 1, MOST_STEPS)
    for steps in range(1, reach + 1):
        x, y = (-round(steps * pace_px * float(along)) for along in way)
        moved = np.array([[1, 0, -x], [0, 1, -y]], np.float32)
        there_px = cv2.warpAffine(
            disparity_px, moved, (width, height), flags=cv2.INTER_NEAREST, borderValue=float(disparity_px.max())
        )
        found = is_open & (disparity_px - there_px >= max((steps - 1) * pace_px, JUMP_PX))
        behind_px[found] = there_px[found]
        is_open &= ~found
    return behind_px


def _nearest_in_wide(disparity_px: FloatMap, shown_px: FloatMap, way: FloatArray) -> FloatMap:
    """Disparity of the nearest thing that wide sees in the direction of each pixel's point at the shown disparity."""
    least_px = float(shown_px.min())
    margin_x, margin_y = np.ceil(np.abs(way) * (float(disparity_px.max()) - least_px)).astype(np.int64) + 1
    rows, columns = np.indices(disparity_px.shape, dtype=np.float32)

    def place(at_px: FloatMap) -> tuple[IntArray, IntArray]:
        away_px = at_px - least_px
        x, y = np.rint(columns + np.float32(way[0]) * away_px), np.rint(rows + np.float32(way[1]) * away_px)
        return y.astype(np.int64) + margin_y, x.astype(np.int64) + margin_x

    height, width = disparity_px.shape
    nearest_px = np.full((height + 2 * margin_y, width + 2 * margin_x), -np.inf, np.float32)
    order = np.argsort(disparity_px, axis=None, kind="stable")  # the nearest is written last
    at_y, at_x = (axis.ravel()[order] for axis in place(disparity_px))
    nearest_px[at_y, at_x] = disparity_px.ravel()[order]
    guarded_px = cv2.dilate(nearest_px, np.ones((GUARD_STEPS, GUARD_STEPS), np.uint8))
    return np.asarray(guarded_px[place(shown_px)], dtype=np.float32)


def _at_every_pixel(
    rows: IntArray, columns: IntArray, colour: FloatImage, disparity_px: FloatMap, *, step_px: int
) -> Uncovered:
    """Pixels of the photo in some of its steps, row by row."""
    inner_y, inner_x = np.divmod(np.arange(step_px**2), step_px)
    y, x = ((steps[:, None] * step_px + inner).ravel() for steps, inner in ((rows, inner_y), (columns, inner_x)))
    order = np.argsort(y, kind="stable")
    own = np.repeat(np.arange(len(rows)), step_px**2)[order]
    return Uncovered(y[order], x[order], colour[rows[own], columns[own]], disparity_px[rows[own], columns[own]])
