"""A wide-open lens: light of every pixel spread over its own disk, nearer surfaces hiding what lies behind.

Layers of pixels of like blur radius are laid over each other, far to near. The lens is cut into quarters, each rendered
for itself: what a blurred edge hides depends on where in the lens one looks from, and a single disk would forget that
(it costs 1 to 4 dB along edges).
A layer is drawn in cells as large as its disk allows. Far layers are laid over each other first, coarse cells before
fine ones, and near layers likewise from the nearest on, for what is laid over may be put together in any grouping; what
lies around the focus is drawn between the two, tile by tile, at the photo's own size. So twice the radius costs a few
layers more, in cells of which there are few.
Letters: H W image, h w in cells. A picture seen through the lens is a list: four of its quarters, or one for all four.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np

from telewide.bokeh.aperture import DISK, QUARTERS, Aperture, spot_of
from telewide.bokeh.layers import Behind, Box, Fronts, SortedPhoto, box_of, shrunk, sort_photo, tiles_of
from telewide.cores import return_freed_memory, usable_cores
from telewide.geometry.arrays import FloatImage, FloatMap

IN_FOCUS_PX = 0.5  # a disk within one pixel: such a pixel is left as it is
WHOLE_LENS_PX = 1.5  # so small a disk is drawn as one
CELLS_A_RADIUS = 8.0  # of a disk, at most; where there would be more, cells of twice the size are taken
FINE_CELL_PX = 2  # layers of cells up to this size are drawn tile by tile
COARSEST_FILL_PX = 8  # cells in which a layer around the focus is continued behind others
TILE_PX = 512
BAND_TILES = 2  # rows of tiles; what lies hidden in them is known at a time

Quarters = list[FloatMap]


@dataclass(frozen=True)
class _Seen:
    """Layers laid over each other within a box: quarters (h, w, 4) in cells, light times coverage, and coverage."""

    quarters: Quarters
    box: Box
    cell: int

    def at(self, box: Box, *, cell: int) -> _Seen:
        """Cut out a box within this one, in cells of this size or finer; the sides of the box are multiples of both."""
        if box == self.box and cell == self.cell:
            return self
        factor = self.cell // cell
        wanted = box.seen_from(self.box)
        around = wanted.outward(self.cell).grown(self.cell, hw=self.box.hw)
        inner = wanted.seen_from(around).in_cells(cell)
        cut = []
        for quarter in self.quarters:
            part = quarter[around.in_cells(self.cell).slices]
            wh = part.shape[1] * factor, part.shape[0] * factor
            large = part if factor == 1 else cv2.resize(part, wh, interpolation=cv2.INTER_LINEAR)
            cut.append(np.array(large[inner.slices], dtype=np.float32))
        return _Seen(cut, box, cell)


@dataclass(frozen=True)
class _View:
    """A sorted photo and the opening it is seen through."""

    photo: SortedPhoto
    aperture: Aperture

    @property
    def frame(self) -> Box:
        return Box(0, self.photo.hw[0], 0, self.photo.hw[1])

    @property
    def largest_px(self) -> float:
        return float(np.abs(self.photo.bins.radius_px).max())

    def radius_px(self, index: int) -> float:
        return float(self.photo.bins.radius_px[index])

    def cell(self, index: int) -> int:
        return _cell_of(self.radius_px(index))

    def reach_px(self, index: int) -> float:
        """Distance to which a bin may be seen behind nearer ones: by its own disk, and through their edges."""
        nearer_px = float(np.abs(self.photo.bins.radius_px[index:]).max())
        return (abs(self.radius_px(index)) + nearer_px) * self.aperture.reach + 1

    @property
    def halo_px(self) -> int:
        """Margin around a tile in which its layers are drawn, so that their disks reach into it."""
        return (math.ceil(CELLS_A_RADIUS * FINE_CELL_PX * self.aperture.reach) + 4) // 2 * 2

    @property
    def fill_cell(self) -> int:
        return min(max(_cell_of(self.largest_px) // 2, 1), COARSEST_FILL_PX)


def spread_light(light: FloatImage, radius_px: FloatMap, *, aperture: Aperture = DISK) -> FloatImage:
    """Render a photo through a lens, given the blur radius of each pixel.

    Args:
        light: (H, W, 3) float32, linear light of the sharp photo.
        radius_px: (H, W) float32, signed radius of the circle of confusion, px; larger is nearer.
        aperture: shape of the opening.

    Returns:
        (H, W, 3) float32, linear light, nowhere outside the range of the input.
    """
    height, width = radius_px.shape
    return spread_sorted(sort_for_lens(light, radius_px, None), aperture=aperture)[:height, :width]


def sort_for_lens(light: FloatImage, radius_px: FloatMap, behind: Behind | None) -> SortedPhoto:
    """Sort a photo for :func:`spread_sorted`, which needs nothing else of it.

    Args:
        light: (H, W, 3) float32, linear light of the sharp photo.
        radius_px: (H, W) float32, signed radius of the circle of confusion, px; larger is nearer.
        behind: what is known of what nearer surfaces hide.
    """
    largest_px = max(-float(radius_px.min()), float(radius_px.max()))
    return sort_photo(light, radius_px, multiple=_cell_of(largest_px), behind=behind)


def spread_sorted(photo: SortedPhoto, *, aperture: Aperture = DISK) -> FloatImage:
    """Render a sorted photo through a lens.

    Args:
        photo: of :func:`sort_for_lens`.
        aperture: shape of the opening.

    Returns:
        (H, W, 3) float32, linear light, of the size of the sorted photo: what was added to its sides is mirrored.
    """
    return_freed_memory()
    view = _View(photo, aperture)
    present = photo.bins_in(view.frame)
    fine = [index for index in present if view.cell(index) <= FINE_CELL_PX]
    coarse = [index for index in present if view.cell(index) > FINE_CELL_PX]
    far = _stacked(view, (index for index in coarse if view.radius_px(index) < 0), is_over=True)
    near = _stacked(view, (index for index in reversed(coarse) if view.radius_px(index) > 0), is_over=False)
    return_freed_memory()
    spread = np.empty((*photo.hw, 3), np.float32)

    def draw(tile: Box, hidden: dict[int, _Seen]) -> None:
        spread[tile.slices] = _drawn(view, tile, fine=fine, hidden=hidden, far=far, near=near)

    def draw_band(band: Box, pool: ThreadPoolExecutor) -> None:
        hidden = _hidden_in(view, fine, band)
        list(pool.map(partial(draw, hidden=hidden), (tile.moved(band) for tile in tiles_of(band.hw, TILE_PX))))

    with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
        for band in _bands_of(photo.hw):
            draw_band(band, pool)
    return spread


def _bands_of(hw: tuple[int, int]) -> list[Box]:
    """Cut a frame into rows of tiles, a few of them at a time: what is hidden in them is held in memory."""
    rows = BAND_TILES * TILE_PX
    return [Box(top, min(top + rows, hw[0]), 0, hw[1]) for top in range(0, hw[0], rows)]


def _cell_of(radius_px: float) -> int:
    """Size of the cells in which a disk is drawn: a power of two."""
    return int(2 ** max(0, math.ceil(math.log2(max(abs(radius_px), 1e-3) / CELLS_A_RADIUS))))


def _stacked(view: _View, order: Iterable[int], *, is_over: bool) -> _Seen | None:
    """Lay coarse layers of the whole photo each over those before it, or under them; None where there is none."""
    stack: _Seen | None = None
    for index in order:
        cell = view.cell(index)
        layer = view.photo.layer_in_cells(index, cell=cell, reach_px=view.reach_px(index))
        stack = _nothing(view.frame, cell) if stack is None else stack.at(view.frame, cell=cell)
        _add(stack, layer, view, index=index, is_over=is_over)
    return stack


def _hidden_in(view: _View, fine: list[int], band: Box) -> dict[int, _Seen]:
    """Fine layers with what they continue to behind others; empty where those are so small that tiles look for it."""
    if view.fill_cell <= FINE_CELL_PX:
        return {}
    box = band.grown(view.halo_px + 2 * view.fill_cell, hw=view.photo.hw)
    return {index: _hidden(view, index, box) for index in fine}


def _hidden(view: _View, index: int, box: Box) -> _Seen:
    """A layer with what it continues to, in a box and as far around as it may continue from there."""
    cell, reach_px = view.fill_cell, view.reach_px(index)
    wide = box.grown(math.ceil(reach_px), hw=view.photo.hw).outward(cell)
    return _Seen([view.photo.continued(index, wide, cell=cell, reach_px=reach_px)], wide, cell)


def _drawn(
    view: _View, tile: Box, *, fine: list[int], hidden: dict[int, _Seen], far: _Seen | None, near: _Seen | None
) -> FloatImage:
    """Draw one tile, (h, w, 3): the far stack, the fine layers far to near, the near stack."""
    box = tile.grown(view.halo_px, hw=view.photo.hw)
    in_sight = view.photo.bins_in(box)
    reach_px = math.ceil(2 * view.largest_px * view.aperture.reach)
    around = view.photo.bins_in(tile.grown(reach_px, hw=view.photo.hw))
    fine = [index for index in fine if index in around and index <= in_sight[-1]]
    if all(index in fine for index in in_sight):  # what lies behind the farthest of them is hidden by it
        fine, far = [index for index in fine if index >= in_sight[0]], None
    halves = [index for index in fine if view.cell(index) == FINE_CELL_PX]
    layers = _FineLayers(view, box, hidden)
    seen = layers.laid(far, [index for index in halves if view.radius_px(index) < 0], is_over=True)
    seen = layers.laid(seen, [index for index in fine if view.cell(index) == 1], is_over=True)
    nearer = layers.laid(near, [index for index in reversed(halves) if view.radius_px(index) > 0], is_over=False)
    inside = tile.seen_from(box).slices
    quarters = [quarter[inside] for quarter in (seen or _nothing(box, 1)).at(box, cell=1).quarters]
    if nearer is not None:
        quarters = _laid([quarter[inside] for quarter in nearer.at(box, cell=1).quarters], quarters)
    shares = [view.aperture.share_of(quarter) for quarter in QUARTERS] if len(quarters) > 1 else [1.0]
    total = np.zeros((*tile.hw, 4), np.float32)
    for share, quarter in zip(shares, quarters, strict=True):
        weight = np.float32(share) / np.maximum(quarter[..., 3], np.float32(1e-6))
        total += np.asarray(cv2.merge([weight] * 4), dtype=np.float32) * quarter
    return total[..., :3]


@dataclass(frozen=True)
class _FineLayers:
    """Layers around the focus, within a box; what they continue to in cells, where that is known of a whole band."""

    view: _View
    box: Box
    hidden: dict[int, _Seen]

    @cached_property
    def fronts(self) -> dict[int, Fronts]:
        return self.view.photo.fronts_in(self.box)

    def laid(self, seen: _Seen | None, order: list[int], *, is_over: bool) -> _Seen | None:
        """Lay layers of one size of cells each over what is seen already, or under it."""
        if not order:
            return seen
        cell = self.view.cell(order[0])
        seen = _nothing(self.box, cell) if seen is None else seen.at(self.box, cell=cell)
        for index in order:
            _add(seen, shrunk(self._layer(index), cell), self.view, index=index, is_over=is_over)
        return seen

    def _layer(self, index: int) -> FloatMap:
        """A layer at the photo's own size."""
        photo, box = self.view.photo, self.box
        if not (photo.rear_bin[box.slices] > index).any():
            return photo.layer_of(index, box, hidden=None, fronts=self.fronts)
        whole = self.hidden.get(index)
        if whole is None:
            whole = _hidden(self.view, index, box)
        return photo.layer_of(index, box, hidden=whole.at(box, cell=1).quarters[0], fronts=self.fronts)


