"""The stereo sets of KITTI: 2012 (grey or colour) and 2015.

A frame lies in several folders under one name, ``000000_10.png``: two views, and disparities times 256 in 16 bits, 0
for unknown, once with what the right view does not see (occ) and once without (noc). Geiger, Lenz and Urtasun, Are we
ready for autonomous driving? (CVPR 2012); Menze and Geiger, Object scene flow for autonomous vehicles (CVPR 2015).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.levels import read_scaled_disparity, read_view
from telewide.benchmark.datasets.truth import StereoTruth, checked_truth
from telewide.errors import UsageError
from telewide.files import is_file, is_folder, is_there
from telewide.geometry.arrays import FloatMap

_SCALE = 256
_FIRST_OF_TWO_MOMENTS = "*_10.png"
WHOLE_PX_FRAME = "frame"
_WHOLE_PX_FILES = ("reference.png", "target.png", "ground-truth.png")


@dataclass(frozen=True)
class KittiLayout:
    """Folders below ``training``.

    Attributes:
        views: pairs of folders of the left and right views, the preferred first.
        all_known: disparities with what is occluded.
        visible: disparities without.
    """

    views: tuple[tuple[str, str], ...]
    all_known: str
    visible: str


KITTI_2012 = KittiLayout((("colored_0", "colored_1"), ("image_0", "image_1")), "disp_occ", "disp_noc")
KITTI_2015 = KittiLayout((("image_2", "image_3"),), "disp_occ_0", "disp_noc_0")


def kitti_frames(root: Path, layout: KittiLayout) -> tuple[str, ...]:
    """List the frames with truth, sorted: ``000000_10``.

    Args:
        root: the set, or its folder ``training``.
        layout: of which year.
    """
    folder = _training(root) / layout.all_known
    return tuple(sorted(path.stem for path in folder.glob(_FIRST_OF_TWO_MOMENTS)))


def read_kitti(root: Path, frame: str, *, layout: KittiLayout) -> StereoTruth:
    """Read one frame of KITTI's stereo sets.

    Args:
        root: the set, or its folder ``training``.
        frame: such as ``000000_10``.
        layout: of which year.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, they differ in size, or the disparities have no 16 bits.
    """
    training, name = _training(root), f"{frame}.png"
    views = next((pair for pair in layout.views if is_file(training / pair[0] / name)), None)
    if views is None:
        expected = " or ".join(pair[0] for pair in layout.views)
        raise UsageError(f"{training} holds no frame {frame}; {expected}/{name} was expected")
    disparity_px = _disparity(training / layout.all_known / name)
    visible_path = training / layout.visible / name
    occluded = np.isnan(_disparity(visible_path)) & ~np.isnan(disparity_px) if is_there(visible_path) else None
    left, right = (read_view(training / folder / name) for folder in views)
    return checked_truth(training / layout.all_known / name, StereoTruth(left, right, disparity_px, occluded))


def whole_px_frame(root: Path) -> tuple[str, ...]:
    """List the one frame that a folder holds as some examples carry it: reference, target, ground-truth.

    Args:
        root: the folder.
    """
    return (WHOLE_PX_FRAME,) if all(is_file(root / name) for name in _WHOLE_PX_FILES) else ()


def read_whole_px_frame(root: Path) -> StereoTruth:
    """Read one frame whose disparities are whole px in 8 bits, 0 for unknown.

    Args:
        root: holds ``reference.png``, ``target.png`` and ``ground-truth.png``.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, they differ in size, or the disparities have no 8 bits.
    """
    left, right = (read_view(root / name) for name in _WHOLE_PX_FILES[:2])
    disparity_px = read_scaled_disparity(root / _WHOLE_PX_FILES[2], scale=1)
    return checked_truth(root, StereoTruth(left, right, disparity_px))


def _training(root: Path) -> Path:
    return root / "training" if is_folder(root / "training") else root


def _disparity(path: Path) -> FloatMap:
    return read_scaled_disparity(path, scale=_SCALE, bits=16)
