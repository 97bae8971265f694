"""Depth edges that follow the photo: fill what is unknown, snap what is misplaced, never mix two surfaces.

A pixel near a depth edge takes the weighted median of the disparities around it. A neighbour weighs more where its
colour is alike, where it is close, where its disparity is confident, and where it lies away from the edge, whose place
is what is in doubt. A median always is one of its values, so no disparity between two surfaces appears: averaged edges
cost a bokeh 13 dB, more than edges 3 px out of place.
Letters: H W image; N pixels near an edge; K pixels of the window around each.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatMap, IntArray

JUMP_PX = 1.0  # a difference between neighbours that is an edge and no slope, in photos of any size
DOUBT_PX = 4  # how far from its true place a matcher leaves an edge
REACH_PX = 8  # half the window
STEP_PX = 2  # every other pixel of the window is enough
FULL_SCALE_WIDTH_PX = 1600  # DOUBT_PX, REACH_PX and STEP_PX are for photos up to this width, and grow with larger ones
ROUNDS = 3
COLOUR_SIGMA = 0.06  # of sRGB values
EDGE_WEIGHT = 0.15  # of a neighbour within DOUBT_PX of an edge
FILLED_WEIGHT = 0.25  # of a neighbour that was not measured
KEEP_SHARE = 0.35  # of the weight around a pixel that must agree with it, for it to stay as it is
CHUNK = 16384


def nearest_known(known: BoolMap) -> tuple[FloatMap, IntArray]:
    """Find for every pixel the nearest known one.

    Args:
        known: (H, W) bool, True somewhere.

    Returns:
        (H, W) float32 distance, px, and (H, W) int64 flat index of that pixel; both to the accuracy of a 5x5 chamfer
        distance.
    """
    distance_px, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.flatnonzero(known)
    index_of_label = np.zeros(int(label.max()) + 1, dtype=np.int64)
    index_of_label[label.ravel()[index]] = index
    return np.asarray(distance_px, dtype=np.float32), index_of_label[label]


def fill_unknown(disparity_px: FloatMap) -> FloatMap:
    """Give every pixel that is not finite the value of the nearest one that is.

    Args:
        disparity_px: (H, W) float32, px.

    Raises:
        InputError: no pixel is finite.
    """
    known = np.isfinite(disparity_px)
    if known.all():
        return disparity_px
    if not known.any():
        raise InputError("the disparity map holds no known value")
    _, index = nearest_known(known)
    return np.asarray(disparity_px.ravel()[index], dtype=np.float32)


def follow_edges(disparity_px: FloatMap, guide_rgb: FloatMap, *, confidence: FloatMap, valid: BoolMap) -> FloatMap:
    """Move the edges of a disparity map to the edges of the photo.

    Away from depth edges the map is left as it is; so is a pixel around which nothing has its colour.

    Args:
        disparity_px: (H, W) float32, px; what is not finite is filled from its nearest neighbour first.
        guide_rgb: (H, W, 3) float32 in [0, 1], the tele photo.
        confidence: (H, W) float32 in [0, 1].
        valid: (H, W) bool, False where the value was filled in.

    Returns:
        (H, W) float32, px; every value is one of the window around its pixel.

    Raises:
        InputError: the sizes differ, or no disparity is known.
    """
    sizes = {disparity_px.shape, guide_rgb.shape[:2], confidence.shape, valid.shape}
    if len(sizes) > 1:
        raise InputError(f"disparity, photo, confidence and valid mask must have one size, found {sorted(sizes)}")
    scale = max(1, round(disparity_px.shape[1] / FULL_SCALE_WIDTH_PX))
    followed_px = fill_unknown(disparity_px)
    trust = (np.clip(confidence, 0.05, 1) * np.where(valid, 1.0, FILLED_WEIGHT)).astype(np.float32)
    for _ in range(ROUNDS):
        doubtful = _near_edge(followed_px, margin_px=DOUBT_PX * scale)
        weight = trust * np.where(doubtful, np.float32(EDGE_WEIGHT), np.float32(1))
        followed_px = _snapped(followed_px, guide_rgb, weight, np.flatnonzero(doubtful), scale=scale)
    return followed_px


def _near_edge(disparity_px: FloatMap, *, margin_px: int) -> BoolMap:
    square = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(disparity_px, square) - cv2.erode(disparity_px, square) > JUMP_PX
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin_px + 1, 2 * margin_px + 1))
    return np.asarray(cv2.dilate(jump.astype(np.uint8), disk) > 0)


def _snapped(disparity_px: FloatMap, guide_rgb: FloatMap, weight: FloatMap, index: IntArray, *, scale: int) -> FloatMap:
    """Take the weighted median at the pixels of a flat index whose surroundings do not bear them out."""
    height, width = disparity_px.shape
    offset = np.arange(-REACH_PX, REACH_PX + 1, STEP_PX) * scale
    dy, dx = (d.ravel() for d in np.meshgrid(offset, offset, indexing="ij"))
    closeness_K = np.exp(-0.5 * (dx**2 + dy**2) / (0.75 * REACH_PX * scale) ** 2).astype(np.float32)
    colour, values, weights = guide_rgb.reshape(-1, 3), disparity_px.ravel(), weight.ravel()
    snapped = values.copy()
    for start in range(0, len(index), CHUNK):
        at_N = index[start : start + CHUNK]
        y, x = np.divmod(at_N, width)
        inside_NK = _inside(y, dy, height) & _inside(x, dx, width)
        near_NK = np.where(inside_NK, (y[:, None] + dy) * width + x[:, None] + dx, at_N[:, None])
        unlike_NK = ((colour[near_NK] - colour[at_N][:, None]) ** 2).sum(axis=2) / np.float32(2 * COLOUR_SIGMA**2)
        weight_NK = weights[near_NK] * closeness_K * np.exp(-unlike_NK) * inside_NK
        near_px_NK, own_px_N = values[near_NK], values[at_N]
        agree_NK = np.abs(near_px_NK - own_px_N[:, None]) <= JUMP_PX
        is_held_N = (weight_NK * agree_NK).sum(axis=1) >= KEEP_SHARE * weight_NK.sum(axis=1)
        snapped[at_N] = np.where(is_held_N, own_px_N, _weighted_median(near_px_NK, weight_NK))
    return snapped.reshape(height, width)


def _inside(at_N: IntArray, offset_K: IntArray, size: int) -> BoolMap:
    near_NK = at_N[:, None] + offset_K
    return (near_NK >= 0) & (near_NK < size)


def _weighted_median(value_NK: FloatMap, weight_NK: FloatMap) -> FloatMap:
    """The value with half the weight below it, one of the row's own."""
    order = np.argsort(value_NK, axis=1)
    below_NK = np.take_along_axis(weight_NK, order, axis=1).cumsum(axis=1)
    middle = (below_NK >= below_NK[:, -1:] / 2).argmax(axis=1)
    return np.take_along_axis(value_NK, np.take_along_axis(order, middle[:, None], axis=1), axis=1)[:, 0]
