"""Board photos that are decoded before the board is looked for in all of them: what is kept is not decoded again.

Letters: H W photo.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from telewide.capture.images import read_image
from telewide.errors import within_memory
from telewide.geometry.arrays import ByteImage, FloatImage

MAX_BYTES = 512 << 20
"""Of ten photos of 12 megapixels, or two of 50; the others are decoded again."""


def grey_of(photo: FloatImage) -> ByteImage:
    """Return a photo (H, W, 3) as (H, W) uint8 grey, sRGB-encoded."""
    grey = cv2.cvtColor(photo, cv2.COLOR_RGB2GRAY)
    return np.asarray(grey * np.float32(255) + np.float32(0.5), dtype=np.uint8)


class KeptPhotos:
    """Reads board photos, and keeps the first ones, grey and in colour, within a budget of memory.

    Bytes do for boards and take a third of what `capture.photo_store` keeps, which must not round photos of 16 bits.

    Args:
        max_bytes: of all kept photos together.
    """

    def __init__(self, *, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._greys: dict[Path, ByteImage] = {}
        self._colours: dict[Path, ByteImage] = {}

    @property
    def paths(self) -> frozenset[Path]:
        """Photos that are kept."""
        return frozenset(self._greys)

    @property
    def kept_bytes(self) -> int:
        """Memory of all kept photos."""
        return sum(photo.nbytes for photo in (*self._greys.values(), *self._colours.values()))

    def read_grey(self, path: Path) -> ByteImage:
        """Return a photo upright in grey, decoded unless it is kept.

        Args:
            path: any photo that can be read.

        Returns:
            (H, W) uint8, sRGB-encoded, shared with later calls; it must not be changed.

        Raises:
            UsageError: there is no such file.
            InputError: it cannot be read, or takes more memory than there is.
            MissingPartError: it needs a reader that is not installed.
        """
        if path in self._greys:
            return self._greys[path]
        with within_memory(str(path)):
            photo = read_image(path)
            grey = grey_of(photo)
            if self.kept_bytes + 4 * grey.nbytes <= self._max_bytes:
                colour = np.asarray(photo * np.float32(255) + np.float32(0.5), dtype=np.uint8)
                self._greys[path], self._colours[path] = grey, colour
        return grey

    def read_colour(self, path: Path) -> FloatImage:
        """Return a photo in colour: in steps of 1/255 where it is kept, else decoded.

        Args:
            path: any photo that can be read.

        Returns:
            (H, W, 3) float32 in [0, 1].

        Raises:
            UsageError: there is no such file.
            InputError: it cannot be read.
            MissingPartError: it needs a reader that is not installed.
        """
        if path not in self._colours:
            return read_image(path)
        return self._colours[path].astype(np.float32) / np.float32(255)
