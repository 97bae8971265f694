"""A rig without a board: what the command asks for, and what it finds on drawn scenes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from capture.roll import TELE, WIDE, exif_of, write_photo
from numpy.typing import NDArray
from photographed_boards import drawn_rig

from telewide.calibration.rig_file import read_rig
from telewide.calibration.scene_quality import ZERO_CHECK, zero_std_px
from telewide.capture.images import write_image
from telewide.cli import main
from telewide.geometry.rig import Camera, rigid_transform
from telewide.stages.calibrate_scenes import SceneOptions, scenes_call

TEXTURE_WH = (1600, 1200)


def run_cli(*words: str) -> int:
    with pytest.raises(SystemExit) as left:
        main(words)
    return int(left.value.code or 0)


def f35_of_drawn_rig() -> str:
    cameras = (drawn_rig().tele, drawn_rig().wide)
    return ",".join(f"{camera.f_px * math.hypot(36, 24) / math.hypot(*camera.hw):.2f}" for camera in cameras)


def texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """Noise of many sizes."""
    layers = [
        cv2.resize(rng.random((n * 3 // 4, n)).astype(np.float32), TEXTURE_WH, interpolation=cv2.INTER_CUBIC) / weight
        for n, weight in ((20, 1), (80, 1.2), (260, 1.5), (800, 1.7))
    ]
    total = np.sum(layers, axis=0)
    return np.asarray((total - total.min()) / np.ptp(total), dtype=np.float32)


def photo(camera: Camera, camera_from_tele: NDArray[np.float64], planes: list[tuple]) -> NDArray[np.float32]:
    """Draw textured planes, the farthest first, at twice the size, and shrink."""
    fine_K = np.diag([2.0, 2.0, 1.0]) @ camera.K
    fine_K[:2, 2] += 0.5
    fine = np.full((2 * camera.hw[0], 2 * camera.hw[1]), 0.4, dtype=np.float32)
    for tele_from_plane, image, width_m in planes:
        plane_from_px = np.diag([width_m / TEXTURE_WH[0]] * 2 + [1.0]) @ np.array(
            [[1, 0, -TEXTURE_WH[0] / 2], [0, 1, -TEXTURE_WH[1] / 2], [0, 0, 1]]
        )
        photo_from_px = fine_K @ (camera_from_tele @ tele_from_plane)[:3, [0, 1, 3]] @ plane_from_px
        drawn = cv2.warpPerspective(image, photo_from_px, fine.shape[::-1])
        covered = cv2.warpPerspective(np.ones_like(image), photo_from_px, fine.shape[::-1]) > 0.99
        fine[covered] = drawn[covered]
    small = cv2.resize(fine, camera.hw[::-1], interpolation=cv2.INTER_AREA)
    return np.repeat(np.clip(small, 0, 1)[..., None], 3, axis=2)


def write_scenes(folder: Path, *, count: int) -> Path:
    """A wall 2 to 4 m away and two boards in front of it, photographed by the drawn rig."""
    rng = np.random.default_rng(3)
    rig = drawn_rig()
    for number in range(count):
        wall_m = rng.uniform(2, 4)
        wall = rigid_transform(rotation=rng.uniform(-0.5, 0.5, 3), translation=np.array([0, 0, wall_m]))
        planes = [(wall, texture(rng), 2.4 * wall_m)]
        for _ in range(2):
            near_m = rng.uniform(0.6, 1.3)
            place_m = near_m * np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), 1.0])
            pose = rigid_transform(rotation=rng.uniform(-0.5, 0.5, 3), translation=place_m)
            planes.append((pose, texture(rng), 0.18 * near_m))
        for name, camera, transform in (("tele", rig.tele, np.eye(4)), ("wide", rig.wide, rig.wide_from_tele)):
            write_image(folder / f"scene_{number}" / f"{name}.png", photo(camera, transform, planes))
    return folder


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--f35", "27,80"), "longer"),
        (("--f35", "80"), "two numbers"),
        (("--baseline-m", "12"), "metres"),
        (("--board", "chessboard_9x6"), "--from-scenes"),
        (("--wide-side", "behind"), "left, right, above, below"),
    ],
)
def test_wrong_calls(words: tuple[str, ...], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_cli("calibrate", str(tmp_path), "--from-scenes", *words) == 2
    assert named in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [("--baseline-m", "0.012"), ("--f35", "80,27"), ("--wide-side", "left"), ("--wide-side", "behind")]
)
def test_options_of_scenes_do_not_go_with_a_board(
    words: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_cli("calibrate", str(tmp_path), *words) == 2
    told = capsys.readouterr().err
    assert words[0] in told
    assert "--from-scenes" in told


def test_photos_without_exif_need_their_focal_lengths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_cli("calibrate", "--from-scenes") == 2  # no captures/
    for name in ("tele", "wide"):
        write_image(tmp_path / "captures" / "one" / f"{name}.png", rng.random((96, 128, 3)).astype(np.float32))
    capsys.readouterr()
    assert run_cli("calibrate", "--from-scenes") == 3
    assert "--f35" in capsys.readouterr().err
    assert run_cli("calibrate", "--from-scenes", "--f35", "80,27") == 3  # one capture, and nothing to match in it
    assert not (tmp_path / "rig.yaml").exists()


def write_stating(path: Path, **stated: object) -> None:
    write_photo(path, exif=exif_of(**stated))  # type: ignore[arg-type]


def test_a_crop_of_wide_has_no_say(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cropped = {**WIDE, "f35": TELE["f35"]}
    for name, tele in (("one", TELE), ("two", cropped)):
        write_stating(tmp_path / name / "tele.jpg", **tele)
        write_stating(tmp_path / name / "wide.jpg", **WIDE)
    assert run_cli("calibrate", str(tmp_path), "--from-scenes") == 3  # nothing matches in noise
    assert "1 capture in" in capsys.readouterr().err
    write_stating(tmp_path / "one" / "tele.jpg", **cropped)
    assert run_cli("calibrate", str(tmp_path), "--from-scenes") == 3
    told = capsys.readouterr().err
    assert "no capture can be used" in told
    assert "left out: one" in told
    assert "digital crop of the wide lens" in told


def test_the_call_that_is_advised_names_all_that_was_stated() -> None:
    options = SceneOptions(baseline_m=0.012, wide_side="left", f35_mm=(80, 27), out=Path("phone B.yaml"), seed=3)
    stated = "--from-scenes --f35 80,27 --baseline-m 0.012 --wide-side left --seed 3 --out 'phone B.yaml'"
    assert scenes_call(Path("my captures"), options).again() == f"telewide calibrate 'my captures' {stated}"
    assert scenes_call(Path("captures"), SceneOptions()).again() == "telewide calibrate captures --from-scenes"


@pytest.mark.parametrize("share", [0.02, 0.9])
def test_a_corrupt_photo_leaves_the_other_captures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], share: float
) -> None:
    """Cut off in its header, or in its pixels; the others are noise, in which nothing matches."""
    for name in ("one", "two", "three"):
        for view, lens in (("tele", TELE), ("wide", WIDE)):
            write_photo(tmp_path / name / f"{view}.jpg", wh=(96, 72), exif=exif_of(**lens))  # type: ignore[arg-type]
    cut = tmp_path / "one" / "tele.jpg"
    cut.write_bytes(cut.read_bytes()[: int(share * cut.stat().st_size)])
    assert run_cli("calibrate", str(tmp_path), "--from-scenes") == 3
    told = capsys.readouterr().err
    assert "a rig without a board needs 3 captures with 40 matches, found 0" in told
    assert f"left out: one: {cut}" in told
    assert "two: 0 matches, too few for a say" in told


@pytest.mark.parametrize("orientation", [3, 6])
def test_captures_held_otherwise_than_most_have_no_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], orientation: int
) -> None:
    """On its side, or upside down: there the lenses stand the other way round, in photos of the same size."""
    for name, held in (("one", 1), ("two", 1), ("three", orientation)):
        for view, lens in (("tele", TELE), ("wide", WIDE)):
            exif = exif_of(**lens, orientation=held)  # type: ignore[arg-type]
            write_photo(tmp_path / name / f"{view}.jpg", wh=(96, 72), exif=exif)
    assert run_cli("calibrate", str(tmp_path), "--from-scenes") == 3
    told = capsys.readouterr().err
    assert "left out: three: photos of another size or held otherwise" in told
    assert "two: 0 matches" in told


def test_photos_made_in_two_ways_have_no_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, model in (("one", "Phone 1"), ("two", "Phone 2")):
        for view, lens in (("tele", TELE), ("wide", WIDE)):
            write_stating(tmp_path / name / f"{view}.jpg", **lens, model=model)
    assert run_cli("calibrate", str(tmp_path), "--from-scenes") == 3
    assert "not made in the same way" in capsys.readouterr().err


@pytest.mark.slow
def test_drawn_scenes_give_the_ratio_and_say_what_they_cannot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_scenes(tmp_path / "captures", count=8)
    code = run_cli("calibrate", "--from-scenes", "--f35", f35_of_drawn_rig(), "--json")
    answer = json.loads(capsys.readouterr().out)
    assert code == (4 if answer["verdict"] == "insufficient" else 0)
    assert answer["source"] == "scenes"
    assert answer["baseline_m"] is None
    assert answer["asymmetry"] == pytest.approx(drawn_rig().asymmetry, rel=0.005)
    assert answer["epipolar_p90_px"] < 0.75 * answer["asymmetry"]
    assert not answer["scale_verified"]
    stored = read_rig(tmp_path / "rig.yaml")
    assert not stored.rig.is_scale_known
    assert {ZERO_CHECK, "tele focal length against EXIF"} <= {check.name for check in stored.quality.checks}
    assert any("relative" in note for note in stored.facts.notes)
    assert answer["report"] == "rig_report.html"
    assert f"{answer['epipolar_p90_px']:.2f} tele px" in (tmp_path / "rig_report.html").read_text(encoding="utf-8")
    assert run_cli("show", "rig.yaml") == 0
    shown = capsys.readouterr().out
    assert f"the zero of disparity is known to {zero_std_px(stored.quality):.0f} px only" in shown


@pytest.mark.slow
def test_a_stated_baseline_and_too_few_captures_to_check_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_scenes(tmp_path / "captures", count=4)
    words = ("--f35", f35_of_drawn_rig(), "--baseline-m", "0.012", "--wide-side", "right", "--out", "few.yaml")
    assert run_cli("calibrate", "--from-scenes", *words, "--json") == 4
    captured = capsys.readouterr()
    assert "report: few_report.html" in captured.err
    answer = json.loads(captured.out)
    assert answer["verdict"] == "insufficient"
    assert "Take 2 more captures" in answer["hint"]
    assert answer["hint"].endswith("After photos of a board: telewide calibrate boards --out few.yaml")
    assert answer["epipolar_p90_px"] is None
    assert (answer["baseline_m"], answer["baseline_std_m"]) == (pytest.approx(0.012), pytest.approx(0.0005))
    assert not answer["scale_verified"]
    std = read_rig(tmp_path / "few.yaml").transform_std
    assert std is not None
    assert std.baseline_m == pytest.approx(0.0005)
    assert "12.00 ± 0.50 mm" in (tmp_path / "few_report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_matches_that_contradict_exif_are_no_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The truth is 1611 px, which EXIF's 80 mm miss by 1 %; six rooms without much depth want far less.
    monkeypatch.chdir(tmp_path)
    captures = Path(__file__).parents[2] / "examples" / "phone" / "captures"
    assert run_cli("calibrate", str(captures), "--from-scenes", "--json") == 4
    assert "Matches want a tele focal length" in json.loads(capsys.readouterr().out)["hint"]
    assert "matches hardly show it" not in (tmp_path / "rig_report.html").read_text(encoding="utf-8")