def _nothing(box: Box, cell: int) -> _Seen:
    return _Seen([np.zeros((box.hw[0] // cell, box.hw[1] // cell, 4), np.float32)], box, cell)


def _add(seen: _Seen, layer: FloatMap, view: _View, *, index: int, is_over: bool) -> None:
    """Lay the spots of a layer over what is seen, or under it, in place."""
    filled = box_of(layer[..., 3] > 0)
    if min(filled.hw) == 0:
        return
    radius_px = view.radius_px(index)
    margin = math.ceil(abs(radius_px) / seen.cell * view.aperture.reach) + 2
    there = filled.grown(margin, hw=layer.shape[:2]).slices
    spots = _spots(layer[there], radius_px, cell=seen.cell, aperture=view.aperture)
    if len(spots) > len(seen.quarters):
        seen.quarters.extend(seen.quarters[0].copy() for _ in QUARTERS[1:])
    for whole, spot in zip(seen.quarters, spots * (len(seen.quarters) // len(spots)), strict=True):
        quarter = whole[there]
        passing = np.asarray(cv2.merge([1 - (spot if is_over else quarter)[..., 3]] * 4), dtype=np.float32)
        if is_over:
            quarter *= passing
            quarter += spot
        else:
            passing *= spot
            quarter += passing


def _laid(over: Quarters, under: Quarters) -> Quarters:
    """Lay one picture over another."""
    n = max(len(over), len(under))
    over, under = (quarters * (n // len(quarters)) for quarters in (over, under))
    laid = []
    for front, rear in zip(over, under, strict=True):
        passing = np.asarray(cv2.merge([1 - front[..., 3]] * 4), dtype=np.float32)
        passing *= rear
        passing += front
        laid.append(passing)
    return laid


def _spots(layer: FloatMap, radius_px: float, *, cell: int, aperture: Aperture) -> Quarters:
    """Spread each cell over its disk, for each quarter of the lens or for all."""
    if abs(radius_px) <= IN_FOCUS_PX:
        return [layer]
    # Averaging over cells, and drawing between them, spread light too: by about a cell.
    radius = math.copysign(math.sqrt(max(radius_px**2 - (cell**2 if cell > 1 else 0), 0.25)) / cell, radius_px)
    parts = [None] if abs(radius_px) <= WHOLE_LENS_PX else list(QUARTERS)
    spots = [spot_of(radius, part, aperture=aperture) for part in parts]
    border = cv2.BORDER_REFLECT_101 if cell == 1 else cv2.BORDER_REFLECT  # the world is mirrored beyond the frame
    return [np.asarray(cv2.filter2D(layer, -1, s.kernel, anchor=s.anchor_xy, borderType=border)) for s in spots]
