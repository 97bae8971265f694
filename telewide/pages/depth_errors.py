"""Errors of depth that errors of disparity cause at each distance, as a curve and a table for the pages about a rig.

``sigma_z / z = z sigma_d / (f B)``; distances are metres, or baselines where nobody stated how long the baseline is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig
from telewide.pages.axes import Axis, axis_over
from telewide.pages.charts import Line, line_chart
from telewide.pages.page import html_part
from telewide.pages.rig_figures import depth_error_m

MATCHING_STD_PX = 0.5
"""Error that matching is taken to have, px."""

_NEAREST_M, _FARTHEST_M = 0.25, 10.0
_ROWS_M = (0.5, 1.0, 2.0, 4.0)
_HIGHEST_PERCENT = 130.0
"""Leaves room for the legend above the curves, which end at 100."""
_BASELINES_PER_M = 100.0
"""A phone's lenses are about a centimetre apart."""


def depth_errors(rig: StereoRig, stds_px: Mapping[str, float], *, caption: str, notes: Sequence[str]) -> Markup:
    """Draw the relative error of depth over the distance, with a table.

    Args:
        rig: its tele's focal length and its baseline are taken.
        stds_px: standard deviations of the disparity, tele px, by the names of their curves; at most two.
        caption: the sentence below the chart.
        notes: sentences below the table.

    Returns:
        HTML.
    """
    unit, unit_m = ("m", 1.0) if rig.is_scale_known else ("baselines", 1 / _BASELINES_PER_M)
    distances = np.geomspace(_NEAREST_M, _FARTHEST_M, 60) / unit_m
    shares = {name: 100 * _share(distances, rig, std_px) for name, std_px in stds_px.items()}
    chart = line_chart(
        [Line(name, np.column_stack([distances, np.minimum(100.0, share)])) for name, share in shares.items()],
        x=Axis(f"distance, {unit}", float(distances[0]), float(distances[-1]), is_log=True),
        y=_percent_axis(max(float(share.max()) for share in shares.values())),
        caption=caption,
    )
    rows = []
    for row_m in _ROWS_M:
        distance, metres = row_m / unit_m, row_m if rig.is_scale_known else None
        row_shares = [float(_share(np.array(distance), rig, std_px)) for std_px in stds_px.values()]
        rows.append([f"{distance:g} {unit}", *(_cell(share, distance_m=metres) for share in row_shares)])
    return html_part("depth_errors", chart=chart, head=["distance", *stds_px], rows=rows, notes=notes)


def _percent_axis(highest: float) -> Axis:
    label = "error of depth, % of the distance"
    return axis_over([0.0, highest], label=label) if highest <= 100 else Axis(label, 0.0, _HIGHEST_PERCENT)


def _share(distances: FloatArray, rig: StereoRig, std_px: float) -> FloatArray:
    """Deviation of depth over depth; distances are metres, or baselines of a rig whose scale is not known."""
    depth = distances if rig.is_scale_known else distances * rig.baseline_m
    return depth_error_m(depth, rig, disparity_std_px=std_px) / depth


def _cell(share: float, *, distance_m: float | None) -> str:
    """A deviation of depth as a length, where there are lengths, and as a share of the distance."""
    if share >= 1:
        return "not known"
    if distance_m is None:
        return f"± {share:.1%}"
    error_m = share * distance_m
    length = f"{error_m * 1e3:.1f} mm" if error_m < 0.0995 else f"{error_m:.2f} m"
    return f"± {length} ({share:.1%})"
