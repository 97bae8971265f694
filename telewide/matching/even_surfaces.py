"""Even surfaces of a matched map: what a network draws of a plain wall ripples, the wall does not.

On a surface the errors of a network are smooth, and larger where it is less sure. So large even pieces of the map are
looked for, and pixels are pulled to their piece: within what their confidence leaves open, and not where the network
is sure of texture. Edges of depth, and what stands before a piece, stay as they are.
Letters: H W image; h w grid of cells; K terms of a polynomial.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.doubt import ramp, share_within
from telewide.matching.pieces import (
    CELL_PX,
    LEAST_SIDE_PX,
    POWERS,
    Cells,
    Piece,
    View,
    enlarged,
    find_pieces,
    mean_around,
    scaled,
)

SURE = (0.9, 0.99)
TEXTURED = (0.005, 0.02)
"""Confidence, and mean change of colour a px, over which a pixel is held back; at the upper ends of both it stays."""
AROUND_PX = 33
JUMP_PX = 1.0
JUMP_REACH_PX = (1.0, 5.0)
"""Distances from a jump of depth over which the pull begins and is whole."""


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
    view = View.of(found, ref)
    cells = Cells.of(view)
    pieces = find_pieces(cells)
    if not pieces:
        return found
    surface_px, share = _surface_of_pieces(pieces, cells, hw=view.disparity_px.shape)
    away_px = surface_px - view.disparity_px
    pull = share * share_within(away_px, view.tolerance_px) * _openness(view)
    return DisparityMap(view.disparity_px + pull * away_px, found.confidence, found.valid)


def _surface_of_pieces(
    pieces: list[Piece], cells: Cells, *, hw: tuple[int, ...]
) -> tuple[FloatMap, NDArray[np.float32]]:
    """(H, W) surfaces, px, and shares in [0, 1] of how far within its piece a pixel lies."""
    h, w = cells.disparity_px.shape
    coefficients = np.zeros((len(POWERS), h, w), dtype=np.float32)
    share = np.zeros((h, w), dtype=np.float32)
    for piece in pieces:
        alike = cv2.blur(piece.inside.astype(np.float32), (3, 3), borderType=cv2.BORDER_REPLICATE)
        share[piece.inside] = 2 * np.maximum(alike[piece.inside] - 0.5, 0)
        coefficients[:, piece.inside] = piece.coefficients[:, None]
    # The centres that cells are sampled at lie half a cell from their corner.
    columns, rows = (np.arange(side, dtype=np.float64) / CELL_PX - 0.5 for side in (hw[1], hw[0]))
    x, y = (place.astype(np.float32) for place in scaled(columns, rows, hw=(h, w)))
    surface_px = np.zeros(hw, dtype=np.float32)
    for (right, down), of_term in zip(POWERS, coefficients, strict=True):
        surface_px += x**right * y**down * enlarged(of_term, hw, cv2.INTER_NEAREST)
    return surface_px, enlarged(share, hw, cv2.INTER_LINEAR)


def _openness(view: View) -> FloatMap:
    """(H, W) share in [0, 1] of a pull that is followed: none beside jumps of depth, little where texture is sure."""
    sure = ramp(mean_around(view.confidence, AROUND_PX), *SURE)
    textured = ramp(mean_around(view.slope, AROUND_PX), *TEXTURED)
    near = np.ones((5, 5))
    is_jump = cv2.dilate(view.smooth_px, near) - cv2.erode(view.smooth_px, near) > JUMP_PX
    distance_px = np.asarray(cv2.distanceTransform((~is_jump).astype(np.uint8), cv2.DIST_L2, 3), dtype=np.float32)
    return (1 - sure * textured) * ramp(distance_px, *JUMP_REACH_PX)
