"""Schema of a ``rig.yaml``, key by key."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from telewide.calibration.quality import Bound, Status, Verdict
from telewide.options import Options
from telewide.ranges import (
    MAX_BASELINE_M,
    MAX_CENTRE_SIDES,
    MAX_DISTORTION,
    MAX_FOCAL_SIDES,
    MAX_SIDE_PX,
    MIN_BASELINE_M,
)
from telewide.records import Line

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Orientation = Annotated[int, Field(ge=1, le=8)]
Row = tuple[Number, Number, Number]

_ROTATION_TOLERANCE = 1e-6
_BASELINE_TOLERANCE = 1e-3


class CameraStdSheet(Options):
    """Standard deviations of a camera."""

    f_px: Deviation
    cx_px: Deviation
    cy_px: Deviation
    distortion: tuple[Deviation, ...]
    aspect: Deviation = 0.0


class CameraSheet(Options):
    """A lens at one photo size."""

    width_px: Annotated[int, Field(gt=0, le=MAX_SIDE_PX)]
    height_px: Annotated[int, Field(gt=0, le=MAX_SIDE_PX)]
    fx_px: Positive
    fy_px: Positive
    cx_px: Number
    cy_px: Number
    distortion: tuple[Annotated[Number, Field(ge=-MAX_DISTORTION, le=MAX_DISTORTION)], ...]
    std: CameraStdSheet | None = None

    @model_validator(mode="after")
    def _is_of_a_lens(self) -> CameraSheet:
        side_px = max(self.width_px, self.height_px)
        if max(self.fx_px, self.fy_px) > MAX_FOCAL_SIDES * side_px:
            raise ValueError(f"fx_px and fy_px of at most {MAX_FOCAL_SIDES} times the longer side, {side_px} px")
        if max(abs(self.cx_px), abs(self.cy_px)) > MAX_CENTRE_SIDES * side_px:
            raise ValueError(f"cx_px and cy_px within {MAX_CENTRE_SIDES} times the longer side, {side_px} px")
        return self

    @field_validator("distortion")
    @classmethod
    def _has_a_length_of_opencv(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) not in (0, 4, 5, 8):
            raise ValueError(f"0, 4, 5 or 8 coefficients; found {len(value)}")
        return value


class RigStdSheet(Options):
    """Standard deviations of the rig; covariance of three turns in radians and three shifts in metres."""

    rotation_deg: tuple[Deviation, Deviation, Deviation]
    translation_m: tuple[Deviation, Deviation, Deviation]
    baseline_m: Deviation
    covariance_rad_m: Annotated[
        tuple[tuple[Number, Number, Number, Number, Number, Number], ...], Field(min_length=6, max_length=6)
    ]


class TransformSheet(Options):
    """From the tele camera's frame to the wide camera's."""

    rotation: tuple[Row, Row, Row]
    translation_m: Row
    std: RigStdSheet | None = None

    @field_validator("rotation")
    @classmethod
    def _turns(cls, value: tuple[Row, Row, Row]) -> tuple[Row, Row, Row]:
        R = np.array(value)
        if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
            raise ValueError("a rotation: three rows of length 1 at right angles, right-handed")
        return value


class CheckSheet(Options):
    """One question and its answer."""

    name: Line
    status: Status
    value: Number | None
    limit: Number | None
    advice: Line = ""
    unit: Line = ""
    bound: Bound = ""


class QualitySheet(Options):
    """Quality of the calibration."""

    verdict: Verdict
    tele_rms_px: Deviation | None
    wide_rms_px: Deviation | None
    epipolar_p50_px: Deviation | None
    epipolar_p90_px: Deviation | None
    epipolar_p99_px: Deviation | None
    cross_validation_px: Deviation | None
    checks: tuple[CheckSheet, ...] = ()


class RigSheet(Options):
    """A whole rig file."""

    format: Literal[1] = 1
    created_utc: Line | None = None
    source: Literal["boards", "scenes"] = "boards"
    board: Line | None = None
    image_pipeline: Line | None = None
    orientations: tuple[Orientation, Orientation] | None = None
    focus_distance_m: Positive | None = None
    scale_verified: bool = False
    is_scale_known: bool = True
    tele: CameraSheet
    wide: CameraSheet
    wide_from_tele: TransformSheet
    baseline_m: Positive
    n_joint_views: Annotated[int, Field(ge=0)] = 0
    left_out: tuple[Line, ...] = ()
    notes: tuple[Line, ...] = ()
    quality: QualitySheet

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> RigSheet:
        length_m = math.hypot(*self.wide_from_tele.translation_m)
        if not length_m >= MIN_BASELINE_M:
            raise ValueError(f"wide_from_tele.translation_m of {MIN_BASELINE_M} or more; found {length_m:g}")
        if abs(length_m - self.baseline_m) > _BASELINE_TOLERANCE * length_m:
            raise ValueError(
                f"baseline_m as long as wide_from_tele.translation_m, {length_m:.6g}; found {self.baseline_m:g}"
            )
        if length_m > MAX_BASELINE_M:
            raise ValueError(f"baseline_m in metres, at most {MAX_BASELINE_M}; found {length_m:g}")
        return self
