"""Light fields of 9 by 9 views: the 4D benchmark of HCI and Konstanz, and the sparse synthetic set of Inria.

Views are numbered row by row from 0 to 80, 40 is the middle. Stored disparities are signed, px from one view to the
next; between two views of a row they grow with the distance. Honauer et al., A dataset and evaluation methodology for
depth estimation on 4D light fields (ACCV 2016); Shi, Jiang and Guillemot, A framework for learning depth from a
flexible subset of dense and sparse light field views (IEEE TIP 2019). Letters: H W image.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.levels import read_view
from telewide.benchmark.datasets.truth import StereoTruth, checked_truth, occluded_by_cross_check
from telewide.capture.pfm import read_pfm
from telewide.errors import InputError, UsageError
from telewide.files import is_there
from telewide.geometry.arrays import BoolMap, FloatMap
from telewide.npz import read_npy
from telewide.simulate.beside import seen_from_beside

SIDE = 9
MIDDLE = 40


def hci_scenes(root: Path) -> tuple[str, ...]:
    """List the scenes of the HCI set, sorted; they lie in `root` or one folder deeper (training, test ...)."""
    return tuple(sorted(_folders_with(root, _hci_view_name(MIDDLE))))


def read_hci(root: Path, scene: str, *, views: tuple[int, int]) -> StereoTruth:
    """Read two views of a scene of the HCI set.

    Args:
        root: holds the scenes, or folders of scenes.
        scene: its name.
        views: numbers of the left and the right view, of one row.

    Returns:
        The pair; all disparities are unknown where the set keeps them to itself. What is occluded follows from both
        disparities, or from the left view's alone where the right one has none: things that only the right view shows
        then hide nothing.

    Raises:
        UsageError: there is no such scene or view, or the views are not of one row.
        InputError: a file cannot be read, or they differ in size.
    """
    folder, steps = _scene_folder(root, scene, _hci_view_name(MIDDLE)), _steps(views)
    pictures = (folder / _hci_view_name(views[0]), folder / _hci_view_name(views[1]))
    return _pair(folder, pictures, tuple(_hci_disparity(folder, view) for view in views), steps=steps)


def inria_scenes(root: Path) -> tuple[str, ...]:
    """List the scenes of Inria's set, sorted."""
    return tuple(sorted(_folders_with(root, _inria_view_name(MIDDLE))))


def read_inria(root: Path, scene: str, *, views: tuple[int, int]) -> StereoTruth:
    """Read two views of a scene of Inria's set, whose every view has its disparity.

    Args:
        root: holds the scenes.
        scene: its name.
        views: numbers of the left and the right view, of one row.

    Raises:
        UsageError: there is no such scene or view, or the views are not of one row.
        InputError: a file cannot be read, or they differ in size.
    """
    folder, steps = _scene_folder(root, scene, _inria_view_name(MIDDLE)), _steps(views)
    pictures = (folder / _inria_view_name(views[0]), folder / _inria_view_name(views[1]))
    return _pair(folder, pictures, tuple(_inria_disparity(folder, view) for view in views), steps=steps)


def _pair(
    folder: Path, pictures: tuple[Path, Path], per_step_px: tuple[FloatMap | None, ...], *, steps: int
) -> StereoTruth:
    left, right = read_view(pictures[0]), read_view(pictures[1])
    of_left_px, of_right_px = (None if px is None else px * np.float32(steps) for px in per_step_px)
    if of_left_px is None:
        return StereoTruth(left, right, np.full(left.shape[:2], np.nan, np.float32))
    truth = checked_truth(folder, StereoTruth(left, right, of_left_px))
    if of_right_px is not None and of_right_px.shape == of_left_px.shape:
        return replace(truth, occluded=occluded_by_cross_check(of_left_px, of_right_px))
    return replace(truth, occluded=_occluded_by_left(truth))


def _occluded_by_left(truth: StereoTruth) -> BoolMap:
    """Find what the right view does not see, by the disparity of the left one alone.

    A pixel is hidden where a surface of the left view lies before its place in the right one, nearer by more than
    `telewide.simulate.beside.SURFACE_STEP_PX`, or where that place is outside. A slanted surface does not hide itself
    up to a slope of 0.6 px a column. Things that only the right view shows are not known: what they hide counts as
    visible.

    Returns:
        (H, W) bool; True as well where the disparity is unknown, which hides nothing.
    """
    beyond_px = np.float32(-2 * truth.disparity_px.shape[1])  # outside on the right, apart from every surface
    disparity_px = np.where(np.isnan(truth.disparity_px), beyond_px, truth.disparity_px)
    return seen_from_beside(truth.left, disparity_px).occluded


def _steps(views: tuple[int, int]) -> int:
    left, right = views
    if not all(0 <= view < SIDE**2 for view in views) or left // SIDE != right // SIDE or left >= right:
        raise UsageError(f"views {left} and {right}: two of one row were expected, such as {MIDDLE} and {MIDDLE + 4}")
    return right - left


def _hci_view_name(view: int) -> str:
    return f"input_Cam{view:03d}.png"


def _hci_disparity(folder: Path, view: int) -> FloatMap | None:
    """Disparity of one view: from the supplement with the maps of all views, or the set's own of the middle one."""
    path = folder / f"gt_disp_lowres_Cam{view:03d}.pfm"
    if not is_there(path) and view == MIDDLE:
        path = folder / "gt_disp_lowres.pfm"
    return read_pfm(path) if is_there(path) else None


def _inria_place(view: int) -> str:
    return f"{view // SIDE + 1}_{view % SIDE + 1}"


def _inria_view_name(view: int) -> str:
    return f"lf_{_inria_place(view)}.png"


def _inria_disparity(folder: Path, view: int) -> FloatMap | None:
    path = folder / f"disparity_{_inria_place(view)}.npy"
    if not is_there(path):
        return None
    stored = np.squeeze(read_npy(path))
    if stored.ndim != 2 or stored.dtype.kind not in "fiu":
        raise InputError(f"{path} holds {stored.dtype} of shape {stored.shape}; a map of numbers was expected")
    disparity_px = stored.astype(np.float32)
    return np.where(np.isfinite(disparity_px), disparity_px, np.float32(np.nan))


def _folders_with(root: Path, file: str) -> dict[str, Path]:
    """Scene folders in `root` or one folder deeper that hold a file, by their names."""
    return {path.parent.name: path.parent for pattern in (f"*/*/{file}", f"*/{file}") for path in root.glob(pattern)}


def _scene_folder(root: Path, scene: str, file: str) -> Path:
    folders = _folders_with(root, file)
    if scene not in folders:
        known = ", ".join(sorted(folders)) or "none"
        raise UsageError(f"{root} has no scene {scene}; {scene}/{file} was expected", hint=f"known scenes: {known}")
    return folders[scene]
