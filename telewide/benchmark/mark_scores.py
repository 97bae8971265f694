"""Measures of a disparity map at marks made by hand: is flat flat, does what is thin stand, where do edges lie?

No true disparity is needed. A plane in space is a plane in disparity; a thin thing stands before its ground by a step
that is known roughly; an edge is where the photo shows it. What is nearer has the larger disparity.
Letters: H W image; N points along a mark; S places across it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.benchmark.marks import CaptureMarks, DepthEdge, Point, ThinThing
from telewide.geometry.arrays import BoolArray, FloatArray, FloatMap, IntArray

EDGE_TOLERANCE_PX = 2.0
FARTHEST_EDGE_PX = 7.5
"""Reach to both sides of a marked edge within which the map's edge is looked for."""
LEAST_STEP_PX = 1.0
"""A smaller difference between both sides is no edge; the marked ones have 2 px and more."""
_THIN_PITCH_PX, _EDGE_PITCH_PX, _ACROSS_PITCH_PX = 1.0, 2.0, 0.5
_LEAST_PLACES = 5  # on each side of an edge: a level that narrow is seen
_FIT_ROUNDS = 40
_EXACT_PX = 1e-4  # residuals below count as this much, so that no weight is infinite


@dataclass(frozen=True)
class MarkScore:
    """Agreement of a disparity map with the marks of a capture; NaN where it has none of a kind.

    Attributes:
        plane_mean_px: mean distance of a plane's pixels from its best plane, averaged over the planes.
        plane_p90_px: 90th percentile of it, likewise averaged.
        thin_right: share in [0, 1] of points along thin things that stand on their side of the middle.
        edges_within_2px: share in [0, 1] of points along marked edges that have the map's edge within 2 px.
        edges_found: share in [0, 1] of them that have it within 7.5 px.
    """

    plane_mean_px: float
    plane_p90_px: float
    thin_right: float
    edges_within_2px: float
    edges_found: float


def score_marks(disparity_px: FloatMap, marks: CaptureMarks) -> MarkScore:
    """Judge a disparity map by all marks of its capture.

    Args:
        disparity_px: (H, W) of the tele photo, px, at the size the marks were made at.
        marks: of the capture.
    """
    planes = [plane_residuals_px(disparity_px, polygon) for polygon in marks.planes.values()]
    thin = [thin_is_right(disparity_px, thing) for thing in marks.thin.values()]
    edges = [edge_offsets_px(disparity_px, edge) for edge in marks.edges.values()]
    offsets_px = np.abs(np.concatenate(edges)) if edges else np.empty(0)
    return MarkScore(
        plane_mean_px=_mean([float(residuals_px.mean()) for residuals_px in planes]),
        plane_p90_px=_mean([float(np.quantile(residuals_px, 0.9)) for residuals_px in planes]),
        thin_right=_mean(np.concatenate(thin)) if thin else math.nan,
        edges_within_2px=_mean(offsets_px <= EDGE_TOLERANCE_PX),
        edges_found=_mean(np.isfinite(offsets_px)),
    )


def plane_residuals_px(disparity_px: FloatMap, polygon: Sequence[Point]) -> FloatArray:
    """Distances of the disparities inside a polygon from the plane that has the least mean distance.

    The fit is by least absolute deviations (reweighted least squares), so a ripple or a hole does not tilt it.

    Args:
        disparity_px: (H, W), px.
        polygon: corners (x, y), px.

    Returns:
        (N,) absolute residuals of all its pixels, px; NaN alone where the map knows none of them.
    """
    inside = np.zeros(disparity_px.shape, dtype=np.uint8)
    cv2.fillPoly(inside, [np.round(np.asarray(polygon)).astype(np.int32)], 1)
    rows, columns = np.nonzero((inside > 0) & np.isfinite(disparity_px))
    if not len(rows):
        return np.full(1, np.nan)
    values_px = disparity_px[rows, columns].astype(np.float64)
    design = np.column_stack([np.ones(len(rows)), _centred(columns), _centred(rows)])
    weights = np.ones(len(rows))
    for _ in range(_FIT_ROUNDS):
        weighted = design * weights[:, None]
        coefficients = np.linalg.lstsq(design.T @ weighted, weighted.T @ values_px, rcond=None)[0]
        residuals_px = np.abs(values_px - design @ coefficients)
        weights = 1 / np.maximum(residuals_px, _EXACT_PX)
    return np.asarray(residuals_px)


