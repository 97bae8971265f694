"""``telewide import`` as a program sees it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
import typer
from capture.roll import TELE, WIDE, exif_of, write_photo
from typer.testing import CliRunner, Result

from telewide.cli.import_roll import IMPORT_EPILOG, import_photos
from telewide.errors import InputError, UsageError


def run(*words: str | Path) -> Result:
    app = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False)
    app.command("import", epilog=IMPORT_EPILOG)(import_photos)
    app.command("other")(lambda: None)
    return CliRunner().invoke(app, ["import", *map(str, words)])


@pytest.fixture
def roll(tmp_path: Path) -> Path:
    """A pair, a digital crop, and a photo without EXIF."""
    for name, lens, second in (("T1", TELE, 0.0), ("W1", WIDE, 1.3), ("X1", {"focal": 4.25, "f35": 52}, 1.0)):
        write_photo(tmp_path / "DCIM" / f"{name}.jpg", exif=exif_of(**lens, second=second))  # type: ignore[arg-type]
    write_photo(tmp_path / "DCIM" / "note[1].jpg")
    return tmp_path / "DCIM"


def test_a_dry_run_shows_everything_and_writes_nothing(roll: Path, tmp_path: Path) -> None:
    result = run(roll, tmp_path / "captures", "--dry-run")
    assert result.exit_code == 0
    assert not (tmp_path / "captures").exists()
    rows = {line.split()[0]: line for line in result.stdout.splitlines()}
    assert rows["T1"].split() == ["T1", "T1.jpg", "W1.jpg", "1.3", "6", "/", "4.25", "52", "/", "26", "2.00"]
    assert "a digital crop of the 4.25 mm lens: 52 mm equivalent" in rows["X1.jpg"]
    assert "2026-05-01 12:00:01" in rows["X1.jpg"]
    assert "states no focal length" in rows["note[1].jpg"]
    assert "would be imported into" in result.stderr
    assert "1 new, 0 already there" in result.stderr


def test_an_import_and_another(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    first = run(roll, captures)
    assert first.exit_code == 0
    assert sorted(path.name for path in (captures / "T1").iterdir()) == ["pair.json", "tele.jpg", "wide.jpg"]
    assert "next: telewide" in first.stderr
    again = run(roll, captures)
    assert again.exit_code == 0
    assert "0 new, 1 already there" in again.stderr


def test_json_is_one_object(roll: Path, tmp_path: Path) -> None:
    result = run(roll, tmp_path / "captures", "--json", "--quiet")
    told = json.loads(result.stdout)
    assert result.stderr == ""
    assert [pair["name"] for pair in told["pairs"]] == ["T1"]
    assert told["pairs"][0]["seconds_apart"] == pytest.approx(1.3)
    assert told["pairs"][0]["ratio_35"] == 2
    assert [Path(one["file"]).name for one in told["unpaired"]] == ["X1.jpg", "note[1].jpg"]
    assert all(one["reason"] for one in told["unpaired"])


def test_an_import_that_fails_has_no_answer(roll: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    result = run(roll, tmp_path / "taken" / "captures", "--json")
    assert isinstance(result.exception, UsageError)
    assert result.stdout == ""


def test_lenses_that_were_not_chosen_are_named_with_the_call_that_takes_them(tmp_path: Path) -> None:
    dcim = tmp_path / "my DCIM"
    for k, (name, focal, f35) in enumerate((("U", 2.2, 13), ("W", 6.3, 24), ("T", 7.9, 70), ("L", 18.6, 230))):
        write_photo(dcim / f"{name}.jpg", exif=exif_of(focal=focal, f35=f35, second=float(k)))
    told = run(dcim, tmp_path / "captures").stderr
    assert "Maker Phone 1: 7.9 mm (70 mm equivalent) is paired with 6.3 mm (24 mm equivalent)" in told
    (line,) = (line for line in told.splitlines() if "if those are meant: " in line)
    words = shlex.split(line.split("meant: ")[1])
    assert words[:2] == ["telewide", "import"]
    taken = json.loads(run(*words[2:], "--json", "--quiet").stdout)
    assert [pair["tele"]["focal_length_mm"] for pair in taken["pairs"]] == [18.6]
    assert taken["lenses"][0]["chosen"] == {"wide_mm": 6.3, "tele_mm": 18.6, "n_pairs": 1}


def test_no_pair_is_an_error(roll: Path, tmp_path: Path) -> None:
    (roll / "T1.jpg").unlink()
    result = run(roll, tmp_path / "captures", "--json")
    assert isinstance(result.exception, InputError)
    assert result.stdout == ""
    assert "X1.jpg: a digital crop" in result.exception.message
    assert result.exception.hint


@pytest.mark.parametrize("option", ["--max-seconds", "--tele-mm", "--wide-mm"])
def test_options_that_make_no_sense(roll: Path, tmp_path: Path, option: str) -> None:
    result = run(roll, tmp_path / "captures", option, "-1")
    assert isinstance(result.exception, UsageError)
    assert option in result.exception.message


def test_help_shows_an_example() -> None:
    told = " ".join(run("--help").stdout.split())
    assert "Example: telewide import /media/phone/DCIM captures/ --dry-run" in told
    assert "--dry-run" in told
