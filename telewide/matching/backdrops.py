"""Plain walls behind things: where a network cannot match one, it gives it the disparity of the thing before it.

That is where src does not see the wall, or where the wall has no texture at all; beyond the thing, the same wall is
often matched. So plain, unsure cells that reach the border of the picture go to the farthest large piece that has
their colour, if it lies behind them and the views bear it out: where both see the wall it must fit as well as what was
found.
Letters: H W image; h w grid of cells.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.borne_out import borne_out
from telewide.matching.pieces import (
    CELL_PX,
    LEAST_SIDE_PX,
    Cells,
    Piece,
    View,
    at_centres,
    enlarged,
    find_pieces,
    mean_around,
)

UNSURE, HARDLY_SURE, SURE = 0.4, 0.55, 0.9
"""Confidence below which cells go to a wall; below which plain cells that hang together with them go along; and from
which on a pixel stays in any case."""
LEAST_SURE, SURER = 0.12, 1.1
"""Median confidence of a wall at the least; and how many times as sure as a cell that goes to it."""
LEAST_WALL, LEAST_REGION = 0.02, 0.01
"""Shares of all cells that a wall holds at the least, and a region that goes to one."""
WALL_TOLERANCE_PX = 2.5
"""Distance from its surface within which a cell is a wall's own, at the most: one that takes in the slope that leads to
the thing before it bends towards that."""
RANGE_PERCENT, BACKGROUND = (5, 95), 0.5
"""Percentiles of all disparities, and the farthest part of the range between them, where walls are backdrops."""
PLAIN = 0.02
"""Change of colour a px below which a cell is plain."""
LIGHTNESS, CHROMA = 8.6, 8.0
"""Differences in L* and in (a*, b*) within which a cell has a wall's colour; a pixel of the rim, in half of them."""
BEHIND_PX, BEYOND_PX = 1.0, 1.0
"""Distance by which a wall lies behind; and by which it goes beyond the disparities of its own cells."""
RIM_PX = 12
"""Reach beyond its cells within which a region takes in pixels of its colour."""


def with_backdrops(found: DisparityMap, ref: FloatImage, src: FloatImage) -> DisparityMap:
    """Bring plain parts of a wall that stuck to what stands before it back to the wall.

    Args:
        found: its confidence is the probability of an error below 1 px.
        ref: (H, W, 3) the view of the map, [0, 1].
        src: (H, W, 3) the other view.

    Returns:
        The map; disparities that change get smaller. Confidence and what counts as measured are the same.
    """
    if min(found.disparity_px.shape) < LEAST_SIDE_PX:
        return found
    view = View.of(found, ref)
    cells = Cells.of(view)
    is_plain = (cells.confidence < HARDLY_SURE) & (at_centres(mean_around(view.slope, CELL_PX + 1)) < PLAIN)
    if not _large_at_border(is_plain).any():
        return found
    lab = cv2.cvtColor(np.ascontiguousarray(ref, dtype=np.float32), cv2.COLOR_RGB2LAB)
    colour = np.asarray(lab, dtype=np.float32)
    regions = _regions(cells, is_plain, at_centres(mean_around(colour, CELL_PX + 1)))
    if not regions:
        return found
    moved_px = found.disparity_px.copy()
    for region, surface_px in regions:
        surface = enlarged(surface_px, moved_px.shape, cv2.INTER_LINEAR)
        goes = _with_rim(region, colour) & (found.confidence < SURE) & (surface < moved_px - BEHIND_PX)
        moved_px[goes] = surface[goes]
    is_borne_out = borne_out(found.disparity_px, moved_px, ref=ref, src=src)
    return DisparityMap(np.where(is_borne_out, moved_px, found.disparity_px), found.confidence, found.valid)


def _large_at_border(mask: BoolMap) -> BoolMap:
    """Pieces of a grid that reach its border and are no small ones, without what is less than three cells wide."""
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    count, piece = cv2.connectedComponents(opened, connectivity=8)
    is_large = np.bincount(piece.ravel(), minlength=count) >= LEAST_REGION * mask.size
    at_border = np.zeros(count, dtype=np.bool_)
    for side in (piece[0], piece[-1], piece[:, 0], piece[:, -1]):
        at_border[side] = True
    at_border[0] = False
    return np.asarray((is_large & at_border)[piece])


