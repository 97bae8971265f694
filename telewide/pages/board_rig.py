"""Content of the page about a rig from photos of a board."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from markupsafe import Markup

from telewide.calibration.result import Calibration, CameraStd, ViewResult
from telewide.geometry.rig import Camera
from telewide.pages.board_rig_charts import (
    board_depth_errors,
    coverage_figures,
    cross_validation_figures,
    epipolar_figure,
    pose_figure,
    residual_figures,
    view_figures,
)
from telewide.pages.page import html_part
from telewide.pages.report import NextStep
from telewide.pages.rig_page import RectifiedViews, RigPage, Section, rectified_section
from telewide.pages.rig_text import distortion_words


def board_rig_page(
    calibration: Calibration,
    *,
    facts: Mapping[str, str],
    next_steps: Sequence[NextStep] = (),
    rectified: RectifiedViews | None = None,
) -> RigPage:
    """Compose the page about a calibration.

    Args:
        calibration: what to show.
        facts: where it comes from: board, photos, version.
        next_steps: commands worth running now.
        rectified: a rectified pair; None leaves it out.
    """
    quality, views = calibration.quality, calibration.views
    charts = "charts"
    return RigPage(
        title="Calibration",
        heading="Calibration of a wide and a tele lens",
        usable="Usable: it works, and the warnings below say what would make it better.",
        quality=quality,
        summary=_summary(calibration),
        sections=(
            Section("The rig", _rig_table(calibration), judged_by=("focal length",)),
            Section("Coverage", coverage_figures(calibration), charts, ("coverage",)),
            Section("Residuals", residual_figures(calibration), charts, ("reprojection", "contradiction")),
            Section("Photos", view_figures(calibration), charts, ("photos used", "both photos", "left out")),
            Section("Left out", _left_out_table(views)),
            Section("Repeatability", cross_validation_figures(calibration), charts, ("half the photos",)),
            Section("Held-out epipolar error", epipolar_figure(quality), charts, ("epipolar",)),
            Section("Depth error", board_depth_errors(calibration), judged_by=("distance of the lenses",)),
            rectified_section(rectified, missing=Markup()),
            Section("How the board was held", pose_figure(views), charts, ("tilted", "farthest", "size of a square")),
        ),
        next_steps=next_steps,
        facts=facts,
    )


def _summary(calibration: Calibration) -> str:
    rig, quality = calibration.rig, calibration.quality
    n_used = sum(view.is_used for view in calibration.views)
    words = [
        f"{n_used} of {len(calibration.views)} photos used",
        f"reprojection {quality.tele_rms_px:.2f} px (tele) and {quality.wide_rms_px:.2f} px (wide) RMS",
        f"tele is {rig.asymmetry:.3f} times as long as wide",
    ]
    if rig.is_scale_known:
        std_mm = calibration.transform_std.baseline_m * 1e3
        words.append(f"lenses {rig.baseline_m * 1e3:.2f} ± {std_mm:.2f} mm apart")
    return "; ".join(words) + "."


def _rig_table(calibration: Calibration) -> Markup:
    rig = calibration.rig
    tele, wide = _camera_cells(rig.tele, calibration.tele_std), _camera_cells(rig.wide, calibration.wide_std)
    rows = [[name, tele.get(name, "-"), wide.get(name, "-")] for name in {**tele, **wide}]
    notes = [_transform_words(calibration)]
    return html_part("noted_table", head=["", "tele", "wide"], rows=rows, notes=notes)


def _camera_cells(camera: Camera, std: CameraStd) -> dict[str, str]:
    cells = {
        "photo": f"{camera.hw[1]} x {camera.hw[0]} px",
        "focal length": _with_std(camera.f_px, std.f_px, "px"),
        "principal point x": _with_std(float(camera.K[0, 2]), std.cx_px, "px"),
        "principal point y": _with_std(float(camera.K[1, 2]), std.cy_px, "px"),
    }
    return cells | (distortion_words(camera, std) if camera.distortion.any() else {})


def _transform_words(calibration: Calibration) -> str:
    rig, std = calibration.rig, calibration.transform_std
    std_text = " ".join(f"{value:.3f}" for value in std.rotation_deg)
    words = f"The lenses are turned against each other by {rig.turn_deg:.3f} degrees (± {std_text} about x, y, z)"
    if not rig.is_scale_known:
        return f"{words}; their distance is not known in metres."
    x_mm, y_mm, z_mm = rig.wide_from_tele[:3, 3] * 1e3
    sigma = " ".join(f"{value * 1e3:.2f}" for value in std.translation_m)
    return (
        f"{words}; tele's centre lies at {x_mm:.2f} {y_mm:.2f} {z_mm:.2f} mm (± {sigma}) of the wide camera. "
        "All ± are one standard deviation."
    )


def _left_out_table(views: Sequence[ViewResult]) -> Markup:
    rows = [[view.shot, view.camera, _figure(view.rms_px), view.reason] for view in views if not view.is_used]
    head = ["shot", "photo", "RMS, px", "why"]
    return html_part("table", head=head, rows=rows, words=[3]) if rows else Markup()


def _with_std(value: float, std: float, unit: str) -> str:
    return f"{value:.1f} ± {std:.1f} {unit}" if math.isfinite(std) else f"{value:.1f} {unit}"


def _figure(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
