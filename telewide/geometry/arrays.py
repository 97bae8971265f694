"""The array types of the package: what a number is; the docstring beside says the shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Points (N, 2), matrices, whatever is computed in double precision."""
FloatMap = NDArray[np.float32]
"""(H, W) maps such as disparity, and pictures of any number of channels."""
FloatImage = NDArray[np.float32]
"""(H, W, 3) RGB in [0, 1]."""
BoolMap = NDArray[np.bool_]
"""(H, W) masks."""
BoolArray = NDArray[np.bool_]
"""(N,) flags."""
ByteImage = NDArray[np.uint8]
"""(H, W) or (H, W, 3) pictures of 8 bits, and raw bytes."""
IntArray = NDArray[np.int64]
"""Numbers of things, or places of pixels."""
