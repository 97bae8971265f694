"""The stereo sets of Middlebury College: 2001, 2003, 2005 and 2006, 2014.

The first four store disparities as bytes, 0 for unknown, multiplied by a scale that goes with the size of the pictures.
Scharstein and Szeliski, A taxonomy and evaluation of dense two-frame stereo (IJCV 2002); the same, High-accuracy
stereo depth maps using structured light (CVPR 2003); Scharstein and Pal, Learning conditional random fields for stereo
(CVPR 2007); Hirschmueller and Scharstein, Evaluation of cost functions for stereo matching (CVPR 2007); Scharstein et
al., High-resolution stereo datasets with subpixel-accurate ground truth (GCPR 2014). Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.levels import picture_path, read_levels, read_scaled_disparity, read_view
from telewide.benchmark.datasets.truth import StereoTruth, checked_truth, occluded_by_cross_check
from telewide.capture.facts import FACTS_FILE
from telewide.capture.images import write_image
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.errors import InputError, UsageError
from telewide.files import is_file, is_folder, is_there, write_text
from telewide.geometry.arrays import BoolMap, FloatMap
from telewide.simulate.degrade import shrink_and_enlarge

_LEFT, _RIGHT, _LEFT_DISPARITY = "view1.png", "view5.png", "disp1.png"
_VIEWS_2006 = range(7)
_FULL_WIDTH_2003_PX = 1800
_VISIBLE, _OCCLUDED = 255, 128


@dataclass(frozen=True)
class _Names:
    """Names of the files of one layout, without suffix, and what its disparities are divided by."""

    left: str
    right: str
    disparity: str
    scale: float
    right_disparity: str | None = None


_LAYOUTS_2001 = (
    _Names(left="im2", right="im6", disparity="disp2", scale=8, right_disparity="disp6"),
    _Names(left="im0", right="im1", disparity="disp0", scale=8, right_disparity="disp1"),  # the scene called map
    _Names("scene1.row3.col3", "scene1.row3.col4", "truedisp.row3.col3", 16),  # Tsukuba
    _Names("left", "right", "groundtruth", 16),  # Tsukuba, renamed
)


def scenes_2001(root: Path) -> tuple[str, ...]:
    """List the scenes of a Middlebury 2001 folder, sorted."""
    return tuple(sorted(e.name for e in root.iterdir() if is_folder(e) and _layout_2001(e) is not None))


def read_middlebury_2001(scene_folder: Path) -> StereoTruth:
    """Read one scene of Middlebury 2001.

    Args:
        scene_folder: holds im2, im6, disp2 and disp6; for Tsukuba, the views of columns 3 and 4 and truedisp.

    Raises:
        UsageError: there is no such scene.
        InputError: a file cannot be read, or they differ in size.
    """
    names = _layout_2001(scene_folder)
    if names is None:
        raise UsageError(f"{scene_folder} holds no scene of Middlebury 2001; im2, im6 and disp2 were expected")
    return _read_bytes_scene(scene_folder, names)


def scenes_2003(root: Path) -> tuple[str, ...]:
    """List the scenes of a Middlebury 2003 folder, sorted."""
    return tuple(sorted(e.name for e in root.iterdir() if is_folder(e) and picture_path(e, "disp2") is not None))


def read_middlebury_2003(scene_folder: Path) -> StereoTruth:
    """Read one scene of Middlebury 2003 of any of its sizes: full, half or quarter, told by the width.

    Args:
        scene_folder: holds im2, im6, disp2 and, where there is one, disp6 or occl (0 where occluded or unknown).

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, or they differ in size.
    """
    path = picture_path(scene_folder, "disp2")
    if path is None:
        raise UsageError(f"{scene_folder} holds no scene of Middlebury 2003; im2, im6 and disp2 were expected")
    scale = max(1, round(_FULL_WIDTH_2003_PX / read_levels(path).shape[1]))
    truth = _read_bytes_scene(
        scene_folder, _Names(left="im2", right="im6", disparity="disp2", scale=scale, right_disparity="disp6")
    )
    mask_path = picture_path(scene_folder, "occl")
    if mask_path is None:
        return truth
    occluded = read_levels(mask_path) != _VISIBLE
    return checked_truth(scene_folder, StereoTruth(truth.left, truth.right, truth.disparity_px, occluded))


def middlebury_2006_scenes(root: Path) -> tuple[str, ...]:
    """List the scenes of a Middlebury 2005 or 2006 folder.

    Args:
        root: holds one folder per scene.

    Returns:
        The names, sorted.

    Raises:
        UsageError: there is no such folder.
        InputError: it holds no scene.
    """
    if not is_folder(root):
        raise UsageError(f"{root} is no folder; the folder of the Middlebury 2006 scenes was expected")
    scenes = tuple(sorted(entry.parent.name for entry in root.glob(f"*/{_LEFT}")))
    if not scenes:
        raise InputError(f"{root} holds no scene; folders with {_LEFT}, {_RIGHT} and {_LEFT_DISPARITY} were expected")
    return scenes


def read_middlebury_2006(scene_folder: Path, *, scale_denominator: int, right_view: int = 5) -> StereoTruth:
    """Read one scene of Middlebury 2005 or 2006.

    Args:
        scene_folder: holds view1.png (left), view5.png (right), disp1.png and, for what is occluded, disp5.png. Three
            scenes of 2005 have no disparities: all is unknown there.
        scale_denominator: 1 for the full-size set, 2 for half, 3 for third: what the bytes are divided by.
        right_view: which of the seven equally spaced views is the right one; disparities shrink with the distance.

    Returns:
        The pair and its truth.

    Raises:
        UsageError: a file does not exist, or there is no such view.
        InputError: a file cannot be read, or they differ in size.
    """
    if right_view not in _VIEWS_2006 or right_view < 2:
        raise UsageError(f"view {right_view} of {scene_folder}: a view to the right of view 1, 2 to 6, was expected")
    left, right = read_view(scene_folder / _LEFT), read_view(scene_folder / f"view{right_view}.png")
    stored = scene_folder / _LEFT_DISPARITY
    if not is_there(stored):
        return StereoTruth(left, right, np.full(left.shape[:2], np.nan, np.float32))
    of_view5_px = read_scaled_disparity(stored, scale=scale_denominator)
    occluded = None
    if right_view == 5 and is_there(path := scene_folder / "disp5.png"):
        occluded = _cross_checked(scene_folder, of_view5_px, read_scaled_disparity(path, scale=scale_denominator))
    disparity_px = (of_view5_px * ((right_view - 1) / 4)).astype(np.float32)
    return checked_truth(scene_folder, StereoTruth(left, right, disparity_px, occluded))


def scenes_2014(root: Path) -> tuple[str, ...]:
    """List the scenes of a Middlebury 2014 folder, sorted."""
    return tuple(sorted(e.name for e in root.iterdir() if is_folder(e) and is_file(e / "im0.png")))


def read_middlebury_2014(scene_folder: Path) -> StereoTruth:
    """Read one scene of Middlebury 2014, or of the stereo evaluation of its third version.

    Args:
        scene_folder: holds im0.png, im1.png and disp0.pfm or disp0GT.pfm; mask0nocc.png, or else the right view's
            disparity, tells what is occluded.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, or they differ in size.
    """
    left, right = read_view(scene_folder / "im0.png"), read_view(scene_folder / "im1.png")
    disparity_px = read_pfm(_pfm_2014(scene_folder, 0))
    mask_path, right_path = scene_folder / "mask0nocc.png", _pfm_2014(scene_folder, 1)
    occluded = None
    if is_there(mask_path):
        occluded = read_levels(mask_path) == _OCCLUDED
    elif is_there(right_path):
        occluded = _cross_checked(scene_folder, disparity_px, read_pfm(right_path))
    return checked_truth(scene_folder, StereoTruth(left, right, disparity_px, occluded))


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


def _layout_2001(folder: Path) -> _Names | None:
    return next((names for names in _LAYOUTS_2001 if picture_path(folder, names.disparity) is not None), None)


def _read_bytes_scene(folder: Path, names: _Names) -> StereoTruth:
    paths = {stem: picture_path(folder, stem) for stem in (names.left, names.right, names.disparity)}
    for stem, path in paths.items():
        if path is None:
            raise UsageError(f"{folder} holds no {stem}; {', '.join(paths)} were expected as .png, .ppm or .pgm")
    left, right, stored = (path for path in paths.values() if path is not None)
    disparity_px = read_scaled_disparity(stored, scale=names.scale)
    occluded = None
    if names.right_disparity and (path := picture_path(folder, names.right_disparity)) is not None:
        occluded = _cross_checked(folder, disparity_px, read_scaled_disparity(path, scale=names.scale))
    return checked_truth(folder, StereoTruth(read_view(left), read_view(right), disparity_px, occluded))


def _cross_checked(folder: Path, left_px: FloatMap, right_px: FloatMap) -> BoolMap:
    if left_px.shape != right_px.shape:
        raise InputError(
            f"{folder}: the disparities of the two views differ in size: {left_px.shape}, {right_px.shape}"
        )
    return occluded_by_cross_check(left_px, right_px)


def _pfm_2014(folder: Path, view: int) -> Path:
    evaluated = folder / f"disp{view}GT.pfm"
    return evaluated if is_there(evaluated) else folder / f"disp{view}.pfm"
