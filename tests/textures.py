"""A texture to see and to match at any distance, shared by the tests."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def textured(rng: np.random.Generator, *, hw: tuple[int, int]) -> NDArray[np.float32]:
    """Colourful noise of all scales."""
    image = np.zeros((*hw, 3), dtype=np.float32)
    for sigma_px in (1.0, 2.0, 4.0, 9.0, 25.0):
        noise = cv2.GaussianBlur(rng.standard_normal((*hw, 3)).astype(np.float32), (0, 0), sigma_px)
        image += 0.1 * noise / noise.std()
    return np.asarray(np.clip(0.5 + image, 0.05, 0.95), dtype=np.float32)
