"""Corners to a few hundredths of a pixel, by fitting what a blurred edge looks like to the photo's own pixels.

Pixel (0, 0) is the centre of the top-left pixel. Samples are taken to linear light first: there blur adds and leaves
edges where they are. A saddle is where two edges cross, dark and bright in turn: ``I = m + g.x + c erf(u1) erf(u2)``,
u_i the signed distance to edge i over ``sqrt(2) sigma``. Fitted whole, it has no bias from blur.
Letters: N corners or quads; S samples; P = 9 parameters (x, y, two angles, log sigma | m, g, c); K positions on a side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from telewide.geometry.arrays import ByteImage, FloatArray
from telewide.srgb import linear_from_srgb

MAX_HALF_PX = 20.0
"""Wider windows gain little, and a lens bends what is in them."""
MIN_HALF_PX = 2.0
"""Smaller windows hold fewer samples than the fit has parameters."""
_ITERATIONS = 25
_STILL_PX = 1e-4
_LONGEST_STEP = 2.0  # px, rad or log sigma at once
_ALL_SAMPLES_PX = 10.0  # of larger windows every other pixel is enough: their neighbours repeat each other
_MIN_CONTRAST = 0.01  # of linear light, half the step from black to white
_MAX_MISFIT = 0.35  # root mean square residual over that contrast
_SIGMA_PX = (0.2, 8.0)
_SIDE_POSITIONS = np.linspace(0.12, 0.88, 25)
_PROFILE = np.linspace(-1, 1, 41)
_PROFILE_SHARES = (1.0, 0.5, 0.5)  # of the half length: long to find the side, short to keep noise out

_LINEAR = linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255)).astype(np.float64)


@dataclass(frozen=True)
class Refined:
    """Corners after refinement.

    Attributes:
        points_px: (N, 2) px.
        is_good: (N,) False where the photo does not look like that, or the window leaves it.
    """

    points_px: FloatArray
    is_good: NDArray[np.bool_]


def refine_saddles(grey_u8: ByteImage, start_px: FloatArray, *, edges_rad: FloatArray, half_px: FloatArray) -> Refined:
    """Fit the crossing of two edges at each corner, by Levenberg-Marquardt.

    Args:
        grey_u8: (H, W) uint8, sRGB-encoded.
        start_px: (N, 2) where to begin, well within the window.
        edges_rad: (N, 2) directions of the two edges, from x towards y.
        half_px: (N,) radius of the window, in which nothing but the two edges may lie.

    Returns:
        The corners, in the order given.
    """
    half_px = np.clip(half_px, MIN_HALF_PX, MAX_HALF_PX)
    centre_px = np.rint(start_px)
    is_inside = ((centre_px - half_px[:, None] >= 0) & (centre_px + half_px[:, None] <= _last_px(grey_u8))).all(axis=1)
    points_px, is_good = start_px.astype(np.float64), np.zeros(len(start_px), dtype=np.bool_)
    chosen = np.flatnonzero(is_inside)
    # Corners of one size of window are fitted together: their samples make a rectangular array.
    radius_px = np.ceil(half_px).astype(np.int64)
    for radius in np.unique(radius_px[chosen]):
        group = chosen[radius_px[chosen] == radius]
        offsets_px = _disc(float(half_px[group].mean()))
        samples = _LINEAR[_taken(grey_u8, centre_px[group][:, None] + offsets_px)]
        fit = _fit_saddles(samples, offsets_px, start_px[group] - centre_px[group], edges_rad[group])
        points_px[group] = centre_px[group] + fit.points_px
        moved_px = np.linalg.norm(points_px[group] - start_px[group], axis=1)
        is_good[group] = fit.is_good & (moved_px < 0.8 * half_px[group])
    return Refined(points_px, is_good)


def refine_quads(grey_u8: ByteImage, quads_px: FloatArray, *, half_px: FloatArray) -> Refined:
    """Fit a line to each side of dark quadrilaterals and cross them.

    A side is measured at K positions along profiles across it; its corners are left out, since blur rounds them.

    Args:
        grey_u8: (H, W) uint8, sRGB-encoded.
        quads_px: (N, 4, 2) corners, clockwise as seen in the photo.
        half_px: (N,) half length of the profiles, on which nothing but the side may lie.

    Returns:
        The 4 N corners, in the order given.
    """
    points_px, is_good = quads_px.astype(np.float64), np.ones(quads_px.shape[:2], dtype=np.bool_)
    for share in _PROFILE_SHARES:
        lines, is_line = _side_lines(grey_u8, points_px, half_px * share)
        corners = np.cross(np.roll(lines, 1, axis=1), lines)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings_px = corners[..., :2] / corners[..., 2:]
        is_good &= is_line & np.roll(is_line, 1, axis=1) & np.isfinite(crossings_px).all(axis=-1)
        is_good &= np.linalg.norm(np.nan_to_num(crossings_px) - quads_px, axis=-1) < 2 * half_px[:, None]
        points_px = np.where(is_good[..., None], crossings_px, points_px)
    return Refined(points_px.reshape(-1, 2), is_good.reshape(-1))


def _side_lines(grey_u8: ByteImage, quads_px: FloatArray, half_px: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Lines (N, 4, 3), homogeneous, through what brightens near each side, side i from corner i on; whether found."""
    along = np.roll(quads_px, -1, axis=1) - quads_px
    # Clockwise on a y-down picture: outwards is to the left of the way around.
    outwards = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    outwards = outwards / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    at_px = quads_px[:, :, None] + _SIDE_POSITIONS[:, None] * along[:, :, None]
    reach_px = half_px[:, None, None] * np.ones_like(at_px[..., 0])
    return _fit_lines(*_edges_on_profiles(grey_u8, at_px, outwards[:, :, None], reach_px))


