"""From the corners of a board in many shots to a rig.

Each lens is solved alone, from every view it has; then the two lenses against each other, from the corners both see;
then everything at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.result import Calibration
from telewide.calibration.shots import DetectedShot

FloatArray = NDArray[np.float64]


def calibrate_rig(
    shots: Sequence[DetectedShot], *, board_points_m: FloatArray, is_scale_known: bool = True, seed: int = 0
) -> Calibration:
    """Calibrate two lenses that photographed a board, together or alone.

    Args:
        shots: corners by shot; the lenses may differ in photo size and focal length, and see different corners.
        board_points_m: (N, 3) corners in the board's frame by their id, z = 0.
        is_scale_known: False where the board was not measured.
        seed: of the choice of views that are held out.

    Returns:
        The calibration; ``quality.verdict`` says whether it can be used, ``quality.checks`` what to photograph next.

    Raises:
        InputError: no rig can be had: too few views, shots that contradict each other, lenses exchanged.
    """
    raise NotImplementedError
