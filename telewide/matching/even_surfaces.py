"""Even surfaces of a matched map: what a network draws of a plain wall ripples, the wall does not.

On a surface the errors of a network are smooth, and larger where it is less sure. So large even pieces of the map are
looked for, each a polynomial of the second degree in the picture, and pixels are pulled to their piece: within what
their confidence leaves open, and not where the network is sure of texture. Edges of depth, and what stands before a
piece, stay as they are. On a plane disparity is affine in the picture; the second degree is for what bends, and for
what lenses leave of their distortion.
Letters: H W image; h w grid of cells; K terms of a polynomial.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, FloatArray, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.doubt import ramp, share_within, std_of_error_px

CELL_PX = 8
SEEDS_ACROSS = 12
"""Places along the side of a square picture from which pieces grow."""
SEED_REACH_CELLS = 8
LEAST_SIDE_PX = 64
"""A smaller picture has no room for pieces."""
LEAST_SHARE = 0.015
"""Smallest piece, of all cells."""
TOLERANCE_STDS = 3.0
TOLERANCE_PX = (0.6, 6.0)
"""Least and largest distance from a piece within which a pixel is taken for one of it."""
STEEP = 12 / 255
"""Change of colour a px, from which a cell is more than a plain surface: only the least tolerance counts there."""
SURE = (0.9, 0.99)
TEXTURED = (0.005, 0.02)
"""Confidence, and mean change of colour a px, over which a pixel is held back; at the upper ends of both it stays."""
AROUND_PX = 33
JUMP_PX = 1.0
JUMP_REACH_PX = (1.0, 5.0)
"""Distances from a jump of depth over which the pull begins and is whole."""

_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Of x and y in each term of a polynomial; the first three are those of a plane."""
_AFFINE_TERMS = 3
_AFFINE_ROUNDS, _ROUNDS = 2, 6
_REWEIGHTINGS = 3
_LEAST_STD_PX = 0.3


def even_surfaces(found: DisparityMap, ref: FloatImage) -> DisparityMap:
    """Pull the pixels of large even pieces of a map to their surface.

    Args:
        found: its confidence is the probability of an error below 1 px.
        ref: (H, W, 3) the view of the map, [0, 1].

    Returns:
        The map with other disparities; confidence and what counts as measured are the same.
    """
    if min(found.disparity_px.shape) < LEAST_SIDE_PX:
        return found
    view = _View.of(found, ref)
    cells = _Cells.of(view)
    pieces = _pieces(cells)
    if not pieces:
        return found
    surface_px, share = _surface_of_pieces(pieces, cells, hw=view.disparity_px.shape)
    away_px = surface_px - view.disparity_px
    pull = share * share_within(away_px, view.tolerance_px) * _openness(view)
    return DisparityMap(view.disparity_px + pull * away_px, found.confidence, found.valid)


@dataclass(frozen=True)
class _View:
    """Facts of each pixel, (H, W) each.

    Attributes:
        disparity_px: as matched.
        smooth_px: its median over 5 x 5 pixels.
        confidence: as matched.
        sure: the mean confidence around it.
        std_px: of its error, by `sure`.
        slope: change of colour a px.
        tolerance_px: distance from a piece within which it is taken for one of it.
    """

    disparity_px: FloatMap
    smooth_px: FloatMap
    confidence: FloatMap
    sure: FloatMap
    std_px: FloatMap
    slope: FloatMap
    tolerance_px: FloatMap

    @classmethod
    def of(cls, found: DisparityMap, ref: FloatImage) -> _View:
        slope = _slope(ref)
        is_steep = cv2.dilate(slope, np.ones((CELL_PX + 3, CELL_PX + 3))) >= STEEP
        sure = _mean_around(found.confidence, 2 * CELL_PX + 1)
        std_px = std_of_error_px(sure)
        tolerance_px = np.where(is_steep, TOLERANCE_PX[0], np.clip(TOLERANCE_STDS * std_px, *TOLERANCE_PX))
        return cls(
            disparity_px=found.disparity_px,
            smooth_px=np.asarray(cv2.medianBlur(np.ascontiguousarray(found.disparity_px), 5), dtype=np.float32),
            confidence=found.confidence,
            sure=sure,
            std_px=std_px,
            slope=slope,
            tolerance_px=tolerance_px.astype(np.float32),
        )


