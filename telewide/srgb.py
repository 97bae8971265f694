"""The sRGB curve and its inverse (IEC 61966-2-1). Light adds up in linear values only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]


def linear_from_srgb(image_srgb: FloatImage) -> FloatImage:
    """Undo the sRGB curve, continued above 1.

    Args:
        image_srgb: float32 of any shape; 0 to 1, or more where highlights were recovered.

    Returns:
        Same shape, linear light.
    """
    low = image_srgb / np.float32(12.92)
    high = ((np.maximum(image_srgb, 0.0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(image_srgb <= 0.04045, low, high).astype(np.float32)


def srgb_from_linear(image_linear: FloatImage) -> FloatImage:
    """Inverse of :func:`linear_from_srgb`."""
    low = image_linear * np.float32(12.92)
    high = np.float32(1.055) * np.maximum(image_linear, 0.0) ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(image_linear <= 0.0031308, low, high).astype(np.float32)
