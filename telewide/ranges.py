"""Ranges of the numbers that files state: sizes, lenses, disparities, seeds. What lies beyond is refused.

The limits lie far beyond what cameras have and far below what would ask for more memory than there is.
"""

from __future__ import annotations

MAX_PIXELS = 1 << 28
"""Of a photo, 268 megapixels; phones have up to 200."""
MAX_SIDE_PX = 1 << 16
"""Of a photo."""
MAX_SIDE_RATIO = 32
"""Of a photo's longer side to its shorter one; panoramas have up to 20."""
MAX_FILE_BYTES = 3 << 29
"""Of any file that is read: as many as 268 megapixels of three channels of 16 bits have."""
MAX_PACKED_BYTES = 1 << 29
"""Of a photo in a format that loses something: 2 bytes a pixel of the largest, more than any encoder writes."""
MAX_SCANS = 64
"""Of a progressive JPEG; encoders make 10 to 20, and each costs a walk over all its pixels."""
MAX_FOCAL_SIDES = 64
"""Focal length in longer sides of the photo: of some 2300 mm on 36 x 24 mm."""
MAX_CENTRE_SIDES = 16
"""Distance of the principal point from the photo's corner, in its longer sides."""
MAX_DISTORTION = 1e6
"""Of any coefficient of OpenCV's model; long lenses have large ones."""
MIN_BASELINE_M, MAX_BASELINE_M = 1e-5, 2.0
"""A phone's lenses are 0.01 m apart, a car's 0.5 m: a larger number was meant in millimetres."""
MAX_ASYMMETRY = 100.0
"""f_tele / f_wide in pixels."""
MAX_DISPARITY_PX, MAX_SPAN_PX = 8192, 4096
"""Of a window: its ends, and from end to end."""
MAX_CANVAS = 16
"""Pixels of a rectified view in those of the tele photo."""
MAX_SEED = (1 << 32) - 1
MAX_STEPS, MAX_STAGES = 10**9, 100
"""Of a training."""
MAX_CROP_PX, MAX_STEP_PIXELS = 4096, 1 << 24
"""Of a crop's side, and of all crops of a step: 64 of 512 x 512."""
