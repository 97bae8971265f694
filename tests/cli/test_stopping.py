"""SIGTERM acts like Ctrl-C: a message, no half-written file, an exit code of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from telewide.cli import main
from telewide.cli.stopping import INTERRUPTED, TERMINATED, terminable

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
PATIENCE_S = 60

HALF_WRITTEN = """
import sys, time
from pathlib import Path
from telewide.files import replacing
from telewide.cli.stopping import terminable
with terminable() as interrupted:
    try:
        with replacing(Path(sys.argv[1])) as temporary:
            temporary.write_text("half")
            print("ready", flush=True)
            time.sleep(60)
    except KeyboardInterrupt:
        sys.exit(interrupted())
"""


def ignore_ctrl_c() -> None:
    """As a shell starts what runs in the background."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def test_a_file_being_written_is_taken_back(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")
    words = [sys.executable, "-c", HALF_WRITTEN, str(tmp_path / "a.txt")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        assert len(list(tmp_path.iterdir())) == 2
        process.terminate()
        assert process.wait(PATIENCE_S) == TERMINATED
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


@pytest.mark.parametrize("is_in_background", [True, False])
def test_a_command_says_that_it_was_stopped_and_leaves_whole_files(tmp_path: Path, is_in_background: bool) -> None:
    words = [sys.executable, "-m", "telewide", "simulate", str(tmp_path / "out"), "--captures", "500"]
    with subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=ignore_ctrl_c if is_in_background else None,
    ) as process:
        give_up_s = time.monotonic() + PATIENCE_S
        while not list(tmp_path.glob("out/*/tele.png")) and time.monotonic() < give_up_s:
            time.sleep(0.05)
        process.terminate()
        _, told = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == TERMINATED
    assert "stopped; what was finished is kept" in told
    assert "Traceback" not in told
    assert list((tmp_path / "out").rglob(".telewide-*")) == []


def test_the_exit_code_stands_in_the_json_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for number, code in ((signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED), (signal.SIGINT, INTERRUPTED)):
        monkeypatch.setattr("telewide.pipeline.depth_captures", lambda *_, of=number, **__: signal.raise_signal(of))
        with pytest.raises(SystemExit) as left:
            main(["depth", "--method", "sgm", "--json"])
        assert left.value.code == code
        assert json.loads(capsys.readouterr().out)["exit_code"] == code


def test_who_handles_ctrl_c_is_asked_and_all_is_put_back() -> None:
    heard: list[int] = []
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    try:
        with terminable() as interrupted:
            assert interrupted() == INTERRUPTED
            signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
            signal.raise_signal(signal.SIGTERM)
            assert heard == [signal.SIGINT]
            assert interrupted() == TERMINATED
            signal.signal(signal.SIGINT, before[1])
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGINT, before[1])
    assert signal.getsignal(signal.SIGTERM) is before[0]
