"""The page about a calibration: can it be trusted, why, and what to photograph next. One file that opens offline.

Every figure says in its caption what good looks like, for readers who calibrate once a year.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.result import Calibration, CameraStd, ViewResult
from telewide.drawing import fitted_wh, scaled_image
from telewide.files import write_text
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rig import Camera
from telewide.pages.charts import CHART_STYLE
from telewide.pages.report import (
    NextStep,
    facts_html,
    next_step_html,
    page_html,
    picture_html,
    section_html,
    thumbnail,
)
from telewide.pages.rig_charts import (
    coverage_figures,
    cross_validation_figures,
    depth_figure,
    epipolar_figure,
    pose_figure,
    residual_figures,
    view_figures,
)
from telewide.pages.rig_checks import CHECKS_STYLE, advice_html, checks_html
from telewide.pages.rig_text import distortion_words

_SCAN_LINES = 15
_VIEW_WIDTH_PX = 720
_CHECKS_OF = {
    "The rig": ("focal length",),
    "Coverage": ("coverage",),
    "Residuals": ("reprojection", "contradiction"),
    "Photos": ("photos used", "both photos", "left out"),
    "Repeatability": ("half the photos",),
    "Held-out epipolar error": ("epipolar",),
    "Depth error": ("distance of the lenses",),
    "How the board was held": ("tilted", "farthest", "size of a square"),
}
"""Sections of the page, and words in the names of the checks that judge what they show."""
_VERDICTS = {
    "good": "Good: every check passed.",
    "usable": "Usable: it works, and the warnings below say what would make it better.",
    "insufficient": "Not good enough: depth from this rig cannot be trusted. Below is what to photograph next.",
}


def write_rig_report(
    path: Path,
    calibration: Calibration,
    *,
    facts: Mapping[str, str],
    next_steps: Sequence[NextStep] = (),
    rectified: tuple[str, FloatMap, FloatMap] | None = None,
) -> Path:
    """Write the report of a calibration as one HTML file.

    Args:
        path: of the file.
        calibration: what to show.
        facts: where it comes from: board, photos, version.
        next_steps: commands worth running now.
        rectified: name, tele and wide of a rectified pair of one size, (H, W, 3) RGB in [0, 1]; None leaves it out.

    Returns:
        The path.
    """
    write_text(path, rig_report_html(calibration, facts=facts, next_steps=next_steps, rectified=rectified))
    return path


def rig_report_html(
    calibration: Calibration,
    *,
    facts: Mapping[str, str],
    next_steps: Sequence[NextStep],
    rectified: tuple[str, FloatMap, FloatMap] | None,
) -> str:
    """Compose the page of :func:`write_rig_report`; every word given is escaped."""
    quality = calibration.quality
    sections = [
        "<h1>Calibration of a wide and a tele lens</h1>",
        f'<p class="verdict {quality.verdict}">{_VERDICTS[quality.verdict]}<br>{_summary(calibration)}</p>',
        section_html("Checks", checks_html(quality.checks)),
        section_html("What next", advice_html(quality.checks) + "".join(map(next_step_html, next_steps))),
        section_html(_marked("The rig", quality), _rig_html(calibration)),
        section_html(_marked("Coverage", quality), coverage_figures(calibration), css_class="charts"),
        section_html(_marked("Residuals", quality), residual_figures(calibration), css_class="charts"),
        section_html(_marked("Photos", quality), view_figures(calibration), css_class="charts"),
        section_html("Left out", _left_out_html(calibration.views)),
        section_html(_marked("Repeatability", quality), cross_validation_figures(calibration), css_class="charts"),
        section_html(_marked("Held-out epipolar error", quality), epipolar_figure(quality), css_class="charts"),
        section_html(_marked("Depth error", quality), depth_figure(calibration)),
        section_html("A rectified pair", _rectified_html(rectified)),
        section_html(_marked("How the board was held", quality), pose_figure(calibration.views), css_class="charts"),
        section_html("Made by", facts_html(facts)),
    ]
    return page_html("Calibration", sections, extra_style=CHART_STYLE + CHECKS_STYLE)


def scan_lines_picture(tele: FloatMap, wide: FloatMap) -> FloatMap:
    """Put a rectified pair side by side with lines across both: what lies on a line in one must lie on it in the other.

    Args:
        tele: (H, W, 3) RGB in [0, 1].
        wide: (H, W, 3) likewise.

    Returns:
        (h, 2 w + gap, 3) RGB in [0, 1], as large as it is shown.
    """
    wh = fitted_wh((tele.shape[1], tele.shape[0]), box_wh=(_VIEW_WIDTH_PX, _VIEW_WIDTH_PX))
    shown = [scaled_image(np.nan_to_num(view), wh=wh) for view in (tele, wide)]
    gap = np.zeros((wh[1], 8, 3), dtype=np.float32)
    picture = np.concatenate([shown[0], gap, shown[1]], axis=1)
    rows = np.linspace(0, wh[1], _SCAN_LINES + 2)[1:-1].astype(int)
    picture[rows] = 0.1 * picture[rows] + 0.9 * np.array([1.0, 0.45, 0.1], dtype=np.float32)
    return picture.astype(np.float32)


def _marked(heading: str, quality: CalibrationQuality) -> str:
    """A heading with the worst outcome of the checks that judge what is below it."""
    words = _CHECKS_OF[heading]
    outcomes = {check.status for check in quality.checks if any(word in check.name for word in words)}
    worst = next((status for status in ("fail", "warn", "pass") if status in outcomes), None)
    return heading if worst is None else f'{heading} <span class="mark {worst}">{worst}</span>'


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
        words.append(f"lenses {rig.baseline_m * 1e3:.2f} &plusmn; {std_mm:.2f} mm apart")
    return "; ".join(words) + "."


def _rig_html(calibration: Calibration) -> str:
    rig = calibration.rig
    columns = [
        _camera_cells(rig.tele, calibration.tele_std),
        _camera_cells(rig.wide, calibration.wide_std),
    ]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = "".join(
        f'<tr><th scope="row">{name}</th>'
        + "".join(f"<td>{column.get(name, '-')}</td>" for column in columns)
        + "</tr>\n"
        for name in names
    )
    table = f"<table><thead><tr><th></th><th>tele</th><th>wide</th></tr></thead>\n<tbody>{rows}</tbody></table>"
    return f'<div class="scroll">{table}</div><p class="faint">{_transform_words(calibration)}</p>'


def _camera_cells(camera: Camera, std: CameraStd) -> dict[str, str]:
    cells = {
        "photo": f"{camera.hw[1]} x {camera.hw[0]} px",
        "focal length": _with_std(camera.f_px, std.f_px, "px"),
        "principal point x": _with_std(float(camera.K[0, 2]), std.cx_px, "px"),
        "principal point y": _with_std(float(camera.K[1, 2]), std.cy_px, "px"),
    }
    words = {name: html.escape(text) for name, text in distortion_words(camera, std).items()}
    return cells | (words if camera.distortion.any() else {})


def _transform_words(calibration: Calibration) -> str:
    rig, std = calibration.rig, calibration.transform_std
    std_text = " ".join(f"{value:.3f}" for value in std.rotation_deg)
    words = (
        f"The lenses are turned against each other by {rig.turn_deg:.3f} degrees (&plusmn; {std_text} about x, y, z)"
    )
    if not rig.is_scale_known:
        return f"{words}; their distance is not known in metres."
    x_mm, y_mm, z_mm = rig.wide_from_tele[:3, 3] * 1e3
    sigma = " ".join(f"{value * 1e3:.2f}" for value in std.translation_m)
    return (
        f"{words}; tele's centre lies at {x_mm:.2f} {y_mm:.2f} {z_mm:.2f} mm (&plusmn; {sigma}) of the wide camera. "
        "All &plusmn; are one standard deviation."
    )


def _left_out_html(views: Sequence[ViewResult]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{html.escape(view.shot)}</th><td>{view.camera}</td><td>{_figure(view.rms_px)}</td>'
        f'<td class="words">{html.escape(view.reason)}</td></tr>\n'
        for view in views
        if not view.is_used
    )
    head = '<tr><th>shot</th><th>photo</th><th>RMS, px</th><th class="words">why</th></tr>'
    return f'<div class="scroll"><table><thead>{head}</thead>\n<tbody>{rows}</tbody></table></div>' if rows else ""


def _rectified_html(rectified: tuple[str, FloatMap, FloatMap] | None) -> str:
    if rectified is None:
        return ""
    name, tele, wide = rectified
    label = "tele and wide after rectification. Good: whatever lies on a line in one lies on it in the other"
    return picture_html(thumbnail(label, scan_lines_picture(tele, wide), longest_px=2 * _VIEW_WIDTH_PX + 8), name)


def _with_std(value: float, std: float, unit: str) -> str:
    return f"{value:.1f} &plusmn; {std:.1f} {unit}" if math.isfinite(std) else f"{value:.1f} {unit}"


def _figure(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
