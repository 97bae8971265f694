"""Content of the page about a rig from captures without a board, and what such a rig cannot know.

Letters: N matches of a capture.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.scene_rig import CONTRADICTIONS, SceneRig, SideSource
from telewide.geometry.arrays import FloatArray
from telewide.pages.charts import Bar, bar_list
from telewide.pages.depth_errors import MATCHING_STD_PX, depth_errors
from telewide.pages.epipolar_bars import epipolar_bars, epipolar_limit_px
from telewide.pages.page import html_part
from telewide.pages.photo_charts import coverage_chart
from telewide.pages.report import NextStep
from telewide.pages.rig_figures import cell_counts, tele_outline_px
from telewide.pages.rig_page import RectifiedViews, RigPage, Section, rectified_section
from telewide.points.matches import Matches

_COVERAGE_CELLS = (6, 8)
_MAX_DOTS = 4000
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


def scenes_rig_page(
    found: SceneRig,
    *,
    quality: CalibrationQuality,
    views: Sequence[SceneView],
    facts: Mapping[str, str],
    next_steps: Sequence[NextStep] = (),
    rectified: RectifiedViews | None = None,
) -> RigPage:
    """Compose the page about a rig from scenes.

    Args:
        found: the rig and how sure it is.
        quality: what it is worth.
        views: every capture.
        facts: where it comes from: captures, version.
        next_steps: commands worth running now.
        rectified: a rectified pair; None where the rig cannot rectify.
    """
    unrectified = html_part("paragraph", text="This rig cannot rectify a pair.")
    return RigPage(
        title="Rig from captures",
        heading="A wide and a tele lens, from captures without a board",
        usable="Usable: it works, within what the warnings below say it cannot know.",
        quality=quality,
        summary=_summary(found, views),
        sections=(
            Section("The rig", _rig_table(found)),
            Section("Where the matches lie", Markup().join(_coverage_figures(found, views)), "charts"),
            Section("Held-out epipolar error", _error_figures(quality, views), "charts"),
            Section("Depth error", _depth_errors(found)),
            rectified_section(rectified, missing=unrectified),
        ),
        next_steps=next_steps,
        facts=facts,
    )


def _summary(found: SceneRig, views: Sequence[SceneView]) -> str:
    rig, std = found.rig, found.std
    words = [
        f"{sum(view.is_used for view in views)} of {len(views)} captures had matches enough",
        f"tele is {rig.asymmetry:.3f} ± {rig.asymmetry * std.ratio_share:.3f} times as long as wide",
        f"the zero of disparity is known to {std.zero_px:.0f} tele px",
        _baseline_words(found),
    ]
    return "; ".join(words) + "."


def _baseline_words(found: SceneRig) -> str:
    if not found.rig.is_scale_known:
        return "the distance of the lenses is not known, so depth is relative"
    baseline_mm, std_mm = found.rig.baseline_m * 1e3, found.std.baseline_m * 1e3
    return f"lenses {baseline_mm:.2f} ± {std_mm:.2f} mm apart, as stated"


def _rig_table(found: SceneRig) -> Markup:
    head = ["", "value", "±", "what it rests on"]
    notes = ["± is one standard deviation."]
    return html_part("noted_table", head=head, rows=list(_rig_rows(found)), notes=notes, words=[3])


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


def _coverage_figures(found: SceneRig, views: Sequence[SceneView]) -> Iterator[Markup]:
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


def _error_figures(quality: CalibrationQuality, views: Sequence[SceneView]) -> Markup:
    if not math.isfinite(quality.epipolar_p90_px):
        words = "Nothing was held out: too few captures for two rigs that judge each other's captures."
        return html_part("paragraph", text=words)
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


def _depth_errors(found: SceneRig) -> Markup:
    """Errors of depth with the zero of disparity as unsure as it is, and as if it were known."""
    pinned = "zero pinned with --distance" if found.rig.is_scale_known else "were the zero known"
    return depth_errors(
        found.rig,
        {
            f"zero known to {found.std.zero_px:.0f} px, as it is": math.hypot(MATCHING_STD_PX, found.std.zero_px),
            f"{pinned}, matching to {MATCHING_STD_PX} px": MATCHING_STD_PX,
        },
        caption="sigma_z = z² sigma_d / (f B): one standard deviation of depth over distance. At 100 % and above "
        "nothing is known of the distance, only what is nearer than what.",
        notes=_depth_notes(found),
    )


def _depth_notes(found: SceneRig) -> tuple[str, ...]:
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
