"""Questions asked of a calibration, each with its limit and with advice what to photograph next.

Letters: n corners.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from telewide.calibration.quality import (
    SHARE,
    CalibrationQuality,
    Check,
    at_least,
    at_most,
    epipolar_percentiles_px,
    larger_than_usual,
    verdict_of,
)
from telewide.calibration.result import CameraStd, Lens, TransformStd, ViewResult
from telewide.calibration.validation import GRID_HW, difference_px, tele_grid_px
from telewide.geometry.arrays import FloatArray
from telewide.geometry.rig import StereoRig

# Limits: (passes, fails); between them a warning. The first two count from above, the others from below.
JOINT_VIEWS = (12, 5)
LENS_VIEWS = (10, 4)
TILTED_VIEWS = (5, 2)
TILTED_DEG = 20.0
WIDE_SQUARE_PX = (12.0, 6.0)
COVERAGE = (0.6, 0.2)
DISTANCE_RATIO = (1.3, 1.0)
LEFT_OUT = (0.2, 0.5)
F_STD = (0.002, 0.02)
BASELINE_STD = (0.01, 0.1)
LEAST_BASELINE_M = 0.003
"""Lenses of a phone are no nearer to each other than this: nearer ones are one."""
EXCESS = (6.0**0.5, 10.0)
EPIPOLAR_WIDE_PX = (0.75, 2.5)
"""Held-out error p90, in wide pixels, by which a corner can be placed in the wide photo."""
ODD_EVEN_WIDE_PX = (1.5, 6.0)
"""Difference of two half calibrations, wide pixels; each errs more than the whole, by the root of two."""
RMS_PX, RMS_SHARE = 0.25, 1e-4
"""A reprojection error passes up to this many px plus this share of the photo's longer side."""
_CELLS = 8


@dataclass(frozen=True)
class Evidence:
    """Figures the checks look at.

    Attributes:
        views: every view.
        rig: the rig.
        half_rigs: rigs from odd and even views, or None.
        epipolar_px: (n,) held-out epipolar errors, tele px.
        stds: of tele and wide.
        transform_std: of the rig.
        excess: see :mod:`telewide.calibration.uncertainty`.
    """

    views: tuple[ViewResult, ...]
    rig: StereoRig
    half_rigs: tuple[StereoRig, StereoRig] | None
    epipolar_px: FloatArray
    stds: tuple[CameraStd, CameraStd]
    transform_std: TransformStd
    excess: float

    def used(self, lens: Lens) -> list[ViewResult]:
        """The views of a lens that took part."""
        return [view for view in self.views if view.camera == lens and view.is_used]

    @property
    def joint(self) -> list[tuple[ViewResult, ViewResult]]:
        """Tele and wide view of every shot of which both took part."""
        wide = {view.shot: view for view in self.used("wide")}
        return [(view, wide[view.shot]) for view in self.used("tele") if view.shot in wide]


def quality_of(evidence: Evidence) -> CalibrationQuality:
    """Judge a calibration.

    Args:
        evidence: what is known about it.

    Returns:
        Its figures, checks and verdict.
    """
    p50, p90, p99 = epipolar_percentiles_px(evidence.epipolar_px)
    cross_px = _cross_validation_px(evidence)
    checks = (*_view_checks(evidence), *_figure_checks(evidence, p90_px=p90, cross_px=cross_px))
    return CalibrationQuality(
        tele_rms_px=rms_px(evidence.used("tele")),
        wide_rms_px=rms_px(evidence.used("wide")),
        epipolar_p50_px=p50,
        epipolar_p90_px=p90,
        epipolar_p99_px=p99,
        cross_validation_px=cross_px,
        checks=checks,
        verdict=verdict_of(checks),
    )


def rms_px(views: Sequence[ViewResult]) -> float:
    """RMS distance of corner and reprojection over all corners of some views."""
    if not views:
        return float("nan")
    return float(np.sqrt(np.mean(np.concatenate([np.sum(view.residuals_px**2, axis=1) for view in views]))))


def _cross_validation_px(evidence: Evidence) -> float:
    if evidence.half_rigs is None:
        return float("nan")
    distance_m = float(np.median([tele.distance_m for tele, _ in evidence.joint]))
    moved = difference_px(*evidence.half_rigs, distance_m=distance_m, grid_hw=GRID_HW)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


