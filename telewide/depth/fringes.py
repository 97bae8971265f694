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
STRIP_ROWS = 64
"""Rows told at a time: bounds the memory."""


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
    is_beside, is_front = _sides(disparity_px, jump_px=jump_px, reach_px=scale * REACH_PX)
    front, rear = is_front & ~is_beside, ~is_front & ~is_beside
    if not (front.any() and rear.any()):
        return disparity_px
    looks_front = _looks_front(guide_rgb, front, rear, where=is_beside & ~is_front, step=scale * SAMPLE_PX)
    looks_front |= is_front
    width = scale * (BROAD_PX - 1) + 1
    is_thin = cv2.morphologyEx(looks_front.astype(np.uint8), cv2.MORPH_OPEN, np.ones((width, width), np.uint8)) == 0
    is_fringe = ~is_front & _holding(is_front | (looks_front & is_thin), is_front)
    # Not of the nearest pixel of the front: beside an edge a network's map may still lean to the rear.
    of_front = nearest_known(front)[1][is_fringe]
    fringed_px = disparity_px.copy()
    fringed_px[is_fringe] = np.maximum(disparity_px[is_fringe], disparity_px.ravel()[of_front])
    return fringed_px


def _sides(disparity_px: FloatMap, *, jump_px: float, reach_px: float) -> tuple[BoolMap, BoolMap]:
    """Pixels beside an edge, and those nearer than the middle of their nearest edge; none where there is no edge."""
    square = np.ones((3, 3), np.uint8)
    near_px, far_px = cv2.dilate(disparity_px, square), cv2.erode(disparity_px, square)
    is_edge = np.asarray(near_px - far_px > jump_px)
    if not is_edge.any():
        return is_edge, is_edge
    middle_px = cv2.addWeighted(near_px, 0.5, far_px, 0.5, 0)
    del near_px, far_px  # in the next line lies the peak of a large photo's memory
    distance_px, edge = nearest_known(is_edge)
    return distance_px <= reach_px, np.asarray(disparity_px > middle_px.ravel()[edge])


def _looks_front(guide_rgb: FloatMap, front: BoolMap, rear: BoolMap, *, where: BoolMap, step: int) -> BoolMap:
    """(H, W): which of some pixels look like the front surface, as cells of `step` px show it around them."""
    is_asked = cv2.dilate(where.astype(np.uint8), np.ones((step, step), np.uint8), anchor=(0, 0))[::step, ::step] > 0
    number = np.cumsum(is_asked, dtype=np.int32).reshape(is_asked.shape) - 1
    cells = np.nonzero(is_asked)
    of_front, of_rear = (
        _colours_around(guide_rgb, surface, cells=(cells[0], cells[1]), step=step) for surface in (front, rear)
    )
    across = of_front.mean - of_rear.mean
    noise = np.float32(NOISE**2) * np.eye(3, dtype=np.float32)
    precision = np.linalg.inv(of_front.covariance + of_rear.covariance + noise)
    normal = np.einsum("nij,nj->ni", precision, across)
    separation = (normal * across).sum(axis=1)
    tells = (separation > LEAST_SEPARATION) & (np.minimum(of_front.share, of_rear.share) > LEAST_SHARE)
    looks_front = np.zeros(where.shape, np.bool_)
    for top in range(0, len(where), STRIP_ROWS):
        y, x = np.nonzero(where[top : top + STRIP_ROWS])
        y += top
        cell = number[y // step, x // step]
        y, x, cell = (each[tells[cell]] for each in (y, x, cell))
        own_N3 = guide_rgb[y, x] - of_rear.mean[cell]
        share_N = np.clip((own_N3 * normal[cell]).sum(axis=1) / separation[cell], 0, 1)
        off_N3 = own_N3 - share_N[:, None] * across[cell]
        misfit_N = np.einsum("ni,nij,nj->n", off_N3, precision[cell], off_N3)
        looks_front[y, x] = (share_N > DECISIVE) & (misfit_N < LARGEST_MISFIT)
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
