"""The page about a rig from scenes: whole and offline, and it says what such a rig cannot know."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, seen_points

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.scene_quality import SceneEvidence, judge_scenes
from telewide.calibration.scene_rig import FocalPrior, SceneRig, SceneStd, SideSource
from telewide.geometry.rig import StereoRig
from telewide.pages.report import NextStep
from telewide.pages.rig_page import write_rig_page
from telewide.pages.scenes_rig import SceneView, scenes_rig_page

RIG = phone_rig(has_distortion=False)
ERRORS_PX = np.linspace(0, 1.5, 151)


def found(
    rig: StereoRig = RIG, *, side_source: SideSource = "seen", n_scenes: int = 7, focal: FocalPrior | None = None
) -> SceneRig:
    two = np.full(2, 0.02)
    std = SceneStd(0.05, 0.003, 250 * two, np.full(3, 1e-3), two, two / 2, 800 * two, 26.0, baseline_m=0.0005)
    return SceneRig(rig, std, n_scenes, side_source, focal or FocalPrior(RIG.tele.f_px, RIG.wide.f_px))


def judged(rig: SceneRig, *, is_checked: bool = True) -> CalibrationQuality:
    evidence = SceneEvidence(rig, (rig, rig), (ERRORS_PX,)) if is_checked else SceneEvidence(rig, None)
    return judge_scenes(evidence)


def page(path: Path, rig: SceneRig, quality: CalibrationQuality, *, has_pair: bool = True) -> str:
    matches = seen_points(RIG, np.random.default_rng(1), n=90, nearest_m=0.6, farthest_m=3.0)
    is_checked = np.isfinite(quality.epipolar_p90_px)
    views = [
        SceneView("beach <1>", matches, 100, ERRORS_PX if is_checked else np.zeros(0), is_used=True),
        SceneView("fog", matches.select(np.arange(5)), 12, np.zeros(0), is_used=False),
    ]
    grey = np.full((60, 80, 3), 0.5, np.float32)
    content = scenes_rig_page(
        rig,
        quality=quality,
        views=views,
        facts={"captures": "a & b"},
        next_steps=[NextStep("Go on:", "telewide train captures/")],
        rectified=("beach <1>", grey, grey) if has_pair else None,
    )
    write_rig_page(path, content)
    return path.read_text(encoding="utf-8")


def words_of(text: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text.split("</style>")[1]))


def test_the_page_is_one_file_with_every_figure(tmp_path: Path) -> None:
    quality = judged(found())
    text = page(tmp_path / "rig_report.html", found(), quality)
    assert "<script" not in text
    assert not re.search(r'(?:src|href)="(?!data:)', text)
    words = words_of(text)
    for check in quality.checks:
        assert f"{check.status} {check.name}" in words
        assert check.found_words in words
    for value in (quality.epipolar_p50_px, quality.epipolar_p90_px, quality.epipolar_p99_px):
        assert f"{value:.2f} tele px" in words
    assert "90 of 100 matches in 1 captures agree" in words
    assert f"{RIG.baseline_m * 1e3:.2f} ± 0.50 mm apart, as stated" in words
    assert "beach &lt;1&gt;" in text
    assert "beach <1>" not in text
    assert text.count("<img") == 1
    assert "telewide train captures/" in words


@pytest.mark.parametrize("is_metric", [True, False])
def test_depth_says_what_the_unknown_zero_costs(tmp_path: Path, *, is_metric: bool) -> None:
    rig = found(replace(RIG, is_scale_known=is_metric))
    words = words_of(page(tmp_path / "page.html", rig, judged(rig)))
    assert "zero known to 26 px, as it is" in words
    # sigma_z / z = z sigma_d / (f B) at 0.5 m, or at 50 baselines of any length
    distance = 0.5 if is_metric else 50 * RIG.baseline_m
    share = distance * np.hypot(0.5, 26.0) / (RIG.tele.f_px * RIG.baseline_m)
    assert f"{share:.1%}" in words
    assert ("zero pinned with --distance" in words) is is_metric
    assert ("depth is relative" in words) is not is_metric


@pytest.mark.parametrize(("factor", "is_shown"), [(1.01, False), (1.13, True)])
def test_the_table_and_the_checks_say_the_same_of_a_focal_length(
    tmp_path: Path, factor: float, *, is_shown: bool
) -> None:
    focal = FocalPrior(factor * RIG.tele.f_px, factor * RIG.wide.f_px)
    rig = found(focal=focal)
    words = words_of(page(tmp_path / "page.html", rig, judged(rig)))
    assert ("matches hardly show it" in words) != is_shown
    assert ("Matches want a tele focal length" in words) == is_shown
    assert (
        f"{rig.tele_f_contradiction:.1f} standard deviations from the {focal.tele_f_px:.0f} px" in words
    ) == is_shown


def test_what_was_not_checked_is_said(tmp_path: Path) -> None:
    rig = found(n_scenes=4, side_source="guessed")
    words = words_of(page(tmp_path / "page.html", rig, judged(rig, is_checked=False), has_pair=False))
    assert "Not good enough" in words
    assert "Nothing was held out" in words
    assert "Take 2 more" in words
    assert "a guess: state it with --wide-side" in words
    assert "cannot rectify" in words
