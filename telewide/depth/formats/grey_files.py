"""``photo.jpg`` with ``photo_depth.png`` and ``photo_depth_16.png``: a photo and its grey map, near white, far black.

For programs that take a photo and a map of its depth: lens blur, moving photos, displacement. Grey is linear in
disparity, which is inverse depth, from the 1st to the 99th percentile; every pixel has a value.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from telewide.capture.images import write_image, write_png16
from telewide.depth.formats.contents import Contents, WrittenDepth, levels
from telewide.depth.formats.jpeg_xmp import photo_jpeg
from telewide.depth.nearest import fill_unknown
from telewide.depth.preview import display_range_px
from telewide.files import replacing
from telewide.geometry.arrays import FloatMap

PHOTO_NAME, GREY_NAME, GREY16_NAME = "photo.jpg", "photo_depth.png", "photo_depth_16.png"


def write_grey(folder: Path, contents: Contents) -> WrittenDepth:
    """Write the photo and its grey maps of 8 and 16 bits."""
    disparity = contents.result.disparity
    if not np.isfinite(disparity.disparity_px).any():
        return contents.left_out(GREY_NAME, "nothing was measured")
    near = nearness(disparity.disparity_px, range_px=display_range_px(disparity.disparity_px, valid=disparity.valid))
    paths = [folder / GREY_NAME, folder / GREY16_NAME]
    write_image(paths[0], near)
    write_png16(paths[1], levels(near, bits=16).astype(np.uint16))
    if contents.image is not None:
        paths.insert(0, folder / PHOTO_NAME)
        with replacing(paths[0]) as temporary:
            temporary.write_bytes(photo_jpeg(contents.image, exif=contents.exif_without_place))
    return WrittenDepth(tuple(paths))


def nearness(disparity_px: FloatMap, *, range_px: tuple[float, float]) -> FloatMap:
    """Scale disparity to 0 at the far end of a range and 1 at the near end; unknown takes its nearest neighbour's.

    Args:
        disparity_px: (H, W), px, known somewhere.
        range_px: lowest and highest disparity.

    Returns:
        (H, W) float32 in [0, 1].
    """
    low_px, high_px = range_px
    near = (fill_unknown(disparity_px) - low_px) / (high_px - low_px)
    return np.asarray(np.clip(near, 0, 1), dtype=np.float32)
