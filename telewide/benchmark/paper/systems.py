"""The systems that are compared, each an entry of `SYSTEMS`.

A system gets a task (what it may learn from, how the second view is damaged, a budget) and hands back matchers. One
that learns nothing ignores most of the task, and what it does not see does not count when its cells are kept.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from telewide.assets import BOX_WEIGHTS
from telewide.benchmark.damages import Damage, damaged_view
from telewide.benchmark.datasets.protocols import Scene
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.spaces import match_features
from telewide.errors import unknown_name
from telewide.geometry.arrays import ByteImage, FloatMap
from telewide.matching.filling import fill_rows
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.srgb import grey
from telewide.stages.match import read_matcher

Tell = Callable[[str], None]
Matcher = Callable[[FloatMap, FloatMap, Window], FloatMap]
"""(ref, src, window) to the filled disparity of ref, px."""
Encoder = Callable[[FloatMap], FloatMap]
"""View to its features, (H, W, C)."""

_PACKAGE = Path(__file__).resolve().parents[2]
_BLOCK = 5
_SGBM_STEP_PX = 16
_SGBM_FRACTION = 16
_PATCH_PX = 5


@dataclass(frozen=True)
class Task:
    """Data, damage and budget that a system is prepared for.

    Attributes:
        training: scenes to learn from; their truth is for supervised systems only.
        validation: scenes to choose weights by; may be empty.
        window: disparities to search, px.
        damage: of the second view.
        factor: how many times fewer pixels it has along each side.
        seed: of weights, samples and what is drawn of the damage.
        budget_min: minutes of training.
    """

    training: tuple[Scene, ...]
    validation: tuple[Scene, ...]
    window: Window
    damage: Damage
    factor: float
    seed: int
    budget_min: float

    def asymmetric(self, scene: str, truth: StereoTruth) -> StereoTruth:
        """Return a pair with its right view damaged.

        Args:
            scene: its name, on which depends what is drawn.
            truth: the pair.
        """
        right = damaged_view(truth.right, self.damage, factor=self.factor, scene=scene, seed=self.seed)
        return StereoTruth(truth.left, right, truth.disparity_px, truth.occluded)


@dataclass(frozen=True)
class System:
    """One row.

    Attributes:
        name: by which it is asked for.
        title: as it stands in tables.
        prepare: (task, folder of its own to keep what it learns in, tell) to matchers by the name of their weights:
            last and best, or one without a name.
        sources: modules of telewide that decide what it answers; a change to one of them makes its cells anew.
        files: what it reads besides, such as weights; a change makes its cells anew likewise.
        learns: whether training, validation and budget of the task matter.
        encoder: of a space of features, (task, folder, tell) to what makes them; None for a system that is none.
    """

    name: str
    title: str
    prepare: Callable[[Task, Path, Tell], Mapping[str, Matcher]]
    sources: tuple[str, ...]
    files: tuple[Path, ...] = ()
    learns: bool = True
    encoder: Callable[[Task, Path, Tell], Encoder] | None = None


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


def _comes_with_telewide() -> Mapping[str, Matcher]:
    """The network in the box."""
    match = read_matcher(BOX_WEIGHTS, method="network", device="auto").match
    return {"": lambda ref, src, window: match(ref, src, window=window).disparity_px}


_BOX_SOURCES = ("matching.guided", "matching.inference", "matching.sampling", "matching.volume")
_SYSTEMS = (
    System(
        "sgm-opencv",
        "SGM (OpenCV)",
        lambda _task, _folder, _tell: {"": match_like_opencv},
        ("benchmark.paper.systems", "matching.filling"),
        learns=False,
    ),
    System(
        "sgm",
        "sgm of telewide",
        lambda _task, _folder, _tell: {"": _match_semiglobal},
        ("matching.semiglobal", "matching.filling", "matching.subpixel"),
        learns=False,
    ),
    System(
        "ours",
        "telewide depth, as it comes",
        lambda _task, _folder, _tell: _comes_with_telewide(),
        _BOX_SOURCES,
        files=(BOX_WEIGHTS,),
        learns=False,
    ),
    System(
        "image-space",
        "Image",
        lambda _task, _folder, _tell: {"": _match_patches},
        sources=("benchmark.spaces",),
        learns=False,
        encoder=lambda _task, _folder, _tell: lambda view: view,
    ),
)
SYSTEMS: dict[str, System] = {system.name: system for system in _SYSTEMS}


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


def source_fingerprint(modules: Sequence[str]) -> str:
    """Fingerprint the source text of modules of telewide.

    Args:
        modules: names below ``telewide``.
    """
    digest = hashlib.sha256()
    for module in modules:
        digest.update((_PACKAGE / f"{module.replace('.', '/')}.py").read_bytes())
    return digest.hexdigest()


def _levels(view: FloatMap) -> ByteImage:
    return np.asarray(np.rint(np.clip(grey(view), 0, 1) * 255), np.uint8)
