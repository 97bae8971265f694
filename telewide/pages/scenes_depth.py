"""Errors of depth with a rig from scenes, at each distance: with the zero of disparity as unsure as it is, and pinned.

``sigma_z / z = z sigma_d / (f B)``; distances are metres, or baselines where nobody stated how long the baseline is.
"""

from __future__ import annotations

import math

import numpy as np

from telewide.calibration.scene_rig import SceneRig
from telewide.geometry.arrays import FloatArray
from telewide.pages.charts import Axis, Line, line_chart
from telewide.pages.depth_table import MATCHING_STD_PX, ROWS_M, depth_error_words, depth_table_html
from telewide.pages.rig_figures import depth_error_m

_NEAREST_M, _FARTHEST_M = 0.25, 10.0
_HIGHEST_PERCENT = 130.0
"""Leaves room for the legend above the curves, which end at 100."""
_BASELINES_PER_M = 100.0
"""A phone's lenses are about a centimetre apart."""


def scenes_depth_html(found: SceneRig) -> str:
    """Draw the relative error of depth over the distance, with a table and what every distance shares.

    Args:
        found: the rig, with how sure its zero of disparity is.

    Returns:
        HTML.
    """
    rig = found.rig
    is_metric = rig.is_scale_known
    unit, unit_m = ("m", 1.0) if is_metric else ("baselines", 1 / _BASELINES_PER_M)
    pinned = "zero pinned with --distance" if is_metric else "were the zero known"
    stds = (
        (f"zero known to {found.std.zero_px:.0f} px, as it is", math.hypot(MATCHING_STD_PX, found.std.zero_px)),
        (f"{pinned}, matching to {MATCHING_STD_PX} px", MATCHING_STD_PX),
    )
    distances = np.geomspace(_NEAREST_M, _FARTHEST_M, 60) / unit_m
    lines = [
        Line(name, np.column_stack([distances, np.minimum(100.0, 100 * _share(distances, found, px))]))
        for name, px in stds
    ]
    chart = line_chart(
        lines,
        x=Axis(f"distance, {unit}", float(distances[0]), float(distances[-1]), is_log=True),
        y=Axis("error of depth, % of the distance", 0.0, _HIGHEST_PERCENT),
        caption="sigma_z = z² sigma_d / (f B): one standard deviation of depth over distance. At 100 % and above "
        "nothing is known of the distance, only what is nearer than what.",
    )
    columns = {name: [_cell(row_m / unit_m, found, std_px) for row_m in ROWS_M] for name, std_px in stds}
    table = depth_table_html(columns, distances=[f"{row_m / unit_m:g} {unit}" for row_m in ROWS_M])
    notes = "".join(f'<p class="faint">{note}</p>' for note in _notes(found))
    return f'<div class="charts">{chart}<div><div class="scroll">{table}</div>{notes}</div></div>'


def _notes(found: SceneRig) -> tuple[str, ...]:
    std = found.std
    if found.rig.is_scale_known:
        share = math.hypot(std.baseline_m / found.rig.baseline_m, std.tele_f_share)
        shared = (
            f"The stated distance of the lenses (to {std.baseline_m / found.rig.baseline_m:.1%}) and tele's focal "
            f"length (to {std.tele_f_share:.1%}) add {share:.1%} at every distance."
        )
    else:
        shared = (
            "The distance of the lenses is not known: a known distance then gives the scale, and leaves the zero as "
            "unsure as it is. State --baseline-m to have both."
        )
    zero = (
        "Where infinitely far things lie is not seen in matches: it rests on the principal points, taken near the "
        "middles of the photos. depth_std_m of every capture counts that in; a known distance, or a board, takes it "
        "out."
    )
    return shared, zero


def _share(distances: FloatArray, found: SceneRig, std_px: float) -> FloatArray:
    """Deviation of depth over depth; distances are metres, or baselines of a rig whose scale is not known."""
    depth = distances if found.rig.is_scale_known else distances * found.rig.baseline_m
    return depth_error_m(depth, found.rig, disparity_std_px=std_px) / depth


def _cell(distance_m: float, found: SceneRig, std_px: float) -> str:
    share = float(_share(np.array(distance_m), found, std_px))
    if share >= 1:
        return "not known"
    if not found.rig.is_scale_known:
        return f"&plusmn; {share:.1%}"
    return depth_error_words(share * distance_m, depth_m=distance_m)
