"""What EXIF says of board photos: pieces of the wide lens's photo are set aside, photos held otherwise are turned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from boards.board_photos import board_photo, px_from_pattern
from capture.roll import TELE, WIDE, exif_of, write_photo
from PIL import Image

from telewide.boards.board import Board
from telewide.boards.detection import BoardView
from telewide.boards.orientation import turned_view
from telewide.boards.photo_facts import with_checked_facts
from telewide.boards.shots import BoardShot, detect_shots, find_board_shots
from telewide.errors import InputError

CROP = {"focal": 4.25, "f35": 52}
BOARD = Board(kind="chessboard", columns=6, rows=5, square_m=0.03)


def shoot(folder: Path, name: str, **lenses: dict[str, object]) -> None:
    for view, stated in lenses.items():
        write_photo(folder / name / f"{view}.jpg", exif=exif_of(**stated))  # type: ignore[arg-type]


def test_pieces_of_the_wide_photo_are_set_aside_before_anything_is_solved(tmp_path: Path) -> None:
    for k in range(7):
        shoot(tmp_path, f"near {k}", tele=CROP, wide=WIDE)
        shoot(tmp_path, f"true {k}", tele=TELE, wide=WIDE)
    shots = {shot.name: shot for shot in with_checked_facts(find_board_shots(tmp_path))}
    assert all(shots[f"true {k}"].tele_path is not None for k in range(7))
    for k in range(7):
        shot = shots[f"near {k}"]
        assert (shot.tele_path, shot.wide_path) == (None, tmp_path / f"near {k}" / "wide.jpg")
        (note,) = shot.notes
        assert str(tmp_path / f"near {k}" / "tele.jpg") in note
        assert "digital crop of the 4.25 mm lens: 52 mm equivalent, where other photos of it have 26" in note


def test_a_set_of_nothing_but_pieces_is_refused(tmp_path: Path) -> None:
    for k in range(3):
        shoot(tmp_path, f"near {k}", tele=CROP, wide=WIDE)
    with pytest.raises(InputError, match="none of the 3 tele photos was taken with the tele lens") as caught:
        with_checked_facts(find_board_shots(tmp_path))
    assert "more light" in str(caught.value.hint)


def test_a_photo_of_another_lens_than_its_folder_is_set_aside(tmp_path: Path) -> None:
    for k in range(3):
        shoot(tmp_path, f"{k}", tele=TELE, wide=WIDE)
    shoot(tmp_path, "wrong", tele=WIDE, wide=TELE)
    wrong = with_checked_facts(find_board_shots(tmp_path))[-1]
    assert (wrong.tele_path, wrong.wide_path) == (None, None)
    assert "taken with the 4.25 mm lens, where the others beside it are of the 6 mm lens" in wrong.notes[0]


@pytest.mark.parametrize("stated", [{}, WIDE])
def test_lenses_that_nothing_tells_apart_stay(tmp_path: Path, stated: dict[str, object]) -> None:
    """No EXIF; or two lenses of one focal length, as stereo cameras have."""
    for k in range(3):
        shoot(tmp_path, f"{k}", tele=stated, wide=stated)
    shots = find_board_shots(tmp_path)
    assert with_checked_facts(shots) == shots


def test_shots_are_turned_as_most_are_held(tmp_path: Path) -> None:
    for name, tele, wide in (("a", 1, 6), ("b", 1, 6), ("c", 6, 3), ("d", 3, 6), ("e", 8, 1), ("f", 5, 6)):
        shoot(tmp_path, name, tele=TELE | {"orientation": tele}, wide=WIDE | {"orientation": wide})
    shots = with_checked_facts(find_board_shots(tmp_path))
    turns = {shot.name: (shot.tele_turn_deg, shot.wide_turn_deg) for shot in shots}
    assert turns == {"a": (0, 0), "b": (0, 0), "c": (270, 270), "d": (180, 0), "e": (90, 90), "f": (0, 0)}


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_corners_turn_as_the_photo_does(turns: int) -> None:
    photo = np.zeros((5, 8))
    places = np.array([[0, 0], [7, 0], [2, 4], [6, 3]])
    photo[places[:, 1], places[:, 0]] = [1, 2, 3, 4]
    view = turned_view(BoardView(np.arange(4), places.astype(np.float64), photo.shape), 90 * turns)  # type: ignore[arg-type]
    turned = np.rot90(photo, -turns)
    assert view.hw == turned.shape
    found = view.points_px.astype(int)
    assert turned[found[:, 1], found[:, 0]].tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_the_corners_are_those_of_the_lens_however_the_phone_was_held(tmp_path: Path, orientation: int) -> None:
    """One and the same stored photo, of which EXIF says that it is upright, or turned."""
    homography = px_from_pattern(BOARD, hw=(240, 320), f_px=400, distance_m=0.6, tilt_deg=(20, 15), turn_deg=0)
    stored = Image.fromarray(board_photo(BOARD, homography, hw=(240, 320), blur_px=0.6, samples=3))
    shots = []
    for name, stated in (("a", 1), ("b", 1), ("held", orientation)):
        for view in ("tele", "wide"):
            path = tmp_path / name / f"{view}.jpg"
            path.parent.mkdir(exist_ok=True)
            stored.save(path, exif=exif_of(orientation=stated).tobytes(), quality=95)
        shots.append(BoardShot(name, tmp_path / name / "tele.jpg", tmp_path / name / "wide.jpg"))
    upright, _, held = detect_shots(with_checked_facts(shots), board=BOARD, processes=1)
    for view, other in ((upright.tele, held.tele), (upright.wide, held.wide)):
        assert view is not None
        assert other is not None
        assert (view.ids.tolist(), view.hw) == (other.ids.tolist(), other.hw)
        np.testing.assert_allclose(other.points_px, view.points_px, atol=0.02)
