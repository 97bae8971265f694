"""Sums of semi-global path costs: of a whole image, or the same to the bit strip by strip, in bounded memory.

A path needs nothing of what lies behind it but its costs at the step before. So a first sweep downwards keeps only what
enters each strip from above; then the strips are summed from the last to the first, and what runs upwards goes on from
one to the next.
Letters: D disparity levels, H W image, N M steps of a sweep and pixels beside each other in a step.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatMap

CostVolume = NDArray[np.uint16]
CostsOf = Callable[[slice], CostVolume]
"""(H, D, W) costs of some rows of an image."""

WHOLE_CELLS = 1 << 28
"""Pixels times levels up to which an image is summed as a whole: two volumes of 16 bits take 1 GiB."""
_DRIFTS = (-1, 0, 1)
_SMALL_CHANGE = 180  # price of a change by one level of disparity along a path
_LARGE_CHANGE = 3000  # price of a larger one where ref is even ...
_LEAST_LARGE_CHANGE = 300  # ... and on its strongest edges
_EDGE = 6  # the difference between neighbours of ref that halves the price
_BAND_ROWS = 128  # rows swept sideways at once: bounds the memory
_FORBIDDEN = 20_000  # dearer than any path; leaves room for sums in 16 bits


def summed_over_paths(
    costs_of: CostsOf, guide: FloatMap, *, levels: int, whole_cells: int = WHOLE_CELLS
) -> Iterator[tuple[slice, CostVolume]]:
    """Sum the path costs that reach each pixel from eight directions.

    Args:
        costs_of: matching costs by rows; asked twice for the same ones where the image is large.
        guide: (H, W, 3) in 255 levels of colour: a change of disparity is cheaper at its edges.
        levels: of disparity.
        whole_cells: pixels times levels up to which there is one strip.

    Yields:
        Rows of the image, and their sums, (H, D, W); the last strip comes first.
    """
    strips = _strips(guide.shape[:2], levels=levels, whole_cells=whole_cells)
    from_above = _entering_from_above(costs_of, guide, strips)
    from_below: list[CostVolume | None] = [None] * len(_DRIFTS)
    for rows, entering in zip(reversed(strips), reversed(from_above), strict=True):
        cost_HDW = costs_of(rows)
        total_HDW = np.zeros_like(cost_HDW)
        _sweep_downwards(cost_HDW, total_HDW, guide, rows=rows, entering=entering)
        upwards = guide[rows.start : rows.stop + (from_below[0] is not None)][::-1]
        from_below = [
            _sweep(cost_HDW[::-1], total_HDW[::-1], upwards, drift=drift, path=path)
            for drift, path in zip(_DRIFTS, from_below, strict=True)
        ]
        _sweep_sideways(cost_HDW, total_HDW, guide[rows])
        del cost_HDW
        yield rows, total_HDW
        del total_HDW


def _strips(hw: tuple[int, ...], *, levels: int, whole_cells: int) -> list[slice]:
    height, width = hw
    n_rows = height
    if height * width * levels > whole_cells:
        # Of a row, 8 bytes a cell are held in a strip and its bands, and 6 where a strip begins: the least of the sum.
        n_rows = max(1, round(math.sqrt(6 / 8 * height)))
    return [slice(top, min(top + n_rows, height)) for top in range(0, height, n_rows)]


def _entering_from_above(costs_of: CostsOf, guide: FloatMap, strips: list[slice]) -> list[list[CostVolume | None]]:
    """Path costs, (D, W) for each drift, in the row above each strip; None above the first."""
    entering: list[list[CostVolume | None]] = [[None] * len(_DRIFTS)]
    for rows in strips[:-1]:
        entering.append(_sweep_downwards(costs_of(rows), None, guide, rows=rows, entering=entering[-1]))
    return entering


def _sweep_downwards(
    cost_HDW: CostVolume,
    total_HDW: CostVolume | None,
    guide: FloatMap,
    *,
    rows: slice,
    entering: list[CostVolume | None],
) -> list[CostVolume | None]:
    """Sweep a strip, and return what leaves it."""
    downwards = guide[rows.start - (entering[0] is not None) : rows.stop]
    return [
        _sweep(cost_HDW, total_HDW, downwards, drift=drift, path=path)
        for drift, path in zip(_DRIFTS, entering, strict=True)
    ]


def _sweep_sideways(cost_HDW: CostVolume, total_HDW: CostVolume, guide: FloatMap) -> None:
    for top in range(0, len(guide), _BAND_ROWS):
        band = slice(top, top + _BAND_ROWS)
        cost_WDH = cost_HDW[band].transpose(2, 1, 0).copy()
        total_WDH = np.zeros_like(cost_WDH)
        for direction in (1, -1):
            sideways = guide[band].transpose(1, 0, 2)[::direction]
            _sweep(cost_WDH[::direction], total_WDH[::direction], sideways, drift=0)
        total_HDW[band] += total_WDH.transpose(2, 1, 0)


def _sweep(
    cost_NDM: CostVolume, total_NDM: CostVolume | None, guide: FloatMap, *, drift: int, path: CostVolume | None = None
) -> CostVolume:
    """Add the costs of the paths that run from the first step to the last, ``drift`` pixels aside in each.

    ``L(d) = C(d) + min(L'(d), L'(d - 1) + P1, L'(d + 1) + P1, min L' + P2) - min L'`` with L' of the pixel before on
    the path, P1 the small change and P2 the large one.

    Args:
        cost_NDM: matching costs.
        total_NDM: what they are added to; None to learn only where they end.
        guide: of each step, and before them of the one that paths come from.
        drift: -1, 0 or 1.
        path: (D, M) of paths that come in; None where they begin.

    Returns:
        (D, M), path costs at the last step.
    """
    _, levels, width = cost_NDM.shape
    before_x = np.clip(np.arange(width) - drift, 0, width - 1)
    before = np.full((levels + 2, width), _FORBIDDEN, dtype=np.uint16)  # a level more at either end
    first = 0 if path is not None else 1
    if path is None and total_NDM is not None:
        total_NDM[0] += cost_NDM[0]
    path = (cost_NDM[0] if path is None else path).copy()
    for step, (colours_before, colours) in enumerate(itertools.pairwise(guide), first):
        _shift_columns(path, before[1:-1], by=drift)
        least = before.min(axis=0)
        difference = np.abs(colours - colours_before[before_x]).sum(axis=1)
        large_change = np.maximum(_LARGE_CHANGE / (1 + difference / _EDGE), _LEAST_LARGE_CHANGE).astype(np.uint16)
        np.minimum(before[:-2], before[2:], out=path)
        path += np.uint16(_SMALL_CHANGE)
        np.minimum(path, before[1:-1], out=path)
        np.minimum(path, least + large_change, out=path)
        path -= least
        path += cost_NDM[step]
        if total_NDM is not None:
            total_NDM[step] += path
    return path


def _shift_columns(values: CostVolume, out: CostVolume, *, by: int) -> None:
    """Move columns by -1, 0 or 1; the column left empty repeats its neighbour."""
    if by == 0:
        out[:] = values
    elif by > 0:
        out[:, 1:], out[:, 0] = values[:, :-1], values[:, 0]
    else:
        out[:, :-1], out[:, -1] = values[:, 1:], values[:, -1]