def _view_checks(evidence: Evidence) -> Iterator[Check]:
    joint = evidence.joint
    n = len(joint)
    advice = (
        f"{n} shots show the board well with both lenses at once. Take {max(JOINT_VIEWS[0] - n, 1)} more, the board "
        "filling the tele photo, tilted to all sides, at three distances."
    )
    yield at_least("shots with the board in both photos", n, JOINT_VIEWS, advice=advice, unit="shots")
    yield from _lens_checks(evidence, "tele")
    yield from _lens_checks(evidence, "wide")
    sizes_px = [wide.square_px for _, wide in joint]
    typical_px = float(np.median(sizes_px)) if sizes_px else float("nan")
    advice = (
        f"A square spans {typical_px:.0f} px in the wide photos. Photograph a board with squares "
        f"{1.1 * WIDE_SQUARE_PX[0] / max(typical_px, 1):.1f} times as large, or from nearer."
    )
    yield at_least("size of a square in the wide photos", typical_px, WIDE_SQUARE_PX, advice=advice, unit="px")
    distances_m = [tele.distance_m for tele, _ in joint]
    ratio = max(distances_m) / min(distances_m) if joint else float("nan")
    usual_m = float(np.median(distances_m)) if joint else float("nan")
    advice = f"All joint views are at about {usual_m:.2g} m. Take some nearer, and some at half again that distance."
    yield at_least("farthest board over nearest", ratio, DISTANCE_RATIO, advice=advice, unit="times")
    left_out = [view for view in evidence.views if not view.is_used]
    share, advice = len(left_out) / max(len(evidence.views), 1), _left_out_advice(left_out, n=len(evidence.views))
    yield _at_most("photos left out", share, LEFT_OUT, advice=advice, unit=SHARE)


def _left_out_advice(left_out: Sequence[ViewResult], *, n: int) -> str:
    """Advice on views that disagree, and about those that could not even have taken part."""
    sentences = []
    disagreeing = [view for view in left_out if view.is_fit]
    if disagreeing:
        names = _few(sorted({view.shot for view in disagreeing}))
        sentences.append(
            f"{len(disagreeing)} of {n} views disagree with the others and were left out: {names}. Take them anew, "
            "board and phone at rest."
        )
    unfit = [view for view in left_out if not view.is_fit]
    for reason in dict.fromkeys(view.reason for view in unfit):
        alike = [view for view in unfit if view.reason == reason]
        names = _few(sorted({view.shot for view in alike}))
        sentences.append(f"{len(alike)} of {n} views could not take part ({names}): {reason}.")
    return " ".join(sentences)


def _lens_checks(evidence: Evidence, lens: Lens) -> Iterator[Check]:
    views = evidence.used(lens)
    camera, std = (evidence.rig.tele, evidence.stds[0]) if lens == "tele" else (evidence.rig.wide, evidence.stds[1])
    advice = f"{len(views)} {lens} photos took part. Take more, the board filling the {lens} photo."
    yield at_least(f"{lens} photos used", len(views), LENS_VIEWS, advice=advice, unit="photos")
    tilted = sum(view.tilt_deg >= TILTED_DEG for view in views)
    advice = (
        f"{tilted} {lens} photos show the board tilted by {TILTED_DEG:.0f} degrees or more. Take {TILTED_VIEWS[0]} "
        "more, it turned by 30 to 45 degrees left, right, up and down: head-on views do not tell the focal length."
    )
    yield at_least(f"{lens} photos of a tilted board", tilted, TILTED_VIEWS, advice=advice, unit="photos")
    share, where = _coverage(views, _region_px(evidence.rig, lens))
    part = "of the tele photo" if lens == "tele" else "of what tele sees in the wide photo"
    advice = f"Corners cover {share:.0%} {part}. Photograph the board {where}."
    yield at_least(f"{lens} coverage", share, COVERAGE, advice=advice, unit=SHARE)
    relative = std.f_px / camera.f_px
    advice = (
        f"The {lens} focal length is known to {relative:.2%} only. Take close-ups with the {lens} lens, the board "
        "filling the frame, turned by 30 to 45 degrees to all sides."
    )
    yield _at_most(f"{lens} focal length, standard deviation", relative, F_STD, advice=advice, unit=SHARE)
    limit_px = RMS_PX + RMS_SHARE * max(camera.hw)
    error_px = rms_px(views)
    advice = (
        f"Corners are off by {error_px:.2f} px RMS in the {lens} photos. Keep board and phone at rest, the board flat, "
        "the focus locked; photograph in good light."
    )
    yield _at_most(f"{lens} reprojection error, RMS", error_px, (limit_px, 3 * limit_px), advice=advice, unit="px")


