"""Rig from scenes: the rig, how sure each part of it is, and what was known before and besides.

Sides are those of the tele photo, held upright: wide stands to the right of tele where its centre has x > 0 in tele's
frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from telewide.calibration.quality import larger_than_usual
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig

Side = Literal["left", "right", "above", "below"]
SideSource = Literal["seen", "stated", "guessed", "contradicted"]
"""Contradicted: stated, and the matches show the opposite."""

SIDES: tuple[Side, ...] = get_args(Side)
CONTRADICTIONS = (1.0, 2.5)
"""Standard deviations from which on matches show a focal length that EXIF does not, and above which one is wrong."""
DIRECTIONS: dict[Side, tuple[float, float]] = {"right": (1, 0), "left": (-1, 0), "below": (0, 1), "above": (0, -1)}
"""Unit vectors of the photo, x right, y down."""
_STATED_BASELINE_STD_M = 0.0005
_STATED_BASELINE_STD_SHARE = 0.01


@dataclass(frozen=True)
class FocalPrior:
    """Knowledge of the focal lengths before any match is looked at.

    35 mm equivalents are whole millimetres, which is 1 % of a wide lens and a third of that of a tele; some makers take
    them by the photo's width and not its diagonal, and lenses differ. A wider prior lets a few captures with little
    depth bend the focal lengths by tens of per cent.

    Attributes:
        tele_f_px: of tele, px of its photos.
        wide_f_px: of wide, px of its photos.
        tele_std_share: standard deviation over the value.
        ratio_std_share: standard deviation of ``tele_f / wide_f`` over the value.
    """

    tele_f_px: float
    wide_f_px: float
    tele_std_share: float = 0.02
    ratio_std_share: float = 0.03


@dataclass(frozen=True)
class SceneStd:
    """Standard deviations of a rig from scenes.

    Attributes:
        tele_f_share: of tele's focal length, over its value; nearly that of EXIF, as matches hardly show it.
        ratio_share: of the ratio of the focal lengths, over its value.
        wide_centre_px: (2,) of wide's principal point, px of its photos.
        rotation_rad: (3,) of wide's rotation.
        direction_rad: (2,) of the baseline's direction: in the picture plane, and out of it.
        distortion: (2,) of the radial coefficient k1 of tele and of wide.
        tele_centre_px: (2,) of tele's principal point, px of its photos; matches hardly show it.
        zero_px: of the zero of disparity, tele px.
        baseline_m: of the distance of the lenses, m; 0 where that is not known and so of no length.
    """

    tele_f_share: float
    ratio_share: float
    wide_centre_px: FloatArray
    rotation_rad: FloatArray
    direction_rad: FloatArray
    distortion: FloatArray
    tele_centre_px: FloatArray
    zero_px: float
    baseline_m: float = 0.0


@dataclass(frozen=True)
class SceneRig:
    """A rig from scenes.

    Attributes:
        rig: the rig; its scale is known only where the baseline was stated.
        std: how sure it is.
        n_scenes: captures that had a say.
        side_source: how the side is known on which wide stands.
        focal: what was known of the focal lengths before.
        notes: what a person should know.
    """

    rig: StereoRig
    std: SceneStd
    n_scenes: int
    side_source: SideSource
    focal: FocalPrior
    notes: tuple[str, ...] = ()

    @property
    def wide_side(self) -> Side:
        """The side of tele on which the rig has wide, the nearest of the four."""
        return max(SIDES, key=lambda side: float(wide_centre(self.rig)[:2] @ DIRECTIONS[side]))

    @property
    def tele_f_contradiction(self) -> float:
        """Distance of tele's focal length from what was known before, in standard deviations of both together."""
        moved = math.log(self.rig.tele.f_px / self.focal.tele_f_px)
        return abs(moved) / math.hypot(self.focal.tele_std_share, self.std.tele_f_share)

    @property
    def ratio_contradiction(self) -> float:
        """Likewise of ``tele_f / wide_f``."""
        moved = math.log(self.rig.asymmetry * self.focal.wide_f_px / self.focal.tele_f_px)
        return abs(moved) / math.hypot(self.focal.ratio_std_share, self.std.ratio_share)


def stated_baseline_std_m(baseline_m: float) -> float:
    """Say how sure a stated distance of the lenses is: half a millimetre, or a hundredth of it where that is more.

    It was read off a ruler held against the phone, or off a drawing of its back: the middles of the windows, not where
    the lenses' entrance pupils lie. How many digits somebody typed says nothing about that.
    """
    return max(_STATED_BASELINE_STD_M, _STATED_BASELINE_STD_SHARE * baseline_m)


def scene_notes(found: SceneRig) -> Iterator[str]:
    """Give what a person should know of a rig from scenes, one sentence each."""
    if found.side_source == "guessed":
        yield (
            f"wide is taken to stand {place_words(found.wide_side)} tele, a guess: if near and far come out "
            "exchanged, it is the opposite; state it with `wide_side`"
        )
    if found.std.zero_px > larger_than_usual(found.rig.tele.hw):
        yield f"the zero of disparity is known to {found.std.zero_px:.0f} px only: pin it with a known distance"
    if found.rig.is_scale_known:
        yield (
            f"the baseline is {found.rig.baseline_m * 1e3:g} mm because that was stated; no photo shows it, and it is "
            f"taken to be known to {found.std.baseline_m * 1e3:.1g} mm"
        )
    else:
        yield "the baseline is not known: depth is relative"


def place_words(side: Side) -> str:
    """A side in words that "tele" may follow: "left of"."""
    return side if side in ("above", "below") else f"{side} of"


def wide_centre(rig: StereoRig) -> FloatArray:
    """(3,) where wide stands in tele's frame, in the unit of the rig."""
    return np.asarray(-rig.wide_from_tele[:3, :3].T @ rig.wide_from_tele[:3, 3])
