"""``telewide view`` hands the page to the browser the system names."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from telewide.cli import main


def viewed(run: Path, tmp_path: Path, *, browser: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "BROWSER": browser, "PYTHONPATH": os.pathsep.join(sys.path)}
    call = [sys.executable, "-m", "telewide", "view", str(run)]
    return subprocess.run(call, env=environment, capture_output=True, text=True, check=False, cwd=tmp_path)


@pytest.mark.parametrize("names_page", [False, True])
def test_the_page_is_opened_where_it_lies(tmp_path: Path, names_page: bool) -> None:
    run = tmp_path / "my run"
    run.mkdir()
    (run / "report.html").write_text("<html></html>")
    opened = tmp_path / "opened.txt"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > "{opened}"\n')
    browser.chmod(0o755)
    done = viewed(run / "report.html" if names_page else run, tmp_path, browser=f"{browser} %s")
    assert done.returncode == 0, done.stderr
    assert opened.read_text() == (run / "report.html").as_uri()
    assert done.stdout.strip() == str(run / "report.html")


def test_without_a_page_the_commands_that_write_one_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["view", str(tmp_path)])
    assert left.value.code == 2
    told = capsys.readouterr().err
    assert "report.html does not exist" in told
    assert "telewide depth" in told


def test_beside_the_run_folder_its_page_is_opened(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run/report.html").write_text("<html></html>")
    done = viewed(Path(), tmp_path, browser="true %s")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "run/report.html"


def test_folders_that_hold_a_page_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("beach", "my photos"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.html").write_text("<html></html>")
    with pytest.raises(SystemExit) as left:
        main(["view", str(tmp_path)])
    assert left.value.code == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"telewide view {tmp_path}/beach" in told
    assert f"telewide view '{tmp_path}/my photos'" in told
