"""Unsure pixels of a matched map follow those around them that look alike: the rim of a dark thing, the thing.

Beside an outline, and within what is plain, a network puts pixels between the surfaces; the sharp view tells to which
of them they belong. So the map is sampled around each unsure cell of a grid; samples weigh by how much their colour is
that of the cell, and by their confidence; and the cell takes their weighted median (Ma et al., "Constant Time Weighted
Median Filtering for Stereo Matching and Beyond", ICCV 2013), along a slope where that explains them better. Where the
samples do not agree, or are farther than what the confidence leaves open, all stays as it was.
Letters: H W image; h w grid of cells; N unsure cells; K samples of each; M unsure pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap, IntArray
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
WHOLE_FROM = 0.15
"""Pixels that would go this share of the way go all of it: what stays between two surfaces shines through in bokeh."""

_PASSES = 2  # the second follows what the first has made alike
_SLOPE_CELLS = 2  # on each side, over which a slope is measured
_FLATTEN_CELLS, _FLATTEN_COLOURS, _FLATTEN_TIMES = 9, 25.0, 2  # so that texture parts no surface
_HALVINGS = 9
_SLOPES_OF = 2  # every other sample tells the slope
_CELLS_AT_ONCE = 1024
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
    grid = _Grid.of(found, ref)
    if not len(rows) or not len(grid.row):
        return found
    for _ in range(_PASSES - 1):
        grid = grid.moved(_followed(grid))
    pixels = rows, columns
    new_px, agreed = _at_pixels(pixels, _followed(grid), grid, ref)
    disparity_px = found.disparity_px.copy()
    away_px = new_px - disparity_px[pixels]
    around = np.asarray(cv2.blur(found.confidence, (5, 5)), dtype=np.float32)[pixels]
    share = agreed * _openness(away_px, found.confidence[pixels], around=around)
    disparity_px[pixels] += away_px * ramp(share, 0, WHOLE_FROM)
    return DisparityMap(disparity_px, found.confidence, found.valid)


def _openness(away_px: FloatMap, confidence: FloatMap, *, around: FloatMap) -> FloatMap:
    """Share in [0, 1] of a move that a confidence, and its mean around, leave open."""
    tolerance_px = np.clip(TOLERANCE_STDS * std_of_error_px(around), *TOLERANCE_PX)
    return ramp(confidence, *UNSURE) * share_within(away_px, tolerance_px)


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

    def moved(self, followed: _Followed) -> _Grid:
        """Bring unsure cells to what they follow."""
        away_px = followed.disparity_px - self.disparity_px
        share = followed.agreed * _openness(away_px, self.confidence, around=self.confidence)
        return replace(self, disparity_px=self.disparity_px + share * away_px)


@dataclass(frozen=True)
class _Followed:
    """Surfaces that unsure cells follow: disparity, its slope to the right and down a cell, share that is followed.

    All (h, w); zero where a cell is sure.
    """

    disparity_px: FloatMap
    right_px: FloatMap
    down_px: FloatMap
    agreed: FloatMap
    is_any: BoolMap


def _followed(grid: _Grid) -> _Followed:
    reach = range(-REACH_CELLS, REACH_CELLS + 1, STEP_CELLS)
    offsets = np.array([(y, x) for y in reach for x in reach if y * y + x * x <= REACH_CELLS**2])
    planes = [_bordered(plane) for plane in (grid.disparity_px, *_slopes(grid.disparity_px))]
    colours = [_bordered(grid.flat[..., channel]) for channel in range(3)]
    confidence = np.pad(grid.confidence, REACH_CELLS)  # nothing beyond the picture counts
    width = confidence.shape[1]
    followed = np.zeros((4, *grid.disparity_px.shape), np.float32)
    for first in range(0, len(grid.row), _CELLS_AT_ONCE):
        row, column = (each[first : first + _CELLS_AT_ONCE] for each in (grid.row, grid.column))
        here = (row + REACH_CELLS) * width + column + REACH_CELLS
        there = here + (offsets[:, :1] * width + offsets[:, 1:])
        apart = sum(np.square(colour[there] - colour[here]) for colour in colours)
        weights = (confidence.ravel()[there] + _TINY) * np.exp(apart * np.float32(-1 / (2 * ALIKE**2)))
        followed[:, row, column] = _agreed(*(plane[there] for plane in planes), weights=weights, offsets=offsets)
    disparity_px, right_px, down_px, agreed = followed
    return _Followed(disparity_px, right_px, down_px, agreed, is_any=grid.confidence < UNSURE[0])


def _bordered(plane: FloatMap) -> FloatMap:
    """A plane continued beyond its sides, row after row."""
    return np.pad(plane, REACH_CELLS, mode="edge").ravel()


def _agreed(
    samples_px: FloatMap, right_px: FloatMap, down_px: FloatMap, *, weights: FloatMap, offsets: IntArray
) -> tuple[FloatMap, FloatMap, FloatMap, FloatMap]:
    """(N,) disparity, slopes and share that is followed, of samples (K, N)."""
    y, x = offsets.astype(np.float32).T[..., None]
    some = slice(None, None, _SLOPES_OF)
    right_px, down_px = (_weighted_median(s[some], weights[some], halvings=7) for s in (right_px, down_px))
    level_px, level_scatter_px = _middle(samples_px, weights)
    along = samples_px - right_px * x - down_px * y
    slope_px, slope_scatter_px = _middle(along, weights)
    is_sloped = slope_scatter_px < SLOPE_GAIN * level_scatter_px
    samples_px = np.where(is_sloped, along, samples_px)
    off_px = np.abs(samples_px - np.where(is_sloped, slope_px, level_px))
    agreed = ramp((weights * (off_px < NEAR_PX)).sum(axis=0) / weights.sum(axis=0), *AGREED)
    same = weights * np.square(1 - np.square(np.minimum(off_px / SAME_PX, 1)))
    mean_px = (same * samples_px).sum(axis=0) / np.maximum(same.sum(axis=0), _TINY)
    return mean_px, is_sloped * right_px, is_sloped * down_px, agreed


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
    middle_px = _weighted_median(samples_px, weights, halvings=_HALVINGS)
    scatter_px = (weights * np.abs(samples_px - middle_px)).sum(axis=0) / weights.sum(axis=0)
    return middle_px, np.asarray(scatter_px, dtype=np.float32)


def _weighted_median(values: FloatMap, weights: FloatMap, *, halvings: int) -> FloatMap:
    """(N,) of (K, N), to a small part of their range: halving that takes a tenth of the time of sorting."""
    low, high = values.min(axis=0), values.max(axis=0)
    half = weights.sum(axis=0) / 2
    for _ in range(halvings):
        middle = (low + high) / 2
        is_below = (weights * (values <= middle)).sum(axis=0) >= half
        low, high = np.where(is_below, low, middle), np.where(is_below, middle, high)
    return np.asarray(high, dtype=np.float32)


def _at_pixels(
    pixels: tuple[IntArray, IntArray], followed: _Followed, grid: _Grid, ref: FloatImage
) -> tuple[FloatMap, FloatMap]:
    """(M,) disparity that pixels follow, px, and how far: each takes the most alike of the unsure cells around it."""
    h, w = grid.disparity_px.shape
    y, x = (
        (side + np.float32(0.5)) * np.float32(n / of) - np.float32(0.5)
        for side, n, of in zip(pixels, (h, w), ref.shape, strict=False)
    )
    colour = 255 * ref[pixels]
    below, right_of = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    best, cell = np.full(len(y), np.inf, dtype=np.float32), np.zeros(len(y), dtype=np.int64)
    for down in (0, 1):
        row = np.clip(below + down, 0, h - 1)
        for right in (0, 1):
            column = np.clip(right_of + right, 0, w - 1)
            here = row * w + column
            apart = np.abs(grid.colour.reshape(-1, 3)[here] - colour).sum(axis=1)
            apart += 2 * (np.abs(y - row) + np.abs(x - column))
            apart[~followed.is_any.ravel()[here]] = np.inf
            is_best = apart < best
            best, cell = np.where(is_best, apart, best), np.where(is_best, here, cell)
    row, column = np.divmod(cell, w)
    along_px = followed.right_px.ravel()[cell] * (x - column) + followed.down_px.ravel()[cell] * (y - row)
    agreed = np.where(np.isfinite(best), followed.agreed.ravel()[cell], 0)
    return followed.disparity_px.ravel()[cell] + along_px, agreed.astype(np.float32)