def _figure_checks(evidence: Evidence, *, p90_px: float, cross_px: float) -> Iterator[Check]:
    # A corner can be placed to a part of a wide pixel, which spans several tele pixels.
    tele_px = max(evidence.rig.asymmetry, 1.0) * larger_than_usual(evidence.rig.tele.hw)
    limits_px = (EPIPOLAR_WIDE_PX[0] * tele_px, EPIPOLAR_WIDE_PX[1] * tele_px)
    advice = (
        f"A tenth of the corners held out lie more than {p90_px:.2f} tele px off their line. Take more joint views, "
        "both photos at the same moment, nothing moving."
    )
    yield _at_most("held-out epipolar error of 90 %", p90_px, limits_px, advice=advice, unit="tele px")
    advice = (
        f"Rigs from every second view differ by {cross_px:.2f} tele px. Take twice as many views, tilted to all sides "
        "and spread over the frame."
    )
    limits_px = (ODD_EVEN_WIDE_PX[0] * tele_px, ODD_EVEN_WIDE_PX[1] * tele_px)
    yield _at_most("difference of rigs from half the photos", cross_px, limits_px, advice=advice, unit="tele px")
    yield from _baseline_checks(evidence)
    excess = float(np.sqrt(evidence.excess))
    advice = (
        f"Views contradict each other {excess:.1f} times more than noise of the corners allows; "
        "the stated deviations count that in. Use a rigid flat board, lock the focus, hold still."
    )
    yield _at_most("contradiction of the photos over corner noise", excess, EXCESS, advice=advice, unit="times")


def _baseline_checks(evidence: Evidence) -> Iterator[Check]:
    """Whether the lenses are two, and how well their distance is known."""
    if evidence.rig.is_scale_known:
        baseline_mm, least_mm = evidence.rig.baseline_m * 1e3, LEAST_BASELINE_M * 1e3
        advice = (
            f"The two lenses come out {baseline_mm:.2g} mm apart, nearer than those of any phone: the same lens twice. "
            "Near or in dim light phones give an enlarged piece of the wide photo as tele. Step back, give more light, "
            "and look that the phone uses its tele lens; or measure a square of the board."
        )
        yield at_least("distance of the lenses", baseline_mm, (least_mm, least_mm), advice=advice, unit="mm")
        if baseline_mm < least_mm:
            return  # how well nothing is known, and that the board should come nearer, would lead astray
    relative = evidence.transform_std.baseline_m / max(evidence.rig.baseline_m, 1e-300)
    advice = (
        f"The distance of the lenses, and with it every depth, is known to {relative:.1%} only. Take more joint views, "
        "nearer and tilted."
    )
    yield _at_most("distance of the lenses, standard deviation", relative, BASELINE_STD, advice=advice, unit=SHARE)


def _at_most(name: str, value: float, limits: tuple[float, float], *, advice: str, unit: str) -> Check:
    if np.isnan(value):
        advice = "There are too few joint views to hold some out. Take 12 or more with both lenses."
    return at_most(name, value, limits, advice=advice, unit=unit)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _region_px(rig: StereoRig, lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Upper left and lower right corner, px, of what depth is made from: all of tele, and of wide what tele sees."""
    if lens == "tele":
        return np.array([-0.5, -0.5]), np.array(rig.tele.hw[::-1]) - 0.5
    rays = rig.tele.normalised(tele_grid_px(rig.tele, grid_hw=GRID_HW))
    seen_px = rig.wide.project(np.column_stack([rays, np.ones(len(rays))]) @ rig.wide_from_tele[:3, :3].T)
    limit = np.array(rig.wide.hw[::-1]) - 0.5
    return np.clip(seen_px.min(axis=0), -0.5, limit - 1), np.clip(seen_px.max(axis=0), 0.5, limit)


def _coverage(views: Sequence[ViewResult], region_px: tuple[FloatArray, FloatArray]) -> tuple[float, str]:
    """Share of a region's cells that hold a corner, and where the largest gap is."""
    low, high = region_px
    size = high - low
    cells = np.maximum(np.round(_CELLS * size / size.max()).astype(int), 2)
    held = np.zeros(cells)
    for view in views:
        place = np.floor((view.points_px - low) / size * cells).astype(int)
        place = place[np.all((place >= 0) & (place < cells), axis=1)]
        held[place[:, 0], place[:, 1]] = 1
    thirds = [np.array_split(np.arange(n), 3) for n in cells]
    filled = [
        [held[np.ix_(columns, rows)].mean() if len(columns) and len(rows) else 1.0 for columns in thirds[0]]
        for rows in thirds[1]
    ]
    row, column = np.unravel_index(int(np.argmin(filled)), (3, 3))
    place_name = " ".join(part for part in (("upper", "", "lower")[row], ("left", "", "right")[column]) if part)
    return float(held.mean()), f"in the {place_name or 'middle'} part of the frame"
