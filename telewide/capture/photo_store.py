"""Decoded photos between the stages of one call: what is kept is not decoded again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.capture.images import read_image
from telewide.geometry.arrays import ByteImage, FloatImage

MAX_BYTES = 512 << 20
"""Of three photos of 12 megapixels, a dozen with 8 bits; those of a larger set are decoded once a stage."""
_STRIP_ROWS = 128


@dataclass(frozen=True)
class HeldPhoto:
    """A decoded photo, in a quarter of its memory where it has 8 bits."""

    _levels: FloatImage | ByteImage

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return self._levels.nbytes

    def pixels(self) -> FloatImage:
        """Return it as (H, W, 3) float32; it may be shared with later calls, so it must not be changed."""
        return _photo_of(self._levels)


class PhotoStore:
    """Reads photos, and keeps the first ones within a budget of memory.

    Args:
        max_bytes: of all kept photos together.
    """

    def __init__(self, *, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._kept: dict[Path, HeldPhoto] = {}

    @property
    def kept_bytes(self) -> int:
        """Memory of all kept photos."""
        return sum(photo.nbytes for photo in self._kept.values())

    def read(self, path: Path) -> FloatImage:
        """Return a photo, decoded unless it is kept.

        Args:
            path: a photo.

        Returns:
            (H, W, 3) float32; it may be shared with later calls, so it must not be changed.

        Raises:
            UsageError: there is no such file.
            InputError: it cannot be read.
        """
        return self.hold(path).pixels()

    def hold(self, path: Path) -> HeldPhoto:
        """Return a photo for use now and later, decoded unless it is kept; raises as :meth:`read` does."""
        if path not in self._kept:
            photo = HeldPhoto(_levels_of(read_image(path)))
            if self.kept_bytes + photo.nbytes > self._max_bytes:
                return photo
            self._kept[path] = photo
        return self._kept[path]


def _levels_of(photo: FloatImage) -> FloatImage | ByteImage:
    """The photo in a quarter of its memory, where it has 8 bits and comes back exactly; else as it is."""
    levels = np.empty(photo.shape, np.uint8)
    for top in range(0, len(photo), _STRIP_ROWS):
        strip, those = photo[top : top + _STRIP_ROWS], levels[top : top + _STRIP_ROWS]
        those[:] = np.round(strip * 255)
        if not np.array_equal(_photo_of(those), strip):
            return photo
    return levels


def _photo_of(kept: FloatImage | ByteImage) -> FloatImage:
    scale = np.float32(1 / 255 if kept.dtype == np.uint8 else 1)
    return np.asarray(kept if scale == 1 else kept * scale, dtype=np.float32)