def _slope(ref: FloatImage) -> FloatMap:
    """(H, W) change of colour a px, of a photo blurred by 1 px."""
    square = np.zeros(ref.shape[:2], dtype=np.float32)
    for channel in range(3):  # one by one, for the memory of large photos
        smooth = cv2.GaussianBlur(np.ascontiguousarray(ref[..., channel]), (0, 0), 1.0)
        for right, down in ((1, 0), (0, 1)):
            square += np.square(cv2.Sobel(smooth, cv2.CV_32F, right, down, scale=1 / 8))
    return np.sqrt(square)


def _mean_around(values: FloatMap, width: int) -> FloatMap:
    return np.asarray(cv2.blur(values, (width, width)), dtype=np.float32)


@dataclass(frozen=True)
class _Cells:
    """The map by cells of ``CELL_PX``: their centres' values, (h, w) each, and the terms of a polynomial (K, h, w)."""

    disparity_px: FloatMap
    confidence: FloatMap
    tolerance_px: FloatMap
    weight: FloatArray
    terms: FloatArray

    @classmethod
    def of(cls, view: _View) -> _Cells:
        centres = (slice(CELL_PX // 2, None, CELL_PX), slice(CELL_PX // 2, None, CELL_PX))
        disparity_px = view.smooth_px[centres]
        weight = 1 / np.maximum(view.std_px[centres], _LEAST_STD_PX).astype(np.float64) ** 2
        h, w = disparity_px.shape
        x, y = _scaled(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64), hw=(h, w))
        terms = np.stack([np.broadcast_to(x**right * y**down, (h, w)) for right, down in _POWERS])
        return cls(disparity_px, view.sure[centres], np.ascontiguousarray(view.tolerance_px[centres]), weight, terms)


def _scaled(columns: FloatArray, rows: FloatArray, *, hw: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Columns and rows of the grid of cells, scaled to about [-1, 1], as a row (1, w) and a column (h, 1)."""
    half = max(hw) / 2
    return ((columns - hw[1] / 2) / half)[None], ((rows - hw[0] / 2) / half)[:, None]


@dataclass(frozen=True)
class _Piece:
    inside: BoolMap
    coefficients: FloatArray

    def distance_px(self, cells: _Cells) -> FloatArray:
        """(h, w) distance of all cells from its surface."""
        surface_px = np.tensordot(self.coefficients, cells.terms[: len(self.coefficients)], 1)
        return np.asarray(np.abs(cells.disparity_px - surface_px))


def _pieces(cells: _Cells) -> list[_Piece]:
    """Large even pieces that share no cell; the surest seeds grow first."""
    is_free = np.ones(cells.disparity_px.shape, dtype=np.bool_)
    pieces = []
    for seed in _seeds(cells):
        piece = _grown(seed, cells, is_free) if is_free[seed] else None
        if piece is not None and piece.inside.sum() >= LEAST_SHARE * is_free.size:
            is_free &= ~piece.inside
            pieces.append(piece)
    return pieces


def _seeds(cells: _Cells) -> list[tuple[int, int]]:
    h, w = cells.disparity_px.shape
    pitch = max(1, int(np.sqrt(h * w) / SEEDS_ACROSS))
    sure = _mean_around(cells.confidence, 2 * SEED_REACH_CELLS + 1)
    places = [(row, column) for row in range(pitch // 2, h, pitch) for column in range(pitch // 2, w, pitch)]
    return sorted(places, key=lambda place: -float(sure[place]))


def _grown(seed: tuple[int, int], cells: _Cells, is_free: BoolMap) -> _Piece | None:
    """Fit the surroundings of a seed, take in what is connected and fits, fit that; None where nothing is even."""
    row, column = seed
    inside = np.zeros_like(is_free)
    rows, columns = (slice(max(0, at - SEED_REACH_CELLS), at + SEED_REACH_CELLS + 1) for at in seed)
    inside[rows, columns] = True
    inside &= is_free & (np.abs(cells.disparity_px - cells.disparity_px[seed]) < 4 * cells.tolerance_px)
    if inside.sum() < SEED_REACH_CELLS**2:
        return None
    piece = _fitted(_Piece(inside, np.array([cells.disparity_px[seed], 0.0, 0.0])), cells, width=4.0)
    for fit in range(_ROUNDS):
        if fit == _AFFINE_ROUNDS:
            piece = _Piece(piece.inside, np.append(piece.coefficients, np.zeros(len(_POWERS) - _AFFINE_TERMS)))
        is_near = (piece.distance_px(cells) < cells.tolerance_px) & is_free
        # Opened, so that a piece does not leak through single cells.
        fits = np.asarray(cv2.morphologyEx(is_near.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))))
        if not fits[seed]:
            return None
        cv2.floodFill(fits, None, (column, row), 2)
        piece = _fitted(_Piece(fits == 2, piece.coefficients), cells, width=1.5)
    return piece


def _fitted(piece: _Piece, cells: _Cells, *, width: float) -> _Piece:
    """Fit the surface to its cells by reweighted least squares with Tukey's weights, ``width`` tolerances wide."""
    inside = piece.inside
    terms = cells.terms[: len(piece.coefficients), inside]
    values_px, weights = cells.disparity_px[inside].astype(np.float64), cells.weight[inside]
    reach_px = width * cells.tolerance_px[inside]
    coefficients = piece.coefficients
    for _ in range(_REWEIGHTINGS):
        off = np.minimum(np.abs(values_px - coefficients @ terms) / reach_px, 1)
        weighted = terms * (weights * (1 - off * off) ** 2)
        ridge = 1e-9 * np.eye(len(terms))
        coefficients = np.linalg.solve(weighted @ terms.T + ridge, weighted @ values_px)
    return _Piece(inside, coefficients)


def _surface_of_pieces(
    pieces: list[_Piece], cells: _Cells, *, hw: tuple[int, ...]
) -> tuple[FloatMap, NDArray[np.float32]]:
    """(H, W) surfaces, px, and shares in [0, 1] of how far within its piece a pixel lies."""
    h, w = cells.disparity_px.shape
    coefficients = np.zeros((len(_POWERS), h, w), dtype=np.float32)
    share = np.zeros((h, w), dtype=np.float32)
    for piece in pieces:
        alike = cv2.blur(piece.inside.astype(np.float32), (3, 3), borderType=cv2.BORDER_REPLICATE)
        share[piece.inside] = 2 * np.maximum(alike[piece.inside] - 0.5, 0)
        coefficients[:, piece.inside] = piece.coefficients[:, None]
    # The centres that cells are sampled at lie half a cell from their corner.
    columns, rows = (np.arange(side, dtype=np.float64) / CELL_PX - 0.5 for side in (hw[1], hw[0]))
    x, y = (place.astype(np.float32) for place in _scaled(columns, rows, hw=(h, w)))
    surface_px = np.zeros(hw, dtype=np.float32)
    for (right, down), of_term in zip(_POWERS, coefficients, strict=True):
        surface_px += x**right * y**down * _enlarged(of_term, hw, cv2.INTER_NEAREST)
    return surface_px, _enlarged(share, hw, cv2.INTER_LINEAR)


def _enlarged(cells: FloatMap, hw: tuple[int, ...], interpolation: int) -> FloatMap:
    """(H, W) of a grid of cells; the rest of a cell that the picture cuts off continues the last."""
    h, w = cells.shape
    whole = cv2.resize(cells, (w * CELL_PX, h * CELL_PX), interpolation=interpolation)
    right, below = max(0, hw[1] - w * CELL_PX), max(0, hw[0] - h * CELL_PX)
    padded = cv2.copyMakeBorder(whole, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.asarray(padded[: hw[0], : hw[1]], dtype=np.float32)


def _openness(view: _View) -> FloatMap:
    """(H, W) share in [0, 1] of a pull that is followed: none beside jumps of depth, little where texture is sure."""
    sure = ramp(_mean_around(view.confidence, AROUND_PX), *SURE)
    textured = ramp(_mean_around(view.slope, AROUND_PX), *TEXTURED)
    near = np.ones((5, 5))
    is_jump = cv2.dilate(view.smooth_px, near) - cv2.erode(view.smooth_px, near) > JUMP_PX
    distance_px = np.asarray(cv2.distanceTransform((~is_jump).astype(np.uint8), cv2.DIST_L2, 3), dtype=np.float32)
    return (1 - sure * textured) * ramp(distance_px, *JUMP_REACH_PX)