def thin_is_right(disparity_px: FloatMap, thing: ThinThing) -> BoolArray:
    """Tell where a thin thing stands on its side of the middle between its ground and itself.

    The ground is the map's own, the mean of the places beside the line, so an error of both is none of the thing. How
    far the thing truly stands from it is the marked step; a point is right where the map has more than half of it. A
    thing that is missing has no step, nor has one whose ground was swallowed: both are wrong.

    Args:
        disparity_px: (H, W), px.
        thing: its mark.

    Returns:
        (N,) bool, a point each px.
    """
    points_N2, right_N2, share_N = _walk(thing.line, pitch_px=_THIN_PITCH_PX)
    grounds_NS = _sampled(disparity_px, _beside(points_N2, right_N2, np.asarray(thing.ground_px)))
    found_N = _sampled(disparity_px, points_N2[:, None])[:, 0] - grounds_NS.mean(axis=1)
    first_px, last_px = thing.step_px
    step_N = first_px + (last_px - first_px) * share_N
    return np.asarray(found_N * np.sign(step_N) > np.abs(step_N) / 2)


def edge_offsets_px(disparity_px: FloatMap, edge: DepthEdge) -> FloatArray:
    """Distances from a marked edge to the map's own, along the normal of the mark.

    The map's edge is where two levels, far before and near behind, explain the profile across the mark with the least
    absolute deviation; the levels are medians, and must differ by 1 px at least.

    Args:
        disparity_px: (H, W), px.
        edge: its mark.

    Returns:
        (N,) px, a point each 2 px; positive towards the near side, NaN where no edge lies within 7.5 px.
    """
    points_N2, right_N2, _ = _walk(edge.line, pitch_px=_EDGE_PITCH_PX)
    towards_near_N2 = right_N2 if edge.near == "right" else -right_N2
    reach = round(FARTHEST_EDGE_PX / _ACROSS_PITCH_PX) + _LEAST_PLACES
    places_S = np.arange(-reach, reach + 1, dtype=np.float64) * _ACROSS_PITCH_PX
    profile_NS = _sampled(disparity_px, _beside(points_N2, towards_near_N2, places_S))
    offsets_N, least_N = np.full(len(points_N2), np.nan), np.full(len(points_N2), np.inf)
    for split in range(_LEAST_PLACES, len(places_S) - _LEAST_PLACES + 1):
        far_NS, near_NS = profile_NS[:, :split], profile_NS[:, split:]
        far_N, near_N = np.median(far_NS, axis=1), np.median(near_NS, axis=1)
        cost_N = np.abs(far_NS - far_N[:, None]).sum(axis=1) + np.abs(near_NS - near_N[:, None]).sum(axis=1)
        is_better_N = cost_N < least_N
        is_edge_N = near_N - far_N >= LEAST_STEP_PX
        place_px = (places_S[split - 1] + places_S[split]) / 2
        offsets_N = np.where(is_better_N, np.where(is_edge_N, place_px, np.nan), offsets_N)
        least_N = np.where(is_better_N, cost_N, least_N)
    return np.asarray(offsets_N)


def _walk(line: Sequence[Point], *, pitch_px: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points along a polyline, unit normals to the right of the walk (y points down), and shares of the way."""
    corners = np.asarray(line, dtype=np.float64)
    ways = np.diff(corners, axis=0)
    lengths_px = np.hypot(ways[:, 0], ways[:, 1])
    ends_px = np.concatenate([[0.0], np.cumsum(lengths_px)])
    along_px = np.linspace(0, ends_px[-1], max(2, round(ends_px[-1] / pitch_px) + 1))
    segment = np.clip(np.searchsorted(ends_px, along_px, side="right") - 1, 0, len(ways) - 1)
    direction_N2 = (ways / lengths_px[:, None])[segment]
    points_N2 = corners[segment] + direction_N2 * (along_px - ends_px[segment])[:, None]
    right_N2 = np.column_stack([-direction_N2[:, 1], direction_N2[:, 0]])
    return points_N2, right_N2, along_px / ends_px[-1]


def _beside(points_N2: FloatArray, normals_N2: FloatArray, offsets_S: FloatArray) -> FloatArray:
    """(N, S, 2) places beside each point."""
    return np.asarray(points_N2[:, None] + normals_N2[:, None] * offsets_S[:, None])


def _sampled(disparity_px: FloatMap, places_NS2: FloatArray) -> FloatArray:
    """(N, S) disparities, bilinear; NaN where any neighbour is unknown."""
    x_NS, y_NS = (np.ascontiguousarray(places_NS2[..., axis], dtype=np.float32) for axis in (0, 1))
    sampled = cv2.remap(disparity_px, x_NS, y_NS, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled.astype(np.float64)


def _centred(places: IntArray) -> FloatArray:
    """Columns or rows moved and scaled to about [-1, 1], where the fit is well conditioned."""
    middle = (places.max() + places.min()) / 2
    return np.asarray((places - middle) / max(places.max() - middle, 1.0))


def _mean(values: Sequence[float] | FloatArray | BoolArray) -> float:
    return float(np.mean(values)) if len(values) else math.nan
