"""What cameras are judged by: a grey card and a chart of colours, and a camera that hardly makes noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HW = (96, 128)
QUIET = {"full_well_e": 1e7, "read_noise_e": 0.0}


def grey(level: float, hw: tuple[int, int] = HW) -> NDArray[np.float32]:
    return np.full((*hw, 3), level, np.float32)


def chart() -> NDArray[np.float32]:
    """Six patches of 32 x 40 px, linear sRGB."""
    colours = [
        (0.4, 0.2, 0.14),
        (0.1, 0.2, 0.4),
        (0.15, 0.3, 0.12),
        (0.55, 0.5, 0.1),
        (0.3, 0.08, 0.25),
        (0.2, 0.2, 0.2),
    ]
    patches = np.array(colours, np.float32).reshape(2, 3, 1, 1, 3)
    return np.concatenate([np.concatenate(row, axis=1) for row in np.broadcast_to(patches, (2, 3, 32, 40, 3))])
