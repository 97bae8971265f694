"""Unsure pixels of a matched map follow those around them that look alike: the rim of a dark thing, the thing.

Beside an outline, and within what is plain, a network puts pixels between the surfaces; the sharp view tells to which
of them they belong. So the map is sampled around each unsure cell of a grid; samples weigh by how much their colour is
that of the cell, and by their confidence; and the cell takes their weighted median (Ma et al., "Constant Time Weighted
Median Filtering for Stereo Matching and Beyond", ICCV 2013), along a slope where that explains them better. Where the
samples do not agree, or are farther than what the confidence leaves open, all stays as it was.
Letters: H W image; h w grid of cells; N unsure cells; K samples of each; M unsure pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage, FloatMap, IntArray
from telewide.geometry.stereo import DisparityMap
from telewide.matching.doubt import ramp, share_within, std_of_error_px

CELLS_ALONG = 320
"""Cells along the longer side of a picture; a small picture has its pixels."""
REACH_CELLS, STEP_CELLS = 24, 4
"""Radius of the disc of samples, and their distance from each other."""
ALIKE = 15.0
"""Standard deviation of a channel, of 255, within what counts as one colour."""
UNSURE = (0.9, 0.7)
"""Confidence below which a pixel begins to follow, and from which on it wholly does."""
AGREED = (0.5, 0.7)
"""Share of the samples near their median, likewise."""
NEAR_PX, SAME_PX = 1.5, 1.0
"""Samples near the median; and those that are averaged, with Tukey's weights."""
SLOPE_GAIN = 0.5
"""A slope is taken where the samples scatter about it by less than this share of their scatter about one disparity."""
TOLERANCE_STDS, TOLERANCE_PX = 3.0, (0.6, 30.0)
"""Distance a pixel may move: standard deviations of its error, and the least and the most."""

_PASSES = 2  # the second follows what the first has made alike
_SLOPE_CELLS = 2  # on each side, over which a slope is measured
_FLATTEN_CELLS, _FLATTEN_COLOURS, _FLATTEN_TIMES = 9, 25.0, 2  # so that texture parts no surface
_HALVINGS = 12
_TINY = np.float32(1e-6)


def follow_lookalikes(found: DisparityMap, ref: FloatImage) -> DisparityMap:
    """Bring unsure pixels to the surface of what looks like them.

    Args:
        found: its confidence is the probability of an error below 1 px.
        ref: (H, W, 3) the view of the map, [0, 1].

    Returns:
        The map with other disparities; confidence and what counts as measured are the same.
    """
    rows, columns = np.nonzero(found.confidence < UNSURE[0])
    for _ in range(_PASSES):
        grid = _Grid.of(found, ref)
        if not len(rows) or not len(grid.row):
            return found
        found = _moved(found, (rows, columns), grid, ref)
    return found


def _moved(found: DisparityMap, pixels: tuple[IntArray, IntArray], grid: _Grid, ref: FloatImage) -> DisparityMap:
    disparity_px = found.disparity_px.copy()
    new_px, agreed = _at_pixels(pixels, _followed(grid), grid, ref)
    away_px = new_px - disparity_px[pixels]
    std_px = std_of_error_px(_mean_around(found.confidence)[pixels])
    pull = agreed * ramp(found.confidence[pixels], *UNSURE)
    pull *= share_within(away_px, np.clip(TOLERANCE_STDS * std_px, *TOLERANCE_PX))
    disparity_px[pixels] += pull * away_px
    return DisparityMap(disparity_px, found.confidence, found.valid)


def _mean_around(values: FloatMap) -> FloatMap:
    return np.asarray(cv2.blur(values, (5, 5)), dtype=np.float32)


