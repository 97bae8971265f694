"""Corners found in drawn photos, whose truth is exact, and in photographed sets."""

from __future__ import annotations

import resource
from pathlib import Path

import cv2
import numpy as np
import pytest
from boards.board_photos import board_photo, pattern_points_m, projected, px_from_pattern
from numpy.typing import NDArray
from PIL import Image

from telewide.boards.board import Board, board_points_m, load_board
from telewide.boards.detection import BoardView, detect_board
from telewide.boards.photo_detection import detect_photos, read_grey

EXACT_PX = 0.05
HW = (480, 640)
SHORT = Board(kind="chessboard", columns=6, rows=5, square_m=0.03)
CHARUCO = Board(kind="charuco", columns=6, rows=5, square_m=0.03, marker_m=0.021, dictionary="DICT_4X4_50")
LEGACY = CHARUCO.model_copy(update={"rows": 4, "legacy_pattern": True})
GRID = Board(kind="aruco_grid", columns=4, rows=3, square_m=0.036, gap_m=0.009, dictionary="DICT_4X4_50")


def errors_px(view: BoardView, board: Board, homography: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each corner from its truth; large where an id is wrong."""
    assert (np.diff(view.ids) > 0).all()
    truth_px = projected(homography, pattern_points_m(board))[view.ids]
    return np.asarray(np.linalg.norm(view.points_px - truth_px, axis=1))


def rms_px(values_px: NDArray[np.float64]) -> float:
    return float(np.sqrt((values_px**2).mean()))


@pytest.mark.parametrize("turn_deg", [0, 40, 180, -75])
def test_chessboard_is_exact_and_knows_its_ends(turn_deg: float) -> None:
    homography = px_from_pattern(SHORT, hw=HW, f_px=900, distance_m=0.6, tilt_deg=(25, -20), turn_deg=turn_deg)
    photo = board_photo(SHORT, homography, hw=HW, blur_px=0.8, noise=1)
    view = detect_board(photo, board=SHORT)
    assert view is not None
    assert view.hw == HW
    assert view.ids.tolist() == list(range(30))
    assert errors_px(view, SHORT, homography).max() < EXACT_PX


@pytest.mark.parametrize(
    ("blur_px", "noise", "limit_px"), [(0.5, 0, 0.007), (1.5, 3, 0.06), (3.0, 0, 0.03), (3.0, 3, 0.15)]
)
def test_blur_moves_no_corner(blur_px: float, noise: float, limit_px: float) -> None:
    homography = px_from_pattern(SHORT, hw=HW, f_px=900, distance_m=0.55, tilt_deg=(-20, 30))
    view = detect_board(board_photo(SHORT, homography, hw=HW, blur_px=blur_px, noise=noise), board=SHORT)
    assert view is not None
    assert len(view.ids) == 30
    errors = errors_px(view, SHORT, homography)
    assert rms_px(errors) < limit_px
    offsets = view.points_px - projected(homography, pattern_points_m(SHORT))[view.ids]
    assert np.abs(offsets.mean(axis=0)).max() < limit_px / 2, "all corners are off to one side"


def test_small_squares_are_found() -> None:
    # 12 px a square: the least that is of use.
    homography = px_from_pattern(SHORT, hw=HW, f_px=480, distance_m=1.2, tilt_deg=(10, 10))
    view = detect_board(board_photo(SHORT, homography, hw=HW, noise=1), board=SHORT)
    assert view is not None
    assert errors_px(view, SHORT, homography).max() < 0.1


@pytest.mark.slow
def test_large_photo_is_measured_at_its_own_size() -> None:
    hw = (1500, 2100)
    homography = px_from_pattern(SHORT, hw=hw, f_px=3000, distance_m=0.6, tilt_deg=(25, -20), turn_deg=10)
    view = detect_board(board_photo(SHORT, homography, hw=hw, noise=1, samples=2), board=SHORT)
    assert view is not None
    assert view.hw == hw
    assert len(view.ids) == 30
    assert errors_px(view, SHORT, homography).max() < EXACT_PX


@pytest.mark.parametrize("board", [CHARUCO, LEGACY], ids=["charuco", "legacy"])
@pytest.mark.parametrize("turn_deg", [0, 150])
def test_charuco_is_exact(board: Board, turn_deg: float) -> None:
    homography = px_from_pattern(board, hw=HW, f_px=1200, distance_m=0.55, tilt_deg=(25, -20), turn_deg=turn_deg)
    view = detect_board(board_photo(board, homography, hw=HW, noise=1), board=board)
    assert view is not None
    assert len(view.ids) > 0.9 * board.n_corners
    errors = errors_px(view, board, homography)
    assert rms_px(errors) < EXACT_PX
    assert errors.max() < 2 * EXACT_PX


def test_charuco_of_the_other_pattern_is_not_found() -> None:
    homography = px_from_pattern(LEGACY, hw=HW, f_px=1200, distance_m=0.55)
    photo = board_photo(LEGACY, homography, hw=HW)
    view = detect_board(photo, board=LEGACY.model_copy(update={"legacy_pattern": False}))
    assert view is None


def test_charuco_partly_out_of_the_photo_and_covered() -> None:
    homography = px_from_pattern(CHARUCO, hw=HW, f_px=1600, distance_m=0.55, tilt_deg=(15, 20), offset_m=(0.06, 0.03))
    photo = board_photo(CHARUCO, homography, hw=HW, noise=1)
    truth_px = projected(homography, pattern_points_m(CHARUCO))
    is_inside = ((truth_px > 8) & (truth_px < np.array(HW[::-1]) - 9)).all(axis=1)
    assert 6 <= is_inside.sum() < CHARUCO.n_corners
    view = detect_board(photo, board=CHARUCO)
    assert view is not None
    assert is_inside[view.ids].all()
    assert len(view.ids) >= 0.7 * is_inside.sum()
    assert rms_px(errors_px(view, CHARUCO, homography)) < EXACT_PX
    middle_px = np.rint(truth_px[is_inside].mean(axis=0)).astype(int)
    cv2.circle(photo, tuple(middle_px.tolist()), 45, 128, -1)
    covered = detect_board(photo, board=CHARUCO)
    assert covered is not None
    is_covered = np.linalg.norm(truth_px - middle_px, axis=1) < 43
    assert not is_covered[covered.ids].any(), "a corner under a hand was made up"
    assert rms_px(errors_px(covered, CHARUCO, homography)) < EXACT_PX


@pytest.mark.parametrize("turn_deg", [12, 200])
def test_aruco_grid_is_exact(turn_deg: float) -> None:
    homography = px_from_pattern(GRID, hw=HW, f_px=1200, distance_m=0.6, tilt_deg=(25, -15), turn_deg=turn_deg)
    view = detect_board(board_photo(GRID, homography, hw=HW, noise=1, samples=6), board=GRID)
    assert view is not None
    assert len(view.ids) == GRID.n_corners
    errors = errors_px(view, GRID, homography)
    assert rms_px(errors) < EXACT_PX
    assert errors.max() < 3 * EXACT_PX


@pytest.mark.parametrize("board", [SHORT, CHARUCO, GRID], ids=["chessboard", "charuco", "aruco_grid"])
def test_no_board_is_none(board: Board, rng: np.random.Generator) -> None:
    assert detect_board(np.full(HW, 128, np.uint8), board=board) is None
    assert detect_board(rng.integers(0, 255, HW, dtype=np.uint8), board=board) is None
    assert detect_board(np.zeros((9, 7), np.uint8), board=board) is None
    other = Board(kind="chessboard", columns=8, rows=7, square_m=0.02)
    homography = px_from_pattern(other, hw=HW, f_px=900, distance_m=0.5, tilt_deg=(10, 10))
    assert detect_board(board_photo(other, homography, hw=HW), board=board) is None


def test_symmetric_board_points_right_as_far_as_it_can() -> None:
    board = Board(kind="chessboard", columns=5, rows=5, square_m=0.03)  # 6 x 6 squares: same after half a turn
    homography = px_from_pattern(board, hw=HW, f_px=900, distance_m=0.6, turn_deg=170)
    view = detect_board(board_photo(board, homography, hw=HW), board=board)
    assert view is not None
    grid_px = view.points_px.reshape(5, 5, 2)
    assert grid_px[:, -1, 0].mean() > grid_px[:, 0, 0].mean()
    assert grid_px[-1, :, 1].mean() > grid_px[0, :, 1].mean()


def views_of(photos: list[Path], board: Board) -> list[BoardView | None]:
    return [detect_board(read_grey(path), board=board) for path in photos]


def intrinsic_rms_px(views: list[BoardView | None], board: Board) -> float:
    points_m = board_points_m(board).astype(np.float32)
    seen = [view for view in views if view is not None]
    return float(
        cv2.calibrateCamera(
            [points_m[view.ids] for view in seen],
            [view.points_px.astype(np.float32)[:, None] for view in seen],
            seen[0].hw[::-1],
            None,
            None,
        )[0]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "n", "limit_px"), [("calib_stereo_opencv", 26, 0.18), ("calib_stereo_photos", 58, 0.17)]
)
def test_every_photo_of_the_chessboard_sets(data_root: Path, folder: str, n: int, limit_px: float) -> None:
    board = load_board("chessboard_9x6")
    for side in ("left", "right"):
        photos = sorted((data_root / folder).glob(f"{side}*.jpg"))
        assert len(photos) == n / 2
        views = views_of(photos, board)
        assert all(view is not None and len(view.ids) == 54 for view in views)
        assert intrinsic_rms_px(views, board) < limit_px


@pytest.mark.slow
def test_charuco_photos(data_root: Path) -> None:
    board = Board(kind="charuco", columns=12, rows=9, square_m=0.06, marker_m=0.047, dictionary="DICT_5X5_100")
    for name in ("pettod_im1.jpg", "pettod_im2.jpg"):
        view = detect_board(read_grey(data_root / "charuco_photos" / name), board=board)
        assert view is not None
        assert len(view.ids) == board.n_corners == 88
        # Distortion apart, a plane's photo is a homography of it.
        homography = cv2.findHomography(board_points_m(board)[:, :2], view.points_px)[0]
        assert rms_px(np.linalg.norm(projected(homography, board_points_m(board)[:, :2]) - view.points_px, axis=1)) < 1
    screen = Board(kind="charuco", columns=9, rows=5, square_m=0.03, marker_m=0.0225, dictionary="DICT_6X6_250")
    view = detect_board(read_grey(data_root / "charuco_photos" / "yumashino_measure.jpg"), board=screen)
    assert view is not None
    assert len(view.ids) >= 24  # words are written over some


@pytest.mark.slow
def test_aruco_photos(data_root: Path) -> None:
    board = Board(kind="aruco_grid", columns=4, rows=5, square_m=0.0375, gap_m=0.005, dictionary="DICT_6X6_1000")
    views = views_of(sorted((data_root / "aruco_board_photos").glob("*.jpg")), board)
    assert len(views) == 42
    assert all(view is not None and len(view.ids) >= 70 for view in views)
    assert intrinsic_rms_px(views, board) < 0.4


@pytest.mark.slow
def test_a_photo_without_a_board_is_soon_given_up(data_root: Path) -> None:
    import time

    photo = read_grey(next((data_root / "phone_tele_wide_exif").glob("*tele.[jJ]*")))
    started_s = time.process_time()
    assert detect_board(photo, board=load_board("chessboard_9x6")) is None
    assert time.process_time() - started_s < 20


def test_where_no_processes_can_be_started_one_looks_for_the_board(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Their semaphores are files in memory, which a limit of files, or no such place, forbids."""
    for name in ("a.png", "b.png"):
        Image.new("L", (64, 48)).save(tmp_path / name)
    paths, board = [tmp_path / "a.png", tmp_path / "b.png"], load_board("chessboard_9x6")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, hard))
    try:
        results = list(detect_photos(paths, board=board, processes=2))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(results) == 2
    assert "going on with one" in caplog.text
