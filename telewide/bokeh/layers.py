"""A photo sorted into layers by blur radius, at its own size or in cells of several pixels.

A *bin* is a range of signed radii that shares one disk; a *layer* is a bin with what it continues to behind others.
What a nearer surface hides is continued from the nearest pixel of the surfaces behind it, so that a blurred edge shows
background and not darkness, and a slanted surface that is cut into bins stays whole. Under the next pixels of the very
surface a layer goes on with their own light: where bins change along an outline, no background shines through the seam.
Letters: H W image, h w in cells; N pixels of one bin, or bins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.bokeh.coverage import JUMP_PX, split_mixed_pixels
from telewide.depth.nearest import nearest_known
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap, IntArray

BIN_PX = 1.0  # finer bins gain nothing, bins of 2 px cost 2 dB
BIN_GROWTH = 0.12  # bins may widen with their radius: a large disk forgives more
FILL_PX = 5  # hidden colours are means over this square: what nobody saw is better guessed smooth
WHOLE_COVERAGE = 0.9
LEAST_KNOWN = 0.25  # share of a cell that is seen, for it to be continued where nothing is
TILE_PX = 256
BLOCK_PX = 128  # squares in which it is known which bins occur
SHARE_CELL_PX = 4  # cells of this size or larger know how much of them lies in which bin
SAMPLED_PX = 1 << 21  # of more pixels, every other row and column tells the mean radii
_CHUNK = 1 << 16
_TINY = np.float32(1e-6)
Number = TypeVar("Number", np.uint8, np.float32)


@dataclass(frozen=True)
class Box:
    """Rows ``top:bottom`` and columns ``left:right``."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices that cut it out of an array."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width."""
        return self.bottom - self.top, self.right - self.left

    def grown(self, margin: int, *, hw: tuple[int, int]) -> Box:
        """Widen by a margin, within a frame of ``hw``."""
        top, left = max(self.top - margin, 0), max(self.left - margin, 0)
        return Box(top, min(self.bottom + margin, hw[0]), left, min(self.right + margin, hw[1]))

    @property
    def sides(self) -> tuple[int, int, int, int]:
        """Top, bottom, left and right."""
        return self.top, self.bottom, self.left, self.right

    def outward(self, multiple: int) -> Box:
        """Widen to sides that are whole multiples."""
        top, left = (side // multiple * multiple for side in (self.top, self.left))
        bottom, right = (-(-side // multiple) * multiple for side in (self.bottom, self.right))
        return Box(top, bottom, left, right)

    def in_cells(self, cell: int) -> Box:
        """The same box in cells; its sides are whole multiples."""
        return Box(self.top // cell, self.bottom // cell, self.left // cell, self.right // cell)

    def within(self, other: Box) -> Box:
        """Cut off what lies outside of another; empty where nothing is left."""
        top, left = (max(own, its) for own, its in ((self.top, other.top), (self.left, other.left)))
        bottom, right = min(self.bottom, other.bottom), min(self.right, other.right)
        return Box(top, max(bottom, top), left, max(right, left))

    def moved(self, other: Box) -> Box:
        """The same box, counted from another's corner, counted from where that one is."""
        return Box(self.top + other.top, self.bottom + other.top, self.left + other.left, self.right + other.left)

    def seen_from(self, other: Box) -> Box:
        """The same box counted from another's corner."""
        return Box(self.top - other.top, self.bottom - other.top, self.left - other.left, self.right - other.left)


def tiles_of(hw: tuple[int, int], size: int) -> list[Box]:
    """Cut a frame into boxes."""
    return [
        Box(top, min(top + size, hw[0]), left, min(left + size, hw[1]))
        for top in range(0, hw[0], size)
        for left in range(0, hw[1], size)
    ]


