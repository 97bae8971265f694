"""Scale of the scene in tele over that in wide: a robust similarity from matches of the photos as captured.

Nothing is known beforehand: neither how the photos are turned nor where wide shows what tele sees. A first look on
small pictures finds the place; a second one, with tele shrunk to wide's own scale, measures. Parallax spreads points
along one direction, the baseline's, and would pass for scale where near things lie to one side: points are therefore
weighed by the spread found along either direction, so that scale comes from across the baseline.
Convention: ``p_wide = R(rotation) p_tele / factor + shift``; pixel (0, 0) is the centre of the top-left pixel.
Letters: N matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatArray, FloatImage
from telewide.points.features import Features, sift_features, stretched
from telewide.srgb import grey

MIN_SCALE_MATCHES = 15
"""Fewer agreeing matches than this are no measurement."""
_COARSE_SIDE_PX = 900
_FINE_SIDE_PX = 1400
_MAX_FEATURES = 4000
_RATIO = 0.8
_COARSE_TOLERANCE = 0.015
_FINE_REACH = 0.03
_MAX_OCTAVE_RATIO = 1.6
_MARGIN = 0.08
_ITERATIONS = 12
_SOFT = 2.0


@dataclass(frozen=True)
class ScaleEstimate:
    """Place of tele's scene in wide.

    Attributes:
        factor: size of the scene in tele over that in wide, px over px.
        factor_std: its standard deviation, from the spread of the matches.
        rotation_deg: turn of wide against tele, clockwise on the screen.
        n: matches that agree.
    """

    factor: float
    factor_std: float
    rotation_deg: float
    n: int


def estimate_scale(tele: FloatImage, wide: FloatImage) -> ScaleEstimate | None:
    """Measure the asymmetric factor on one pair of photos.

    Args:
        tele: (H, W, 3) or (H, W) in [0, 1], as captured.
        wide: (H', W', 3) or (H', W') in [0, 1], as captured, of any other size; it shows all or most of what tele sees.

    Returns:
        The estimate; None where fewer than 15 matches agree.
    """
    tele_grey, wide_grey = grey(tele), grey(wide)
    similarity = _coarse(tele_grey, wide_grey)
    if similarity is None:
        return None
    for _ in range(2):
        tele_px, wide_px = _fine_matches(tele_grey, wide_grey, similarity)
        if len(tele_px) < MIN_SCALE_MATCHES:
            return None
        similarity, weight, factor_std = _weighed_similarity(tele_px, wide_px)
    a, b = similarity[:2, 0]
    is_used = weight > 0.25
    if is_used.sum() < MIN_SCALE_MATCHES:
        return None
    return ScaleEstimate(
        factor=float(1.0 / np.hypot(a, b)),
        factor_std=factor_std,
        rotation_deg=float(np.degrees(np.arctan2(b, a))),
        n=int(is_used.sum()),
    )


def _coarse(tele_HW: FloatImage, wide_HW: FloatImage) -> FloatArray | None:
    """A first similarity (2, 3), from features of any scale on small pictures."""
    tele_points, tele_shrink = _points(tele_HW, longest_px=_COARSE_SIDE_PX)
    wide_points, wide_shrink = _points(wide_HW, longest_px=_COARSE_SIDE_PX)
    tele_px, wide_px = _tentative(tele_points, wide_points)
    if len(tele_px) < 4:
        return None
    tele_px, wide_px = _unshrunk(tele_px, tele_shrink), _unshrunk(wide_px, wide_shrink)
    tolerance_px = _COARSE_TOLERANCE * _COARSE_SIDE_PX / wide_shrink
    found, inlier = cv2.estimateAffinePartial2D(
        tele_px, wide_px, ransacReprojThreshold=tolerance_px, maxIters=5000, confidence=0.999
    )
    if found is None or np.unique(np.round(wide_px[inlier.ravel() > 0] / 3), axis=0).shape[0] < 6:
        return None
    return np.asarray(found, dtype=np.float64)


def _fine_matches(tele_HW: FloatImage, wide_HW: FloatImage, similarity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matches near a known similarity: tele shrunk to wide's scale, wide cropped to what tele sees."""
    scale = float(np.hypot(*similarity[:2, 0]))
    left, top, right, bottom = _seen_box(tele_HW, wide_HW, similarity)
    wide_part = wide_HW[top:bottom, left:right]
    if min(wide_part.shape) < 32:
        return np.zeros((0, 2)), np.zeros((0, 2))
    wide_points, wide_shrink = _points(wide_part, longest_px=_FINE_SIDE_PX)
    tele_points, tele_shrink = _points(tele_HW, shrink=min(1.0, scale * wide_shrink))
    tele_px, wide_px = _tentative(
        tele_points, wide_points, max_size_ratio=_MAX_OCTAVE_RATIO, sizes=scale * wide_shrink / tele_shrink
    )
    tele_px = _unshrunk(tele_px, tele_shrink)
    wide_px = _unshrunk(wide_px, wide_shrink) + np.array([left, top])
    near_px = _FINE_REACH * max(wide_part.shape)
    is_near = np.linalg.norm(_moved(similarity, tele_px) - wide_px, axis=1) < near_px
    return tele_px[is_near], wide_px[is_near]


