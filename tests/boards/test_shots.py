"""Board photos in folders: what belongs together, what is noted, and that corners of one shot have the same ids."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from boards.board_photos import board_photo, pattern_points_m, projected, px_from_pattern
from ordinary_user import as_ordinary_user

from telewide.boards.board import Board
from telewide.boards.detection import BoardView
from telewide.boards.orientation import alike_numbered, direction_deg
from telewide.boards.shots import BoardShot, DetectedShot, detect_shots, find_board_shots
from telewide.errors import InputError, UsageError

HW = (240, 320)
BOARD = Board(kind="chessboard", columns=6, rows=5, square_m=0.03)
HALF_TURN = Board(kind="chessboard", columns=7, rows=5, square_m=0.03)
QUARTER_TURN = Board(kind="chessboard", columns=6, rows=6, square_m=0.03)


def write_photo(path: Path, board: Board, *, f_px: float, turn_deg: float = 0, tilt_x_deg: float = 20) -> None:
    homography = px_from_pattern(board, hw=HW, f_px=f_px, distance_m=0.6, tilt_deg=(tilt_x_deg, 15), turn_deg=turn_deg)
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), board_photo(board, homography, hw=HW, blur_px=0.6, samples=3))


def touch(folder: Path, *names: str) -> None:
    for number, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(bytes([number]))


def test_every_layout_also_mixed(tmp_path: Path) -> None:
    touch(tmp_path, "a/tele.jpg", "a/WIDE.JPG", "Tele/b.png", "wide/b.jpg", "wide/c.jpg", "d/tele.jpg", "a/notes.txt")
    touch(tmp_path, "tele_close/IMG_1.jpg", "wide-close/IMG_1.jpg", ".hidden/tele.jpg", "tele/.b.png", "other/x.jpg")
    shots = find_board_shots(tmp_path)
    found = {
        shot.name: tuple(
            path.relative_to(tmp_path).as_posix() if path else None for path in (shot.tele_path, shot.wide_path)
        )
        for shot in shots
    }
    assert found == {
        "a": ("a/tele.jpg", "a/WIDE.JPG"),
        "b": ("Tele/b.png", "wide/b.jpg"),
        "c": (None, "wide/c.jpg"),
        "d": ("d/tele.jpg", None),
        "tele_close/IMG_1": ("tele_close/IMG_1.jpg", None),
        "wide_close/IMG_1": (None, "wide-close/IMG_1.jpg"),
    }
    assert [shot.name for shot in shots] == sorted(found)


def test_the_photos_of_a_shot_are_found_by_any_letter_case(tmp_path: Path) -> None:
    touch(tmp_path, "tele/IMG_1.JPG", "wide/img_1.jpg", "tele_close/A.jpg", "tele_close/a.jpg")
    shots = {shot.name: (shot.tele_path, shot.wide_path) for shot in find_board_shots(tmp_path)}
    assert shots["IMG_1"] == (tmp_path / "tele" / "IMG_1.JPG", tmp_path / "wide" / "img_1.jpg")
    assert set(shots) == {"IMG_1", "tele_close/A", "tele_close/a"}


def test_raw_only_where_both_lenses_have_it(tmp_path: Path) -> None:
    touch(tmp_path, "a/tele.dng", "a/tele.jpg", "a/wide.jpg", "b/tele.dng", "b/tele.jpg", "b/wide.jpg", "b/wide.dng")
    a, b = find_board_shots(tmp_path)
    assert a.tele_path is not None
    assert b.tele_path is not None
    assert a.tele_path.suffix == ".jpg"
    assert b.tele_path.suffix == ".dng"
    assert a.notes == b.notes == ()


def test_what_is_no_folder_of_boards_is_said(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        find_board_shots(tmp_path / "boards")
    with pytest.raises(InputError, match="it is empty") as caught:
        find_board_shots(tmp_path)
    assert "tele_close" in (caught.value.hint or "")
    touch(tmp_path, "photo.jpg")
    with pytest.raises(InputError, match=r"photo\.jpg"):
        find_board_shots(tmp_path)
    with pytest.raises(UsageError, match="is a file"):
        find_board_shots(tmp_path / "photo.jpg")


def test_one_picture_twice_is_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "a/tele.jpg", "b/tele.jpg")
    (tmp_path / "a/wide.jpg").write_bytes((tmp_path / "a/tele.jpg").read_bytes())
    shot = find_board_shots(tmp_path)[0]
    assert shot.tele_path is None
    assert shot.wide_path is None
    assert "same picture" in shot.notes[0]


def test_bad_photos_are_notes_and_the_others_are_used(tmp_path: Path) -> None:
    write_photo(tmp_path / "a/tele.png", BOARD, f_px=600)
    write_photo(tmp_path / "a/wide.png", BOARD, f_px=400)
    write_photo(tmp_path / "b/wide.png", BOARD, f_px=500)
    touch(tmp_path, "b/tele.jpg")
    assert cv2.imwrite(str(tmp_path / "b" / "blank.png"), np.zeros(HW, np.uint8))
    (tmp_path / "c").mkdir()
    (tmp_path / "b" / "blank.png").rename(tmp_path / "c" / "tele.png")
    told: list[DetectedShot] = []
    shots = (*find_board_shots(tmp_path), BoardShot("gone", tmp_path / "gone.jpg", None))
    detected = detect_shots(shots, board=BOARD, tick=told.append, processes=1)
    assert told == list(detected)
    assert [shot.name for shot in detected] == ["a", "b", "c", "gone"]
    a, b, c, gone = detected
    assert a.tele is not None
    assert a.wide is not None
    assert a.notes == ()
    assert b.tele is None
    assert b.wide is not None
    assert "tele.jpg" in b.notes[0]
    assert "no board found" in c.notes[0]
    assert "does not exist" in gone.notes[0]


def test_what_nobody_can_look_at_leaves_the_others(tmp_path: Path) -> None:
    touch(tmp_path, "good/tele.png", "good/wide.png", "lost+found/tele.png")
    (tmp_path / "long").symlink_to("x" * 300)
    (tmp_path / "good" / "tele.jpg").symlink_to("x" * 300)

    def look() -> None:
        good, closed = find_board_shots(tmp_path)
        assert (good.name, good.notes) == ("good", ())
        assert (closed.tele_path, closed.wide_path) == (None, None)
        assert closed.notes == (f"{tmp_path / 'lost+found'} cannot be opened: Permission denied",)

    try:
        (tmp_path / "lost+found").chmod(0)
        as_ordinary_user(tmp_path, look)
    finally:
        (tmp_path / "lost+found").chmod(0o755)


def test_no_board_anywhere_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    assert cv2.imwrite(str(tmp_path / "a/tele.png"), np.zeros(HW, np.uint8))
    with pytest.raises(InputError, match="6 x 5 inner corners in any of 1 photos"):
        detect_shots(find_board_shots(tmp_path), board=BOARD, processes=1)
    unknown = Board(kind="aruco_grid", columns=2, rows=2, square_m=0.03, gap_m=0.01, dictionary="DICT_NONE")
    with pytest.raises(InputError, match="DICT_NONE"):
        detect_shots(find_board_shots(tmp_path), board=unknown, processes=1)


@pytest.mark.parametrize(
    ("board", "turn_deg"), [(BOARD, 100), (HALF_TURN, 85), (HALF_TURN, 92), (QUARTER_TURN, 42), (QUARTER_TURN, 50)]
)
def test_one_corner_has_one_id_in_both_views(tmp_path: Path, board: Board, turn_deg: float) -> None:
    # Near the turn where "points right" changes over, the two lenses alone would number the corners differently.
    write_photo(tmp_path / "a/tele.png", board, f_px=480, turn_deg=turn_deg - 4)
    write_photo(tmp_path / "a/wide.png", board, f_px=360, turn_deg=turn_deg + 4)
    shot = detect_shots(find_board_shots(tmp_path), board=board, processes=1)[0]
    assert shot.tele is not None
    assert shot.wide is not None
    assert len(shot.tele.ids) == len(shot.wide.ids) == board.n_corners
    np.testing.assert_array_equal(shot.tele.ids, np.sort(shot.tele.ids))
    np.testing.assert_array_equal(shot.wide.ids, np.sort(shot.wide.ids))
    turned_deg = direction_deg(shot.wide, board=board) - direction_deg(shot.tele, board=board)
    assert abs((turned_deg + 180) % 360 - 180) < 15
    assert shot.notes == ()


def test_every_numbering_is_brought_to_tele() -> None:
    homography = px_from_pattern(QUARTER_TURN, hw=HW, f_px=400, distance_m=0.6, tilt_deg=(20, 10))
    points_px = projected(homography, pattern_points_m(QUARTER_TURN))
    ids = np.arange(36)
    tele = BoardView(ids, points_px, HW)
    for quarter in range(4):
        turned_px = np.rot90(points_px.reshape(6, 6, 2), quarter).reshape(-1, 2)
        wide, note = alike_numbered(tele, BoardView(ids, turned_px, HW), board=QUARTER_TURN)
        np.testing.assert_allclose(wide.points_px, points_px)
        assert note is None


def test_a_photo_on_its_side_is_noted() -> None:
    board = Board(kind="aruco_grid", columns=2, rows=2, square_m=0.03, gap_m=0.01, dictionary="DICT_4X4_50")
    upright_px = projected(px_from_pattern(board, hw=HW, f_px=400, distance_m=0.6), pattern_points_m(board))
    ids = np.arange(16)
    sideways_px = np.column_stack([HW[0] - 1 - upright_px[:, 1], upright_px[:, 0]])
    wide, note = alike_numbered(BoardView(ids, upright_px, HW), BoardView(ids, sideways_px, HW[::-1]), board=board)
    np.testing.assert_array_equal(wide.ids, ids)
    assert note is not None
    assert "90 degrees" in note


@pytest.mark.slow
def test_the_number_of_processes_changes_nothing(tmp_path: Path) -> None:
    for number in range(3):
        write_photo(tmp_path / f"{number}/tele.png", BOARD, f_px=600, tilt_x_deg=10 * number)
        write_photo(tmp_path / f"{number}/wide.png", BOARD, f_px=400, tilt_x_deg=10 * number)
    touch(tmp_path, "3/tele.jpg")
    shots = find_board_shots(tmp_path)
    alone, together = (detect_shots(shots, board=BOARD, processes=n) for n in (1, 2))
    for one, other in zip(alone, together, strict=True):
        assert (one.name, one.notes) == (other.name, other.notes)
        for mine, theirs in ((one.tele, other.tele), (one.wide, other.wide)):
            assert (mine is None) == (theirs is None)
            if mine is not None and theirs is not None:
                np.testing.assert_array_equal(mine.ids, theirs.ids)
                np.testing.assert_array_equal(mine.points_px, theirs.points_px)
