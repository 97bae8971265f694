"""``disparity.pfm``: float px, unknown +inf, rows bottom up (Middlebury's convention)."""

from __future__ import annotations

from pathlib import Path

from telewide.capture.pfm import write_pfm
from telewide.depth.formats.contents import Contents, WrittenDepth

PFM_NAME = "disparity.pfm"


def write_pfm_file(folder: Path, contents: Contents) -> WrittenDepth:
    """Write ``disparity.pfm``."""
    write_pfm(folder / PFM_NAME, contents.result.disparity.disparity_px)
    return WrittenDepth((folder / PFM_NAME,))
