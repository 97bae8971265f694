"""``points.ply``: coloured points, m. They lie in tele's frame: x right, y down, z forward.

trimesh (the extra ``mesh``) writes it. Letters: h w after thinning; N points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.depth.formats.contents import (
    NO_METRES,
    Contents,
    WrittenDepth,
    levels,
    positions_m,
    thinned,
    written_whole,
)
from telewide.geometry.arrays import ByteImage, FloatMap

PLY_NAME = "points.ply"
POINTS_LONGEST_PX = 1600


def write_ply(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``points.ply``."""
    at_m = positions_m(contents, longest_px=POINTS_LONGEST_PX)
    if at_m is None or not np.isfinite(at_m).any():
        return contents.left_out(PLY_NAME, NO_METRES)
    from trimesh import PointCloud

    known = np.isfinite(at_m).all(axis=2)
    colours = None if contents.image is None else _bytes(contents.image, longest_px=POINTS_LONGEST_PX)[known]
    return written_whole(folder / PLY_NAME, PointCloud(at_m[known], colors=colours).export(file_type="ply"))


def _bytes(image: FloatMap, *, longest_px: int) -> ByteImage:
    return levels(np.nan_to_num(thinned(image, longest_px=longest_px)), bits=8).astype(np.uint8)