@dataclass(frozen=True)
class _Grid:
    """The map by cells; rows and columns (N,) of those that are unsure.

    Attributes:
        disparity_px: (h, w) of their centres.
        confidence: (h, w) their mean.
        colour: (h, w, 3) their mean, [0, 255].
        flat: (h, w, 3) the same without texture.
        row: (N,) of the unsure cells.
        column: (N,) likewise.
    """

    disparity_px: FloatMap
    confidence: FloatMap
    colour: FloatImage
    flat: FloatImage
    row: IntArray
    column: IntArray

    @classmethod
    def of(cls, found: DisparityMap, ref: FloatImage) -> _Grid:
        height, width = found.disparity_px.shape
        scale = min(1.0, CELLS_ALONG / max(height, width))
        wh = max(1, round(width * scale)), max(1, round(height * scale))
        colour = cv2.resize((255 * np.clip(ref, 0, 1)).astype(np.uint8), wh, interpolation=cv2.INTER_AREA)
        flat = colour
        for _ in range(_FLATTEN_TIMES):
            flat = cv2.bilateralFilter(flat, _FLATTEN_CELLS, _FLATTEN_COLOURS, _FLATTEN_CELLS / 2)
        confidence = np.asarray(cv2.resize(found.confidence, wh, interpolation=cv2.INTER_AREA), dtype=np.float32)
        rows, columns = (
            ((np.arange(n) + 0.5) * (of / n)).astype(np.int64) for n, of in ((wh[1], height), (wh[0], width))
        )
        row, column = np.nonzero(confidence < UNSURE[0])
        return cls(
            found.disparity_px[rows[:, None], columns],
            confidence,
            colour.astype(np.float32),
            flat.astype(np.float32),
            row,
            column,
        )


@dataclass(frozen=True)
class _Followed:
    """Surfaces that unsure cells follow: disparity, its slope to the right and down a cell, share that is followed.

    All (h, w); NaN where a cell is sure.
    """

    disparity_px: FloatMap
    right_px: FloatMap
    down_px: FloatMap
    agreed: FloatMap


def _followed(grid: _Grid) -> _Followed:
    reach = range(-REACH_CELLS, REACH_CELLS + 1, STEP_CELLS)
    offsets = [(y, x) for y in reach for x in reach if y * y + x * x <= REACH_CELLS**2]
    weights = _weights(grid, offsets)
    samples_px = _sampled(grid.disparity_px, grid, offsets)
    right_px, down_px = (_weighted_median(_sampled(s, grid, offsets), weights) for s in _slopes(grid.disparity_px))
    y, x = np.array(offsets, dtype=np.float32).T[..., None]
    level_px, level_scatter_px = _middle(samples_px, weights)
    along = samples_px - right_px * x - down_px * y
    slope_px, slope_scatter_px = _middle(along, weights)
    is_sloped = slope_scatter_px < SLOPE_GAIN * level_scatter_px
    samples_px = np.where(is_sloped, along, samples_px)
    off_px = np.abs(samples_px - np.where(is_sloped, slope_px, level_px))
    agreed = ramp((weights * (off_px < NEAR_PX)).sum(axis=0) / weights.sum(axis=0), *AGREED)
    same = weights * (1 - np.minimum(off_px / SAME_PX, 1) ** 2) ** 2
    mean_px = (same * samples_px).sum(axis=0) / np.maximum(same.sum(axis=0), _TINY)
    return _Followed(*(_on_grid(v, grid) for v in (mean_px, is_sloped * right_px, is_sloped * down_px, agreed)))


def _on_grid(values: FloatMap, grid: _Grid) -> FloatMap:
    """(h, w) of the values (N,) of unsure cells."""
    whole = np.full(grid.disparity_px.shape, np.nan, np.float32)
    whole[grid.row, grid.column] = values
    return whole


