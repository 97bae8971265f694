"""Large even pieces of a matched map: walls, doors, table tops, each a polynomial of the second degree in the picture.

On a plane disparity is affine in the picture; the second degree is for what bends, and for what lenses leave of their
distortion. Pieces grow on a grid of cells from the surest places of the map.
Letters: H W image; h w grid of cells; K terms of a polynomial.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatArray, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.doubt import std_of_error_px

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

POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Of x and y in each term of a polynomial; the first three are those of a plane."""
_AFFINE_TERMS = 3
_AFFINE_ROUNDS, _ROUNDS = 2, 6
_REWEIGHTINGS = 3
_LEAST_STD_PX = 0.3
_CENTRES = (slice(CELL_PX // 2, None, CELL_PX),) * 2


@dataclass(frozen=True)
class View:
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
    def of(cls, found: DisparityMap, ref: FloatImage) -> View:
        """Gather them of a map and the view (H, W, 3) that it is of, [0, 1]."""
        slope = _slope(ref)
        is_steep = cv2.dilate(slope, np.ones((CELL_PX + 3, CELL_PX + 3))) >= STEEP
        sure = mean_around(found.confidence, 2 * CELL_PX + 1)
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


def at_centres(values: FloatMap) -> FloatMap:
    """Sample (H, W) or (H, W, C) values at the centres of cells."""
    return values[_CENTRES]


def mean_around(values: FloatMap, width: int) -> FloatMap:
    """Average over the square of ``width`` around each."""
    return np.asarray(cv2.blur(values, (width, width)), dtype=np.float32)


@dataclass(frozen=True)
class Cells:
    """The map by cells of ``CELL_PX``: their centres' values, (h, w) each, and the terms of a polynomial (K, h, w)."""

    disparity_px: FloatMap
    confidence: FloatMap
    tolerance_px: FloatMap
    weight: FloatArray
    terms: FloatArray

    @classmethod
    def of(cls, view: View) -> Cells:
        """Sample a map at the centres of its cells."""
        disparity_px = view.smooth_px[_CENTRES]
        weight = 1 / np.maximum(view.std_px[_CENTRES], _LEAST_STD_PX).astype(np.float64) ** 2
        h, w = disparity_px.shape
        x, y = scaled(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64), hw=(h, w))
        terms = np.stack([np.broadcast_to(x**right * y**down, (h, w)) for right, down in POWERS])
        return cls(disparity_px, view.sure[_CENTRES], np.ascontiguousarray(view.tolerance_px[_CENTRES]), weight, terms)


def scaled(columns: FloatArray, rows: FloatArray, *, hw: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Columns and rows of the grid of cells, scaled to about [-1, 1], as a row (1, w) and a column (h, 1)."""
    half = max(hw) / 2
    return ((columns - hw[1] / 2) / half)[None], ((rows - hw[0] / 2) / half)[:, None]


@dataclass(frozen=True)
class Piece:
    """A piece.

    Attributes:
        inside: (h, w) cells that are its own.
        coefficients: (K,) of its polynomial.
    """

    inside: BoolMap
    coefficients: FloatArray

    def surface_px(self, cells: Cells) -> FloatArray:
        """(h, w) its surface, within and beyond it."""
        return np.asarray(np.tensordot(self.coefficients, cells.terms[: len(self.coefficients)], 1))

    def distance_px(self, cells: Cells) -> FloatArray:
        """(h, w) distance of all cells from its surface."""
        return np.asarray(np.abs(cells.disparity_px - self.surface_px(cells)))

    def flattened(self, cells: Cells) -> Piece:
        """The plane through its cells, which goes on beyond them where a bend would run away."""
        terms, values_px = cells.terms[:_AFFINE_TERMS, self.inside], cells.disparity_px[self.inside]
        plane = _least_squares(terms, values_px.astype(np.float64), cells.weight[self.inside])
        return _fitted(Piece(self.inside, plane), cells, width=4.0)


def find_pieces(cells: Cells) -> list[Piece]:
    """Large even pieces that share no cell; the surest seeds grow first."""
    is_free = np.ones(cells.disparity_px.shape, dtype=np.bool_)
    pieces = []
    for seed in _seeds(cells):
        piece = _grown(seed, cells, is_free) if is_free[seed] else None
        if piece is not None and piece.inside.sum() >= LEAST_SHARE * is_free.size:
            is_free &= ~piece.inside
            pieces.append(piece)
    return pieces


def _seeds(cells: Cells) -> list[tuple[int, int]]:
    h, w = cells.disparity_px.shape
    pitch = max(1, int(np.sqrt(h * w) / SEEDS_ACROSS))
    sure = mean_around(cells.confidence, 2 * SEED_REACH_CELLS + 1)
    places = [(row, column) for row in range(pitch // 2, h, pitch) for column in range(pitch // 2, w, pitch)]
    return sorted(places, key=lambda place: -float(sure[place]))


def _grown(seed: tuple[int, int], cells: Cells, is_free: BoolMap) -> Piece | None:
    """Fit the surroundings of a seed, take in what is connected and fits, fit that; None where nothing is even."""
    row, column = seed
    inside = np.zeros_like(is_free)
    rows, columns = (slice(max(0, at - SEED_REACH_CELLS), at + SEED_REACH_CELLS + 1) for at in seed)
    inside[rows, columns] = True
    inside &= is_free & (np.abs(cells.disparity_px - cells.disparity_px[seed]) < 4 * cells.tolerance_px)
    if inside.sum() < SEED_REACH_CELLS**2:
        return None
    piece = _fitted(Piece(inside, np.array([cells.disparity_px[seed], 0.0, 0.0])), cells, width=4.0)
    for fit in range(_ROUNDS):
        if fit == _AFFINE_ROUNDS:
            piece = Piece(piece.inside, np.append(piece.coefficients, np.zeros(len(POWERS) - _AFFINE_TERMS)))
        is_near = (piece.distance_px(cells) < cells.tolerance_px) & is_free
        # Opened, so that a piece does not leak through single cells.
        fits = np.asarray(cv2.morphologyEx(is_near.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))))
        if not fits[seed]:
            return None
        cv2.floodFill(fits, None, (column, row), 2)
        piece = _fitted(Piece(fits == 2, piece.coefficients), cells, width=1.5)
    return piece


def _fitted(piece: Piece, cells: Cells, *, width: float) -> Piece:
    """Fit the surface to its cells by reweighted least squares with Tukey's weights, ``width`` tolerances wide."""
    inside = piece.inside
    terms = cells.terms[: len(piece.coefficients), inside]
    values_px, weights = cells.disparity_px[inside].astype(np.float64), cells.weight[inside]
    reach_px = width * cells.tolerance_px[inside]
    coefficients = piece.coefficients
    for _ in range(_REWEIGHTINGS):
        off = np.minimum(np.abs(values_px - coefficients @ terms) / reach_px, 1)
        coefficients = _least_squares(terms, values_px, weights * (1 - off * off) ** 2)
    return Piece(inside, coefficients)


def _least_squares(terms: FloatArray, values: FloatArray, weights: FloatArray) -> FloatArray:
    weighted = terms * weights
    return np.asarray(np.linalg.solve(weighted @ terms.T + 1e-9 * np.eye(len(terms)), weighted @ values))


def enlarged(cells: FloatMap, hw: tuple[int, ...], interpolation: int) -> FloatMap:
    """(H, W) of a grid of cells; the rest of a cell that the picture cuts off continues the last."""
    h, w = cells.shape
    whole = cv2.resize(cells, (w * CELL_PX, h * CELL_PX), interpolation=interpolation)
    right, below = max(0, hw[1] - w * CELL_PX), max(0, hw[0] - h * CELL_PX)
    padded = cv2.copyMakeBorder(whole, 0, below, 0, right, cv2.BORDER_REPLICATE)
    return np.asarray(padded[: hw[0], : hw[1]], dtype=np.float32)
