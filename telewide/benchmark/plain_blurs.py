"""Other ways to blur a photo by its depth, to compare with: what is simple, and what others do.

Letters: H W image; h w of a disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from telewide.bokeh.aperture import DISK, spot_of
from telewide.bokeh.lens import IN_FOCUS_PX
from telewide.bokeh.render import LARGEST_RADIUS_SHARE, render_bokeh
from telewide.depth.nearest import fill_unknown
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.srgb import linear_from_srgb, srgb_from_linear

_LEVELS = 32
_LEAST_SIGMA_PX = 0.2
_BIN_PX = 1.0
_TINY = np.float32(1e-6)

Blur = Callable[..., FloatImage]


def gaussian_blur(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatImage:
    """Blur every pixel by a Gaussian of its own disk's spread, in linear light: what bokeh is without layers.

    Args:
        image_srgb: (H, W, 3) float32.
        disparity_px: (H, W) float32, px; NaN is filled from its nearest neighbour.
        focus_px: the disparity that stays sharp.
        k: radius of the disk per px of disparity.
    """
    light = linear_from_srgb(image_srgb)
    sigma_px = np.abs(_radius_px(disparity_px, focus_px=focus_px, k=k)) / 2  # a disk's spread along an axis
    level = np.digitize(sigma_px, np.linspace(0, float(sigma_px.max()) + 1e-6, _LEVELS + 1))
    blurred = light.copy()
    for i in np.unique(level):
        own = level == i
        sigma = float(sigma_px[own].mean())
        if sigma > _LEAST_SIGMA_PX:
            blurred[own] = cv2.GaussianBlur(light, (0, 0), sigma)[own]
    return srgb_from_linear(blurred)


def scattered(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatImage:
    """Spread every pixel over its disk and divide by what arrived; nothing hides anything.

    The classical renderer of Peng et al., BokehMe, CVPR 2022, section 3.2, with disks of pixels in bins of 1 px.

    Args:
        image_srgb: (H, W, 3) float32.
        disparity_px: (H, W) float32, px; NaN is filled from its nearest neighbour.
        focus_px: the disparity that stays sharp.
        k: radius of the disk per px of disparity.
    """
    total = np.zeros((*disparity_px.shape, 4), np.float32)
    for layer in _spread_layers(image_srgb, disparity_px, focus_px=focus_px, k=k):
        total += layer
    return _divided(total)


def laid_over(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatImage:
    """Lay blurred layers over each other, far to near, and divide by what they cover; nothing continues behind others.

    As Peng et al., MPIB, ECCV 2022, without its network that paints what is hidden.

    Args:
        image_srgb: (H, W, 3) float32.
        disparity_px: (H, W) float32, px; NaN is filled from its nearest neighbour.
        focus_px: the disparity that stays sharp.
        k: radius of the disk per px of disparity.
    """
    seen = np.zeros((*disparity_px.shape, 4), np.float32)
    for layer in _spread_layers(image_srgb, disparity_px, focus_px=focus_px, k=k):
        seen = layer + (1 - layer[..., 3:]) * seen
    return _divided(seen)


def layered(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatImage:
    """Blur as telewide does.

    Args:
        image_srgb: (H, W, 3) float32.
        disparity_px: (H, W) float32, px; NaN is filled from its nearest neighbour.
        focus_px: the disparity that stays sharp.
        k: radius of the disk per px of disparity.
    """
    return render_bokeh(image_srgb, disparity_px, focus_disparity_px=focus_px, radius_per_px=k)


BLURS: dict[str, Blur] = {"ours": layered, "gaussian": gaussian_blur, "scatter": scattered, "over": laid_over}


def _divided(light: FloatMap) -> FloatImage:
    return srgb_from_linear(np.asarray(light[..., :3] / np.maximum(light[..., 3:], _TINY), dtype=np.float32))


def _radius_px(disparity_px: FloatMap, *, focus_px: float, k: float) -> FloatMap:
    cap_px = min(disparity_px.shape) * LARGEST_RADIUS_SHARE
    away_px = fill_unknown(disparity_px) - np.float32(focus_px)
    return np.asarray(np.clip(away_px * np.float32(k), -cap_px, cap_px), dtype=np.float32)


def _spread_layers(image_srgb: FloatImage, disparity_px: FloatMap, *, focus_px: float, k: float) -> Iterator[FloatMap]:
    """Light times coverage, and coverage (H, W, 4), of the pixels of one disk each, spread, far to near."""
    light = linear_from_srgb(image_srgb)
    radius_px = _radius_px(disparity_px, focus_px=focus_px, k=k)
    bins = np.rint(radius_px / _BIN_PX).astype(np.int64)
    for index in np.unique(bins):
        own = bins == index
        layer = np.dstack([light, np.ones_like(radius_px)]) * own[..., None].astype(np.float32)
        radius = float(radius_px[own].mean())
        if abs(radius) > IN_FOCUS_PX:
            spot = spot_of(radius, None, aperture=DISK)
            layer = cv2.filter2D(layer, -1, spot.kernel, anchor=spot.anchor_xy, borderType=cv2.BORDER_REFLECT_101)
        yield np.asarray(layer, dtype=np.float32)
