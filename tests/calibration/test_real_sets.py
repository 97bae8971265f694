"""Real board photos against the figures other tools give for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.boards.board import board_points_m, load_board
from telewide.boards.shots import BoardShot, DetectedShot, detect_shots
from telewide.calibration.result import Calibration
from telewide.calibration.solver import calibrate_rig

BOARD = load_board("chessboard_9x6")
SQUARE_M = BOARD.square_m


def detected(folder: Path) -> tuple[DetectedShot, ...]:
    names = sorted((path.stem.removeprefix("left") for path in folder.glob("left*.jpg")), key=int)
    shots = [BoardShot(name, folder / f"left{name}.jpg", folder / f"right{name}.jpg") for name in names]
    return detect_shots(shots, board=BOARD, processes=1)


@pytest.fixture(scope="module")
def opencv_shots(data_root: Path) -> tuple[DetectedShot, ...]:
    return detected(data_root / "calib_stereo_opencv")


@pytest.fixture(scope="module")
def opencv(opencv_shots: tuple[DetectedShot, ...]) -> Calibration:
    return calibrate_rig(opencv_shots, board_points_m=board_points_m(BOARD))


def stereo_rms_px(calibration: Calibration) -> float:
    """RMS over the corners of both cameras, as OpenCV's stereoCalibrate counts it."""
    squared = [np.sum(view.residuals_px**2, axis=1) for view in calibration.views if view.is_used]
    return float(np.sqrt(np.mean(np.concatenate(squared))))


def test_opencv_sample_is_solved_as_well_as_by_opencv(opencv: Calibration, data_root: Path) -> None:
    assert all(view.is_used for view in opencv.views)
    assert len(opencv.views) == 26
    assert stereo_rms_px(opencv) <= 0.22
    assert opencv.rig.baseline_m / SQUARE_M == pytest.approx(3.33, rel=5e-3)
    assert opencv.rig.tele.f_px == pytest.approx(533, rel=5e-3)
    assert opencv.rig.wide.f_px == pytest.approx(537, rel=5e-3)
    assert opencv.quality.verdict != "insufficient"


@pytest.mark.slow
def test_photos_of_a_stereo_webcam(data_root: Path) -> None:
    found = calibrate_rig(detected(data_root / "calib_stereo_photos"), board_points_m=board_points_m(BOARD))
    assert stereo_rms_px(found) <= 0.26
    assert found.rig.tele.f_px == pytest.approx(463, rel=1e-2)
    assert np.mean([view.is_used for view in found.views]) > 0.85


def halved(path: Path, to: Path) -> Path:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    cv2.imwrite(str(to), cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    return to


@pytest.mark.slow
def test_one_camera_at_half_its_size(opencv: Calibration, data_root: Path, tmp_path: Path) -> None:
    """The focal ratio is told, and the boards stand where the set at full size puts them."""
    folder = data_root / "calib_stereo_opencv"
    names = [view.shot for view in opencv.views if view.camera == "tele"]
    shots = [
        BoardShot(name, folder / f"left{name}.jpg", halved(folder / f"right{name}.jpg", tmp_path / f"{name}.png"))
        for name in names
    ]
    found = calibrate_rig(detect_shots(shots, board=BOARD, processes=1), board_points_m=board_points_m(BOARD))
    expected, ratio = 2 * opencv.rig.asymmetry, found.rig.asymmetry
    std = ratio * np.hypot(found.tele_std.f_px / found.rig.tele.f_px, found.wide_std.f_px / found.rig.wide.f_px)
    assert abs(ratio / expected - 1) < 0.003 or abs(ratio - expected) < 1.96 * std
    distances_m = {(view.shot, view.camera): view.distance_m for view in opencv.views if view.is_used}
    for view in found.views:
        if view.is_used and (view.shot, view.camera) in distances_m:
            assert view.distance_m == pytest.approx(distances_m[view.shot, view.camera], rel=5e-3)


RUIN: dict[str, Callable[[DetectedShot, np.random.Generator, DetectedShot], DetectedShot]] = {
    "blurred": lambda shot, rng, other: replace(
        shot, tele=replace(shot.tele, points_px=shot.tele.points_px + 2 * rng.normal(size=(54, 2)))
    ),
    "exchanged": lambda shot, rng, other: replace(shot, tele=shot.wide, wide=shot.tele),
    "of another shot": lambda shot, rng, other: replace(shot, wide=other.wide),
    "of another board": lambda shot, rng, other: replace(
        shot, tele=replace(shot.tele, points_px=(shot.tele.points_px - 320) * (1.0, 1.1) + 320)
    ),
}


def test_a_third_ruined_is_named_and_does_no_harm(
    opencv: Calibration, opencv_shots: tuple[DetectedShot, ...], rng: np.random.Generator
) -> None:
    shots = list(opencv_shots)
    for index, ruin in zip((1, 4, 7, 10), RUIN.values(), strict=True):
        shots[index] = ruin(shots[index], rng, shots[index + 1])
    found = calibrate_rig(shots, board_points_m=board_points_m(BOARD))
    out = {view.shot for view in found.views if not view.is_used}
    assert out == {shots[index].name for index in (1, 4, 7, 10)}
    std_m = np.hypot(found.transform_std.baseline_m, opencv.transform_std.baseline_m)
    assert abs(found.rig.baseline_m - opencv.rig.baseline_m) < 3 * std_m
    for mine, theirs, std in (
        (found.rig.tele, opencv.rig.tele, found.tele_std),
        (found.rig.wide, opencv.rig.wide, found.wide_std),
    ):
        assert abs(mine.f_px - theirs.f_px) < 3 * std.f_px