def _weighed_similarity(tele_px: FloatArray, wide_px: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Similarity (2, 3) with weights (N,) of the matches and the standard deviation of its factor.

    Student-like weights; the residuals' own covariance, short across the baseline and long along it, is estimated with
    the similarity (iteratively reweighted least squares).
    """
    centre = np.median(tele_px, axis=0)
    x, y = (tele_px - centre).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    # rows of x and of y of every match; parameters a, b, shift
    design = np.stack([np.column_stack([x, -y, one, zero]), np.column_stack([y, x, zero, one])], axis=1)
    covariance = np.eye(2) * np.var(wide_px)
    weight = np.ones(len(x))
    law = np.zeros(4)
    start = cv2.estimateAffinePartial2D(tele_px - centre, wide_px, ransacReprojThreshold=3.0, maxIters=5000)[0]
    if start is not None:
        law = np.array([start[0, 0], start[1, 0], start[0, 2], start[1, 2]])
        covariance = _robust_covariance(wide_px - design @ law)
    for _ in range(_ITERATIONS):
        precision = np.linalg.inv(covariance)
        residual = wide_px - design @ law
        distance = np.einsum("ni,ij,nj->n", residual, precision, residual)
        weight = 1.0 / (1.0 + (distance / _SOFT**2) ** 2)
        normal = np.einsum("n,nik,ij,njl->kl", weight, design, precision, design)
        law = np.linalg.solve(normal, np.einsum("n,nik,ij,nj->k", weight, design, precision, wide_px))
        covariance = _robust_covariance(wide_px - design @ law)
    spread = np.linalg.inv(normal)
    scale = float(np.hypot(law[0], law[1]))
    direction = law[:2] / scale
    scale_std = float(np.sqrt(direction @ spread[:2, :2] @ direction))
    similarity = np.array([[law[0], -law[1], law[2]], [law[1], law[0], law[3]]])
    similarity[:, 2] -= similarity[:, :2] @ centre
    return similarity, weight, scale_std / scale**2


def _robust_covariance(residual_px: FloatArray) -> FloatArray:
    """Covariance (2, 2) of the inner part of the residuals, by its own axes, with a floor of 0.05 px."""
    keep = np.ones(len(residual_px), dtype=bool)
    covariance = np.eye(2)
    for _ in range(4):
        covariance = residual_px[keep].T @ residual_px[keep] / max(int(keep.sum()), 1) + np.eye(2) * 0.05**2
        distance = np.einsum("ni,ij,nj->n", residual_px, np.linalg.inv(covariance), residual_px)
        keep = distance < max(6.0, float(np.median(distance)))
    return np.asarray(covariance)


def _points(
    image_HW: FloatImage, *, longest_px: int | None = None, shrink: float | None = None
) -> tuple[Features, float]:
    """SIFT points of a picture shrunk to a size or by a share, and that share."""
    share = min(1.0, (longest_px or max(image_HW.shape)) / max(image_HW.shape)) if shrink is None else shrink
    wh = (max(8, round(image_HW.shape[1] * share)), max(8, round(image_HW.shape[0] * share)))
    small = image_HW if share == 1.0 else cv2.resize(image_HW, wh, interpolation=cv2.INTER_AREA)
    found = sift_features(
        stretched(np.asarray(small, dtype=np.float32)), max_features=_MAX_FEATURES, contrast_threshold=0.015
    )
    return found.rooted(), wh[0] / image_HW.shape[1]


def _tentative(
    tele: Features, wide: Features, *, max_size_ratio: float | None = None, sizes: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Mutual best matches that pass Lowe's ratio test; ``sizes`` is wide's expected diameter over tele's."""
    if min(len(tele.xy_px), len(wide.xy_px)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    similarity = tele.descriptor @ wide.descriptor.T
    if max_size_ratio is not None:
        ratio = np.abs(np.log(wide.size_px[None, :] / (sizes * tele.size_px[:, None])))
        similarity[ratio > np.log(max_size_ratio)] = -1.0
    best = similarity.argmax(axis=1)
    rows = np.arange(len(best))
    first = similarity[rows, best].copy()
    is_mutual = similarity.argmax(axis=0)[best] == rows
    similarity[rows, best] = -1.0
    is_clear = (1.0 - first) < _RATIO**2 * (1.0 - similarity.max(axis=1))
    keep = is_mutual & is_clear & (first > 0)
    return tele.xy_px[keep], wide.xy_px[best[keep]]


def _unshrunk(xy_px: FloatArray, share: float) -> FloatArray:
    return (xy_px + 0.5) / share - 0.5


def _moved(similarity: FloatArray, xy_px: FloatArray) -> FloatArray:
    return np.asarray(xy_px @ similarity[:, :2].T + similarity[:, 2])


def _seen_box(tele_HW: FloatImage, wide_HW: FloatImage, similarity: FloatArray) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of what tele sees of wide, with a margin."""
    height, width = tele_HW.shape
    corners = _moved(similarity, np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64))
    margin_px = _MARGIN * np.ptp(corners, axis=0)
    low = np.maximum(np.floor(corners.min(axis=0) - margin_px), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0) + margin_px), (wide_HW.shape[1], wide_HW.shape[0])).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
