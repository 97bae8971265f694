"""Mixed pixels: a photo's pixel on a depth edge shows two surfaces, and only the front one hides what lies behind.

Along a jump of the blur radius each pixel is split into a front part, whose coverage is where its colour lies between
the pure colours on either side, and the rear colour beneath it: ``C = front + (1 - coverage) * rear``, kept exactly, so
that two sharp surfaces give the photo back. What neither colour explains goes to the part that covers more. Each part
has the radius of the nearest pure pixel of its surface: the pixel's own is the least certain, and parts of an outline
that fall into other bins than the surface behind them would be blurred alone. Colours are linear light.
Letters: H W image; N mixed pixels; K pixels of the window around each.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, FloatMap

JUMP_PX = 1.0  # a difference in blur radius that shows
REACH_PX = 3  # how far pure colours are looked for
IMPURE_WEIGHT = 1e-3  # where a surface is too thin to have a pure pixel, its own pixels must do
LARGEST_MISFIT = 0.25  # squared, of the contrast: a colour farther off the line is no mixture of the two
LEAST_CONTRAST = 1e-5  # squared, of linear light: less tells nothing
CHUNK = 16384  # mixed pixels split at a time: bounds the memory


@dataclass(frozen=True)
class MixedPixels:
    """The pixels of a photo that show two surfaces, row by row, each as a front part over a rear one.

    Attributes:
        y: (N,) rows.
        x: (N,) columns.
        front: (N, 4) float32, light times coverage, and coverage in [0, 1].
        front_radius_px: (N,) float32, signed blur radius of the front part.
        rear: (N, 3) float32, light beneath; where the coverage is 1 it is not seen.
        rear_radius_px: (N,) float32.
    """

    y: NDArray[np.int64]
    x: NDArray[np.int64]
    front: FloatMap
    front_radius_px: FloatMap
    rear: FloatMap
    rear_radius_px: FloatMap


def split_mixed_pixels(light: FloatMap, radius_px: FloatMap) -> MixedPixels:
    """Split the pixels along jumps of the blur radius into front and rear.

    Args:
        light: (H, W, 3) float32, linear light.
        radius_px: (H, W) float32, signed blur radius, larger is nearer, px.

    Returns:
        Those pixels; every other one shows one surface alone.
    """
    square = np.ones((3, 3), np.uint8)
    nearest_px, farthest_px = cv2.dilate(radius_px, square), cv2.erode(radius_px, square)
    mixed = np.asarray(nearest_px - farthest_px > JUMP_PX)
    middle_px = np.asarray((nearest_px + farthest_px) / 2, dtype=np.float32)
    at_y, at_x = np.nonzero(mixed)
    split = MixedPixels(
        at_y,
        at_x,
        front=np.empty((len(at_y), 4), np.float32),
        front_radius_px=np.empty(len(at_y), np.float32),
        rear=np.empty((len(at_y), 3), np.float32),
        rear_radius_px=np.empty(len(at_y), np.float32),
    )
    for start in range(0, len(at_y), CHUNK):
        some = slice(start, start + CHUNK)
        parts = _split(light, radius_px, mixed, middle_px, at=(at_y[some], at_x[some]))
        split.front[some], split.front_radius_px[some], split.rear[some], split.rear_radius_px[some] = parts
    return split


def _split(
    light: FloatMap,
    radius_px: FloatMap,
    mixed: BoolMap,
    middle_px: FloatMap,
    *,
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> tuple[FloatMap, FloatMap, FloatMap, FloatMap]:
    """Split the N pixels at rows and columns: front (N, 4), its radius (N,), rear (N, 3), its radius (N,)."""
    height, width = radius_px.shape
    offset = np.arange(-REACH_PX, REACH_PX + 1)
    dy, dx = (d.ravel() for d in np.meshgrid(offset, offset, indexing="ij"))
    index = np.clip(at[0][:, None] + dy, 0, height - 1) * width + np.clip(at[1][:, None] + dx, 0, width - 1)
    nearby_NK = radius_px.ravel()[index]
    closeness_K = np.exp(-0.5 * (dx**2 + dy**2)).astype(np.float32)
    weight_NK = closeness_K * np.where(mixed.ravel()[index], np.float32(IMPURE_WEIGHT), np.float32(1))
    colour_NK3, middle_N1 = light.reshape(-1, 3)[index], middle_px[at][:, None]
    is_front_NK = nearby_NK > middle_N1
    front_N3, front_radius_N = _pure(colour_NK3, nearby_NK, weight_NK * is_front_NK)
    rear_N3, rear_radius_N = _pure(colour_NK3, nearby_NK, weight_NK * ~is_front_NK)
    own_N3 = light[at]
    coverage_N = _coverage(own_N3, front_N3, rear_N3, otherwise=radius_px[at] > middle_px[at])
    coverage_N1 = coverage_N[:, None]
    rest_N3 = own_N3 - coverage_N1 * front_N3 - (1 - coverage_N1) * rear_N3
    covers_more_N1 = coverage_N1 >= 0.5
    front_N3 = np.maximum(coverage_N1 * front_N3 + np.where(covers_more_N1, rest_N3, 0), 0)
    rear_N3 = np.maximum(rear_N3 + np.where(covers_more_N1, 0, rest_N3 / np.maximum(1 - coverage_N1, 0.5)), 0)
    return np.column_stack([front_N3, coverage_N]), front_radius_N, rear_N3, rear_radius_N


def _coverage(own_N3: FloatMap, front_N3: FloatMap, rear_N3: FloatMap, *, otherwise: BoolMap) -> FloatMap:
    """Share of the front colour in each pixel (N,); all or nothing where the two colours do not tell."""
    across_N3 = front_N3 - rear_N3
    contrast_N = (across_N3**2).sum(axis=1)
    share_N = np.clip(((own_N3 - rear_N3) * across_N3).sum(axis=1) / np.maximum(contrast_N, LEAST_CONTRAST), 0, 1)
    misfit_N = ((own_N3 - rear_N3 - share_N[:, None] * across_N3) ** 2).sum(axis=1)
    telling_N = (contrast_N > LEAST_CONTRAST) & (misfit_N < LARGEST_MISFIT * contrast_N)
    return np.where(telling_N, share_N, otherwise).astype(np.float32)


def _pure(colour_NK3: FloatMap, radius_NK: FloatMap, weight_NK: FloatMap) -> tuple[FloatMap, FloatMap]:
    """Mean colour (N, 3) of the one surface whose pixel weighs most, and the radius (N,) of that pixel."""
    radius_N = radius_NK[np.arange(len(weight_NK)), weight_NK.argmax(axis=1)]
    share_NK = weight_NK * (np.abs(radius_NK - radius_N[:, None]) <= JUMP_PX)
    share_NK /= share_NK.sum(axis=1, keepdims=True)
    return np.einsum("nk,nkc->nc", share_NK, colour_NK3), radius_N
