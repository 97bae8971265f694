"""Fringes of an outline: hair, twigs and wires, too thin for a matcher and a median, told from the ground by colour.

Where the two surfaces at an edge differ in colour as a whole, the colours of either, beyond the reach of doubt, are
taken for normally distributed, and Fisher's discriminant between them says of which a pixel of the rear side is. It
comes to the front if it is thin and hangs together with the front surface: broad areas are left to matching, for
shadows and stains look like the thing that they lie beside.
Letters: H W image; N pixels beside an edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.depth.nearest import nearest_known
from telewide.geometry.arrays import BoolMap, FloatMap, IntArray

REACH_PX = 12
"""Reach of a fringe beside an edge; the surfaces' own colours are those beyond."""
AROUND_PX = 24
"""Half the window in which the surfaces show their colours."""
SAMPLE_PX = 3
"""Every third pixel tells the colours of a surface."""
LEAST_SHARE = 0.01
"""Of the window, that has to show either surface."""
NOISE = 0.02
"""Standard deviation of a colour at the least, sRGB."""
LEAST_SEPARATION = 20.0
"""Squared distance of the two mean colours, in standard deviations, from which colour tells."""
LARGEST_MISFIT = 6.0
"""Squared distance of a colour of either from the line between the two mean colours, in standard deviations."""
DECISIVE = 0.65
"""Share of the way from the rear to the front colour from which a pixel is of the front surface."""
BROAD_PX = 5
"""A square of this width finds no room in a thin thing."""


@dataclass(frozen=True)
class _Colours:
    """Colours of one surface around each of N places.

    Attributes:
        share: (N,) of the window.
        mean: (N, 3) sRGB.
        covariance: (N, 3, 3).
    """

    share: FloatMap
    mean: FloatMap
    covariance: FloatMap


def with_fringes(disparity_px: FloatMap, guide_rgb: FloatMap, *, jump_px: float, scale: int = 1) -> FloatMap:
    """Give the hair, twigs and wires at an outline the disparity of the surface that they hang together with.

    Source: linear discriminant, R. A. Fisher, "The use of multiple measurements in taxonomic problems", Annals of
    Eugenics 7, 1936, at each pixel from what lies around it.

    Args:
        disparity_px: (H, W) float32, px, finite.
        guide_rgb: (H, W, 3) float32 in [0, 1], the tele photo.
        jump_px: a difference between neighbours that is an edge.
        scale: times the reach and the windows, for large photos.

    Returns:
        (H, W) float32; nothing is farther than it was, and every value is one of the map.
    """
    square = np.ones((3, 3), np.uint8)
    near_px, far_px = cv2.dilate(disparity_px, square), cv2.erode(disparity_px, square)
    is_edge = near_px - far_px > jump_px
    if not is_edge.any():
        return disparity_px
    distance_px, edge = nearest_known(is_edge)
    is_beside = distance_px <= scale * REACH_PX
    is_front = disparity_px > ((near_px + far_px) / 2).ravel()[edge]
    front, rear = is_front & ~is_beside, ~is_front & ~is_beside
    if not (front.any() and rear.any()):
        return disparity_px
    y, x = np.nonzero(is_beside & ~is_front)
    looks_front = is_front.copy()
    looks_front[y, x] = _looks_front(guide_rgb, front, rear, at=(y, x), step=scale * SAMPLE_PX)
    width = scale * (BROAD_PX - 1) + 1
    is_thin = cv2.morphologyEx(looks_front.astype(np.uint8), cv2.MORPH_OPEN, np.ones((width, width), np.uint8)) == 0
    is_fringe = ~is_front & _holding(is_front | (looks_front & is_thin), is_front)
    # Not of the nearest pixel of the front: beside an edge a network's map may still lean to the rear.
    fringed_px = disparity_px.copy()
    fringed_px[is_fringe] = disparity_px.ravel()[nearest_known(front)[1][is_fringe]]
    return np.maximum(fringed_px, disparity_px)


def _looks_front(
    guide_rgb: FloatMap, front: BoolMap, rear: BoolMap, *, at: tuple[IntArray, IntArray], step: int
) -> BoolMap:
    """Whether the N pixels at rows and columns look like the front surface (N,), as cells of `step` px show it."""
    width = -(-guide_rgb.shape[1] // step)
    cell, cell_of_N = np.unique(at[0] // step * width + at[1] // step, return_inverse=True)
    of_front, of_rear = (
        _colours_around(guide_rgb, surface, cells=(cell // width, cell % width), step=step) for surface in (front, rear)
    )
    across = of_front.mean - of_rear.mean
    noise = np.float32(NOISE**2) * np.eye(3, dtype=np.float32)
    precision = np.linalg.inv(of_front.covariance + of_rear.covariance + noise)
    normal = np.einsum("nij,nj->ni", precision, across)
    separation = (normal * across).sum(axis=1)
    tells = (separation > LEAST_SEPARATION) & (np.minimum(of_front.share, of_rear.share) > LEAST_SHARE)
    some_N = np.flatnonzero(tells[cell_of_N])
    cell_of_N = cell_of_N[some_N]
    own_N3 = guide_rgb[at[0][some_N], at[1][some_N]] - of_rear.mean[cell_of_N]
    share_N = np.clip((own_N3 * normal[cell_of_N]).sum(axis=1) / separation[cell_of_N], 0, 1)
    off_N3 = own_N3 - share_N[:, None] * across[cell_of_N]
    misfit_N = np.einsum("ni,nij,nj->n", off_N3, precision[cell_of_N], off_N3)
    looks_front = np.zeros(len(at[0]), np.bool_)
    looks_front[some_N] = (share_N > DECISIVE) & (misfit_N < LARGEST_MISFIT)
    return looks_front


def _colours_around(guide_rgb: FloatMap, surface: BoolMap, *, cells: tuple[IntArray, IntArray], step: int) -> _Colours:
    """Colours of a surface in the windows around N cells of `step` px."""
    colour, is_shown = guide_rgb[::step, ::step], surface[::step, ::step].astype(np.float32)
    size = 2 * (AROUND_PX // SAMPLE_PX) + 1

    def mean_around(plane: FloatMap) -> FloatMap:
        return np.asarray(cv2.blur(plane, (size, size), borderType=cv2.BORDER_REFLECT)[cells], dtype=np.float32)

    shown = colour * is_shown[..., None]
    share_N = mean_around(is_shown)
    per_share_N1 = np.asarray(1 / np.maximum(share_N, np.float32(1e-6))[:, None], dtype=np.float32)
    mean_N3 = mean_around(shown) * per_share_N1
    products_N33 = np.stack([mean_around(shown * colour[..., i : i + 1]) * per_share_N1 for i in range(3)], axis=1)
    covariance_N33 = np.asarray(products_N33 - mean_N3[:, :, None] * mean_N3[:, None], dtype=np.float32)
    return _Colours(share_N, np.asarray(mean_N3, dtype=np.float32), covariance_N33)


def _holding(mask: BoolMap, some: BoolMap) -> BoolMap:
    """Those connected pieces of a mask that hold some given pixels."""
    count, piece = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    holds = np.zeros(count, np.bool_)
    holds[piece[mask & some]] = True
    return np.asarray(mask & holds[piece])