def _last_px(grey_u8: ByteImage) -> FloatArray:
    return np.array([grey_u8.shape[1] - 1, grey_u8.shape[0] - 1], dtype=np.float64)


def _disc(half_px: float) -> FloatArray:
    """(S, 2) whole offsets within a radius, of large ones every other like the black squares of a chessboard."""
    reach = int(np.ceil(half_px))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    is_inside = np.hypot(x, y) <= half_px + 0.5
    if half_px > _ALL_SAMPLES_PX:
        is_inside &= (x + y) % 2 == 0
    return np.column_stack([x[is_inside], y[is_inside]]).astype(np.float64)


def _taken(grey_u8: ByteImage, at_px: FloatArray) -> ByteImage:
    """Pixels at whole positions, those outside taken from the border."""
    x, y = np.clip(at_px, 0, _last_px(grey_u8)).astype(np.int64).transpose(-1, *range(at_px.ndim - 1))
    return np.asarray(grey_u8[y, x])


def _fit_saddles(samples: FloatArray, offsets_px: FloatArray, start_px: FloatArray, edges_rad: FloatArray) -> Refined:
    """Fit (N, S) samples at (S, 2) offsets; the result is relative to the offsets' origin."""
    n = len(samples)
    shape = np.column_stack([start_px, edges_rad, np.zeros(n)])
    damping = np.full(n, 1e-3)
    linear, misfit = _linear_part(samples, offsets_px, shape)
    for _ in range(_ITERATIONS):
        jacobian, residuals = _jacobian(samples, offsets_px, shape, linear)
        normal = np.einsum("nsp,nsq->npq", jacobian, jacobian)
        diagonal = np.einsum("npp->np", normal)
        damped = normal + np.eye(jacobian.shape[2]) * (damping[:, None] * diagonal + 1e-12)[:, None, :]
        step = np.linalg.solve(damped, np.einsum("nsp,ns->np", jacobian, residuals)[..., None])[..., 0]
        tried = shape + np.clip(step[:, :5], -_LONGEST_STEP, _LONGEST_STEP)
        tried[:, 4] = np.clip(tried[:, 4], *np.log(_SIGMA_PX))
        tried_linear, tried_misfit = _linear_part(samples, offsets_px, tried)
        is_better = tried_misfit < misfit
        moved_px = np.where(is_better, np.abs(tried[:, :2] - shape[:, :2]).max(axis=1), 0)
        shape = np.where(is_better[:, None], tried, shape)
        linear = np.where(is_better[:, None], tried_linear, linear)
        misfit = np.where(is_better, tried_misfit, misfit)
        damping = np.clip(np.where(is_better, damping / 10, damping * 10), 1e-9, 1e6)
        if is_better.any() and moved_px.max() < _STILL_PX:
            break
    contrast = np.abs(linear[:, 3])
    is_good = (contrast > _MIN_CONTRAST) & (misfit < _MAX_MISFIT * contrast)
    return Refined(shape[:, :2], is_good)