def box_of(mask: BoolMap) -> Box:
    """Find the smallest box around what is True; an empty one where nothing is."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return Box(0, 0, 0, 0)
    return Box(int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)


@dataclass(frozen=True)
class Bins:
    """Signed radii cut into bins, far to near.

    Attributes:
        edges_px: (N - 1,) between them.
        radius_px: (N,) of their disks: the mean, so that a flat surface gets its exact one; the middle of an empty bin.
    """

    edges_px: NDArray[np.float32]
    radius_px: NDArray[np.float64]

    def index(self, radius_px: FloatMap) -> NDArray[np.uint8]:
        """Number of the bin of each radius."""
        found = np.empty(radius_px.shape, np.uint8)
        numbers, radii_px = found.reshape(-1), radius_px.reshape(-1)
        for start in range(0, len(numbers), _CHUNK):
            numbers[start : start + _CHUNK] = np.digitize(radii_px[start : start + _CHUNK], self.edges_px)
        return found


def cut_into_bins(radius_px: FloatMap) -> Bins:
    """Choose the bins of a map of radii.

    Args:
        radius_px: (H, W) float32, signed blur radius, larger is nearer, px.
    """
    farthest, nearest = float(radius_px.min()), float(radius_px.max())
    edges_px = [BIN_PX / 2]
    while edges_px[-1] < max(-farthest, nearest):
        edges_px.append(edges_px[-1] + max(BIN_PX, BIN_GROWTH * edges_px[-1]))
    edges = np.array([*(-e for e in reversed(edges_px)), *edges_px], dtype=np.float32)
    edges = edges[(edges > farthest) & (edges < nearest)]
    some_px = radius_px if radius_px.size <= SAMPLED_PX else radius_px[::2, ::2]
    bin_index = np.digitize(some_px, edges).ravel()
    count = np.bincount(bin_index, minlength=len(edges) + 1)
    total = np.bincount(bin_index, weights=some_px.ravel(), minlength=len(edges) + 1)
    middle_px = np.diff(np.array([farthest, *edges, nearest])) / 2 + [farthest, *edges]
    return Bins(edges, np.where(count > 0, total / np.maximum(count, 1), middle_px))


@dataclass(frozen=True)
class Fronts:
    """Front parts of mixed pixels that belong to one bin, row by row: places (N,), light and coverage (N, 4)."""

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    rgba: FloatMap
    lowest_bin: NDArray[np.uint8]

    def within(self, box: Box) -> Fronts:
        """Those in a box, counted from its corner."""
        some = _places_in(box, self.y, self.x)
        return replace(self.at(some), y=self.y[some] - box.top, x=self.x[some] - box.left)

    def at(self, which: BoolMap | IntArray) -> Fronts:
        """Some of them."""
        return Fronts(self.y[which], self.x[which], self.rgba[which], self.lowest_bin[which])


def _places_in(box: Box, y: NDArray[np.int64], x: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the places (N,), which stand row by row, that lie in a box."""
    first, last = np.searchsorted(y, (box.top, box.bottom))
    return np.asarray(first + np.flatnonzero((x[first:last] >= box.left) & (x[first:last] < box.right)))


@dataclass(frozen=True)
class Behind:
    """Light known to lie behind pixels of the photo, row by row: places (N,), linear light (N, 3), blur radius (N,)."""

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    light: FloatMap
    radius_px: FloatMap


@dataclass(frozen=True)
class _Hidden:
    """The same, sorted: places (N,), light and 1 (N, 4), bins (N,) of it and of the rear part before it."""

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    light: FloatMap
    own_bin: NDArray[np.uint8]
    rear_bin: NDArray[np.uint8]

    def count(self, index: int, box: Box, *, cell: int, seen: FloatMap, share: FloatMap) -> None:
        """Add, to cells of a box, what of it is seen once all that is nearer than a bin is away."""
        some = _places_in(box, self.y, self.x)
        some = some[(self.own_bin[some] <= index) & (self.rear_bin[some] > index)]
        y, x = (self.y[some] - box.top) // cell, (self.x[some] - box.left) // cell
        np.add.at(share, (y, x), np.float32(1 / cell**2))
        own = self.own_bin[some] == index
        np.add.at(seen, (y[own], x[own]), self.light[some[own]] / np.float32(cell**2))


