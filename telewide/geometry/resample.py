"""Take a picture apart and put it together on another grid, once, without losing sharpness or making up patterns.

Between the pixels lies the cubic B-spline that passes through all of them (M. Unser, Splines: a perfect fit for signal
and image processing, IEEE Signal Processing Magazine 16(6), 1999): sharper than cubic convolution, and exact where
OpenCV's own cubic and Lanczos round positions to 1/32 px. It is built of OpenCV's linear interpolation, which rounds
too before version 5; there Lanczos has to do. Where the new grid is coarser the picture is first held to
what that grid can carry, by Keys' cubic stretched to its pixels.
Letters: H W new grid; t a position between two pixels.
"""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatMap

_SPLINE_POLE = np.sqrt(3.0) - 2  # of the filter that turns samples into the coefficients of the cubic spline
_SPLINE_REACH = 9  # what lies beyond weighs 1e-5
_BAND_PIXELS = 1 << 16  # what stays in a core's cache, and is not asked of the system anew each time
_PAD_PX = 16


def resample(image: FloatMap, map_x: FloatMap, map_y: FloatMap, *, shrink: float = 1.0) -> FloatMap:
    """Read an image at given places.

    Args:
        image: (h, w, C) or (h, w) float32 in [0, 1].
        map_x: (H, W) float32, x in the image, px; outside of it its border is continued.
        map_y: (H, W) float32, y likewise.
        shrink: pixels of the image for one of the new grid; above 1 the image is antialiased.

    Returns:
        (H, W, C) or (H, W) float32 in [0, 1].
    """
    height, width = image.shape[:2]
    x, y = np.clip(map_x, 0, width - 1), np.clip(map_y, 0, height - 1)
    pad_px = _PAD_PX + int(2 * max(1.0, shrink))
    left, top = (max(0, int(axis.min()) - pad_px) for axis in (x, y))
    used = image[top : int(y.max()) + pad_px, left : int(x.max()) + pad_px]
    is_exact = has_exact_positions()
    kernel = _spline_coefficients_kernel() if is_exact else np.ones(1)
    if shrink > 1:
        kernel = np.convolve(kernel, _stretched_cubic(shrink))
    filtered = cv2.sepFilter2D(used, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    coefficients = np.asarray(filtered, dtype=np.float32)
    result = np.empty((*map_x.shape, *image.shape[2:]), dtype=np.float32)
    rows = max(1, _BAND_PIXELS // max(1, map_x.shape[1]))

    def fill(first: int) -> None:
        band = slice(first, first + rows)
        read = _spline_at if is_exact else _lanczos_at
        values = read(coefficients, x[band] - np.float32(left), y[band] - np.float32(top))
        np.clip(values, 0, 1, out=result[band])

    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        list(pool.map(fill, range(0, map_x.shape[0], rows)))
    return result


@functools.cache
def has_exact_positions() -> bool:
    """Whether this OpenCV interpolates linearly at any position, or rounds it to 1/32 px."""
    ramp, at = np.array([[0, 1]], np.float32), np.full((1, 1), 0.01, np.float32)
    return bool(abs(float(cv2.remap(ramp, at, 0 * at, cv2.INTER_LINEAR)[0, 0]) - 0.01) < 1e-4)


def _spline_coefficients_kernel() -> NDArray[np.float64]:
    taps = _SPLINE_POLE ** np.abs(np.arange(-_SPLINE_REACH, _SPLINE_REACH + 1))
    return np.asarray(taps / taps.sum())


def _stretched_cubic(shrink: float) -> NDArray[np.float64]:
    """Keys' kernel (a = -0.5), as wide as pixels of the new grid."""
    reach = int(np.ceil(2 * shrink))
    t = np.abs(np.arange(-reach, reach + 1)) / shrink
    near, far = 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    taps = np.where(t <= 1, near, np.where(t < 2, far, 0.0))
    return np.asarray(taps / taps.sum())


def _spline_at(coefficients: FloatMap, x: FloatMap, y: FloatMap) -> FloatMap:
    """Value of the spline: of its 4 x 4 coefficients every 2 x 2 are fetched as one, by linear interpolation.

    C. Sigg, M. Hadwiger, Fast third-order texture filtering, GPU Gems 2, chapter 20.
    """
    (x_before, x_after, x_weight), (y_before, y_after, y_weight) = _paired_taps(x), _paired_taps(y)

    def fetch(at_x: FloatMap, at_y: FloatMap) -> FloatMap:
        fetched = cv2.remap(coefficients, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(fetched, dtype=np.float32)

    x_share, y_share = (_for_all_channels(weight, coefficients.shape) for weight in (x_weight, y_weight))
    upper, lower = fetch(x_before, y_before), fetch(x_before, y_after)
    upper += x_share * (fetch(x_after, y_before) - upper)
    lower += x_share * (fetch(x_after, y_after) - lower)
    upper += y_share * (lower - upper)
    return upper


def _lanczos_at(values: FloatMap, x: FloatMap, y: FloatMap) -> FloatMap:
    fetched = cv2.remap(values, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(fetched, dtype=np.float32)


def _for_all_channels(weight: FloatMap, shape: tuple[int, ...]) -> FloatMap:
    """Repeat a weight for every channel: numpy multiplies equal shapes ten times faster than it broadcasts."""
    return weight if len(shape) == 2 else np.asarray(cv2.merge([weight] * shape[2]), dtype=np.float32)


def _paired_taps(position: FloatMap) -> tuple[FloatMap, FloatMap, FloatMap]:
    """Where the first two and the last two of four taps are fetched as one, and the weight of the last two."""
    one, four, six = (np.float32(number) for number in (1, 4, 6))
    base = np.floor(position)
    t = position - base
    s = one - t
    first, second = s * s * s, (np.float32(3) * t - six) * t * t + four
    last = t * t * t
    before = first + second  # all weights are sixths
    after = six - before
    return base - one + second / before, base + one + last / after, after / six
