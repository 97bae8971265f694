"""``depth.exr``: the photo in linear light, ``Z``, m, ``disparity``, px, and ``confidence``; the camera in the header.

Z is distance along the optical axis, float; what is unknown is +infinity, farther than anything. The extra ``exr``
(OpenEXR, the library of the format's makers) writes it. Letters: H W image.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from telewide.depth.formats.contents import Contents, WrittenDepth
from telewide.files import replacing
from telewide.srgb import linear_from_srgb

EXR_NAME = "depth.exr"
MEANING = "disparity: px"
MEANING_OF_Z = "Z: m along the optical axis, +inf unknown"


def write_exr(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``depth.exr``; without Z where metres are not known."""
    import OpenEXR

    result = contents.result
    channels = {
        "disparity": result.disparity.disparity_px.astype(np.float32),
        "confidence": contents.confidence.astype(np.float16),
    }
    if contents.image is not None:
        channels["RGB"] = linear_from_srgb(contents.image).astype(np.float16)
    if result.depth_m is not None:
        channels["Z"] = np.where(np.isfinite(result.depth_m), result.depth_m, np.inf).astype(np.float32)
    header: dict[str, object] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    meaning = MEANING if result.depth_m is None else f"{MEANING_OF_Z}; {MEANING}"
    header |= {"software": "telewide", "comments": meaning}
    if contents.facts is not None:
        header |= replace(contents.facts, done=meaning).exr_attributes()
    if result.K is not None:
        header["cameraIntrinsicsPx"] = result.K.astype(np.float32)
    if result.baseline_m is not None:
        header["baselineMetres"] = float(result.baseline_m)
        header["doffsPx"] = float(result.doffs_px)
    with replacing(folder / EXR_NAME) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
    notes = () if result.depth_m is not None else (f"{result.name}: {EXR_NAME} has no Z, for metres are not known",)
    return WrittenDepth((folder / EXR_NAME,), notes)
