"""The PDF of a board, read back from its own bytes: true scale, true pattern, a ruler, a sound file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.boards.board import PAPER_WH_M, Board, list_boards, load_board, resized_board
from telewide.boards.pattern import black_rectangles_m
from telewide.boards.pdf import pdf_from_page
from telewide.boards.printing import RULER_M, board_page, largest_square_m, write_board
from telewide.errors import UsageError

POINTS_PER_M = 72 / 0.0254
TENTH_MM_PT = POINTS_PER_M * 1e-4


def rectangles_pt(data: bytes) -> NDArray[np.float64]:
    """Operands of every ``re`` in a file: x, y, width, height; y up."""
    return np.array([[float(n) for n in row] for row in re.findall(rb"(\S+) (\S+) (\S+) (\S+) re\n", data)])


def texts(data: bytes) -> list[str]:
    return [text.decode() for text in re.findall(rb"\((.*?)\) Tj", data)]


def media_box_pt(data: bytes) -> tuple[float, float]:
    found = re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", data)
    assert found is not None
    return float(found[1]), float(found[2])


@pytest.mark.parametrize("name", list_boards())
def test_true_scale_on_the_named_paper(tmp_path: Path, name: str) -> None:
    board = load_board(name)
    write_board(tmp_path / "b.pdf", board, name=name)
    data = (tmp_path / "b.pdf").read_bytes()
    width_pt, height_pt = media_box_pt(data)
    paper_pt = [length_m * POINTS_PER_M for length_m in PAPER_WH_M[board.paper]]
    assert sorted((width_pt, height_pt)) == pytest.approx(paper_pt, abs=1e-3)
    expected_m = black_rectangles_m(board)
    drawn_pt = rectangles_pt(data)
    pattern_pt, ruler_pt = drawn_pt[: len(expected_m)], drawn_pt[len(expected_m) :]
    # Up to where the pattern lies on the sheet, each rectangle is its own metres in points, upside down.
    tops_pt = height_pt - pattern_pt[:, 1] - pattern_pt[:, 3]
    np.testing.assert_allclose(pattern_pt[:, 2:], expected_m[:, 2:] * POINTS_PER_M, atol=1e-3)
    for got_pt, wanted_m in ((pattern_pt[:, 0], expected_m[:, 0]), (tops_pt, expected_m[:, 1])):
        shift_pt = got_pt - wanted_m * POINTS_PER_M
        assert np.ptp(shift_pt) < 1e-3
        assert shift_pt[0] > 5 * 10 * TENTH_MM_PT, "too near the edge of the sheet for a printer"
    # Nothing of the ruler touches the board, and the ruler is as long as it says.
    assert (ruler_pt[:, 1] + ruler_pt[:, 3]).max() < pattern_pt[:, 1].min() - 2 * 10 * TENTH_MM_PT
    ends_pt = ruler_pt[:, 0].min(), (ruler_pt[:, 0] + ruler_pt[:, 2]).max()
    assert ends_pt[1] - ends_pt[0] == pytest.approx(RULER_M * POINTS_PER_M, abs=1e-3)
    assert ruler_pt[:, 1].min() > 0
    assert (drawn_pt[:, 0] + drawn_pt[:, 2]).max() < width_pt


def test_a_chessboard_has_its_black_squares() -> None:
    board = load_board("chessboard_9x6")
    rectangles_m = black_rectangles_m(board)
    assert len(rectangles_m) == 10 * 7 / 2
    np.testing.assert_allclose(rectangles_m[:, 2:], board.square_m)
    assert rectangles_m[0, :2].tolist() == [0, 0]


def test_size_and_name_are_printed() -> None:
    board = resized_board(load_board("charuco_a4"), square_m=0.024)
    told = " ".join(texts(pdf_from_page(board_page(board, name="charuco_a4"))))
    for word in ("charuco_a4", "10 x 7 squares", "square 24 mm", "marker 17.28 mm", "DICT_4X4_50", "A4", "100 %"):
        assert word in told


def test_a_board_too_large_says_what_fits() -> None:
    board = load_board("chessboard_9x6")
    with pytest.raises(UsageError, match="does not fit on A4") as caught:
        board_page(resized_board(board, square_m=0.03), name="b")
    fitting_m = largest_square_m(board)
    assert f"{fitting_m:g}" in (caught.value.hint or "")
    board_page(resized_board(board, square_m=fitting_m), name="b")
    with pytest.raises(UsageError):
        board_page(resized_board(board, square_m=fitting_m + 0.0002), name="b")


def test_tall_boards_turn_the_sheet() -> None:
    tall = Board(kind="chessboard", columns=5, rows=8, square_m=0.025)
    assert board_page(tall, name="b").wh_m == PAPER_WH_M["A4"]


def test_the_file_is_sound() -> None:
    page = board_page(load_board("chessboard_9x6"), name=r"my (odd\) bräd")
    data = pdf_from_page(page)
    assert data.startswith(b"%PDF-1.4")
    assert data.endswith(b"%%EOF\n")
    start = int(data.rsplit(b"startxref\n", 1)[1].split()[0])
    assert data[start:].startswith(b"xref\n")
    offsets = [int(line) for line in re.findall(rb"(\d{10}) 00000 n ", data)]
    assert len(offsets) == 6
    for number, offset in enumerate(offsets, start=1):
        assert data[offset:].startswith(b"%d 0 obj" % number)
    length = int(re.search(rb"/Length (\d+)", data)[1])  # type: ignore[index]
    stream = data.split(b"stream\n", 1)[1]
    assert stream[length:].startswith(b"\nendstream")
    assert rb"my \(odd\\\) br?d" in data
