"""Names, notes and EXIF of other people reach a terminal visibly: no command prints a control character of theirs."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from rich.table import Table
from rigs import phone
from source import modules

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.cli import main
from telewide.cli.console import VisibleFormatter
from telewide.cli.terminal import TerminalConsole
from telewide.simulate.captures import write_captures
from telewide.text import printable

ESCAPE = "\x1b]0;owned\x07\x9b2J"


def run(capfd: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Exit code, and all that was printed, which must hold nothing a terminal obeys."""
    with pytest.raises(SystemExit) as left:
        main(words)
    printed = "".join(capfd.readouterr())
    assert printed == printable(printed)
    return int(left.value.code or 0), printed


def test_the_console_shows_them_in_lines_and_in_tables() -> None:
    console = TerminalConsole(file=io.StringIO(), width=200)
    console.print(f"line {ESCAPE}", markup=False)
    table = Table(f"head {ESCAPE}")
    table.add_row(f"cell {ESCAPE}")
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    printed = console.file.getvalue()
    assert printed == printable(printed)
    assert printed.count(r"\x1b]0;owned\x07\x9b2J") == 3


@pytest.mark.parametrize(("level", "kind"), [(logging.INFO, "note"), (logging.WARNING, "warning")])
def test_the_log_shows_them(level: int, kind: str) -> None:
    record = logging.LogRecord("telewide", level, "file", 1, "facts of %s", (ESCAPE,), None)
    assert VisibleFormatter().format(record) == kind + r": facts of \x1b]0;owned\x07\x9b2J"


def test_notes_of_a_rig(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    quality = CalibrationQuality(*[math.nan] * 6, checks=(), verdict="good")
    facts = RigFacts(notes=(ESCAPE,), image_pipeline=f"jpeg:{ESCAPE}")
    write_stored_rig(tmp_path / "rig.yaml", StoredRig(phone(), None, None, None, quality, facts))
    for options in ((), ("--json",)):
        code, printed = run(capfd, "show", str(tmp_path / "rig.yaml"), *options)
        assert code == 0
        assert "owned" in printed


def test_unknown_keys_of_captures_yaml_and_names_of_photos(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / f"one{ESCAPE}"
    folder.mkdir()
    for view in ("tele", "wide"):
        (folder / f"{view}.png").write_bytes(view.encode())
    code, printed = run(capfd, "depth", str(tmp_path), "--method", "sgm", "--run", str(tmp_path / "run"))
    assert code == 3
    assert r"one\x1b]0;owned" in printed
    (tmp_path / "captures.yaml").write_text(yaml.safe_dump({f"key{ESCAPE}": 1}))
    code, printed = run(capfd, "depth", str(tmp_path), "--method", "sgm", "--json")
    assert code == 3
    assert "owned" in printed
    assert run(capfd, "depth", f"no{ESCAPE}", "--method", "sgm")[0] == 2
    assert run(capfd, "depth", f"--{ESCAPE}")[0] == 2
    assert run(capfd, ESCAPE)[0] == 2


def test_exif_of_a_roll(tmp_path: Path, capfd: pytest.CaptureFixture[str], rng: np.random.Generator) -> None:
    for number, focal_mm in enumerate((2.2, 6.3, 9.0)):
        exif = Image.Exif()
        exif[271], exif[272] = f"maker{ESCAPE}", f"model{ESCAPE}"
        exif.get_ifd(34665).update({37386: focal_mm, 36867: f"2024:01:01 10:00:0{number}"})
        levels = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
        Image.fromarray(levels).save(tmp_path / f"a{number}{ESCAPE}.jpg", exif=exif)
    os.mkfifo(tmp_path / f"pipe{ESCAPE}.jpg")
    for options in ((), ("--json",)):
        code, printed = run(capfd, "import", str(tmp_path), str(tmp_path / "captures"), "--dry-run", *options)
        assert code == 0
        assert "owned" in printed


def test_names_that_are_no_utf8(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/one\xff"))
    folder.mkdir()
    for view in ("tele", "wide"):
        (folder / f"{view}.png").write_bytes(view.encode())
    code, printed = run(capfd, "depth", str(tmp_path), "--method", "sgm", "--run", str(tmp_path / "run"))
    assert code == 3
    assert r"one\xff" in printed


def test_work_in_a_folder_whose_name_is_no_utf8_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Record and page name the folder, their bytes are text."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    write_captures(folder / "captures", count=1, seed=1, hw=(96, 128), factor=2)
    monkeypatch.chdir(tmp_path)
    code, _ = run(capfd, "depth", str(folder / "captures"), "--method", "sgm", "--run", "run", "--json")
    assert code == 0
    record = json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))
    assert len(record["commands"]["depth"]["inputs_sha256"]) == 2
    assert "/caf\\" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def test_nothing_is_printed_by_another_way() -> None:
    """Each way out to a person goes through `console.say`, `console.print_json` or a `TerminalConsole`."""
    found = [
        f"{module.name}: {line.strip()}"
        for module in modules()
        if module.name != "benchmark.memory"  # answers the process that started it
        for line in module.path.read_text().splitlines()
        if re.search(
            r"typer\.echo\(|typer\.secho\(|click\.echo\(|[^l]Console\(|print_exc|sys\.std(out|err)\.write", line
        )
    ]
    assert [line for line in found if not re.match(r"cli\.console: .*(printable|json_text)\(", line)] == []
    assert found


def test_remarks_of_decoders_are_not_shown(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    looped = b"II*\x00" + (8).to_bytes(4, "little") + bytes.fromhex("0100fe000400010000000000000008000000")
    for view in ("tele", "wide"):
        (tmp_path / f"{view}.tif").write_bytes(looped + view.encode())
    code, printed = run(capfd, "depth", str(tmp_path), "--method", "sgm", "--run", str(tmp_path / "run"))
    assert code == 3
    assert "nothing in it can be recognised" in printed
    assert "TiffPage" not in printed
