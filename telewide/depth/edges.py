"""Depth edges that follow the photo: fill what is unknown, snap what is misplaced, never mix two surfaces.

A pixel near a depth edge takes the weighted median of the disparities around it. A neighbour weighs more where its
colour is alike, where it is close, where its disparity is confident, and where it lies away from the edge, whose place
is what is in doubt. A median always is one of its values, so no disparity between two surfaces appears: averaged edges
cost a bokeh 13 dB, more than edges 3 px out of place.
A large photo is followed at a fraction of its size, where a matcher's map has its detail, and then at its own size in a
narrow band along the edges found.
Letters: H W image, h w at a fraction of its size; N places; K pixels of the window around each; J offsets along a side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.cores import usable_cores
from telewide.depth.fringes import with_fringes
from telewide.depth.nearest import fill_unknown
from telewide.depth.slopes import steepened, with_smooth_outlines
from telewide.depth.strands import with_strands
from telewide.depth.votes import agreeing_share, tiles_of, voters_of, votes_around, weighted_median
from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatMap, IntArray

JUMP_PX = 1.0  # a difference between neighbours that is an edge and no slope, in photos of any size
DOUBT_PX = 4  # how far from its true place a matcher leaves an edge
REACH_PX = 8  # half the window
STEP_PX = 2  # every other pixel of the window is enough
FULL_SCALE_WIDTH_PX = 1600  # photos up to this width are followed at their own size, larger ones at a fraction first
ROUNDS = 3
EDGE_WEIGHT = 0.15  # of a neighbour within DOUBT_PX of an edge
FILLED_WEIGHT = 0.25  # of a neighbour that was not measured
KEEP_SHARE = 0.35  # of the weight around a pixel that must agree with it, for it to stay as it is
FINE_REACH_PX = 2  # half the window of the second pass, px of the fraction
CHUNK = 16384

Item = TypeVar("Item")


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
    filled_px = fill_unknown(disparity_px)
    trust = np.clip(confidence, 0.05, 1) * np.where(valid, np.float32(1), np.float32(FILLED_WEIGHT))
    scale = max(1, round(disparity_px.shape[1] / FULL_SCALE_WIDTH_PX))
    if scale == 1:
        followed_px = with_smooth_outlines(_followed(steepened(filled_px), guide_rgb, trust), jump_px=JUMP_PX)
        followed_px = with_fringes(followed_px, guide_rgb, jump_px=JUMP_PX)
        return with_strands(followed_px, guide_rgb, trust=_measured(confidence, valid))
    wh = -(-disparity_px.shape[1] // scale), -(-disparity_px.shape[0] // scale)
    small_trust, small_px = (
        cv2.resize(plane, wh, interpolation=cv2.INTER_NEAREST_EXACT) for plane in (trust, filled_px)
    )
    small_guide = np.asarray(cv2.resize(guide_rgb, wh, interpolation=cv2.INTER_AREA), dtype=np.float32)
    small_px = steepened(np.asarray(small_px, dtype=np.float32))
    small_px = _followed(small_px, small_guide, np.asarray(small_trust, dtype=np.float32))
    lies_at_edge = _near_edge(small_px, margin_px=0)
    weight = np.asarray(small_trust * np.where(lies_at_edge, EDGE_WEIGHT, 1), dtype=np.float32)
    followed_px = _at_own_size(filled_px, guide_rgb, small_px=small_px, small_guide=small_guide, weight=weight)
    followed_px = with_smooth_outlines(followed_px, jump_px=JUMP_PX)
    followed_px = with_fringes(followed_px, guide_rgb, jump_px=JUMP_PX, scale=scale)
    return with_strands(followed_px, guide_rgb, trust=_measured(confidence, valid), scale=scale)


def _measured(confidence: FloatMap, valid: BoolMap) -> FloatMap:
    return np.where(valid, confidence, np.float32(0))


def _followed(disparity_px: FloatMap, guide_rgb: FloatMap, trust: FloatMap) -> FloatMap:
    """Move edges by up to half a window, in rounds: after each, less is in doubt."""
    for _ in range(ROUNDS):
        doubtful = _near_edge(disparity_px, margin_px=DOUBT_PX)
        weight = trust * np.where(doubtful, np.float32(EDGE_WEIGHT), np.float32(1))
        disparity_px = _snapped(disparity_px, guide_rgb, weight, doubtful)
    return disparity_px


def _near_edge(disparity_px: FloatMap, *, margin_px: int) -> BoolMap:
    square = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(disparity_px, square) - cv2.erode(disparity_px, square) > JUMP_PX
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin_px + 1, 2 * margin_px + 1))
    return np.asarray(cv2.dilate(jump.astype(np.uint8), disk) > 0)


def _snapped(disparity_px: FloatMap, guide_rgb: FloatMap, weight: FloatMap, doubtful: BoolMap) -> FloatMap:
    """Take the weighted median at the doubtful pixels whose surroundings do not bear them out."""
    voters = voters_of(disparity_px, guide_rgb, weight, margin=REACH_PX)
    offset = np.arange(-REACH_PX, REACH_PX + 1, STEP_PX)
    closeness = np.exp(-0.5 * (offset[:, None] ** 2 + offset**2) / (0.75 * REACH_PX) ** 2).astype(np.float32)
    loose = np.zeros(doubtful.shape, np.bool_)

    def test(tile: tuple[slice, slice]) -> None:
        share = agreeing_share(voters, tile, offset_J=offset, closeness_JJ=closeness)
        loose[tile] = doubtful[tile] & (share < KEEP_SHARE)

    _in_threads(test, tiles_of(doubtful))
    at_y, at_x = np.nonzero(loose)
    snapped_px = disparity_px.copy()

    def decide(start: int) -> None:
        y, x = at_y[start : start + CHUNK], at_x[start : start + CHUNK]
        votes = votes_around(voters, guide_rgb[y, x], (y, x), offset_J=offset, closeness=closeness.ravel())
        snapped_px[y, x] = weighted_median(*votes)

    _in_threads(decide, range(0, len(at_y), CHUNK))
    return snapped_px


def _at_own_size(
    disparity_px: FloatMap, guide_rgb: FloatMap, *, small_px: FloatMap, small_guide: FloatMap, weight: FloatMap
) -> FloatMap:
    """Bring edges found at a fraction of the size (h, w) to the photo's own pixels (H, W)."""
    wh = disparity_px.shape[::-1]
    followed_px = np.asarray(cv2.resize(small_px, wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)
    # On one surface the map keeps its own values, which are finer.
    np.copyto(followed_px, disparity_px, where=np.abs(followed_px - disparity_px) <= JUMP_PX)
    voters = voters_of(small_px, small_guide, weight, margin=FINE_REACH_PX)
    offset = np.arange(-FINE_REACH_PX, FINE_REACH_PX + 1)
    band = _near_edge(small_px, margin_px=FINE_REACH_PX - 1).astype(np.uint8)
    at_y, at_x = np.nonzero(cv2.resize(band, wh, interpolation=cv2.INTER_NEAREST_EXACT))

    def decide(start: int) -> None:
        y, x = at_y[start : start + CHUNK], at_x[start : start + CHUNK]
        (row, closeness_y), (column, closeness_x) = (
            _place(own, offset, scale=small / full)
            for own, small, full in zip((y, x), small_px.shape, disparity_px.shape, strict=True)
        )
        closeness_NK = (closeness_y[:, :, None] * closeness_x[:, None]).reshape(len(y), -1)
        value_NK, vote_NK = votes_around(
            voters, guide_rgb[y, x], (row, column), offset_J=offset, closeness=closeness_NK
        )
        agreeing_N = (vote_NK * (np.abs(value_NK - followed_px[y, x][:, None]) <= JUMP_PX)).sum(axis=1)
        loose = np.flatnonzero(agreeing_N < vote_NK.sum(axis=1) / 2)
        followed_px[y[loose], x[loose]] = weighted_median(value_NK[loose], vote_NK[loose])

    _in_threads(decide, range(0, len(at_y), CHUNK))
    return followed_px


def _place(at_N: IntArray, offset: IntArray, *, scale: float) -> tuple[NDArray[np.int64], FloatMap]:
    """Nearest row (or column) at a fraction of the size, and what the rows around it weigh, (N, 5)."""
    exact_N = (at_N + 0.5) * scale - 0.5
    nearest_N = np.rint(exact_N).astype(np.int64)
    away_NJ = (nearest_N - exact_N)[:, None] + offset
    return nearest_N, np.exp(-0.5 * (away_NJ / (FINE_REACH_PX / 2)) ** 2).astype(np.float32)


def _in_threads(work: Callable[[Item], None], items: Iterable[Item]) -> None:
    with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
        list(pool.map(work, items))
