"""Result of a calibration: the rig, how sure every number is, and what every photo had to do with it.

Standard deviations are one sigma. Board poses are ``tele_from_board``, metres. Letters: N corners seen in a view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from telewide.calibration.quality import CalibrationQuality
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig

Lens = Literal["tele", "wide"]


@dataclass(frozen=True)
class CameraStd:
    """Standard deviations of a camera.

    Attributes:
        f_px: of the mean focal length.
        cx_px: of the principal point, along x.
        cy_px: of the principal point, along y.
        distortion: (n,) of the coefficients, in their order; 0 where one is held at 0 and believed to be.
        aspect: of ``(fx - fy) / (fx + fy)``; 0 where pixels are taken as square.
    """

    f_px: float
    cx_px: float
    cy_px: float
    distortion: FloatArray
    aspect: float = 0.0


@dataclass(frozen=True)
class TransformStd:
    """Standard deviations of ``wide_from_tele``.

    Attributes:
        rotation_deg: (3,) of small turns about the wide camera's x, y and z axis.
        translation_m: (3,) of the translation.
        baseline_m: of the distance between the lenses.
        covariance: (6, 6) of the three turns, rad, and the translation, m; they are strongly correlated.
    """

    rotation_deg: FloatArray
    translation_m: FloatArray
    baseline_m: float
    covariance: FloatArray


@dataclass(frozen=True)
class ViewResult:
    """One photo of the board in the calibration.

    Attributes:
        shot: name of the shot.
        camera: which lens took it.
        rms_px: RMS distance of corner and reprojection, px of this photo; of a view left out: with the rig as solved
            and the board placed as well as can be. NaN where that cannot be said.
        n: number of corners seen.
        is_used: whether it took part.
        reason: why it was left out, for people; "" if it was used.
        ids: (N,) int64 corner ids.
        points_px: (N, 2) corners as detected.
        residuals_px: (N, 2) detected less reprojected.
        tilt_deg: angle between the board and the image plane; NaN where unknown.
        distance_m: distance of the board's middle along the optical axis; NaN where unknown.
        square_px: median distance of neighbouring corners in the photo.
        is_fit: whether it could have taken part, had it agreed with the others; False of a photo held otherwise, for
            instance.
    """

    shot: str
    camera: Lens
    rms_px: float
    n: int
    is_used: bool
    reason: str
    ids: NDArray[np.int64]
    points_px: FloatArray
    residuals_px: FloatArray
    tilt_deg: float
    distance_m: float
    square_px: float
    is_fit: bool = True


@dataclass(frozen=True)
class Calibration:
    """A rig and everything known about it.

    Attributes:
        rig: the rig, from all used views.
        tele_std: how sure the tele camera is.
        wide_std: how sure the wide camera is.
        transform_std: how sure ``wide_from_tele`` is.
        views: every photo in which the board was found, used or not, in the order of the shots, tele before wide.
        half_rigs: rigs from the odd and from the even views, for cross-validation; None with too few joint views.
        quality: what it is worth.
    """

    rig: StereoRig
    tele_std: CameraStd
    wide_std: CameraStd
    transform_std: TransformStd
    views: tuple[ViewResult, ...]
    half_rigs: tuple[StereoRig, StereoRig] | None
    quality: CalibrationQuality
