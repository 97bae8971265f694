"""Doubt that the confidence of a match leaves, where it is the probability of an error below 1 px."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from telewide.geometry.arrays import FloatMap

_CONFIDENCES = (0.05, 0.9995)  # beyond them a normal deviation says nothing


def std_of_error_px(confidence: FloatMap) -> FloatMap:
    """Standard deviation of a normal error that stays below 1 px with this probability.

    Args:
        confidence: any shape, in [0, 1].
    """
    return np.asarray(1 / ndtri((1 + np.clip(confidence, *_CONFIDENCES)) / 2), dtype=np.float32)


def share_within(distance_px: FloatMap, tolerance_px: FloatMap) -> FloatMap:
    """Fall smoothly from 1, within half the tolerance, to 0 at the whole of it.

    Args:
        distance_px: any shape, of either sign.
        tolerance_px: of that shape.
    """
    reach = np.clip(2 * np.abs(distance_px) / tolerance_px - 1, 0, 1)
    return np.asarray(1 - reach * reach * (3 - 2 * reach), dtype=np.float32)


def ramp(values: FloatMap, first: float, last: float) -> FloatMap:
    """Rise in a line from 0 at the first value to 1 at the last, which may be the smaller of the two."""
    return np.asarray(np.clip((values - first) / (last - first), 0, 1), dtype=np.float32)
