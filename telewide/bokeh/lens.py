"""A wide-open lens: light of every pixel spread over its own disk, nearer surfaces hiding what lies behind.

Pixels are sorted into bins of signed blur radius and laid over each other as layers, far to near. What a nearer surface
hides is continued from the nearest pixel of the surfaces behind it, so that a blurred edge shows background and not
darkness. The lens is cut into quarters, each rendered for itself: what a blurred edge hides depends on where in the
lens one looks from, and a single disk would forget that (it costs 1 to 4 dB along edges).
Letters: H W image; a *bin* is a range of signed radii that shares one disk; a *layer* is a bin with what it hides.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.bokeh.coverage import SplitPixels, split_mixed_pixels
from telewide.depth.edges import nearest_known
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap, IntArray

IN_FOCUS_PX = 0.5  # a disk within one pixel: such a pixel is left as it is
BIN_PX = 1.0  # finer bins gain nothing, bins of 2 px cost 2 dB
BIN_GROWTH = 0.12  # bins may widen with their radius: a large disk forgives more
COARSE_RADIUS_PX = 8.0  # disks above this are drawn at half size, above twice this at a quarter, ...
TILE_PX = 1024
MAX_THREADS = 4
PX_AT_ONCE = 8_000_000  # in all threads, what tiles see around themselves counted in: 260 bytes each, 2 GB
QUARTERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))  # signs of y and x
SUPERSAMPLING = 8
FILL_PX = 5  # hidden colours are means over this square: what nobody saw is better guessed smooth


@dataclass(frozen=True)
class _Bins:
    """Signed radii cut into bins, far to near: ``edges_px`` (N - 1,) between them, ``radius_px`` (N,) of their disks.

    A bin that holds no pixel has the radius 0.
    """

    edges_px: NDArray[np.float32]
    radius_px: NDArray[np.float64]


@dataclass(frozen=True)
class _Box:
    """Rows ``top:bottom`` and columns ``left:right``."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def grown(self, margin: int, *, hw: tuple[int, int], multiple: int = 1) -> _Box:
        """Widen by a margin and out to whole multiples, within a frame of ``hw``."""
        top, left = (max(v - margin, 0) // multiple * multiple for v in (self.top, self.left))
        bottom, right = (-(-(v + margin) // multiple) * multiple for v in (self.bottom, self.right))
        return _Box(top, min(bottom, hw[0]), left, min(right, hw[1]))

    def moved(self, *, y: int, x: int) -> _Box:
        return _Box(self.top + y, self.bottom + y, self.left + x, self.right + x)


def spread_light(light: FloatImage, radius_px: FloatMap) -> FloatImage:
    """Render a photo through a lens, given the blur radius of each pixel.

    Works tile by tile, so that memory stays bounded; a tile sees as far around itself as its pixels depend on. The
    larger the disks, the fewer tiles at once, down to one.

    Args:
        light: (H, W, 3) float32, linear light of the sharp photo.
        radius_px: (H, W) float32, signed radius of the circle of confusion, px; larger is nearer.

    Returns:
        (H, W, 3) float32, linear light, nowhere outside the range of the input.
    """
    bins = _bins(radius_px)
    largest_px = float(np.abs(bins.radius_px).max())
    coarsest = _coarseness(largest_px)
    halo_px = _round_up(math.ceil(3 * largest_px) + 8, coarsest)
    tile_px = _round_up(TILE_PX, coarsest)
    height, width = radius_px.shape
    spread = np.empty_like(light)

    def render(tile: _Box) -> None:
        rows = _mirrored(tile.top - halo_px, tile.bottom + halo_px, size=height)
        columns = _mirrored(tile.left - halo_px, tile.right + halo_px, size=width)
        around = np.ix_(rows, columns)
        inside = tile.moved(y=halo_px - tile.top, x=halo_px - tile.left)
        spread[tile.slices] = _render_layers(light[around], radius_px[around], bins)[inside.slices]

    threads = min(os.cpu_count() or 1, MAX_THREADS, max(1, PX_AT_ONCE // (tile_px + 2 * halo_px) ** 2))
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(render, _tiles((height, width), tile_px)))
    return spread


def _round_up(value: int, multiple: int) -> int:
    return -(-value // multiple) * multiple


def _tiles(hw: tuple[int, int], size: int) -> Iterator[_Box]:
    for top in range(0, hw[0], size):
        for left in range(0, hw[1], size):
            yield _Box(top, min(top + size, hw[0]), left, min(left + size, hw[1]))


def _mirrored(start: int, stop: int, *, size: int) -> IntArray:
    """Indices ``start:stop`` mirrored into ``0:size``, for want of knowing what lies beyond the frame."""
    period = max(2 * size - 2, 1)
    index = np.abs(np.arange(start, stop)) % period
    return np.minimum(index, period - index) if size > 1 else np.zeros_like(index)


def _bins(radius_px: FloatMap) -> _Bins:
    """Cut the radii into bins; each disk gets the mean radius of its bin, so a flat surface gets its exact one."""
    farthest, nearest = float(radius_px.min()), float(radius_px.max())
    edges_px = [BIN_PX / 2]
    while edges_px[-1] < max(-farthest, nearest):
        edges_px.append(edges_px[-1] + max(BIN_PX, BIN_GROWTH * edges_px[-1]))
    edges = np.array([*(-e for e in reversed(edges_px)), *edges_px], dtype=np.float32)
    edges = edges[(edges > farthest) & (edges < nearest)]
    bin_index = np.digitize(radius_px, edges).ravel()
    count = np.bincount(bin_index, minlength=len(edges) + 1)
    total = np.bincount(bin_index, weights=radius_px.ravel(), minlength=len(edges) + 1)
    return _Bins(edges, total / np.maximum(count, 1))


def _render_layers(light: FloatImage, radius_px: FloatMap, bins: _Bins) -> FloatImage:
    """Lay the blurred layers over each other, far to near, once for each quarter of the lens; (H, W, 3)."""
    hw = radius_px.shape
    parts = split_mixed_pixels(light, radius_px)
    front_bin = np.digitize(parts.front_radius_px, bins.edges_px)
    rear_bin = np.digitize(parts.rear_radius_px, bins.edges_px)
    largest_px = float(np.abs(bins.radius_px).max())
    seen_by_quarter = [np.zeros((*hw, 4), np.float32) for _ in QUARTERS]
    for i in np.union1d(front_bin, rear_bin):
        disk_px = float(bins.radius_px[i])
        reach_px = math.ceil(abs(disk_px) + largest_px) + 1
        box = _box_of((front_bin == i) | (rear_bin == i)).grown(2 * reach_px, hw=hw)
        layer = _layer(parts, front_bin, rear_bin, box=box, index=int(i), reach_px=reach_px)
        used = _box_of(layer[..., 3] > 0)
        there = used.moved(y=box.top, x=box.left)
        target = there.grown(math.ceil(abs(disk_px)) + 1, hw=hw, multiple=_coarseness(disk_px))
        placed = np.zeros((target.bottom - target.top, target.right - target.left, 4), np.float32)
        placed[there.moved(y=-target.top, x=-target.left).slices] = layer[used.slices]
        for seen, blurred in zip(seen_by_quarter, _blurred_by_quarter(placed, radius_px=disk_px), strict=True):
            under = seen[target.slices]
            under *= 1 - blurred[..., 3:]
            under += blurred
    total = np.zeros((*hw, 3), np.float32)
    for seen in seen_by_quarter:
        total += seen[..., :3] / np.maximum(seen[..., 3:], 1e-6)
    total /= len(QUARTERS)
    return total


def _layer(
    parts: SplitPixels, front_bin: IntArray, rear_bin: IntArray, *, box: _Box, index: int, reach_px: float
) -> FloatImage:
    """One bin and what it continues to behind nearer ones, as light and coverage (h, w, 4) of the box.

    A pixel hidden from the surfaces of this bin and farther belongs to the bin of the nearest of their pixels, so a
    slanted surface that is cut into bins stays whole.
    """
    front_bin, rear_bin = front_bin[box.slices], rear_bin[box.slices]
    front, rear_light = parts.front[box.slices], parts.rear[box.slices]
    member = rear_bin == index
    layer = np.zeros((*member.shape, 4), np.float32)
    layer[member, :3] = rear_light[member]
    layer[member, 3] = 1
    known = rear_bin <= index
    if member.any() and not known.all():
        distance_px, source = nearest_known(known)
        hidden = ~known & (distance_px <= reach_px) & member.ravel()[source]
        smooth = cv2.blur(layer, (FILL_PX, FILL_PX), borderType=cv2.BORDER_CONSTANT).reshape(-1, 4)[source[hidden]]
        layer[hidden] = smooth / np.maximum(smooth[:, 3:], 1e-6)
    own = front_bin == index
    layer[own] = front[own] + (1 - front[own, 3:]) * layer[own]
    return layer


def _box_of(mask: BoolMap) -> _Box:
    """Smallest box around a mask that is True somewhere, or an empty one."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return _Box(0, 0, 0, 0)
    return _Box(int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1)


def _coarseness(radius_px: float) -> int:
    """By how much a layer is shrunk while its disk is drawn: a power of two that leaves a disk of 4 px at least."""
    return int(2 ** max(0, math.ceil(math.log2(max(abs(radius_px), 1e-3) / COARSE_RADIUS_PX))))


def _blurred_by_quarter(layer: FloatImage, *, radius_px: float) -> Iterator[FloatImage]:
    """Convolve with each quarter of a disk; large disks at a reduced size.

    A surface behind the focus is seen upside down in its disk: a negative radius swaps the quarters.
    """
    if abs(radius_px) <= IN_FOCUS_PX or layer.size == 0:
        yield from (layer for _ in QUARTERS)
        return
    coarse = _coarseness(radius_px)
    height, width = layer.shape[:2]
    padded_wh = _round_up(width, coarse), _round_up(height, coarse)
    small_wh = padded_wh[0] // coarse, padded_wh[1] // coarse
    padded = cv2.copyMakeBorder(layer, 0, padded_wh[1] - height, 0, padded_wh[0] - width, cv2.BORDER_CONSTANT)
    small = cv2.resize(padded, small_wh, interpolation=cv2.INTER_AREA)  # a copy where the sizes are equal
    for sign_y, sign_x in QUARTERS:
        flip = 1 if radius_px > 0 else -1
        kernel, anchor_xy = _quarter_disk(abs(radius_px) / coarse, sign_yx=(sign_y * flip, sign_x * flip))
        blurred = cv2.filter2D(small, -1, kernel, anchor=anchor_xy, borderType=cv2.BORDER_CONSTANT)
        large = cv2.resize(blurred, padded_wh, interpolation=cv2.INTER_LINEAR)
        yield np.asarray(large[:height, :width], dtype=np.float32)


@lru_cache(maxsize=1024)
def _quarter_disk(radius_px: float, *, sign_yx: tuple[int, int]) -> tuple[FloatImage, tuple[int, int]]:
    """Share of each pixel that a quarter of a disk covers, summing to 1, and the pixel (x, y) of the disk's centre."""
    size = math.ceil(radius_px + 0.5) + 1
    offset = (np.arange(size * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    inside = (offset[:, None] ** 2 + offset[None] ** 2 <= radius_px**2) & (offset[:, None] > 0) & (offset[None] > 0)
    covered = inside.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING).sum(axis=(1, 3)).astype(np.float64)
    kernel = (covered / covered.sum())[:: sign_yx[0], :: sign_yx[1]].astype(np.float32)
    anchor_xy = (0 if sign_yx[1] > 0 else size - 1, 0 if sign_yx[0] > 0 else size - 1)
    return np.ascontiguousarray(kernel), anchor_xy
