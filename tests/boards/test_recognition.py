"""The shipped boards are told apart by photos of them, and by nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from boards.board_photos import board_photo, px_from_pattern

from telewide.boards.board import list_boards, load_board
from telewide.boards.recognition import recognise_board
from telewide.boards.shots import BoardShot
from telewide.capture.images import write_image
from telewide.errors import InputError

HW = (480, 640)


def shots_of(name: str, folder: Path) -> list[BoardShot]:
    """A shot without a board in it, then one of the board in both photos."""
    board = load_board(name)
    rng = np.random.default_rng(2)
    paths = {lens: folder / f"{lens}.png" for lens in ("tele", "wide", "blank")}
    write_image(paths["blank"], rng.random((*HW, 3)).astype(np.float32))
    for lens, f_px in (("tele", 850.0), ("wide", 700.0)):
        homography = px_from_pattern(board, hw=HW, f_px=f_px, distance_m=3.0 * board.wh_m[1], tilt_deg=(15, 20))
        write_image(paths[lens], board_photo(board, homography, hw=HW, samples=2).astype(np.float32) / 255)
    return [BoardShot("a", paths["blank"], None), BoardShot("b", paths["tele"], paths["wide"])]


@pytest.mark.parametrize("name", list_boards())
def test_each_board_is_recognised(name: str, tmp_path: Path) -> None:
    found = recognise_board(shots_of(name, tmp_path))
    assert name in (found.name, *found.same_pattern)
    twins = {"chessboard_9x6", "chessboard_9x6_a3"}  # differ in size alone
    assert {found.name, *found.same_pattern} == (twins if name in twins else {name})


def test_no_board_lists_those_that_were_tried(tmp_path: Path) -> None:
    (tmp_path / "broken.png").write_bytes(b"no picture")
    blank = [*shots_of("chessboard_9x6", tmp_path)[:1], BoardShot("broken", tmp_path / "broken.png", None)]
    with pytest.raises(InputError) as caught:
        recognise_board(blank)
    assert all(name in caught.value.message for name in list_boards())