def _weights(grid: _Grid, offsets: list[tuple[int, int]]) -> NDArray[np.float32]:
    """(K, N) of the samples: colour and confidence; none beyond the picture."""
    apart = np.zeros((len(offsets), len(grid.row)), dtype=np.float32)
    for channel in range(3):
        plane = np.ascontiguousarray(grid.flat[..., channel])
        apart += np.square(_sampled(plane, grid, offsets) - plane[grid.row, grid.column])
    confidence = _sampled(grid.confidence, grid, offsets, has_border=True) + _TINY
    return np.asarray(confidence * np.exp(apart * np.float32(-1 / (2 * ALIKE**2))), dtype=np.float32)


def _sampled(
    plane: FloatMap, grid: _Grid, offsets: list[tuple[int, int]], *, has_border: bool = False
) -> NDArray[np.float32]:
    """(K, N) values of a plane around the unsure cells; beyond the picture its last ones, or zeros with a border."""
    padded = np.pad(plane, REACH_CELLS, mode="constant" if has_border else "edge")
    width = padded.shape[1]
    at = (grid.row + REACH_CELLS) * width + grid.column + REACH_CELLS
    return np.stack([padded.ravel()[at + y * width + x] for y, x in offsets])


def _slopes(disparity_px: FloatMap) -> tuple[FloatMap, FloatMap]:
    """Change to the right and down, px a cell."""
    k = _SLOPE_CELLS
    padded = cv2.copyMakeBorder(disparity_px, k, k, k, k, cv2.BORDER_REPLICATE)
    inner = slice(k, -k)
    return (
        (padded[inner, 2 * k :] - padded[inner, : -2 * k]) / np.float32(2 * k),
        (padded[2 * k :, inner] - padded[: -2 * k, inner]) / np.float32(2 * k),
    )


def _middle(samples_px: FloatMap, weights: FloatMap) -> tuple[FloatMap, FloatMap]:
    """(N,) weighted median, and the mean distance from it."""
    middle_px = _weighted_median(samples_px, weights)
    scatter_px = (weights * np.abs(samples_px - middle_px)).sum(axis=0) / weights.sum(axis=0)
    return middle_px, np.asarray(scatter_px, dtype=np.float32)


def _weighted_median(values: FloatMap, weights: FloatMap) -> FloatMap:
    """(N,) of (K, N), to a small part of their range: halving that takes a tenth of the time of sorting."""
    low, high = values.min(axis=0), values.max(axis=0)
    half = weights.sum(axis=0) / 2
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_below = (weights * (values <= middle)).sum(axis=0) >= half
        low, high = np.where(is_below, low, middle), np.where(is_below, middle, high)
    return np.asarray(high, dtype=np.float32)


def _at_pixels(
    pixels: tuple[IntArray, IntArray], followed: _Followed, grid: _Grid, ref: FloatImage
) -> tuple[FloatMap, FloatMap]:
    """(M,) disparity that pixels follow, px, and how far: each takes the most alike of the four cells around it."""
    h, w = grid.disparity_px.shape
    height, width = ref.shape[:2]
    y, x = ((pixels[0] + 0.5) * (h / height) - 0.5, (pixels[1] + 0.5) * (w / width) - 0.5)
    colour = 255 * ref[pixels]
    best = np.full(len(y), np.inf, dtype=np.float32)
    disparity_px, agreed = np.zeros_like(best), np.zeros_like(best)
    for down in (0, 1):
        for right in (0, 1):
            row = np.clip(np.floor(y).astype(np.int64) + down, 0, h - 1)
            column = np.clip(np.floor(x).astype(np.int64) + right, 0, w - 1)
            of_cell = followed.disparity_px[row, column]
            apart = np.abs(grid.colour[row, column] - colour).sum(axis=1) + 2 * (np.abs(y - row) + np.abs(x - column))
            is_best = np.isfinite(of_cell) & (apart < best)
            best[is_best] = apart[is_best]
            along_px = followed.right_px[row, column] * (x - column) + followed.down_px[row, column] * (y - row)
            disparity_px[is_best] = (of_cell + along_px)[is_best]
            agreed[is_best] = followed.agreed[row, column][is_best]
    return disparity_px, agreed
