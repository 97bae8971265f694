"""What a rig from scenes is worth: the verdict when nothing was held out, and what no match can show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, seen_points

from telewide.calibration.quality import Check
from telewide.calibration.scene_quality import (
    MIN_CHECKED_SCENES,
    SceneEvidence,
    is_match,
    judge_scenes,
    row_errors_px,
    zero_std_px,
)
from telewide.calibration.scene_rig import FocalPrior, SceneRig, SceneStd, SideSource, scene_notes
from telewide.geometry.rig import StereoRig
from telewide.points.epipolar import across_in_wide, moved_rig

RIG = phone_rig(has_distortion=False)
FOCAL = FocalPrior(RIG.tele.f_px, RIG.wide.f_px)


def made(
    rig: StereoRig = RIG, *, n_scenes: int = 8, zero_px: float = 20.0, side_source: SideSource = "stated"
) -> SceneRig:
    two = np.full(2, 0.02)
    std = SceneStd(0.05, 0.003, 250 * two, np.full(3, 1e-3), two, two / 2, 800 * two, zero_px, baseline_m=0.0005)
    return SceneRig(rig, std, n_scenes, side_source, FOCAL)


def check(evidence: SceneEvidence, word: str) -> Check:
    found = [each for each in judge_scenes(evidence).checks if word in each.name]
    assert len(found) == 1, word
    return found[0]


def halves(second: StereoRig = RIG) -> tuple[SceneRig, SceneRig]:
    return made(n_scenes=4), made(second, n_scenes=4)


@pytest.mark.parametrize("n_scenes", [3, 5])
def test_a_rig_that_nothing_was_held_out_from_is_not_usable(n_scenes: int) -> None:
    quality = judge_scenes(SceneEvidence(made(n_scenes=n_scenes), None))
    assert quality.verdict == "insufficient"
    failed = [each for each in quality.checks if each.status == "fail"]
    assert [each.name for each in failed] == ["captures to check the rig by"]
    assert f"Take {MIN_CHECKED_SCENES - n_scenes} more" in failed[0].advice
    assert np.isnan([quality.epipolar_p90_px, quality.cross_validation_px]).all()


def test_with_halves_that_agree_it_is_usable() -> None:
    evidence = SceneEvidence(made(), halves(), (np.linspace(0, 0.5, 51), np.linspace(0.5, 1, 50)))
    quality = judge_scenes(evidence)
    assert quality.verdict == "usable"
    assert quality.cross_validation_px == pytest.approx(0, abs=1e-9)
    assert quality.epipolar_p50_px == pytest.approx(0.5)
    assert quality.epipolar_p90_px == pytest.approx(0.9, abs=0.01)
    assert check(evidence, "check the rig").status == "pass"


def test_the_guide_says_how_far_exif_is_trusted(repo: Path) -> None:
    prior = FocalPrior(RIG.tele.f_px, RIG.wide.f_px)
    told = f"trusted to {prior.tele_std_share:.0%}, and the ratio of the two lenses to {prior.ratio_std_share:.0%}"
    assert told.replace("%", " %") in (repo / "docs" / "capture.md").read_text(encoding="utf-8").replace("\n  ", " ")


@pytest.mark.parametrize("error_px", [0.5, 3.0, 12.0])
def test_the_same_captures_with_more_pixels_are_judged_alike(error_px: float) -> None:
    """12 and 50 megapixels of one sensor: errors have twice the px, and are no larger."""
    verdicts, doubts = [], []
    for width_px in (4032, 8064):
        zoom = width_px / 4032
        rig = phone_rig(has_distortion=False, width_px=width_px)
        turned = moved_rig(rig, rotation_vector=np.array([0, 0, 0.001 * error_px]))
        both = made(rig, zero_px=0.9 * zoom), made(turned, zero_px=0.9 * zoom)
        errors_px = np.full(50, error_px * zoom)
        assert is_match(errors_px, rig=rig).all() == (error_px < 9)
        whole = replace(both[0], focal=FocalPrior(rig.tele.f_px, rig.wide.f_px))
        quality = judge_scenes(SceneEvidence(whole, both, (errors_px,)))
        verdicts.append({each.name: each.status for each in quality.checks})
        doubts.append([note for note in scene_notes(whole) if "zero of disparity" in note])
    assert verdicts[0] == verdicts[1]
    assert doubts == [[], []]


def test_halves_that_differ_are_told_but_not_for_the_zero_of_disparity() -> None:
    across = across_in_wide(RIG)
    K = RIG.wide.K.copy()
    K[:2, 2] += 20 * np.array([across[1], -across[0]])  # along the baseline: no match shows it
    shifted = replace(RIG, wide=replace(RIG.wide, K=K))
    assert check(SceneEvidence(made(), halves(shifted)), "half the captures").value < 0.3
    turned = moved_rig(RIG, rotation_vector=np.array([0, 0, 0.03]))
    assert check(SceneEvidence(made(), halves(turned)), "half the captures").status == "fail"


@pytest.mark.parametrize(("source", "status"), [("guessed", "warn"), ("contradicted", "fail")])
def test_a_side_that_is_not_known_is_a_check(source: SideSource, status: str) -> None:
    assert check(SceneEvidence(made(side_source=source), halves()), "side").status == status
    names = [each.name for each in judge_scenes(SceneEvidence(made(), halves())).checks]
    assert not any("side" in name for name in names)


@pytest.mark.parametrize(("factor", "status"), [(1.02, "pass"), (0.98, "pass"), (0.95, "warn"), (0.885, "fail")])
def test_matches_that_contradict_exif_are_no_rig(factor: float, status: str) -> None:
    two = np.full(2, 0.02)
    std = SceneStd(0.02, 0.003, two, two, two, two, two, zero_px=20.0)
    tele, wide = (replace(camera, K=np.diag([factor, factor, 1]) @ camera.K) for camera in (RIG.tele, RIG.wide))
    both = SceneRig(replace(RIG, tele=tele, wide=wide), std, 8, "stated", FOCAL)
    off = check(SceneEvidence(both, halves()), "tele focal length against EXIF")
    assert off.status == status
    assert off.value == pytest.approx(abs(np.log(factor)) / np.hypot(0.02, 0.02))
    assert check(SceneEvidence(both, halves()), "f_wide against EXIF").status == "pass"
    one = SceneRig(replace(RIG, wide=wide), replace(std, ratio_share=0.0265), 8, "stated", FOCAL)
    assert check(SceneEvidence(one, halves()), "f_wide against EXIF").status == status


def test_the_zero_of_disparity_is_read_back() -> None:
    quality = judge_scenes(SceneEvidence(made(zero_px=27.5), halves()))
    assert zero_std_px(quality) == pytest.approx(27.5)
    assert zero_std_px(replace(quality, checks=())) == 0.0


def test_a_stated_baseline_is_not_a_measured_one() -> None:
    distance = check(SceneEvidence(made(), halves()), "distance of the lenses")
    assert distance.status == "warn"
    assert distance.value == pytest.approx(0.0005 / RIG.baseline_m)
    relative = made(replace(RIG, is_scale_known=False))
    assert not any("distance of the lenses" in each.name for each in judge_scenes(SceneEvidence(relative, None)).checks)


def test_row_errors_are_those_of_the_matches_and_mismatches_stand_out(rng: np.random.Generator) -> None:
    good = seen_points(RIG, rng, n=300, nearest_m=0.6, farthest_m=3.0)
    wrong = replace(good, src_px=np.vstack([good.src_px[:270], good.src_px[270:] + 30]))
    errors_px = row_errors_px(wrong, rig=RIG)
    kept = is_match(errors_px, rig=RIG)
    assert not kept[270:].any()
    assert kept[:270].all()
