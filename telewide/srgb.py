"""The sRGB curve and its inverse (IEC 61966-2-1), and luma. Light adds up in linear values only.

Letters: H W image.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Values = TypeVar("Values", NDArray[np.float32], NDArray[np.float64])

_KNEE_SRGB, _KNEE_LINEAR = 0.04045, 0.0031308
_SLOPE, _OFFSET, _EXPONENT = 12.92, 0.055, 2.4


def linear_from_srgb(values_srgb: Values) -> Values:
    """Undo the sRGB curve, continued above 1.

    Args:
        values_srgb: float32 or float64 of any shape; 0 to 1, or more where highlights were recovered.

    Returns:
        Same shape and type, linear light.
    """
    high = ((np.maximum(values_srgb, 0.0) + _OFFSET) / (1 + _OFFSET)) ** _EXPONENT
    return np.where(values_srgb <= _KNEE_SRGB, values_srgb / _SLOPE, high)


def srgb_from_linear(values_linear: Values) -> Values:
    """Inverse of :func:`linear_from_srgb`."""
    high = (1 + _OFFSET) * np.maximum(values_linear, 0.0) ** (1 / _EXPONENT) - _OFFSET
    return np.where(values_linear <= _KNEE_LINEAR, values_linear * _SLOPE, high)


def srgb_slope(values_linear: Values) -> Values:
    """Derivative of :func:`srgb_from_linear`, of the same shape and type."""
    high = (1 + _OFFSET) / _EXPONENT * np.maximum(values_linear, _KNEE_LINEAR) ** (1 / _EXPONENT - 1)
    return np.where(values_linear <= _KNEE_LINEAR, high.dtype.type(_SLOPE), high)


def grey(image_srgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Luma (Rec. 601 weights) of an (H, W, 3) image, (H, W) float32; a grey one is returned as it is."""
    if image_srgb.ndim == 2:
        return image_srgb
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image_srgb), cv2.COLOR_RGB2GRAY), dtype=np.float32)
