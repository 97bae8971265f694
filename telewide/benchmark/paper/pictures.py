"""A sheet of pictures a scene: the pair as it was seen, the truth, and what each system found, with its errors.

Maps are kept beside the scores of a cell, at most `MAP_WIDTH_PX` wide. Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.depth.preview import colourise, display_range_px
from telewide.drawing import painted, scaled_image
from telewide.files import is_file
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import resize_disparity
from telewide.pages.contact import strip, write_sheet

MAP_WIDTH_PX = 480
ERROR_SHOWN_PX = 6.0
"""Error that is drawn in the brightest colour, the same on every sheet."""
_PANEL_PX = 300
_COLUMNS = 6


@dataclass(frozen=True)
class Found:
    """Disparity of one system in one scene.

    Attributes:
        title: of the system and its weights.
        off_3px_5percent: 3PE, share in [0, 1].
        disparity_px: (h, w), px of a map at most `MAP_WIDTH_PX` wide.
    """

    title: str
    off_3px_5percent: float
    disparity_px: FloatMap


@dataclass(frozen=True)
class Sheet:
    """Pictures of one scene.

    Attributes:
        column: heading of the column it is of.
        scene: its name.
        path: of the PNG.
    """

    column: str
    scene: str
    path: Path


def keep_map(folder: Path, scene: str, weights: str, *, disparity_px: FloatMap) -> None:
    """Keep a map for pictures.

    Args:
        folder: of the cell.
        scene: its name.
        weights: by which it was found.
        disparity_px: (H, W) px.
    """
    write_pfm(_map_path(folder, scene, weights), _reduced(disparity_px))


def kept_map(folder: Path, scene: str, weights: str) -> FloatMap | None:
    """Read a kept map: (h, w) px of itself; None where there is none.

    Raises:
        InputError: it cannot be read.
    """
    path = _map_path(folder, scene, weights)
    return read_pfm(path) if is_file(path) else None


def write_scene_sheet(path: Path, truth: StereoTruth, found: Sequence[Found]) -> None:
    """Write the pictures of one scene as PNG: all disparities at one scale, all errors up to `ERROR_SHOWN_PX`.

    Args:
        path: ends in .png.
        truth: the pair, its right view as most systems see it.
        found: what systems found.
    """
    true_px = _reduced(truth.disparity_px)
    wh = (true_px.shape[1], true_px.shape[0])
    to_full = truth.disparity_px.shape[1] / wh[0]  # errors are shown in px of the scene
    range_px = display_range_px(true_px)
    shown_px = f"{range_px[0] * to_full:.0f} to {range_px[1] * to_full:.0f} px"
    panels = [scaled_image(truth.left, wh=wh), scaled_image(truth.right, wh=wh), colourise(true_px, range_px=range_px)]
    labels = ["sharp view", "second view", f"truth, {shown_px}"]
    blank = np.full((wh[1], wh[0], 3), np.float32(0.1))
    panels += [blank] * (_COLUMNS - len(panels))
    labels += [""] * (_COLUMNS - len(labels))
    for each in found:
        error_px = np.abs(each.disparity_px - true_px) * np.float32(to_full)
        panels += [
            colourise(each.disparity_px, range_px=range_px),
            painted(error_px, value_range=(0, ERROR_SHOWN_PX), table="inferno"),
        ]
        labels += [each.title, f"error to {ERROR_SHOWN_PX:g} px; 3PE {100 * each.off_3px_5percent:.1f} %"]
    write_sheet(path, strip(panels, labels, width_px=_PANEL_PX * _COLUMNS, columns=_COLUMNS))


def _map_path(folder: Path, scene: str, weights: str) -> Path:
    return folder / "maps" / f"{scene}-{weights or 'only'}.pfm"


def _reduced(disparity_px: FloatMap) -> FloatMap:
    height, width = disparity_px.shape
    if width <= MAP_WIDTH_PX:
        return disparity_px
    return resize_disparity(disparity_px, wh=(MAP_WIDTH_PX, max(1, round(height * MAP_WIDTH_PX / width))))
