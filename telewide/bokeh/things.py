"""Things that stand before the rest of a scene: pieces of one distance, neither thin nor strips of the ground.

Letters: H W image, h w thinned out.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatMap

LONGEST_PX = 192  # of the map in which things are looked for
LARGE = 0.08  # of the weight of the photo's inner part
WIDTH = 4  # the inner part fades out as exp(-4 r^2), r from 0 to 1 at the sides
FILLED, TALL, WIDE = 0.4, 0.6, 0.7  # of its box at least; height over width at least; of the photo's width at most
STEPS = 8  # slabs begin an eighth of their thickness apart


def nearest_thing(
    disparity_px: FloatMap, weight: FloatMap, *, before_px: float, slab_px: float
) -> tuple[slice, slice] | None:
    """Find the nearest large thing in the inner part of a photo.

    Args:
        disparity_px: (H, W), px.
        weight: (H, W), 0 where the disparity is not trusted.
        before_px: all of it has a larger disparity.
        slab_px: thickness of a thing.

    Returns:
        Rows and columns of the box around it; None where nothing is large, filled and upright enough.
    """
    step = -(-max(disparity_px.shape) // LONGEST_PX)
    thinned_px, inner = (each[step // 2 :: step, step // 2 :: step] for each in (disparity_px, weight))
    if not (inner > 0).any():
        return None
    y, x = (np.linspace(-1, 1, size) for size in inner.shape)
    inner = inner * np.exp(-WIDTH * (x[None] ** 2 + y[:, None] ** 2))
    inner /= inner.sum()
    nearest_px = float(np.percentile(thinned_px[inner > 0], 99.5))
    for start_px in np.arange(nearest_px - slab_px, before_px, -slab_px / STEPS):
        here = (inner > 0) & (thinned_px >= start_px) & (thinned_px <= start_px + slab_px)
        box = _largest_piece(here, inner)
        if box is not None:
            return slice(box[0].start * step, box[0].stop * step), slice(box[1].start * step, box[1].stop * step)
    return None


def _largest_piece(here: BoolMap, weight: FloatMap) -> tuple[slice, slice] | None:
    """Box of the piece that weighs most and is a thing; None where none is."""
    n, label, facts, _ = cv2.connectedComponentsWithStats(here.astype(np.uint8), connectivity=4)
    held = np.bincount(label.ravel(), weights=(weight * here).ravel(), minlength=n)
    for piece in np.argsort(held)[::-1]:
        if held[piece] < LARGE:
            break
        left, top, width, height, area = (int(fact) for fact in facts[piece])
        if area >= FILLED * width * height and height >= TALL * width and width <= WIDE * here.shape[1]:
            return slice(top, top + height), slice(left, left + width)
    return None
