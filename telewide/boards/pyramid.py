"""A photo at several sizes: boards are found in the smallest that shows them, and measured in the largest.

Half-pixel rule: ``x_photo = (x_level + 0.5) s - 0.5``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import ByteImage, FloatArray

SMALL_PX = 1000
"""Longest side of the smallest level, at most."""
LARGE_PX = 4500
"""Longest side of the largest level, at most: looking for a board in more takes long and finds no more."""


@dataclass(frozen=True)
class Level:
    """One size of a photo.

    Attributes:
        grey_u8: (h, w) uint8.
        scale_xy: photo px per px of this level.
    """

    grey_u8: ByteImage
    scale_xy: tuple[float, float]

    def to_photo_px(self, points_px: FloatArray) -> FloatArray:
        """Points (..., 2) of this level on the photo; inverse of :meth:`from_photo_px`."""
        return np.asarray((points_px + 0.5) * self.scale_xy - 0.5, dtype=np.float64)

    def from_photo_px(self, points_px: FloatArray) -> FloatArray:
        """Points (..., 2) of the photo on this level; inverse of :meth:`to_photo_px`."""
        return np.asarray((points_px + 0.5) / self.scale_xy - 0.5, dtype=np.float64)


def pyramid(grey_u8: ByteImage) -> Iterator[Level]:
    """Give a photo at growing sizes, each twice as large as the one before; each is made when it is asked for.

    Args:
        grey_u8: (H, W) uint8.

    Yields:
        The levels, the smallest first. Small photos have one level, their own size.
    """
    height, width = grey_u8.shape
    halvings = max(0, int(np.ceil(np.log2(max(height, width) / SMALL_PX))))
    for halving in range(halvings, -1, -1):
        w, h = max(1, round(width / 2**halving)), max(1, round(height / 2**halving))
        if max(w, h) > LARGE_PX:
            return
        same_size = (h, w) == grey_u8.shape
        resized = grey_u8 if same_size else cv2.resize(grey_u8, (w, h), interpolation=cv2.INTER_AREA)
        yield Level(np.asarray(resized, dtype=np.uint8), (width / w, height / h))
