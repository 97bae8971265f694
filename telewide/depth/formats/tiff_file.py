"""``depth.tif``, metres, or ``disparity.tif``, px, where metres are not known: one page of float32, unknown NaN.

Its ImageDescription says in JSON what the values are. It is not compressed: deflating saves a fifth, and is no part of
TIFF 6.0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

from telewide.depth.formats.contents import Contents, WrittenDepth
from telewide.files import replacing
from telewide.text import json_text

DEPTH_TIFF_NAME, DISPARITY_TIFF_NAME = "depth.tif", "disparity.tif"


def write_tiff(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth.tif``, or ``disparity.tif`` where metres are not known."""
    result = contents.result
    has_metres = result.depth_m is not None
    path = folder / (DEPTH_TIFF_NAME if has_metres else DISPARITY_TIFF_NAME)
    told: dict[str, object] = {
        "quantity": "depth along the optical axis" if has_metres else "disparity x_tele - x_wide",
        "unit": "m" if has_metres else "px",
        "unknown": "NaN",
        "K": None if result.K is None else result.K.tolist(),
        "baseline_m": result.baseline_m,
        "doffs_px": result.doffs_px,
    }
    values = result.disparity.disparity_px if result.depth_m is None else result.depth_m
    with replacing(path) as temporary:
        tifffile.imwrite(
            temporary,
            values.astype(np.float32),
            photometric="minisblack",
            description=json_text(told),
            metadata=None,
            software="telewide",
        )
    notes = () if has_metres else (f"{result.name}: {path.name} holds px, for its depth in metres is not known",)
    return WrittenDepth((path,), notes)