def _edge_steps(offsets_px: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Normals (N, 2, 2), offsets from the corner (N, S, 2), distances over sqrt(2) sigma and their erf (N, S, 2)."""
    angles = shape[:, 2:4]
    normals = np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    from_corner = offsets_px[None] - shape[:, None, :2]
    scaled = np.einsum("nsk,nek->nse", from_corner, normals) / (np.sqrt(2) * np.exp(shape[:, 4]))[:, None, None]
    return normals, from_corner, scaled, np.asarray(erf(scaled), dtype=np.float64)


def _linear_part(samples: FloatArray, offsets_px: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best m, g and c (N, 4) for given saddles, and the root mean square residual (N,)."""
    steps = _edge_steps(offsets_px, shape)[3]
    basis = np.empty((*samples.shape, 4))
    basis[..., 0] = 1
    basis[..., 1:3] = offsets_px
    basis[..., 3] = steps.prod(axis=-1)
    normal = np.einsum("nsp,nsq->npq", basis, basis) + 1e-9 * np.eye(4)
    linear = np.linalg.solve(normal, np.einsum("nsp,ns->np", basis, samples)[..., None])[..., 0]
    residuals = samples - np.einsum("nsp,np->ns", basis, linear)
    return linear, np.sqrt((residuals**2).mean(axis=1))


def _jacobian(
    samples: FloatArray, offsets_px: FloatArray, shape: FloatArray, linear: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives (N, S, 9) of the model and residuals (N, S)."""
    normals, from_corner, scaled, steps = _edge_steps(offsets_px, shape)
    slopes = 2 / np.sqrt(np.pi) * np.exp(-(scaled**2)) / (np.sqrt(2) * np.exp(shape[:, 4]))[:, None, None]
    contrast = linear[:, 3, None]
    # d I / d u_i, times the other edge's step.
    by_edge = contrast[..., None] * slopes * steps[..., ::-1]
    tangents = np.stack([normals[..., 1], -normals[..., 0]], axis=-1)
    jacobian = np.empty((*samples.shape, 9))
    jacobian[..., :2] = -np.einsum("nse,nek->nsk", by_edge, normals)
    jacobian[..., 2:4] = -by_edge * np.einsum("nsk,nek->nse", from_corner, tangents)
    jacobian[..., 4] = -(by_edge * scaled).sum(axis=-1) * (np.sqrt(2) * np.exp(shape[:, 4]))[:, None]
    jacobian[..., 5] = 1
    jacobian[..., 6:8] = offsets_px
    jacobian[..., 8] = steps.prod(axis=-1)
    return jacobian, samples - np.einsum("nsp,np->ns", jacobian[..., 5:], linear)


def _edges_on_profiles(
    grey_u8: ByteImage, at_px: FloatArray, outwards: FloatArray, reach_px: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Where each profile, dark to bright, brightens: the centre of its slope. (..., 2) px, and whether there is one."""
    profile_px = at_px[..., None, :] + (reach_px[..., None] * _PROFILE)[..., None] * outwards[..., None, :]
    slope = np.maximum(np.diff(_interpolated(grey_u8, profile_px), axis=-1), 0)
    between = (_PROFILE[1:] + _PROFILE[:-1]) / 2
    # Noise far from the edge pulls the centre: only what is steep counts.
    slope = np.maximum(slope - 0.15 * slope.max(axis=-1, keepdims=True), 0)
    rise = slope.sum(axis=-1)
    centre = (slope * between).sum(axis=-1) / np.maximum(rise, 1e-9)
    last_px = _last_px(grey_u8)
    is_inside = ((profile_px >= 0) & (profile_px <= last_px)).all(axis=(-1, -2))
    return at_px + (reach_px * centre)[..., None] * outwards, is_inside & (rise > _MIN_CONTRAST)


def _interpolated(grey_u8: ByteImage, at_px: FloatArray) -> FloatArray:
    """Linear light between pixels, bilinear."""
    low = np.floor(at_px)
    part = at_px - low
    value = np.zeros(at_px.shape[:-1])
    for dy in (0, 1):
        for dx in (0, 1):
            weight = np.abs(1 - dx - part[..., 0]) * np.abs(1 - dy - part[..., 1])
            value += weight * _LINEAR[_taken(grey_u8, low + np.array([dx, dy]))]
    return value


def _fit_lines(points_px: FloatArray, is_known: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Total least squares lines (..., 3), homogeneous, through (..., K, 2) points; outliers leave in a second round."""
    weights = is_known.astype(np.float64)
    for _ in range(3):
        total = np.maximum(weights.sum(axis=-1), 1e-9)
        middle = (weights[..., None] * points_px).sum(axis=-2) / total[..., None]
        centred = points_px - middle[..., None, :]
        scatter = np.einsum("...k,...ki,...kj->...ij", weights, centred, centred)
        normal = np.linalg.eigh(scatter)[1][..., 0]
        distance_px = np.abs(np.einsum("...ki,...i->...k", centred, normal))
        spread_px = np.median(np.where(is_known, distance_px, np.nan_to_num(distance_px)), axis=-1)
        weights = (is_known & (distance_px <= np.maximum(3 * spread_px, 0.1)[..., None])).astype(np.float64)
    lines = np.concatenate([normal, -(normal * middle).sum(axis=-1)[..., None]], axis=-1)
    return lines, weights.sum(axis=-1) >= len(_SIDE_POSITIONS) / 2
