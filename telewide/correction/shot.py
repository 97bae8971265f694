"""What autofocus and stabilisation moved since the calibration, shot by shot, on top of a rig.

The wide is said to have moved, tele stays: its principal point across the baseline, a turn, its focal length. Vertical
means across the baseline: along y of the frame in which both views are rectified, whose x points from tele to wide.
``vertical_px = y_tele - y_wide`` there, in tele's pixels (both views at tele's focal length), 0 for a perfect rig.
Letters: N matches.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.correction.epipolar import rectified_axes
from telewide.geometry.rig import StereoRig, rigid_transform

FloatArray = NDArray[np.float64]


def _no_turn() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class ShotRefinement:
    """This shot's own correction of a rig; the default is no correction.

    Attributes:
        vertical_offset_px: ``y_tele - y_wide`` at the principal point that the rig leaves and this takes out, tele px.
        scale: what wide's focal length is multiplied with.
        rotation_vector: (3,) rad, turn of wide on top of the rig's, in wide's frame: ``R = exp(v) R_rig``.
        translation_direction: (3,) unit vector of ``wide_from_tele``'s translation; None keeps the rig's.
        vertical_offset_std_px: standard deviation of the offset; NaN where nothing was fitted.
        scale_std: likewise.
        rotation_std_rad: (3,) likewise; 0 for turns that are not part of the model.
        direction_std_rad: largest standard deviation of the translation's direction; 0 where it is the rig's.
        residual_before_px: median absolute vertical misfit of the held-out matches with the rig alone, tele px.
        residual_after_px: with this correction.
        n_matches: matches that agree with the correction, fitted and held out.
        is_fitted: False where the matches were too few, and this is the identity.
        is_at_once: False where wide stood elsewhere for this shot, so that the baseline's length is unknown.
        notes: one sentence for everything a person should know.
    """

    vertical_offset_px: float = 0.0
    scale: float = 1.0
    rotation_vector: FloatArray = field(default_factory=_no_turn)
    translation_direction: FloatArray | None = None
    vertical_offset_std_px: float = float("nan")
    scale_std: float = float("nan")
    rotation_std_rad: FloatArray = field(default_factory=_no_turn)
    direction_std_rad: float = 0.0
    residual_before_px: float = float("nan")
    residual_after_px: float = float("nan")
    n_matches: int = 0
    is_fitted: bool = False
    is_at_once: bool = True
    notes: tuple[str, ...] = ()

    @property
    def roll_rad(self) -> float:
        """The turn about wide's optical axis."""
        return float(self.rotation_vector[2])

    @property
    def roll_std_rad(self) -> float:
        """Standard deviation of the roll."""
        return float(self.rotation_std_rad[2])


def refined_rig(rig: StereoRig, refinement: ShotRefinement) -> StereoRig:
    """Apply this shot's correction to a rig.

    Args:
        rig: as calibrated, for photos of the shot's size.
        refinement: what :func:`fit_shot` found on top of it.

    Returns:
        The rig of this shot: wide's focal length and principal point, its rotation, and, where it was fitted, the
        direction of the translation. Tele and the length of the baseline stay; a turn moves no lens centre.
    """
    turn = np.asarray(cv2.Rodrigues(refinement.rotation_vector.reshape(3, 1))[0], dtype=np.float64)
    translation_m = turn @ rig.wide_from_tele[:3, 3]
    if refinement.translation_direction is not None:
        translation_m = rig.baseline_m * refinement.translation_direction
    K = rig.wide.K.copy()
    K[:2, :2] *= refinement.scale
    K[:2, 2] -= refinement.vertical_offset_px / rig.asymmetry * across_in_wide(rig)
    return replace(
        rig,
        wide=replace(rig.wide, K=K),
        wide_from_tele=rigid_transform(rotation=turn @ rig.wide_from_tele[:3, :3], translation=translation_m),
        is_scale_known=rig.is_scale_known and refinement.is_at_once,
    )


def across_in_wide(rig: StereoRig) -> FloatArray:
    """(2,) unit vector across the baseline, in the photo of wide."""
    across = (rig.wide_from_tele[:3, :3] @ rectified_axes(rig)[1])[:2]
    return np.asarray(across / np.linalg.norm(across))
