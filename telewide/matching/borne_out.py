"""Whether the two views bear it out that a region of a map was moved to another disparity.

Where src sees the region, before and after, what it sees there must be like ref, and differ from it evenly.
Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatArray, FloatImage, FloatMap, IntArray

SMOOTH_PX, HIDDEN_BY_PX = 2.0, 2.0
"""Before views are compared they are smoothed; and a pixel is hidden from src by one that is nearer by this."""
MISFIT, MISFIT_BY, UNEVEN_BY = 1.3, 0.5 / 255, 0.08 / 255
"""A region may fit worse than where it was by this factor and this difference of colour, and more unevenly by the last:
lenses change the colour of a whole region, and what varies within it tells where it belongs."""
LEAST_PX, LEAST_SEEN, STILL_SEEN = 16, 0.2, 0.5
"""Pixels, and share of a region seen by src, that tell how it fits; half of it has to be seen where it is, too."""


def borne_out(disparity_px: FloatMap, moved_px: FloatMap, *, ref: FloatImage, src: FloatImage) -> BoolMap:
    """Find the regions that were moved and fit no worse where they are than where they were.

    Args:
        disparity_px: (H, W) as it was, px.
        moved_px: (H, W) as it is; a region is connected and differs.
        ref: (H, W, 3) the view of both, [0, 1].
        src: (H, W, 3) the other view.

    Returns:
        (H, W) their pixels. What src sees neither before nor after tells nothing, and is among them.
    """
    is_moved = moved_px != disparity_px
    count, region = cv2.connectedComponents(is_moved.astype(np.uint8), connectivity=8)
    # Beside an outline both views show a blend, which goes with the thing.
    inner = region * cv2.erode(is_moved.astype(np.uint8), np.ones((4 * round(SMOOTH_PX) + 1,) * 2))
    size = np.bincount(inner.ravel(), minlength=count)
    smooth = [_smooth(view) for view in (ref, src)]
    before, after = (_misfit(px, *smooth, region=inner, count=count) for px in (disparity_px, moved_px))
    is_seen_before, is_seen = (fit.seen >= np.maximum(LEAST_PX, LEAST_SEEN * size) for fit in (before, after))
    fits = (after.mean <= MISFIT * before.mean + MISFIT_BY) & (after.uneven <= before.uneven + UNEVEN_BY)
    is_borne_out = np.where(is_seen_before, (after.seen >= STILL_SEEN * before.seen) & fits, fits | ~is_seen)
    is_borne_out[0] = False
    return np.asarray(is_borne_out[region])


def _smooth(view: FloatImage) -> FloatImage:
    return np.asarray(cv2.GaussianBlur(np.ascontiguousarray(view), (0, 0), SMOOTH_PX), dtype=np.float32)


@dataclass(frozen=True)
class _Misfit:
    """Differences of colour between the views, of each region; 0 where src sees none of it.

    Attributes:
        seen: pixels that src sees.
        mean: of their absolute differences.
        uneven: mean absolute deviation of their differences from the region's mean difference.
    """

    seen: IntArray
    mean: FloatArray
    uneven: FloatArray


def _misfit(disparity_px: FloatMap, ref: FloatImage, src: FloatImage, *, region: IntArray, count: int) -> _Misfit:
    height, width = disparity_px.shape
    row, column = np.indices((height, width), dtype=np.float32)
    there = column - disparity_px
    nearest = np.rint(there).astype(np.int64)
    is_inside = (nearest >= 0) & (nearest < width)
    at = (row[is_inside].astype(np.int64), nearest[is_inside])
    front_px = np.full((height, width), -np.inf, dtype=np.float32)
    np.maximum.at(front_px, at, disparity_px[is_inside])
    front_px = np.asarray(cv2.dilate(front_px, np.ones((4 * round(SMOOTH_PX) + 1,) * 2)), dtype=np.float32)
    is_seen = is_inside.copy()
    is_seen[is_inside] = front_px[at] < disparity_px[is_inside] + HIDDEN_BY_PX
    is_seen &= region > 0  # all the rest did not move
    warped = cv2.remap(src, there, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    off, region = (warped - ref)[is_seen], region[is_seen]
    seen = np.bincount(region, minlength=count)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(region, weights=values, minlength=count) / np.maximum(seen, 1))

    centre = np.stack([mean(channel) for channel in off.T], axis=1)
    return _Misfit(seen, mean(np.abs(off).mean(axis=1)), mean(np.abs(off - centre[region]).mean(axis=1)))
