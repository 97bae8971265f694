"""Public stereo sets read as pairs with truth, and written as capture folders.

Middlebury 2006 (Hirschmueller and Scharstein, Evaluation of cost functions for stereo matching, CVPR 2007): per scene
``view1.png`` (left), ``view5.png`` (right), ``disp1.png`` with the left view's disparity as bytes, 0 for unknown: px
in the full-size set, px * 2 in the half-size, px * 3 in the third-size one. Left plays tele; right, made soft, wide.
Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.capture.facts import FACTS_FILE
from telewide.capture.images import read_image, write_image, write_pfm
from telewide.errors import InputError, UsageError
from telewide.files import write_text
from telewide.geometry.arrays import FloatImage
from telewide.simulate.degrade import shrink_and_enlarge

_LEFT, _RIGHT, _LEFT_DISPARITY = "view1.png", "view5.png", "disp1.png"


@dataclass(frozen=True)
class StereoTruth:
    """A rectified pair of equal cameras with the true disparity of its left view.

    Attributes:
        left: (H, W, 3) RGB float32 in [0, 1].
        right: (H, W, 3) RGB float32 in [0, 1].
        disparity_px: (H, W) float32, ``x_left - x_right``, NaN where unknown.
    """

    left: FloatImage
    right: FloatImage
    disparity_px: FloatImage


def middlebury_2006_scenes(root: Path) -> tuple[str, ...]:
    """List the scenes of a Middlebury 2006 folder.

    Args:
        root: holds one folder per scene.

    Returns:
        The names, sorted.

    Raises:
        UsageError: there is no such folder.
        InputError: it holds no scene.
    """
    if not root.is_dir():
        raise UsageError(f"{root} is no folder; the folder of the Middlebury 2006 scenes was expected")
    scenes = tuple(sorted(entry.parent.name for entry in root.glob(f"*/{_LEFT}")))
    if not scenes:
        raise InputError(f"{root} holds no scene; folders with {_LEFT}, {_RIGHT} and {_LEFT_DISPARITY} were expected")
    return scenes


def read_middlebury_2006(scene_folder: Path, *, scale_denominator: int) -> StereoTruth:
    """Read one scene of Middlebury 2006.

    Args:
        scene_folder: holds view1.png, view5.png and disp1.png.
        scale_denominator: 1 for the full-size set, 2 for half, 3 for third: what the bytes are divided by.

    Returns:
        The pair and its truth.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, or the three differ in size.
    """
    left, right = read_image(scene_folder / _LEFT), read_image(scene_folder / _RIGHT)
    disparity_px = _read_bytes_disparity(scene_folder / _LEFT_DISPARITY, scale_denominator)
    if not left.shape == right.shape == (*disparity_px.shape, 3):
        found = f"{left.shape[:2]}, {right.shape[:2]} and {disparity_px.shape}"
        raise InputError(f"{scene_folder}: the views and the disparity differ in size (height, width): {found}")
    return StereoTruth(left, right, disparity_px)


def write_middlebury_captures(
    root: Path, out: Path, *, scenes: Sequence[str], factor: float, scale_denominator: int = 3
) -> tuple[Path, ...]:
    """Write scenes of Middlebury 2006 as captures of unequal cameras.

    Each becomes ``<scene>/tele.png`` (left), ``wide.png`` (right, shrunk by `factor` and enlarged again, the size
    kept) and ``truth.pfm``; one ``captures.yaml`` goes with them.

    Args:
        root: holds one folder per scene.
        out: folder to write to.
        scenes: names of the scenes.
        factor: how much sharper tele is than wide, >= 1.
        scale_denominator: see `read_middlebury_2006`.

    Returns:
        The capture folders.

    Raises:
        UsageError: a scene that is not there, or a place that cannot be written.
        InputError: a file cannot be read.
    """
    known = middlebury_2006_scenes(root)
    unknown = [scene for scene in scenes if scene not in known]
    if unknown:
        raise UsageError(f"{root} has no scene {', '.join(unknown)}", hint=f"known scenes: {', '.join(known)}")
    for scene in scenes:
        truth = read_middlebury_2006(root / scene, scale_denominator=scale_denominator)
        write_image(out / scene / "tele.png", truth.left)
        write_image(out / scene / "wide.png", shrink_and_enlarge(truth.right, factor=factor))
        write_pfm(out / scene / "truth.pfm", truth.disparity_px)
    write_text(out / FACTS_FILE, f"format: 1\nrectified: true\nasymmetry: {float(factor)}\nreference: tele\n")
    return tuple(out / scene for scene in scenes)


def _read_bytes_disparity(path: Path, scale_denominator: int) -> FloatImage:
    levels = np.rint(read_image(path)[..., 0] * 255)
    return np.where(levels > 0, levels / scale_denominator, np.nan).astype(np.float32)
