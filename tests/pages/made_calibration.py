"""A calibration written down by hand: a rig with round numbers, boards at known poses, residuals of known size."""

from __future__ import annotations

import dataclasses

import numpy as np

from telewide.calibration.quality import CalibrationQuality, Check, Verdict
from telewide.calibration.result import Calibration, CameraStd, TransformStd, ViewResult
from telewide.geometry.rig import Camera, StereoRig, rigid_transform

RESIDUAL_PX = {"tele": 0.2, "wide": 0.1}
CHECKS = (
    Check("joint views", "pass", 12, 8, "", unit="shots", bound="at least"),
    Check(
        "coverage of <wide>",
        "warn",
        0.41,
        0.6,
        "The wide photos leave the corners empty & dark: go there.",
        unit="share",
        bound="at least",
    ),
)
DROPPED_REASON = "blurred <badly>: 9.1 px"


def made_rig(*, tele_f_px: float = 3000.0, turn_rad: float = 0.01, is_scale_known: bool = True) -> StereoRig:
    """Focal lengths 3000 and 1000 px, 12 mm apart."""
    tele_K = np.array([[tele_f_px, 0, 799.5], [0, tele_f_px, 599.5], [0, 0, 1]])
    wide_K = np.array([[1000.0, 0, 639.5], [0, 1000, 479.5], [0, 0, 1]])
    return StereoRig(
        tele=Camera((1200, 1600), tele_K, np.array([0.05, -0.1, 0, 0, 0])),
        wide=Camera((960, 1280), wide_K, np.array([-0.1, 0.02, 0.001, 0, 0])),
        wide_from_tele=rigid_transform(
            rotation=np.array([0.0, turn_rad, 0.002]), translation=np.array([0.012, 0.0, 0.0])
        ),
        is_scale_known=is_scale_known,
    )


def made_calibration(
    *, n_shots: int = 12, verdict: Verdict = "usable", checks: tuple[Check, ...] = CHECKS, is_scale_known: bool = True
) -> Calibration:
    """Twelve joint shots, of which shot_03 is left out in the wide photo; the halves differ by 1 px in focal length."""
    rng = np.random.default_rng(7)
    rig = made_rig(is_scale_known=is_scale_known)
    y, x = np.mgrid[:6, :9]
    board_m = np.column_stack([x.ravel() - 4.0, y.ravel() - 2.5, np.zeros(54)]) * 0.024
    views: list[ViewResult] = []
    for number in range(n_shots):
        tilt = rng.uniform(-0.7, 0.7, 3)
        distance_m = rng.uniform(0.7, 2.0)
        place_m = np.array([*(rng.uniform(-0.1, 0.1, 2) * distance_m), distance_m])
        pose = rigid_transform(rotation=tilt, translation=place_m)
        in_tele_m = board_m @ pose[:3, :3].T + pose[:3, 3]
        in_wide_m = in_tele_m @ rig.wide_from_tele[:3, :3].T + rig.wide_from_tele[:3, 3]
        tilt_deg = float(np.degrees(np.arccos(abs(pose[2, 2]))))
        for lens, camera, points_m in (("tele", rig.tele, in_tele_m), ("wide", rig.wide, in_wide_m)):
            is_used = not (number == 3 and lens == "wide")
            residuals_px = rng.normal(0, RESIDUAL_PX[lens] / np.sqrt(2), (54, 2))
            views.append(
                ViewResult(
                    shot=f"shot_{number:02d}",
                    camera="tele" if lens == "tele" else "wide",
                    rms_px=float(np.sqrt((residuals_px**2).sum(axis=1).mean())) if is_used else 9.1,
                    n=54,
                    is_used=is_used,
                    reason="" if is_used else DROPPED_REASON,
                    ids=np.arange(54),
                    points_px=camera.project(points_m) + residuals_px,
                    residuals_px=residuals_px,
                    tilt_deg=tilt_deg,
                    distance_m=float(points_m[:, 2].mean()),
                    square_px=24.0,
                )
            )
    std = CameraStd(1.5, 2.0, 2.1, np.array([0.01, 0.05, 0.0, 0.0, 0.0]))
    return Calibration(
        rig=rig,
        tele_std=std,
        wide_std=dataclasses.replace(std, f_px=0.4),
        transform_std=TransformStd(np.full(3, 0.02), np.full(3, 1e-4), 5e-5, np.eye(6) * 1e-8),
        views=tuple(views),
        half_rigs=(rig, made_rig(tele_f_px=3001.0, is_scale_known=is_scale_known)),
        quality=CalibrationQuality(0.2, 0.1, 0.15, 0.42, 0.7, 0.3, checks, verdict),
    )
