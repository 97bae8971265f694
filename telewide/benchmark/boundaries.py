"""Edges of depth in a map, which decide over bokeh, against the true ones.

Depth boundary errors: Koch et al., Evaluation of CNN-based single-image depth estimation methods (ECCV workshops 2018).
Boundary F1: Bochkovskii et al., Depth Pro: sharp monocular metric depth in less than a second (2024). Both need no
hand-drawn edges here: those of the true map are found as those of the estimate are. Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap

FARTHEST_PX = 10.0
_SIGMA_PX = 2**0.5
_WEAK, _STRONG = 0.15, 0.3  # of the Sobel gradient of a map in [0, 1]; a step of h px in n has 8 h / n
_INTEGER_SCALE = 1 << 12
_RATIOS = np.linspace(1.05, 1.25, 10)
_LEAST_INVERSE_DEPTH = 1e-6


@dataclass(frozen=True)
class BoundaryErrors:
    """Distances of edges from where they should be.

    Attributes:
        accuracy_px: mean distance of the estimate's edges to the nearest true one, those beyond 10 px left out.
        completeness_px: mean distance from edges of either map to the other's, at most 10 px each.
    """

    accuracy_px: float
    completeness_px: float


def boundary_errors(estimate_px: FloatMap, truth_px: FloatMap) -> BoundaryErrors:
    """Depth boundary errors, both 10 px where the estimate has no edges.

    Args:
        estimate_px: (H, W) disparity, px; NaN where there is none.
        truth_px: (H, W) disparity, px; edges where it is unknown (NaN) do not count.

    Returns:
        The errors; NaN where the truth has no edges.

    Raises:
        ValueError: the shapes differ, or nothing of the truth is known.
    """
    known = _known(estimate_px, truth_px)
    ends_px = float(np.nanmin(truth_px)), float(np.nanmax(truth_px))
    found, true = (depth_edges(map_px, ends_px=ends_px) & known for map_px in (estimate_px, truth_px))
    if not true.any():
        return BoundaryErrors(float("nan"), float("nan"))
    if not found.any():
        return BoundaryErrors(FARTHEST_PX, FARTHEST_PX)
    to_true_px, to_found_px = (ndimage.distance_transform_edt(~edges) for edges in (true, found))
    near = found & (to_true_px <= FARTHEST_PX)
    accuracy_px = float(to_true_px[near].mean()) if near.any() else FARTHEST_PX
    both_px = np.concatenate([to_true_px[found], to_found_px[true]])
    return BoundaryErrors(accuracy_px, float(np.minimum(both_px, FARTHEST_PX).mean()))


def depth_edges(map_px: FloatMap, *, ends_px: tuple[float, float]) -> BoolMap:
    """Find the edges of a map by Canny's detector, after a Gaussian of sqrt(2) px.

    Args:
        map_px: (H, W) disparity, px; NaN is filled from its nearest neighbour.
        ends_px: disparities that become 0 and 1; what is beyond is cut off. Thresholds are 0.15 and 0.3 of that.

    Returns:
        (H, W) bool, thin lines.
    """
    low_px, high_px = ends_px
    if not np.isfinite(map_px).any() or high_px <= low_px:
        return np.zeros(map_px.shape, dtype=np.bool_)
    scaled = np.clip((fill_unknown(map_px) - low_px) / (high_px - low_px), 0, 1).astype(np.float32)
    smooth = cv2.GaussianBlur(scaled, (0, 0), _SIGMA_PX, borderType=cv2.BORDER_REPLICATE)
    gradients = [
        np.rint(cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, borderType=cv2.BORDER_REPLICATE) * _INTEGER_SCALE)
        for order in ((1, 0), (0, 1))
    ]
    dx, dy = (gradient.astype(np.int16) for gradient in gradients)
    edges = cv2.Canny(dx, dy, _WEAK * _INTEGER_SCALE, _STRONG * _INTEGER_SCALE, L2gradient=True)
    return np.asarray(edges > 0, dtype=np.bool_)


def boundary_f1(estimate: FloatMap, truth: FloatMap) -> float:
    """Scale-invariant boundary F1: do neighbours whose inverse depths differ by a ratio do so in both maps?

    For each of ten ratios from 1.05 to 1.25, and each of four directions, a boundary lies between two neighbours whose
    ratio is larger. F1 is that of the recall and the precision averaged over the directions that have boundaries; the
    ten are averaged with the ratios as weights.

    Args:
        estimate: (H, W) inverse depth at any scale: disparity, its offset added. What is not positive is taken for far.
        truth: (H, W) likewise, of any other scale; NaN where unknown.

    Returns:
        In [0, 1]; NaN where neither map has a boundary, or a true inverse depth is not positive.

    Raises:
        ValueError: the shapes differ, or nothing of the truth is known.
    """
    known = _known(estimate, truth)
    if (truth[known] <= 0).any():
        return float("nan")
    positive = np.maximum(np.nan_to_num(estimate, nan=0.0), _LEAST_INVERSE_DEPTH)
    found_steps = list(_log_steps(positive, known))
    true_steps = list(_log_steps(np.where(known, truth, 1.0), known))
    scores = np.array([_f1(found_steps, true_steps, np.log(ratio)) for ratio in _RATIOS])
    is_defined = ~np.isnan(scores)
    if not is_defined.any():
        return float("nan")
    return float(np.average(scores[is_defined], weights=_RATIOS[is_defined]))


def _known(estimate: FloatMap, truth: FloatMap) -> BoolMap:
    if estimate.shape != truth.shape:
        raise ValueError(f"estimate {estimate.shape} and truth {truth.shape} must have one shape")
    known = np.isfinite(truth)
    if not known.any():
        raise ValueError("nothing of the truth is known")
    return known


def _log_steps(inverse_depth: FloatMap | FloatArray, known: BoolMap) -> Iterator[FloatArray]:
    """Logarithms of the ratios of known neighbours, from each side: right, left, below, above."""
    logs = np.log(inverse_depth.astype(np.float64))
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        steps = (logs[second] - logs[first])[known[first] & known[second]]
        yield steps
        yield -steps


def _f1(found_steps: list[FloatArray], true_steps: list[FloatArray], least: float) -> float:
    recalls, precisions = [], []
    for found_step, true_step in zip(found_steps, true_steps, strict=True):
        found, true = found_step > least, true_step > least
        shared = float((found & true).sum())
        if true.any():
            recalls.append(shared / true.sum())
        if found.any():
            precisions.append(shared / found.sum())
    if not recalls and not precisions:
        return float("nan")
    recall, precision = (float(np.mean(values)) if values else 0.0 for values in (recalls, precisions))
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0
