"""Decoded photos between the stages of one call: what is kept is not decoded again."""

from __future__ import annotations

from pathlib import Path

from telewide.capture.images import read_image
from telewide.geometry.arrays import FloatImage

MAX_BYTES = 512 << 20
"""Of three photos of 12 megapixels; those of a larger set are decoded once a stage."""


class PhotoStore:
    """Reads photos, and keeps the first ones within a budget of memory.

    Args:
        max_bytes: of all kept photos together.
    """

    def __init__(self, *, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._kept: dict[Path, FloatImage] = {}

    @property
    def kept_bytes(self) -> int:
        """Memory of all kept photos."""
        return sum(photo.nbytes for photo in self._kept.values())

    def read(self, path: Path) -> FloatImage:
        """Return a photo, decoded unless it is kept.

        Args:
            path: a photo.

        Returns:
            (H, W, 3) float32, shared with later calls; it must not be changed.

        Raises:
            UsageError: there is no such file.
            InputError: it cannot be read.
        """
        if path in self._kept:
            return self._kept[path]
        photo = read_image(path)
        if self.kept_bytes + photo.nbytes <= self._max_bytes:
            self._kept[path] = photo
        return photo