def _regions(cells: Cells, is_plain: BoolMap, colour: FloatMap) -> list[tuple[BoolMap, FloatMap]]:
    """Regions (h, w) of the picture that go to a wall, each with its surface (h, w)."""
    surfaces = [(wall, _continued(wall, cells)) for wall in _walls(cells)]
    walls = [
        (_region(wall, cells, colour, may_go=is_plain & (surface_px < cells.disparity_px - BEHIND_PX)), surface_px)
        for wall, surface_px in surfaces
    ]
    is_free = _large_at_border(np.any([region for region, _ in walls], axis=0)) if walls else np.zeros_like(is_plain)
    count, piece = cv2.connectedComponents(is_free.astype(np.uint8), connectivity=8)
    regions = []
    for index in range(1, count):
        rest = piece == index
        for region, surface_px in sorted(walls, key=lambda wall: _order(rest & wall[0], wall[1], rest=rest)):
            # What hangs together with the greater part of a wall is that wall, though light falls on it otherwise.
            goes = rest & (surface_px < cells.disparity_px - BEHIND_PX if _is_most(region, rest) else region)
            if goes.any():
                regions.append((goes, surface_px))
                rest &= ~goes
    return regions


def _is_most(region: BoolMap, rest: BoolMap) -> bool:
    """Whether a region holds half of the cells that are left, or more."""
    return bool((region & rest).sum() >= rest.sum() / 2 > 0)


def _order(region: BoolMap, surface_px: FloatMap, *, rest: BoolMap) -> tuple[bool, float]:
    """Rank of a wall for a region: those that have the greater part of it first, and of them the farthest."""
    return not _is_most(region, rest), float(surface_px[region].mean()) if region.any() else np.inf


def _walls(cells: Cells) -> list[Piece]:
    """Large pieces that are sure, and as far as anything is."""
    low_px, high_px = np.percentile(cells.disparity_px, RANGE_PERCENT)
    farthest_px = low_px + BACKGROUND * (high_px - low_px)
    tight = replace(cells, tolerance_px=np.minimum(cells.tolerance_px, np.float32(WALL_TOLERANCE_PX)))
    return [
        piece
        for piece in find_pieces(tight)
        if piece.inside.mean() >= LEAST_WALL
        and _sureness(piece, cells) >= LEAST_SURE
        and np.median(cells.disparity_px[piece.inside]) <= farthest_px
    ]


def _sureness(piece: Piece, cells: Cells) -> float:
    return float(np.median(cells.confidence[piece.inside]))


def _region(wall: Piece, cells: Cells, colour: FloatMap, *, may_go: BoolMap) -> BoolMap:
    """Cells (h, w) of those that may go to a wall that have its colour and hang together with some that are unsure."""
    off = np.abs(colour - np.median(colour[wall.inside], axis=0))
    is_alike = (off[..., 0] < LIGHTNESS) & (np.hypot(off[..., 1], off[..., 2]) < CHROMA)
    sure = _sureness(wall, cells)
    may_go = may_go & is_alike & ~wall.inside & (cells.confidence < sure)
    _, piece = cv2.connectedComponents(may_go.astype(np.uint8), connectivity=4)
    goes = np.unique(piece[may_go & (cells.confidence < min(UNSURE, sure / SURER))])
    return may_go & np.isin(piece, goes)


def _continued(wall: Piece, cells: Cells) -> FloatMap:
    """(h, w) the plane of a wall, hardly beyond the disparities of its own cells."""
    low_px, high_px = np.percentile(cells.disparity_px[wall.inside], (2, 98))
    plane_px = wall.flattened(cells).surface_px(cells)
    return np.clip(plane_px, low_px - BEYOND_PX, high_px + BEYOND_PX).astype(np.float32)


def _with_rim(region: BoolMap, colour: FloatMap) -> BoolMap:
    """(H, W) pixels of a region of cells, and of its colour around it."""
    inside = enlarged(region.astype(np.float32), colour.shape[:2], cv2.INTER_NEAREST)
    width = 2 * RIM_PX + 1
    share = mean_around(inside, width)
    mean = mean_around(colour * inside[..., None], width) / np.maximum(share, np.float32(1e-6))[..., None]
    off = np.abs(colour - mean)
    is_alike = (off[..., 0] < LIGHTNESS / 2) & (np.hypot(off[..., 1], off[..., 2]) < CHROMA / 2)
    return (inside > 0) | (is_alike & (share > 1e-6))
