"""``telewide board`` as a command: what it writes, what it lists, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner, Result

from telewide.cli.board import board
from telewide.errors import InputError, UsageError

app = typer.Typer()
app.command()(board)


def run(*words: str) -> Result:
    return CliRunner().invoke(app, words)


def test_writes_a_pdf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("chessboard_9x6", "--square-m", "0.024", "--out", "mine.pdf")
    assert done.exit_code == 0, done.output
    data = Path("mine.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert b"square 24 mm" in data
    assert "mine.pdf" in done.stderr
    assert done.stdout == ""
    assert run("charuco_a3").exit_code == 0
    assert Path("charuco_a3.pdf").is_file()


def test_json_says_what_was_written_and_the_next_command_is_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my board.yaml").write_text("kind: chessboard\ncolumns: 5\nrows: 4\nsquare_m: 0.03\n")
    done = run("my board.yaml", "--json")
    written = {"pdf": "my board.pdf", "board": "my board.yaml", "square_m": 0.03, "paper": "A4"}
    assert json.loads(done.stdout) == written
    assert "telewide calibrate --board 'my board.yaml' --square-m MEASURED" in done.stderr
    assert run("my board.yaml", "--quiet").output == ""
    assert "chessboard_9x6" in json.loads(run("--json").stdout)["boards"]


def test_own_board_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("kind: chessboard\ncolumns: 5\nrows: 4\nsquare_m: 0.03\n")
    assert run("mine.yaml", "--paper", "a3").exit_code == 0
    assert b"5 x 4 inner corners" in Path("mine.pdf").read_bytes()


def test_without_a_name_the_known_ones_are_listed() -> None:
    done = run()
    assert done.exit_code == 0
    for name in ("chessboard_9x6", "charuco_a4", "charuco_a3", "aruco_grid_a4"):
        assert name in done.stdout


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("chessbord_9x6",), "chessboard_9x6"),
        (("chessboard_9x6", "--square-m", "24"), "24 m"),
        (("chessboard_9x6", "--square-m", "0.05"), "does not fit on A4"),
        (("chessboard_9x6", "--paper", "A5"), "A5"),
        (("chessboard_9x6", "--out", "board.png"), r"board\.png"),
        (("missing.yaml",), "missing"),
    ],
)
def test_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], told: str) -> None:
    monkeypatch.chdir(tmp_path)
    failed = run(*words)
    assert isinstance(failed.exception, UsageError | InputError)
    with pytest.raises(UsageError, match=told):
        raise failed.exception
    assert list(tmp_path.iterdir()) == []
