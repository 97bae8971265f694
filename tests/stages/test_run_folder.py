"""The run folder: whole files or none, records that add up, one place per call."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import fingerprint, replacing, write_text
from telewide.stages.run_folder import RunFolder, locate_run, locate_run_of_depth, write_run_record


def test_replacing_leaves_the_new_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "new folder" / "a.png"
    with replacing(target) as temporary:
        assert temporary.parent == target.parent
        assert temporary.suffix == ".png"
        temporary.write_bytes(b"new")
        assert not target.exists()
    assert target.read_bytes() == b"new"
    assert list(target.parent.iterdir()) == [target]


@pytest.mark.parametrize("failure", [RuntimeError("bug"), KeyboardInterrupt(), TelewideError("told")])
def test_replacing_keeps_the_old_file_when_the_body_fails(tmp_path: Path, failure: BaseException) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write_half() -> None:
        with replacing(target) as temporary:
            temporary.write_text("half")
            raise failure

    with pytest.raises(type(failure)):
        write_half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_replacing_on_a_full_disk_keeps_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")
    # A limit on the size of files makes the system itself refuse the write, as a full disk does.
    script = (
        "import resource, signal, sys\nfrom pathlib import Path\n"
        "from telewide.files import replacing\nfrom telewide.errors import TelewideError\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))\n"
        "try:\n    with replacing(Path(sys.argv[1])) as path:\n        path.write_bytes(bytes(5000))\n"
        "except TelewideError as error:\n    sys.exit(f'{error.exit_code} {error.message} {error.hint}')\n"
    )
    repo = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", script, target], cwd=repo, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("5 ")
    assert str(target) in done.stderr
    assert "free some space" in done.stderr
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_replacing_says_a_full_device_from_its_number(tmp_path: Path) -> None:
    with pytest.raises(TelewideError, match="No space left") as caught, replacing(tmp_path / "a"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert "free some space" in (caught.value.hint or "")


def test_replacing_where_a_file_stands_for_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match=r"a\.txt cannot be written"):
        write_text(tmp_path / "file" / "a.txt", "x")


def test_replacing_onto_a_folder(tmp_path: Path) -> None:
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(UsageError, match=r"a\.txt cannot be written"):
        write_text(tmp_path / "a.txt", "x")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


WRITES_AND_WAITS = (
    "import sys\nfrom pathlib import Path\nfrom telewide.files import replacing\n"
    "with replacing(Path(sys.argv[1])) as path:\n"
    "    path.write_text('half')\n    sys.stdout.write('begun')\n    sys.stdout.flush()\n    sys.stdin.read()\n"
)


def test_what_a_killed_process_left_goes_and_what_a_living_one_writes_stays(tmp_path: Path, repo: Path) -> None:
    """Only once its writer is dead: the file is removed by whoever writes into the folder next."""
    target, own = tmp_path / "a.png", tmp_path / ".mine.png"
    target.write_text("old")
    own.write_text("mine")
    words = [sys.executable, "-c", WRITES_AND_WAITS, str(target)]
    writer = subprocess.Popen(words, cwd=repo, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert writer.stdout is not None
        assert writer.stdout.read(5) == b"begun"
        write_text(tmp_path / "b.txt", "x")
        (half,) = set(tmp_path.iterdir()) - {target, own, tmp_path / "b.txt"}
        assert half.read_text() == "half"
    finally:
        writer.kill()
        writer.communicate()
    elsewhere = half.with_name(half.name.replace(half.name.split("-")[1], "00000000"))
    elsewhere.write_text("of a process on another machine")
    write_text(tmp_path / "b.txt", "y")
    assert set(tmp_path.iterdir()) == {target, own, tmp_path / "b.txt", elsewhere}
    assert (target.read_text(), own.read_text()) == ("old", "mine")


def test_a_process_of_somebody_else_lives(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.txt") as temporary:
        temporary.touch()
        first = temporary.with_name(temporary.name.replace(f"-{os.getpid()}-", "-1-"))
        first.write_text("of the system's first process")
    write_text(tmp_path / "b.txt", "x")
    assert first.exists()


def test_replacing_takes_the_longest_name_a_folder_takes(tmp_path: Path) -> None:
    target = tmp_path / ("ä" * 125 + ".txt")
    write_text(target, "x")
    assert target.read_text() == "x"


def test_fingerprint_is_sha256_of_the_content(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert fingerprint(tmp_path / "a") == hashlib.sha256(b"abc").hexdigest()
    with pytest.raises(UsageError, match="does not exist"):
        fingerprint(tmp_path / "b")


def test_run_folder_names_its_places_inside_itself(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    for place in (run.pairs, run.train, run.depth, run.run_json):
        assert place.parent == run.root
    assert not run.root.exists()


def test_locate_run_prefers_the_named_then_here_then_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here, captures = tmp_path / "here", tmp_path / "there" / "captures"
    here.mkdir()
    captures.mkdir(parents=True)
    monkeypatch.chdir(here)
    assert locate_run(None, captures).root == Path("run")
    (captures.parent / "run").mkdir()
    assert locate_run(None, captures).root == captures.parent / "run"
    (here / "run").mkdir()
    assert locate_run(None, captures).root == Path("run")
    assert locate_run(tmp_path / "named", captures).root == tmp_path / "named"


@pytest.mark.parametrize("place", ["here", "there"])
def test_a_link_that_nobody_named_is_no_run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    for folder in ("here", "there/captures", "elsewhere"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / place / "run").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match="run is a link to"):
        locate_run(None, tmp_path / "there" / "captures")
    named = tmp_path / place / "run"
    assert locate_run(named, tmp_path / "there" / "captures").root == named


def test_locate_run_refuses_a_file(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("x")
    with pytest.raises(UsageError, match="is a file"):
        locate_run(tmp_path / "run", tmp_path)


def _record(run: RunFolder, command: str, photo: Path, **options: object) -> dict[str, dict[str, dict[str, object]]]:
    write_run_record(run, command=command, options=options, inputs=[photo], timings={"match": 1.23456})
    record: dict[str, dict[str, dict[str, object]]] = json.loads(run.run_json.read_text(encoding="utf-8"))
    return record


def test_run_record_merges_commands_and_replaces_its_own(tmp_path: Path) -> None:
    photo, run = tmp_path / "photo é.jpg", RunFolder(tmp_path / "run")
    photo.write_bytes(b"abc")
    _record(run, "train", photo, seed=1)
    _record(run, "depth", photo, method="sgm", where=Path("x"))
    commands = _record(run, "train", photo, seed=2)["commands"]
    assert set(commands) == {"train", "depth"}
    assert commands["train"]["options"] == {"seed": 2}
    assert commands["train"]["inputs_sha256"] == {"../photo é.jpg": fingerprint(photo)}
    assert commands["train"]["timings_s"] == {"match": 1.235}
    assert commands["depth"]["options"] == {"method": "sgm", "where": "x"}
    assert commands["depth"]["argv"] == sys.argv


@pytest.mark.parametrize("broken", ["{", "[1]", '{"commands": 3}'])
def test_a_broken_record_is_written_anew(tmp_path: Path, broken: str) -> None:
    photo, run = tmp_path / "a", RunFolder(tmp_path)
    photo.write_bytes(b"abc")
    run.run_json.write_text(broken)
    assert set(_record(run, "depth", photo)["commands"]) == {"depth"}


def test_a_file_called_run_is_not_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither where a run folder lies beside the captures: the one here is meant."""
    here = tmp_path / "here"
    here.mkdir()
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(here)
    assert locate_run(None, tmp_path / "captures").root == tmp_path / "run"
    (here / "run").write_text("notes")
    with pytest.raises(UsageError, match="is a file"):
        locate_run(None, tmp_path / "captures")


def test_depth_with_a_place_of_its_own_makes_no_run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    captures, out = tmp_path / "captures", tmp_path / "d1"
    assert locate_run_of_depth(None, captures, out=out) == out / ".telewide"
    assert locate_run_of_depth(None, captures, out=None) is None
    assert locate_run_of_depth(Path("mine"), captures, out=out) == Path("mine")
    (tmp_path / "run").mkdir()  # pairs that lie there are taken
    assert locate_run_of_depth(None, captures, out=out) is None


def test_a_link_that_nobody_named_is_not_taken_for_the_hidden_run_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "results"
    out.mkdir()
    (out / ".telewide").symlink_to(tmp_path)
    with pytest.raises(InputError, match=r"\.telewide is a link"):
        locate_run_of_depth(None, tmp_path / "captures", out=out)
