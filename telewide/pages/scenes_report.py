"""The page about a rig from scenes: can it be trusted, what can it not know, and what to photograph next.

One file that opens offline, kin to the page about a board's calibration. Every figure says in its caption what good
looks like. Letters: N matches of a capture.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.scene_rig import CONTRADICTIONS, SceneRig, SideSource
from telewide.files import write_text
from telewide.geometry.arrays import FloatArray, FloatMap
from telewide.pages.charts import CHART_STYLE, Bar, bar_list, coverage_chart
from telewide.pages.report import (
    NextStep,
    facts_html,
    next_step_html,
    page_html,
    picture_html,
    section_html,
    thumbnail,
)
from telewide.pages.rig_charts import epipolar_bars, epipolar_limit_px
from telewide.pages.rig_checks import CHECKS_STYLE, advice_html, checks_html
from telewide.pages.rig_figures import cell_counts, tele_outline_px
from telewide.pages.rig_report import scan_lines_picture
from telewide.pages.scenes_depth import scenes_depth_html
from telewide.points.matches import Matches

_COVERAGE_CELLS = (6, 8)
_MAX_DOTS = 4000
_PAIR_LONGEST_PX = 1448
_VERDICTS = {
    "good": "Good: every check passed.",
    "usable": "Usable: it works, within what the warnings below say it cannot know.",
    "insufficient": "Not good enough: depth from this rig cannot be trusted. Below is what to photograph next.",
}
_SIDE_WORDS: dict[SideSource, str] = {
    "seen": "matches: only so is everything in front of the lenses",
    "stated": "stated",
    "guessed": "a guess: state it with --wide-side",
    "contradicted": "stated; the matches contradict it",
}


@dataclass(frozen=True)
class SceneView:
    """One capture in a rig from scenes.

    Attributes:
        name: of the capture.
        matches: those that agree with the rig, px of the photos.
        n_found: how many were found.
        errors_px: (N,) row errors with a rig that did not see this capture, tele px; empty where none did.
        is_used: whether it had a say.
    """

    name: str
    matches: Matches
    n_found: int
    errors_px: FloatArray
    is_used: bool


def write_scenes_report(
    path: Path,
    found: SceneRig,
    *,
    quality: CalibrationQuality,
    views: Sequence[SceneView],
    facts: Mapping[str, str],
    next_steps: Sequence[NextStep] = (),
    rectified: tuple[str, FloatMap, FloatMap] | None = None,
) -> Path:
    """Write the report of a rig from scenes as one HTML file.

    Args:
        path: of the file.
        found: the rig and how sure it is.
        quality: what it is worth.
        views: every capture.
        facts: where it comes from: captures, version.
        next_steps: commands worth running now.
        rectified: name, tele and wide of a rectified pair of one size, (H, W, 3) RGB in [0, 1]; None leaves it out.

    Returns:
        The path.
    """
    sections = [
        "<h1>A wide and a tele lens, from captures without a board</h1>",
        f'<p class="verdict {quality.verdict}">{_VERDICTS[quality.verdict]}<br>{_summary(found, views)}</p>',
        section_html("Checks", checks_html(quality.checks)),
        section_html("What next", advice_html(quality.checks) + "".join(map(next_step_html, next_steps))),
        section_html("The rig", _rig_html(found)),
        section_html("Where the matches lie", "".join(_coverage_figures(found, views)), css_class="charts"),
        section_html("Held-out epipolar error", _error_figures(quality, views), css_class="charts"),
        section_html("Depth error", scenes_depth_html(found)),
        section_html("A rectified pair", _rectified_html(rectified)),
        section_html("Made by", facts_html(facts)),
    ]
    write_text(path, page_html("Rig from captures", sections, extra_style=CHART_STYLE + CHECKS_STYLE))
    return path


def _summary(found: SceneRig, views: Sequence[SceneView]) -> str:
    rig, std = found.rig, found.std
    words = [
        f"{sum(view.is_used for view in views)} of {len(views)} captures had matches enough",
        f"tele is {rig.asymmetry:.3f} &plusmn; {rig.asymmetry * std.ratio_share:.3f} times as long as wide",
        f"the zero of disparity is known to {std.zero_px:.0f} tele px",
        _baseline_words(found),
    ]
    return "; ".join(words) + "."


def _baseline_words(found: SceneRig) -> str:
    if not found.rig.is_scale_known:
        return "the distance of the lenses is not known, so depth is relative"
    baseline_mm, std_mm = found.rig.baseline_m * 1e3, found.std.baseline_m * 1e3
    return f"lenses {baseline_mm:.2f} &plusmn; {std_mm:.2f} mm apart, as stated"


def _rig_html(found: SceneRig) -> str:
    rows = "".join(
        f'<tr><th scope="row">{name}</th><td>{value}</td><td>{std}</td><td class="words">{source}</td></tr>\n'
        for name, value, std, source in _rig_rows(found)
    )
    head = '<tr><th></th><th>value</th><th>&plusmn;</th><th class="words">what it rests on</th></tr>'
    table = f"<table><thead>{head}</thead>\n<tbody>{rows}</tbody></table>"
    note = "&plusmn; is one standard deviation."
    return f'<div class="scroll">{table}</div><p class="faint">{note}</p>'


def _rig_rows(found: SceneRig) -> Iterator[tuple[str, str, str, str]]:
    rig, std = found.rig, found.std
    wide_share = math.hypot(std.tele_f_share, std.ratio_share)
    f_px = (rig.tele.f_px, rig.wide.f_px)
    from_exif = _focal_words(found)
    yield "f_tele / f_wide", f"{rig.asymmetry:.4f}", f"{rig.asymmetry * std.ratio_share:.4f}", "matches"
    yield "focal length of tele", f"{f_px[0]:.0f} px", f"{f_px[0] * std.tele_f_share:.0f} px", from_exif
    yield "focal length of wide", f"{f_px[1]:.0f} px", f"{f_px[1] * wide_share:.0f} px", from_exif
    for name, camera, centre_std_px in (("tele", rig.tele, std.tele_centre_px), ("wide", rig.wide, std.wide_centre_px)):
        cx, cy = camera.K[:2, 2]
        cx_std, cy_std = centre_std_px
        source = "that it lies near the photo's middle, and matches"
        yield f"principal point of {name}", f"{cx:.1f}, {cy:.1f} px", f"{cx_std:.1f}, {cy_std:.1f} px", source
    k1 = [float(camera.distortion[:1].sum()) for camera in (rig.tele, rig.wide)]
    k1_std = ", ".join(f"{value:.3f}" for value in std.distortion)
    source = "matches, and that phones correct their photos"
    yield "distortion k1 of tele, wide", f"{k1[0]:+.3f}, {k1[1]:+.3f}", k1_std, source
    largest_deg = math.degrees(float(std.rotation_rad.max()))
    yield "turn between the lenses", f"{rig.turn_deg:.2f} degrees", f"{largest_deg:.2f} degrees", "matches"
    direction_deg = math.degrees(float(std.direction_rad[0]))
    side, source = found.wide_side, _SIDE_WORDS[found.side_source]
    yield "side of wide, from behind", side, f"{direction_deg:.1f} degrees", source
    if rig.is_scale_known:
        baseline_mm, std_mm = rig.baseline_m * 1e3, std.baseline_m * 1e3
        yield "distance of the lenses", f"{baseline_mm:.2f} mm", f"{std_mm:.2f} mm", "stated; no match shows it"
    else:
        yield "distance of the lenses", "not known", "-", "nobody stated it, and no match shows it"
    source = "that principal points lie near the photos' middles; no match shows it"
    yield "zero of disparity", "0 tele px", f"{std.zero_px:.0f} tele px", source


def _focal_words(found: SceneRig) -> str:
    """Words for what the focal lengths rest on, by the same figure that their check goes by."""
    if found.tele_f_contradiction <= CONTRADICTIONS[0]:
        return "EXIF or as stated; matches hardly show it"
    return (
        f"matches, {found.tele_f_contradiction:.1f} standard deviations from the {found.focal.tele_f_px:.0f} px "
        "that EXIF or --f35 says of tele"
    )


def _coverage_figures(found: SceneRig, views: Sequence[SceneView]) -> Iterator[str]:
    used = [view for view in views if view.is_used]
    n_found, n_agreeing = sum(view.n_found for view in used), sum(len(view.matches) for view in used)
    said = f"{n_agreeing} of {n_found} matches in {len(used)} captures agree with the rig. "
    advice = {
        "tele": "Good: all cells filled. Empty ones are where nobody knows how well the rig holds.",
        "wide": "The outline is what tele sees of far things; near ones lie beside it.",
    }
    for lens, camera in (("tele", found.rig.tele), ("wide", found.rig.wide)):
        sides = [view.matches.ref_px if lens == "tele" else view.matches.src_px for view in used]
        points_px = np.concatenate([np.zeros((0, 2)), *sides])
        yield coverage_chart(
            points_px[:: -(-len(points_px) // _MAX_DOTS) or 1],
            cell_counts(points_px, hw=camera.hw, cells=_COVERAGE_CELLS),
            hw=camera.hw,
            caption=f"{lens}: {said}{advice[lens]}",
            outline_px=tele_outline_px(found.rig) if lens == "wide" else None,
        )


def _error_figures(quality: CalibrationQuality, views: Sequence[SceneView]) -> str:
    if not math.isfinite(quality.epipolar_p90_px):
        return "<p>Nothing was held out: too few captures for two rigs that judge each other's captures.</p>"
    caption = (
        "How far matches lie from the row that the other photo says they are on, in captures that the rig was solved "
        "without, each corrected for its own lens movement. This is the row error that stereo matching will meet."
    )
    whole = epipolar_bars(quality, caption=caption)
    each = [Bar(v.name, float(np.percentile(v.errors_px, 90)) if len(v.errors_px) else math.nan) for v in views]
    caption = (
        "The same for every capture: 90 % of its held-out matches are below. A dash: too few matches. Good: all "
        "captures alike; a long one had something moving, or photos taken one after the other."
    )
    return whole + bar_list(each, unit="tele px", caption=caption, limit=epipolar_limit_px(quality))


def _rectified_html(rectified: tuple[str, FloatMap, FloatMap] | None) -> str:
    if rectified is None:
        return "<p>This rig cannot rectify a pair.</p>"
    name, tele, wide = rectified
    label = f"tele and wide of {name} after rectification. Good: whatever lies on a line in one lies on it in the other"
    return picture_html(thumbnail(label, scan_lines_picture(tele, wide), longest_px=_PAIR_LONGEST_PX), name)
