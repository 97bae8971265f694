"""The nearest pixel of which something is known.

Letters: H W image.
"""

from __future__ import annotations

import cv2
import numpy as np

from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatMap, IntArray


def nearest_known(known: BoolMap) -> tuple[FloatMap, IntArray]:
    """Find for every pixel the nearest known one.

    Args:
        known: (H, W) bool, True somewhere.

    Returns:
        (H, W) float32 distance, px, and (H, W) int64 flat index of that pixel; both to the accuracy of a 5x5 chamfer
        distance.
    """
    distance_px, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.flatnonzero(known)
    index_of_label = np.zeros(int(label.max()) + 1, dtype=np.int64)
    index_of_label[label.ravel()[index]] = index
    return np.asarray(distance_px, dtype=np.float32), index_of_label[label]


def fill_unknown(disparity_px: FloatMap) -> FloatMap:
    """Give every pixel that is not finite the value of the nearest one that is.

    Args:
        disparity_px: (H, W) float32, px.

    Raises:
        InputError: no pixel is finite.
    """
    known = np.isfinite(disparity_px)
    if known.all():
        return disparity_px
    if not known.any():
        raise InputError("the disparity map holds no known value")
    _, index = nearest_known(known)
    return np.asarray(disparity_px.ravel()[index], dtype=np.float32)
