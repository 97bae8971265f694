"""Sizes of photos: the largest, and the one each is read in.

Phones make up to 200 megapixels. A larger size than `MAX_PIXELS` is taken for a corrupt or malicious header and refused
before anything is decoded. A photo of more than `MAX_WHOLE_PIXELS` is read at half its size, to keep memory bounded;
all that is computed from it has that size. Letters: H W image; C channels.
"""

from __future__ import annotations

import functools
import logging
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.errors import InputError
from telewide.ranges import MAX_PIXELS, MAX_SIDE_PX, MAX_SIDE_RATIO

Samples = NDArray[np.integer]
"""A picture as decoded, (H, W) or (H, W, C) of 8 or 16 bits."""
MAX_WHOLE_PIXELS = 1 << 26
_log = logging.getLogger("telewide")


def check_size(path: Path, hw: tuple[int, int]) -> None:
    """Refuse a size that no photo has.

    Args:
        path: the photo, to be named.
        hw: height and width that its header states, px.

    Raises:
        InputError: it has no pixels, more than `MAX_PIXELS`, or the shape of no photo.
    """
    if min(hw) < 1:
        raise InputError(f"{path} states a size of {hw[1]} x {hw[0]} px, which is no photo")
    if max(hw) > min(MAX_SIDE_RATIO * min(hw), MAX_SIDE_PX):
        raise InputError(
            f"{path} states a size of {hw[1]} x {hw[0]} px, which no photo has; sides of up to {MAX_SIDE_PX} px are "
            f"read, one at most {MAX_SIDE_RATIO} times the other"
        )
    if hw[0] * hw[1] > MAX_PIXELS:
        raise InputError(
            f"{path} states a size of {hw[1]} x {hw[0]} px, too large to be believed; "
            f"photos of up to {MAX_PIXELS // 10**6} megapixels are read",
            hint="copy the file again from the phone, or export it smaller",
        )


def is_read_halved(hw: tuple[int, int]) -> bool:
    """Tell whether a photo is read at half its size.

    Args:
        hw: height and width as stored, px.
    """
    return hw[0] * hw[1] > MAX_WHOLE_PIXELS


def read_hw(hw: tuple[int, int]) -> tuple[int, int]:
    """Return the height and width in which a photo is read, px.

    Args:
        hw: as stored.
    """
    return ((hw[0] + 1) // 2, (hw[1] + 1) // 2) if is_read_halved(hw) else hw


def narrowed_hw(hw: tuple[int, int], *, width_px: int) -> tuple[int, int]:
    """Return the height and width of a picture that is shrunk where it is wider than a width, px.

    Args:
        hw: as it is read.
        width_px: the largest width.
    """
    return hw if hw[1] <= width_px else (round(hw[0] * width_px / hw[1]), width_px)


def halved(samples: Samples) -> Samples:
    """Halve a picture by the mean of 2 x 2 pixels: ``x' = (x + 0.5) / 2 - 0.5``, as JPEG decoders shrink.

    Args:
        samples: (H, W) or (H, W, C).

    Returns:
        (ceil(H / 2), ceil(W / 2)) or with C; an odd last row or column is averaged with itself.
    """
    height, width = samples.shape[:2]
    if height % 2 or width % 2:
        borders = [(0, height % 2), (0, width % 2), *[(0, 0)] * (samples.ndim - 2)]
        samples = np.pad(samples, borders, mode="edge")
    wh = (samples.shape[1] // 2, samples.shape[0] // 2)
    means = np.asarray(cv2.resize(samples, wh, interpolation=cv2.INTER_AREA), dtype=samples.dtype)
    return means.reshape(wh[1], wh[0], *samples.shape[2:])


@functools.cache
def say_halved(path: Path, hw: tuple[int, int]) -> None:
    """Say once of a photo that it is read at half its size.

    Args:
        path: the photo.
        hw: height and width as stored, px.
    """
    _log.warning("%s has %d megapixels: it is read, and its depth written, at half its size", path, hw[0] * hw[1] / 1e6)


def at_read_size(path: Path, samples: Samples, hw: tuple[int, int]) -> Samples:
    """Halve what is read halved, unless its decoder has done so; say so once a photo.

    Args:
        path: the photo, to be named.
        samples: (H, W) or (H, W, C), as decoded.
        hw: height and width as stored, px.
    """
    if not is_read_halved(hw):
        return samples
    say_halved(path, hw)
    return halved(samples) if samples.shape[:2] == hw else samples
