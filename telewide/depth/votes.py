"""Votes of the pixels around one for its disparity: each weighs by the likeness of its colour, by nearness and trust.

Letters: H W image; N places; K pixels of the window around each; J offsets along one side of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, FloatMap, IntArray

COLOUR_SIGMA = 0.06  # of sRGB values
SAME_SURFACE_PX = 1.0
TILE_PX = 128  # what a tile takes stays in the processor's cache
_COLOUR_UNIT = np.float32(1 / (2**0.5 * COLOUR_SIGMA))

Tile = tuple[slice, slice]


@dataclass(frozen=True)
class Voters:
    """A map and what its pixels weigh, widened on every side by pixels that weigh nothing.

    Attributes:
        value_px: (H, W) disparities, px.
        colour: three (H, W) planes, in units in which ``exp(-d^2)`` is the likeness of two colours.
        weight: (H, W).
        margin: on every side, px; included in H and W.
    """

    value_px: FloatMap
    colour: tuple[FloatMap, ...]
    weight: FloatMap
    margin: int


def voters_of(value_px: FloatMap, guide_rgb: FloatMap, weight: FloatMap, *, margin: int) -> Voters:
    """Prepare a map for votes.

    Args:
        value_px: (H, W) disparities, px.
        guide_rgb: (H, W, 3) float32 in [0, 1].
        weight: (H, W) float32, what each pixel weighs.
        margin: half the window, px.
    """

    def widened(plane: FloatMap) -> FloatMap:
        around = cv2.copyMakeBorder(plane, margin, margin, margin, margin, cv2.BORDER_CONSTANT)
        return np.asarray(around, dtype=np.float32)

    colour = tuple(widened(guide_rgb[..., i] * _COLOUR_UNIT) for i in range(3))
    return Voters(widened(value_px), colour, widened(weight), margin)


def tiles_of(doubtful: BoolMap) -> list[Tile]:
    """Cut a picture into tiles, and return those in which anything is in doubt."""
    height, width = doubtful.shape
    tiles = (
        np.s_[top : min(top + TILE_PX, height), left : min(left + TILE_PX, width)]
        for top in range(0, height, TILE_PX)
        for left in range(0, width, TILE_PX)
    )
    return [tile for tile in tiles if doubtful[tile].any()]


def agreeing_share(voters: Voters, tile: Tile, *, offset_J: IntArray, closeness_JJ: FloatMap) -> FloatMap:
    """Share of the votes around each pixel of a tile that are for its own surface, float32 of the tile's size.

    Args:
        voters: the map.
        tile: without the margin.
        offset_J: rows and columns of the window, relative to a pixel.
        closeness_JJ: what each place of the window weighs.
    """
    own_px = _shifted(voters.value_px, tile, voters.margin, yx=(0, 0))
    own_colour = [_shifted(plane, tile, voters.margin, yx=(0, 0)) for plane in voters.colour]
    agreeing, total = np.zeros_like(own_px), np.zeros_like(own_px)
    for (i, j), closeness in np.ndenumerate(closeness_JJ):
        at_yx = int(offset_J[i]), int(offset_J[j])
        unlike = np.zeros_like(own_px)
        for plane, own in zip(voters.colour, own_colour, strict=True):
            difference = _shifted(plane, tile, voters.margin, yx=at_yx) - own
            difference *= difference
            unlike += difference
        vote = np.exp(np.negative(unlike, out=unlike), out=unlike)
        vote *= _shifted(voters.weight, tile, voters.margin, yx=at_yx)
        vote *= closeness
        total += vote
        vote *= np.abs(_shifted(voters.value_px, tile, voters.margin, yx=at_yx) - own_px) <= SAME_SURFACE_PX
        agreeing += vote
    return np.asarray(agreeing / np.maximum(total, np.float32(1e-30)), dtype=np.float32)


def votes_around(
    voters: Voters,
    colour_N3: FloatMap,
    at_yx: tuple[NDArray[np.int64], NDArray[np.int64]],
    *,
    offset_J: IntArray,
    closeness: FloatMap,
) -> tuple[FloatMap, FloatMap]:
    """Gather the disparities in the windows around N places, and what each weighs for a pixel of a given colour.

    Args:
        voters: the map.
        colour_N3: sRGB in [0, 1].
        at_yx: rows and columns (N,), without the margin.
        offset_J: rows and columns of the window, relative to its middle.
        closeness: what each place of the window weighs, (K,) or (N, K), row by row.

    Returns:
        (N, K) disparities, px, and (N, K) weights.
    """
    stride = voters.value_px.shape[1]
    middle_N = (at_yx[0] + voters.margin) * stride + at_yx[1] + voters.margin
    near_NK = middle_N[:, None] + (offset_J[:, None] * stride + offset_J).ravel()
    unlike_NK = np.zeros(near_NK.shape, np.float32)
    for i, plane in enumerate(voters.colour):
        difference_NK = plane.ravel()[near_NK] - colour_N3[:, i, None] * _COLOUR_UNIT
        unlike_NK += difference_NK * difference_NK
    weight_NK = voters.weight.ravel()[near_NK] * closeness * np.exp(-unlike_NK)
    return voters.value_px.ravel()[near_NK], weight_NK


def weighted_median(value_NK: FloatMap, weight_NK: FloatMap) -> FloatMap:
    """Find the value (N,) of each row with half the weight below it, one of the row's own."""
    order = np.argsort(value_NK, axis=1)
    below_NK = np.take_along_axis(weight_NK, order, axis=1).cumsum(axis=1)
    middle = (below_NK >= below_NK[:, -1:] / 2).argmax(axis=1)
    return np.take_along_axis(value_NK, np.take_along_axis(order, middle[:, None], axis=1), axis=1)[:, 0]


def _shifted(plane: FloatMap, tile: Tile, margin: int, *, yx: tuple[int, int]) -> FloatMap:
    """A tile of a widened plane, seen from a place beside."""
    rows, columns = (
        slice(side.start + margin + by, side.stop + margin + by) for side, by in zip(tile, yx, strict=True)
    )
    return plane[rows, columns]
