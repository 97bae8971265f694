"""The systems that are compared, each an entry of `SYSTEMS`.

Those that learn come from ``benchmark/learned.yaml``, the others are written here.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.learned import read_learned_systems
from telewide.benchmark.paper.corrected import corrected_view
from telewide.benchmark.paper.learned_rows import learned_row
from telewide.benchmark.paper.sources import BOX_NETWORK
from telewide.benchmark.paper.system import Matcher, Place, Prepared, System, Task
from telewide.benchmark.spaces import match_features
from telewide.errors import unknown_name
from telewide.geometry.arrays import ByteImage, FloatMap
from telewide.matching.filling import fill_rows
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.srgb import grey
from telewide.stages.match import read_matcher

_BLOCK = 5
_SGBM_STEP_PX = 16
_SGBM_FRACTION = 16
_PATCH_PX = 5


def match_like_opencv(ref: FloatMap, src: FloatMap, window: Window) -> FloatMap:
    """Semi-global matching as OpenCV's users have it, with the parameters of its examples; holes filled by rows.

    Args:
        ref: (H, W, 3) RGB float32 in [0, 1].
        src: likewise.
        window: disparities to search, px.
    """
    n_disparities = -(-(window[1] - window[0]) // _SGBM_STEP_PX) * _SGBM_STEP_PX
    matcher = cv2.StereoSGBM.create(
        minDisparity=window[0],
        numDisparities=n_disparities,
        blockSize=_BLOCK,
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    found_px = np.asarray(matcher.compute(_levels(ref), _levels(src)), np.float32) / _SGBM_FRACTION
    return fill_rows(np.where(found_px < window[0], np.float32(np.nan), found_px))


def _match_patches(ref: FloatMap, src: FloatMap, window: Window) -> FloatMap:
    return match_features(ref, src, window=window, patch_px=_PATCH_PX)


def _match_semiglobal(ref: FloatMap, src: FloatMap, window: Window) -> FloatMap:
    return match_semiglobal(ref, src, window=window).disparity_px


def _spaced(_task: Task, _place: Place) -> Prepared:
    return Prepared({"": _match_patches}, encoder=lambda view: view)


def _comes_with_telewide(task: Task, _place: Place) -> Prepared:
    """The network in the box, on pairs corrected as depth corrects them."""
    match = read_matcher(BOX_WEIGHTS, method="network", device=task.device).match
    answer: Matcher = lambda ref, src, window: match(ref, src, window=window).disparity_px  # noqa: E731
    return Prepared({"": answer}, corrected_view(task))


_WITHOUT_LEARNING = {
    "sgm-opencv": System(
        "sgm-opencv",
        "SGM (OpenCV)",
        lambda _task, _place: Prepared({"": match_like_opencv}),
        ("benchmark.paper.systems:sgm-opencv",),
        learns=False,
    ),
    "sgm": System(
        "sgm",
        "sgm of telewide",
        lambda _task, _place: Prepared({"": _match_semiglobal}),
        ("benchmark.paper.systems:sgm",),
        learns=False,
    ),
    "ours": System(
        "ours",
        "telewide depth, as it comes",
        _comes_with_telewide,
        ("benchmark.paper.systems:ours", f"matching.networks:{BOX_NETWORK}"),
        files=(BOX_WEIGHTS,),
        learns=False,
    ),
    "image-space": System("image-space", "Image", _spaced, ("benchmark.paper.systems:image-space",), learns=False),
}
SYSTEMS: dict[str, System] = _WITHOUT_LEARNING | {
    name: learned_row(name, system) for name, system in read_learned_systems().items()
}


def find_systems(names: Sequence[str]) -> list[System]:
    """Find systems by their names.

    Args:
        names: of systems.

    Raises:
        UsageError: there is no such system; the nearest name is told.
    """
    for name in names:
        if name not in SYSTEMS:
            raise unknown_name("system", name, SYSTEMS)
    return [SYSTEMS[name] for name in names]


def _levels(view: FloatMap) -> ByteImage:
    return np.asarray(np.rint(np.clip(grey(view), 0, 1) * 255), np.uint8)