@dataclass(frozen=True)
class SortedPhoto:
    """A photo whose pixels are sorted by blur radius.

    Attributes:
        rear: (H, W, 4) float32, linear light and 1; of mixed pixels the rear part.
        rear_bin: (H, W) uint8, its bin.
        lowest_bin: (H, W) uint8, the farthest bin whose layer goes on under it with its light: both are one surface.
        bins: the bins.
        occurs: (h, w, N) bool, which bins occur in each block of `BLOCK_PX`.
        up_to: (N, h, w) uint8, pixels of each cell of `SHARE_CELL_PX` that lie in a bin or farther; None where the
            sides are no multiples of such cells.
    """

    rear: FloatMap
    rear_bin: NDArray[np.uint8]
    lowest_bin: NDArray[np.uint8]
    bins: Bins
    occurs: BoolMap
    up_to: NDArray[np.uint8] | None
    _fronts: dict[int, Fronts]
    _hidden: _Hidden | None = None

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.rear_bin.shape[0], self.rear_bin.shape[1]

    def bins_in(self, box: Box) -> list[int]:
        """Bins that occur in the blocks that hold a box, far to near."""
        blocks = box.outward(BLOCK_PX).in_cells(BLOCK_PX).slices
        return [int(index) for index in np.flatnonzero(self.occurs[blocks].any(axis=(0, 1)))]

    def fronts_in(self, box: Box) -> dict[int, Fronts]:
        """Front parts within a box by their bins, counted from its corner."""
        within = {index: fronts.within(box) for index, fronts in self._fronts.items()}
        return {index: fronts for index, fronts in within.items() if len(fronts.y)}

    def layer_in_cells(self, index: int, *, cell: int, reach_px: float) -> FloatMap:
        """Make the layer of a bin in cells.

        Args:
            index: of the bin.
            cell: px.
            reach_px: how far behind nearer surfaces it is continued.

        Returns:
            (h, w, 4) float32, light times coverage, and coverage.
        """
        layer = self.continued(index, Box(0, self.hw[0], 0, self.hw[1]), cell=cell, reach_px=reach_px)
        fronts = self._fronts.get(index)
        if fronts is not None:
            front = np.zeros_like(layer)
            np.add.at(front, (fronts.y // cell, fronts.x // cell), fronts.rgba / np.float32(cell**2))
            layer *= 1 - front[..., 3:]
            layer += front
        return layer

    def continued(self, index: int, box: Box, *, cell: int, reach_px: float) -> FloatMap:
        """Make the rear parts of a bin and what they continue to, in cells.

        A cell is shared among the bins up to this one as they are seen in it; a cell of which none is seen is shared as
        the nearest one of which some is.

        Args:
            index: of the bin.
            box: where; its sides are multiples of the cell.
            cell: px.
            reach_px: how far behind nearer surfaces it is continued.

        Returns:
            (h, w, 4) float32, light times coverage, and coverage.
        """
        inner = self._reached(index, box, cell=cell, reach_px=reach_px)
        if inner != box:
            layer = np.zeros((box.hw[0] // cell, box.hw[1] // cell, 4), np.float32)
            if min(inner.hw) > 0:
                there = inner.seen_from(box).in_cells(cell).slices
                layer[there] = self._continued(index, inner, cell=cell, reach_px=reach_px)
            return layer
        return self._continued(index, box, cell=cell, reach_px=reach_px)

    def _reached(self, index: int, box: Box, *, cell: int, reach_px: float) -> Box:
        """Narrow a box to where the layer of a bin may be; nothing of it lies outside."""
        blocks = box_of(self.occurs[..., index])
        own = Box(*(BLOCK_PX * side for side in blocks.sides))
        if min(own.hw) == 0:
            return Box(box.top, box.top, box.left, box.left)
        return own.grown(math.ceil(reach_px) + BLOCK_PX // 4, hw=self.hw).outward(cell).within(box)

    def _continued(self, index: int, box: Box, *, cell: int, reach_px: float) -> FloatMap:
        seen = self._seen(index, box, cell=cell)
        share = self._share_up_to(index, box, cell=cell)
        if self._hidden is not None:
            self._hidden.count(index, box, cell=cell, seen=seen, share=share)
        known_share = share[..., None]
        layer = np.asarray(seen / np.maximum(known_share, seen[..., 3:] + _TINY), dtype=np.float32)
        known = known_share[..., 0] >= LEAST_KNOWN
        if known.all() or not known.any():
            return layer
        distance, source = nearest_known(known)
        hidden = ~known & (distance * cell <= reach_px)
        layer[~known & ~hidden] = 0
        layer[hidden] = _smooth(layer, size=FILL_PX // cell | 1).reshape(-1, 4)[source[hidden]]
        return layer

    def _share_up_to(self, index: int, box: Box, *, cell: int) -> FloatMap:
        """Share (h, w) of each cell that lies in this bin or farther."""
        if self.up_to is None or cell < SHARE_CELL_PX:
            behind = (self.rear_bin[box.slices] <= index).view(np.uint8) * np.uint8(255)
            return np.asarray(shrunk(behind, cell) * np.float32(1 / 255))
        count = self.up_to[index][box.in_cells(SHARE_CELL_PX).slices].astype(np.float32)
        return np.asarray(shrunk(count, cell // SHARE_CELL_PX) * np.float32(1 / SHARE_CELL_PX**2))

    def _seen(self, index: int, box: Box, *, cell: int) -> FloatMap:
        """Light and coverage (h, w, 4) of a bin's rear parts, in cells."""
        seen = np.zeros((box.hw[0] // cell, box.hw[1] // cell, 4), np.float32)
        for tile in tiles_of(box.hw, TILE_PX):
            there = tile.moved(box).slices
            mask = (self.rear_bin[there] == index).view(np.uint8)
            if mask.any():
                own = np.asarray(cv2.copyTo(self.rear[there], mask), dtype=np.float32)
                seen[tile.in_cells(cell).slices] = shrunk(own, cell)
        return seen

    def layer_of(self, index: int, box: Box, *, hidden: FloatMap | None, fronts: dict[int, Fronts]) -> FloatMap:
        """Make the layer of a bin at the photo's own size, within a box.

        Args:
            index: of the bin.
            box: where.
            hidden: (h, w, 4) of the box: what the bin continues to; None where it hides behind nothing.
            fronts: within the box, by `fronts_in`.

        Returns:
            (h, w, 4) float32, light times coverage, and coverage.
        """
        rear_bin, lowest_bin = self.rear_bin[box.slices], self.lowest_bin[box.slices]
        shown = (lowest_bin <= index) & (rear_bin >= index)
        layer = np.asarray(cv2.copyTo(self.rear[box.slices], shown.view(np.uint8)), dtype=np.float32)
        if hidden is not None:
            layer += cv2.copyTo(hidden, (lowest_bin > index).view(np.uint8))
        for front_index, some in fronts.items():
            if front_index < index:
                continue
            # Of an outline's pixels only those that hide all: others laid over themselves would hide too much.
            is_shown = (some.lowest_bin <= index) & (some.rgba[:, 3] >= WHOLE_COVERAGE)
            shown_fronts = some.at(is_shown | (front_index == index))
            y, x, rgba = shown_fronts.y, shown_fronts.x, shown_fronts.rgba
            layer[y, x] = rgba + (1 - rgba[:, 3:]) * layer[y, x]
        return layer


def shrunk(plane: NDArray[Number], cell: int) -> NDArray[Number]:
    """Average a plane over cells; its sides are multiples of them."""
    if cell == 1:
        return plane
    wh = plane.shape[1] // cell, plane.shape[0] // cell
    return np.asarray(cv2.resize(plane, wh, interpolation=cv2.INTER_AREA), dtype=plane.dtype)


def _smooth(layer: FloatMap, *, size: int) -> FloatMap:
    """Colours averaged over a square; the coverage stays."""
    if size == 1:
        return layer
    mean = np.asarray(cv2.blur(layer, (size, size), borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
    return np.asarray(mean * (layer[..., 3:] / np.maximum(mean[..., 3:], _TINY)), dtype=np.float32)


def sort_photo(light: FloatImage, radius_px: FloatMap, *, multiple: int, behind: Behind | None = None) -> SortedPhoto:
    """Sort a photo for a lens.

    Args:
        light: (H, W, 3) float32, linear light.
        radius_px: (H, W) float32, signed blur radius, larger is nearer, px.
        multiple: of which the sides are made, by mirroring what lies at their ends.
        behind: what is known of what nearer surfaces hide; all else of it is continued from beside them.
    """
    bins = cut_into_bins(radius_px)
    split = split_mixed_pixels(light, radius_px)
    at, front_bin = (split.y, split.x), bins.index(split.front_radius_px)
    part_px = radius_px.copy()
    part_px[at] = split.front_radius_px
    lowest_front = bins.index(_lowest(part_px)[at])
    part_px[at] = split.rear_radius_px
    rear_bin, lowest_rear = (_enlarged(bins.index(r), multiple) for r in (part_px, _lowest(part_px)))
    del part_px
    rear = np.empty((*rear_bin.shape, 4), np.float32)
    height, width = radius_px.shape
    rear[:height, :width, :3], rear[..., 3] = light, 1
    rear[(*at, slice(3))] = split.rear
    _mirror_beyond(rear, hw=(height, width))
    fronts = {}
    for index in np.unique(front_bin[split.front[:, 3] > 0]):
        which = np.flatnonzero((front_bin == index) & (split.front[:, 3] > 0))
        fronts[int(index)] = Fronts(split.y[which], split.x[which], split.front[which], lowest_front[which])
    occurs, up_to = _counted(rear_bin, len(bins.radius_px), is_shared=multiple % SHARE_CELL_PX == 0)
    for index, some in fronts.items():
        occurs[some.y // BLOCK_PX, some.x // BLOCK_PX, index] = True
    hidden = None if behind is None else _hidden(behind, rear_bin, bins)
    if hidden is not None:
        occurs[hidden.y // BLOCK_PX, hidden.x // BLOCK_PX, hidden.own_bin] = True
    return SortedPhoto(
        rear, rear_bin, lowest_rear, bins=bins, occurs=occurs, up_to=up_to, _fronts=fronts, _hidden=hidden
    )


def _hidden(behind: Behind, rear_bin: NDArray[np.uint8], bins: Bins) -> _Hidden:
    """Sort what lies behind pixels, and leave out what no bin hides."""
    own_bin, before = bins.index(behind.radius_px), rear_bin[behind.y, behind.x]
    some = np.flatnonzero(own_bin < before)
    light = np.column_stack([behind.light[some], np.ones(len(some), np.float32)])
    return _Hidden(behind.y[some], behind.x[some], light, own_bin=own_bin[some], rear_bin=before[some])


def _enlarged(plane: NDArray[np.uint8], multiple: int) -> NDArray[np.uint8]:
    """Make the sides whole multiples, by mirroring what lies at their ends."""
    beyond_y, beyond_x = (-size % multiple for size in plane.shape)
    return np.asarray(cv2.copyMakeBorder(plane, 0, beyond_y, 0, beyond_x, cv2.BORDER_REFLECT), dtype=np.uint8)


def _mirror_beyond(plane: FloatMap, *, hw: tuple[int, int]) -> None:
    """Fill what lies below and to the right of a size as :func:`_enlarged` does, in place: a copy is large."""
    for axis, size in enumerate(hw):
        along = np.moveaxis(plane, axis, 0)
        beyond = np.arange(size, len(along))
        source = beyond % (2 * size)
        along[size:] = along[np.where(source < size, source, 2 * size - 1 - source)]


def _counted(rear_bin: NDArray[np.uint8], n_bins: int, *, is_shared: bool) -> tuple[BoolMap, NDArray[np.uint8] | None]:
    """Find which bins occur in each block, and how much of each cell lies up to each bin, as `SortedPhoto` has them."""
    height, width = rear_bin.shape
    occurs = np.zeros((-(-height // BLOCK_PX), -(-width // BLOCK_PX), n_bins), np.bool_)
    up_to = np.zeros((n_bins, height // SHARE_CELL_PX, width // SHARE_CELL_PX), np.uint8) if is_shared else None
    for block in tiles_of((height, width), BLOCK_PX):
        here = rear_bin[block.slices]
        present = np.flatnonzero(np.bincount(here.ravel(), minlength=n_bins))
        occurs[block.top // BLOCK_PX, block.left // BLOCK_PX, present] = True
        if up_to is not None:
            for index in present:
                own = (here == index).view(np.uint8) * np.uint8(SHARE_CELL_PX**2)
                up_to[index][block.in_cells(SHARE_CELL_PX).slices] = shrunk(own, SHARE_CELL_PX)
    if up_to is not None:
        np.cumsum(up_to, axis=0, out=up_to)
    return occurs, up_to


def _lowest(radius_px: FloatMap) -> FloatMap:
    """Find the least radius at or beside each pixel that is no other surface."""
    lowest_px = np.asarray(cv2.erode(radius_px, np.ones((3, 3), np.uint8)), dtype=np.float32)
    y, x = np.nonzero(radius_px - lowest_px > JUMP_PX)
    own_px = radius_px[y, x]
    lowest_px[y, x] = own_px
    for step_y, step_x in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        at = np.clip(y + step_y, 0, radius_px.shape[0] - 1), np.clip(x + step_x, 0, radius_px.shape[1] - 1)
        is_lower = (radius_px[at] < lowest_px[y, x]) & (own_px - radius_px[at] <= JUMP_PX)
        lowest_px[y[is_lower], x[is_lower]] = radius_px[at][is_lower]
    return lowest_px
