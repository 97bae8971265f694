"""A rig in words: every number with its uncertainty where there is one, nothing that is not known."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from pages.made_calibration import CHECKS, DROPPED_REASON, made_calibration

from telewide.calibration.result import CameraStd
from telewide.calibration.rig_file import RigFacts, StoredRig
from telewide.geometry.rig import Camera, rigid_transform
from telewide.pages.rig_text import distortion_words, rig_lines, summary_line


def stored_rig(*, is_scale_known: bool = True, scale_verified: bool = False) -> StoredRig:
    calibration = made_calibration(is_scale_known=is_scale_known)
    return StoredRig(
        rig=calibration.rig,
        tele_std=calibration.tele_std,
        wide_std=calibration.wide_std,
        transform_std=calibration.transform_std,
        quality=calibration.quality,
        facts=RigFacts(
            image_pipeline="raw:Maker One",
            focus_distance_m=1.5,
            scale_verified=scale_verified,
            board="chessboard_9x6",
            notes=("squares are nominal",),
        ),
        n_joint_views=11,
        left_out=(f"shot_03 wide: {DROPPED_REASON}",),
    )


def test_numbers_come_with_their_uncertainty() -> None:
    text = "\n".join(rig_lines(stored_rig()))
    for words in (
        "3000.0 ± 1.5 px",
        "1000.0 ± 0.4 px",
        "799.5 ± 2.0 px",
        "12.00 ± 0.05 mm",
        "1600 x 1200",
        "k1 -0.1000",
    ):
        assert words in text
    for words in ("usable", "raw:Maker One", "1.5 m", "chessboard_9x6", DROPPED_REASON, "squares are nominal"):
        assert words in text
    turn_deg = np.degrees(np.hypot(0.01, 0.002))
    assert f"{turn_deg:.3f} ± {np.degrees(1e-4):.3f} degrees" in text
    assert CHECKS[1].advice in text
    assert "pass  joint views: 12 shots, at least 8 shots" in text
    assert "warn  coverage of <wide>: 41 %, at least 60 %" in text


def test_a_coefficient_tells_how_sure_it_is_or_that_it_was_held() -> None:
    camera = Camera((10, 10), np.diag([9.0, 9.0, 1.0]), np.array([0.05, 0.0, 3e-5, 0.0, 0.1]))
    std = CameraStd(1.0, 1.0, 1.0, np.array([0.01, 0.1, 1e-6, 0.0, 0.0]))
    assert distortion_words(camera, std) == {
        "k1": "+0.0500 ± 0.0100",
        "k2": "fixed at 0",
        "p1": "+0.0000300 ± 0.0000010",
        "p2": "fixed at 0",
        "k3": "fixed at +0.1",
    }
    assert distortion_words(camera, None)["k1"] == "+0.0500"


def test_nominal_and_unknown_scale_are_said() -> None:
    assert "nominal" in "\n".join(rig_lines(stored_rig())).partition("note")[0]
    assert "nominal" not in "\n".join(rig_lines(stored_rig(scale_verified=True))).partition("note")[0]
    unknown = "\n".join(rig_lines(stored_rig(is_scale_known=False)))
    assert "not known in metres" in unknown
    assert " mm" not in unknown


def test_the_turn_is_as_sure_as_the_turns_about_its_own_axis(rng: np.random.Generator) -> None:
    stored = stored_rig()
    assert stored.transform_std is not None
    spread = rng.normal(size=(6, 6)) * 3e-4
    std = dataclasses.replace(stored.transform_std, covariance=spread @ spread.T)
    text = "\n".join(rig_lines(dataclasses.replace(stored, transform_std=std)))
    small = rng.multivariate_normal(np.zeros(3), std.covariance[:3, :3], size=4000)
    turned = [
        dataclasses.replace(
            stored.rig, wide_from_tele=rigid_transform(rotation=by, translation=np.zeros(3)) @ stored.rig.wide_from_tele
        )
        for by in small
    ]
    found = re.search(r"± ([0-9.]+) degrees", text)
    assert found is not None
    assert float(found[1]) == pytest.approx(np.std([rig.turn_deg for rig in turned]), rel=0.06)


def test_a_distance_of_exif_has_three_figures() -> None:
    stored = stored_rig()
    text = rig_lines(dataclasses.replace(stored, facts=dataclasses.replace(stored.facts, focus_distance_m=0.877962)))
    assert any(re.fullmatch(r"focused at +0\.878 m", line) for line in text)


def test_what_nobody_knows_is_left_out() -> None:
    bare = dataclasses.replace(
        stored_rig(), tele_std=None, wide_std=None, transform_std=None, facts=RigFacts(source="scenes"), left_out=()
    )
    text = "\n".join(rig_lines(bare))
    assert "3000.0 px" in text
    assert "12.00 mm" in text
    assert "±" not in text
    assert "None" not in text
    assert "nan" not in text


def test_summary_is_one_line() -> None:
    calibration = made_calibration()
    line = summary_line(calibration.rig, calibration.quality, baseline_std_m=5e-5)
    assert line.startswith("usable: ")
    assert "12.00 ± 0.05 mm" in line
    assert "\n" not in line
    nan = float("nan")
    without = dataclasses.replace(calibration.quality, epipolar_p90_px=nan)
    assert "nan" not in summary_line(calibration.rig, without)
