"""Lamps and glints that a photo could not hold: clipped to white, they were brighter, and blurred they show it.

Only what is small is taken for a light: a clipped sky or wall stays as it is. Letters: H W image.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from telewide.errors import UsageError
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap

CLIPPED_SRGB = 0.98
"""From here on a channel may be clipped; at 1 it is: JPEG and noise leave clipped lights a little below white."""
LARGEST_LIGHT_SHARE = 0.002
"""Area of a light, as a share of the photo: a lamp 2 m away; twice as large it counts no more."""
MAX_TIMES = 100.0


def with_highlights(light: FloatImage, image_srgb: FloatImage, *, times: float) -> FloatImage:
    """Make small clipped lights as bright as they are taken to have been.

    Args:
        light: (H, W, 3) float32, linear light of the photo; changed in place.
        image_srgb: (H, W, 3) float32, the photo; values above 1 are not clipped.
        times: how many times as bright as white, 1 to 100; 1 changes nothing.

    Returns:
        The same array.

    Raises:
        UsageError: the factor is out of range.
    """
    if not (math.isfinite(times) and 1 <= times <= MAX_TIMES):
        raise UsageError(f"highlights {times}: a factor from 1 to {MAX_TIMES:g} was expected")
    if times == 1:
        return light
    share = light_share(image_srgb)
    at = np.nonzero(share)
    light[at] *= (1 + (np.float32(times) - 1) * share[at])[:, None]
    return light


def light_share(image_srgb: FloatImage) -> FloatMap:
    """Tell what is a small clipped light.

    Args:
        image_srgb: (H, W, 3) float32, the photo; values above 1 are not clipped.

    Returns:
        (H, W) float32: 1 in such lights, 0 elsewhere, between where clipping or smallness is in doubt.
    """
    brightest = image_srgb.max(axis=2)
    clipped = (brightest >= CLIPPED_SRGB) & (brightest <= 1)
    share = np.zeros(clipped.shape, np.float32)
    if clipped.any():
        at = np.nonzero(clipped)
        share[at] = np.minimum((brightest[at] - CLIPPED_SRGB) / (1 - CLIPPED_SRGB), 1) * _smallness(clipped)[at]
    return share


def _smallness(clipped: BoolMap) -> FloatMap:
    """1 in clipped areas that are small enough for a light, 0 in those twice as large."""
    _, label, facts, _ = cv2.connectedComponentsWithStats(clipped.astype(np.uint8), connectivity=8)
    area = facts[:, cv2.CC_STAT_AREA] / (LARGEST_LIGHT_SHARE * clipped.size)
    return np.asarray(np.clip(2 - area, 0, 1)[label], dtype=np.float32)
