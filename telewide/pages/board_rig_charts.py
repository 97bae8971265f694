"""Figures about a rig from photos of a board: coverage, residuals, photos, repeatability, epipolar and depth error.

Each is one or more figure elements, or nothing where there is nothing to draw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from markupsafe import Markup

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.result import Calibration, Lens, ViewResult
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import Camera
from telewide.pages.axes import Axis, axis_over
from telewide.pages.charts import Bar, Line, bar_list, dot_chart
from telewide.pages.depth_errors import MATCHING_STD_PX, depth_errors
from telewide.pages.epipolar_bars import epipolar_bars
from telewide.pages.page import html_part
from telewide.pages.photo_charts import arrow_chart, coverage_chart, heat_chart
from telewide.pages.rig_figures import (
    camera_difference_px,
    cell_counts,
    tele_outline_px,
    transfer_difference_px,
)

LENSES: tuple[Lens, ...] = ("tele", "wide")
_LensFigure = Callable[[Calibration, Lens, Sequence[ViewResult]], Markup]
_COVERAGE_CELLS = (6, 8)
_ARROW_SHARE = 0.03  # the 95th percentile of the arrows is drawn so long, as a share of the photo's width
_MEDIAN_OF_ABS_NORMAL = 0.6745


def coverage_figures(calibration: Calibration) -> Markup:
    """Where the corners lie in the photos of each lens."""
    return _per_lens(calibration, _coverage_figure)


def residual_figures(calibration: Calibration) -> Markup:
    """Draw what the rig does not explain, corner by corner, for each lens."""
    return _per_lens(calibration, _residual_figure)


def view_figures(calibration: Calibration) -> Markup:
    """The error of each photo, the ones left out marked, for each lens."""
    return _per_lens(calibration, _view_figure)


def cross_validation_figures(calibration: Calibration) -> Markup:
    """Draw how differently the odd and the even photos place things: each lens alone, and from tele to wide."""
    if calibration.half_rigs is None:
        return Markup()
    odd, even = calibration.half_rigs
    distance_m = _joint_distance_m(calibration.views)
    maps = (
        ("tele alone", camera_difference_px(odd.tele, even.tele), odd.tele.hw, "px"),
        ("wide alone", camera_difference_px(odd.wide, even.wide), odd.wide.hw, "px"),
        (
            f"from tele to wide, at {_distance(distance_m, calibration)}",
            transfer_difference_px(odd, even, distance_m=distance_m),
            odd.tele.hw,
            "tele px",
        ),
    )
    figures = []
    for name, difference_px, hw, unit in maps:
        caption = (
            f"{name}: rigs solved from every second photo and from the others, {_rms(difference_px):.2f} {unit} "
            f"apart (RMS), {np.nanmax(difference_px):.2f} at most. Good: little more than the noise of the corners, "
            "where boards were held."
        )
        high = max(float(np.nanmax(difference_px)), 0.1)
        values = difference_px.astype(np.float32)
        figures.append(heat_chart(values, hw=hw, value_range=(0.0, high), unit="px", caption=caption))
    return Markup().join(figures)


def epipolar_figure(quality: CalibrationQuality) -> Markup:
    """Row errors in photos that the rig was solved without."""
    if not math.isfinite(quality.epipolar_p90_px):
        return html_part("paragraph", text="Too few photos of both lenses at once to hold any out.")
    return epipolar_bars(
        quality,
        caption="How far corners lie from the line that the other photo says they are on, in photos that the rig was "
        "solved without. This is the row error that stereo matching will meet.",
    )


def board_depth_errors(calibration: Calibration) -> Markup:
    """Draw what errors of disparity cost at each distance, as a curve and a table."""
    rig, quality = calibration.rig, calibration.quality
    if not rig.is_scale_known:
        return html_part("paragraph", text="Without the size of the board there is no depth in metres.")
    own_px = _calibration_std_px(quality)
    stds_px = {f"matching to {MATCHING_STD_PX} px": math.hypot(MATCHING_STD_PX, own_px)}
    if own_px > 0:
        stds_px[f"this calibration alone ({own_px:.2f} px)"] = own_px
    baseline_share = calibration.transform_std.baseline_m / rig.baseline_m
    return depth_errors(
        rig,
        stds_px,
        caption="sigma_z = z² sigma_d / (f B): error of depth over distance, for an error of disparity. That of "
        "the calibration is from the held-out epipolar error or the two halves of the photos, whichever is larger.",
        notes=[f"The distance of the lenses, known to {baseline_share:.2%}, adds the same share at every distance."],
    )


def pose_figure(views: Sequence[ViewResult]) -> Markup:
    """Distance and tilt of the board in each photo."""
    shown = [v for v in views if v.is_used and math.isfinite(v.tilt_deg) and math.isfinite(v.distance_m)]
    if not shown:
        return Markup()
    groups = [
        Line(lens, _stacked([np.array([[v.distance_m, v.tilt_deg]]) for v in shown if v.camera == lens]))
        for lens in LENSES
    ]
    near_m, far_m = min(v.distance_m for v in shown), max(v.distance_m for v in shown)
    caption = (
        f"Each photo's board: {near_m:.2f} to {far_m:.2f} m away. Good: three distances or more, tilts of 30 to 45 "
        "degrees in all directions; boards held straight say little."
    )
    x = axis_over([near_m, far_m], label="distance of the board, m")
    y = Axis("tilt of the board, degrees", 0.0, max(60.0, *(v.tilt_deg for v in shown)))
    return dot_chart(groups, x=x, y=y, caption=caption)


def _per_lens(calibration: Calibration, figure: _LensFigure) -> Markup:
    views = {lens: [view for view in calibration.views if view.camera == lens] for lens in LENSES}
    return Markup().join(figure(calibration, lens, views[lens]) for lens in LENSES if views[lens])


def _camera(calibration: Calibration, lens: Lens) -> Camera:
    return calibration.rig.tele if lens == "tele" else calibration.rig.wide


def _coverage_figure(calibration: Calibration, lens: Lens, views: Sequence[ViewResult]) -> Markup:
    camera = _camera(calibration, lens)
    points_px = _stacked([view.points_px for view in views if view.is_used])
    counts = cell_counts(points_px, hw=camera.hw, cells=_COVERAGE_CELLS)
    caption = f"{lens}: {len(points_px)} corners in {sum(view.is_used for view in views)} photos. " + (
        "Fill the empty cells, the corners of the frame above all."
        if lens == "tele"
        else "The outline is what tele sees: depth needs wide there."
    )
    outline_px = tele_outline_px(calibration.rig) if lens == "wide" else None
    return coverage_chart(points_px, counts, hw=camera.hw, caption=caption, outline_px=outline_px)


def _residual_figure(calibration: Calibration, lens: Lens, views: Sequence[ViewResult]) -> Markup:
    hw = _camera(calibration, lens).hw
    points_px = _stacked([view.points_px for view in views if view.is_used])
    residuals_px = _stacked([view.residuals_px for view in views if view.is_used])
    lengths_px = np.linalg.norm(residuals_px, axis=1)
    longest_px = float(np.quantile(lengths_px, 0.95)) if len(lengths_px) else 0.0
    magnified = _rounded_down(_ARROW_SHARE * hw[1] / max(longest_px, 1e-6))
    caption = (
        f"{lens}: from each corner as reprojected to where it was found, {magnified:g} times enlarged. Good: arrows "
        "point anywhere; a pattern, such as all outwards in the corners of the frame, means a lens model that is too "
        "simple or a board that is not flat."
    )
    shown = np.minimum(1.0, 3 * longest_px / np.maximum(lengths_px, 1e-9))[:, None] * residuals_px
    return arrow_chart(points_px - residuals_px, shown, hw=hw, magnified=magnified, caption=caption)


def _view_figure(_: Calibration, lens: Lens, views: Sequence[ViewResult]) -> Markup:
    bars = [Bar(view.shot, view.rms_px, is_out=not view.is_used) for view in views]
    n_out = sum(bar.is_out for bar in bars)
    caption = f"{lens}: RMS distance of corners and their reprojections in each photo, px; " + (
        f"{n_out} left out (red), with the error they would have." if n_out else "none was left out."
    )
    return bar_list(bars, unit="px", caption=caption)


def _calibration_std_px(quality: CalibrationQuality) -> float:
    """Deviation of the calibration itself along a row, tele px; 0 where nothing says so.

    Two rigs from half of the photos each differ by twice the error of the rig from all of them, and one of the two
    directions of that difference lies along the row.
    """
    estimates = (quality.epipolar_p50_px / _MEDIAN_OF_ABS_NORMAL, quality.cross_validation_px / (2 * math.sqrt(2)))
    return max((estimate for estimate in estimates if math.isfinite(estimate)), default=0.0)


def _joint_distance_m(views: Sequence[ViewResult]) -> float:
    """Median distance of the boards that both lenses saw, from tele."""
    in_wide = {view.shot for view in views if view.camera == "wide" and view.is_used}
    return float(np.median([v.distance_m for v in views if v.camera == "tele" and v.is_used and v.shot in in_wide]))


def _stacked(arrays: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(arrays).astype(np.float64) if arrays else np.zeros((0, 2))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _rounded_down(value: float) -> float:
    """The next lower 1, 2 or 5 times a power of ten, at least 1."""
    power = 10.0 ** math.floor(math.log10(max(value, 1.0)))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= max(value, 1.0))


def _distance(depth_m: float, calibration: Calibration) -> str:
    return f"{depth_m:.2f} m" if calibration.rig.is_scale_known else "the boards' distance"
