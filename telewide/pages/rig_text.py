"""A rig in words, for a terminal: one line a fact, standard deviations behind the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.result import CameraStd, TransformStd
from telewide.calibration.rig_file import StoredRig
from telewide.geometry.rig import Camera, StereoRig

_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def rig_lines(stored: StoredRig) -> tuple[str, ...]:
    """Describe a rig for people.

    Args:
        stored: what :func:`telewide.calibration.rig_file.read_rig` gave.

    Returns:
        Lines of text, an empty one between paragraphs.
    """
    rows = [
        ("verdict", stored.quality.verdict),
        *_cameras(stored),
        *_between(stored),
        *_quality(stored),
        *_origin(stored),
    ]
    width = max(len(name) for name, _ in rows) + 2
    checks = [line for check in stored.quality.checks for line in _check_lines(check)]
    out = [f"left out  {line}" for line in stored.left_out]
    notes = [f"note  {line}" for line in stored.facts.notes]
    lines = [f"{name:<{width}}{text}" for name, text in rows]
    for paragraph in (checks, out, notes):
        lines += ["", *paragraph] if paragraph else []
    return tuple(lines)


def summary_line(rig: StereoRig, quality: CalibrationQuality, *, baseline_std_m: float | None = None) -> str:
    """Say in one line what a calibration gave."""
    is_fit = math.isfinite(quality.tele_rms_px)  # a rig from scenes reprojects no corners
    words = [
        *(
            [f"reprojection {_px(quality.tele_rms_px)} (tele) and {_px(quality.wide_rms_px)} (wide) RMS"]
            if is_fit
            else []
        ),
        f"held-out epipolar error {_px(quality.epipolar_p90_px)} (90 % are below)"
        if math.isfinite(quality.epipolar_p90_px)
        else "nothing held out to judge by",
        f"f_tele / f_wide {rig.asymmetry:.3f}",
    ]
    if rig.is_scale_known:
        words.append(f"baseline {_plus_minus(rig.baseline_m * 1e3, _thousand(baseline_std_m), 'mm', decimals=2)}")
    return f"{quality.verdict}: {', '.join(words)}"


def distortion_words(camera: Camera, std: CameraStd | None) -> dict[str, str]:
    """Say what is known of each of a lens's distortion coefficients.

    Args:
        camera: the lens.
        std: how sure it is; None where that is unknown.

    Returns:
        By name of the coefficient: its value and deviation, or what it was held at. One that is exactly 0 was held.
    """
    values = camera.distortion
    deviations = np.full(len(values), np.nan) if std is None else std.distortion
    return {
        name: _coefficient(float(value), float(deviation))
        for name, value, deviation in zip(_COEFFICIENTS, values, deviations, strict=False)
    }


def _coefficient(value: float, deviation: float) -> str:
    if value == 0:
        return "fixed at 0"
    if deviation == 0:
        return f"fixed at {value:+.4g}"
    if not math.isfinite(deviation):
        return f"{value:+.4f}"
    decimals = max(4, 1 - math.floor(math.log10(deviation)))  # two figures of the deviation, however small
    return f"{value:+.{decimals}f} ± {deviation:.{decimals}f}"


def _check_lines(check: Check) -> Iterator[str]:
    """A check on a line of its own, and below it what to do."""
    limit = f", {check.limit_words}" if check.limit_words else ""
    yield f"{check.status}  {check.name}: {check.found_words}{limit}"
    if check.advice:
        yield f"      {check.advice}"


def _repeatability(cross_px: float) -> str:
    if not math.isfinite(cross_px):
        return "unknown: too few photos to calibrate with half of them"
    return f"rigs from one half of the photos and from the other are {cross_px:.2f} tele px apart"


def _cameras(stored: StoredRig) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    both: Sequence[tuple[str, Camera, CameraStd | None]] = (
        ("tele", stored.rig.tele, stored.tele_std),
        ("wide", stored.rig.wide, stored.wide_std),
    )
    for name, camera, std in both:
        focal = _plus_minus(camera.f_px, None if std is None else std.f_px, "px", decimals=1)
        cx = _plus_minus(float(camera.K[0, 2]), None if std is None else std.cx_px, "px", decimals=1)
        cy = _plus_minus(float(camera.K[1, 2]), None if std is None else std.cy_px, "px", decimals=1)
        terms = ", ".join(f"{k} {text}" for k, text in distortion_words(camera, std).items())
        rows += [
            (name, f"photos of {camera.hw[1]} x {camera.hw[0]} px, focal length {focal}"),
            ("", f"principal point {cx}, {cy}"),
            ("", f"distortion {terms if camera.distortion.any() else 'none'}"),
        ]
    return rows


def _between(stored: StoredRig) -> list[tuple[str, str]]:
    rig, std = stored.rig, stored.transform_std
    turn = _plus_minus(rig.turn_deg, None if std is None else _turn_std_deg(rig, std), "degrees", decimals=3)
    rows = [("f_tele / f_wide", f"{rig.asymmetry:.4f}"), ("turn between them", turn)]
    if rig.is_scale_known:
        baseline = _plus_minus(rig.baseline_m * 1e3, _thousand(std.baseline_m if std else None), "mm", decimals=2)
        unverified = "as stated" if stored.facts.source == "scenes" else "nominal"
        doubt = "" if stored.facts.scale_verified else f"  ({unverified}: nothing was measured)"
        rows.append(("baseline", f"{baseline}{doubt}"))
    else:
        rows.append(("baseline", "not known in metres"))
    return rows


def _turn_std_deg(rig: StereoRig, std: TransformStd) -> float:
    """Standard deviation of the turn's angle: that of small turns about its own axis."""
    turn = cv2.Rodrigues(rig.wide_from_tele[:3, :3])[0].ravel()
    angle_rad = float(np.linalg.norm(turn))
    if angle_rad == 0:  # no axis: as much as about any of the three
        return float(std.rotation_deg.max())
    axis = turn / angle_rad
    return math.degrees(math.sqrt(axis @ std.covariance[:3, :3] @ axis))


def _quality(stored: StoredRig) -> list[tuple[str, str]]:
    quality = stored.quality
    reprojection = f"{_px(quality.tele_rms_px)} (tele), {_px(quality.wide_rms_px)} (wide), RMS"
    return [
        *([("reprojection", reprojection)] if math.isfinite(quality.tele_rms_px) else []),
        (
            "epipolar error",
            f"{_px(quality.epipolar_p50_px)} median, {_px(quality.epipolar_p90_px)} 90 %, "
            f"{_px(quality.epipolar_p99_px)} 99 %, tele px, in photos held out",
        ),
        ("repeatability", _repeatability(quality.cross_validation_px)),
        ("joint views", str(stored.n_joint_views)),
    ]


def _origin(stored: StoredRig) -> list[tuple[str, str]]:
    facts = stored.facts
    focus = f"{facts.focus_distance_m:.3g} m" if facts.focus_distance_m is not None else None
    named = (
        ("made from", facts.source if facts.board is None else f"{facts.source}, {facts.board}"),
        ("images", facts.image_pipeline),
        ("focused at", focus),
        ("created", facts.created_utc),
    )
    return [(name, text) for name, text in named if text is not None]


def _plus_minus(value: float, std: float | None, unit: str, *, decimals: int) -> str:
    if std is None or not math.isfinite(std):
        return f"{value:.{decimals}f} {unit}"
    return f"{value:.{decimals}f} ± {std:.{decimals}f} {unit}"


def _thousand(value: float | None) -> float | None:
    return None if value is None else value * 1e3


def _px(value: float) -> str:
    return f"{value:.2f} px" if math.isfinite(value) else "unknown"
