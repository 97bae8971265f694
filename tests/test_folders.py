"""No link in a shared folder leads out of it, killed commands leave nothing behind, and one command works at a time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from telewide.errors import InputError, MissingPartError, UsageError
from telewide.files import temporary_name, write_text
from telewide.folders import alone_in, append_line, fresh_folder, refuse_links


def test_a_link_below_the_root_is_refused_by_its_name(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    root = tmp_path / "root"
    root.symlink_to(elsewhere)
    (root / "pairs").mkdir()
    refuse_links(root, root / "pairs" / "000" / "new")
    (root / "pairs" / "000").symlink_to(tmp_path)
    with pytest.raises(InputError, match="000 is a link"):
        refuse_links(root, root / "pairs" / "000" / "new")
    (root / "pairs" / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="dangling is a link"):
        refuse_links(root, root / "pairs" / "dangling")


def test_a_line_is_appended_to_a_file_and_to_no_link(tmp_path: Path) -> None:
    append_line(tmp_path / "log", "one")
    append_line(tmp_path / "log", "two")
    assert (tmp_path / "log").read_text() == "one\ntwo\n"
    for target in (tmp_path / "log", tmp_path / "nowhere"):
        link = tmp_path / f"to {target.name}"
        link.symlink_to(target)
        with pytest.raises(InputError, match="is a link"):
            append_line(link, "three")
    assert not (tmp_path / "nowhere").exists()
    assert (tmp_path / "log").read_text() == "one\ntwo\n"
    with pytest.raises(UsageError, match="cannot be written"):
        append_line(tmp_path / "none" / "log", "one")


def test_a_line_is_not_appended_to_the_same_file_in_a_backup(tmp_path: Path) -> None:
    """``cp -al run backup`` gives every file a second name instead of a copy."""
    append_line(tmp_path / "log", "one")
    (tmp_path / "backup").mkdir()
    os.link(tmp_path / "log", tmp_path / "backup" / "log")
    append_line(tmp_path / "log", "two")
    append_line(tmp_path / "log", "three")
    assert (tmp_path / "log").read_text() == "one\ntwo\nthree\n"
    assert (tmp_path / "backup" / "log").read_text() == "one\n"


def test_a_file_replaces_a_link_and_leaves_its_target(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("kept")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "target").read_text() == "kept"
    assert (tmp_path / "link").read_text() == "new"
    assert not (tmp_path / "link").is_symlink()


def test_a_fresh_folder_is_gone_unless_it_was_renamed(tmp_path: Path) -> None:
    with fresh_folder(tmp_path / "captures") as folder:
        (folder / "a").touch()
        folder.rename(tmp_path / "captures" / "kept")
    with pytest.raises(ZeroDivisionError), fresh_folder(tmp_path / "captures") as folder:
        (folder / str(1 // 0)).touch()
    assert [path.name for path in (tmp_path / "captures").iterdir()] == ["kept"]


def test_what_a_killed_process_left_is_removed_and_nothing_through_links(tmp_path: Path) -> None:
    (tmp_path / "canary").mkdir()
    (tmp_path / "canary" / "a").touch()
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    own, pid = temporary_name(".partial"), str(os.getpid())
    left, linked = (own.replace(pid, dead.stdout.decode().strip()).replace(".partial", end) for end in (".a", ".b"))
    captures = tmp_path / "captures"
    (captures / left).mkdir(parents=True)
    (captures / left / "inside").symlink_to(tmp_path / "canary")
    (captures / linked).symlink_to(tmp_path / "canary")
    (captures / own).mkdir()
    with fresh_folder(captures):
        pass
    assert [path.name for path in captures.iterdir()] == [own]
    assert (tmp_path / "canary" / "a").exists()


def test_a_second_command_waits_and_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    script = (
        "import sys, time\nfrom pathlib import Path\nfrom telewide.folders import alone_in\n"
        f"with alone_in(Path({str(folder)!r}), waiting=print):\n    print('in', flush=True)\n    time.sleep(1)\n"
    )
    told: list[str] = []
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "in\n"
        begun_s = time.monotonic()
        with alone_in(folder, waiting=told.append):
            assert time.monotonic() - begun_s > 0.5
            assert other.wait() == 0
    assert told == [f"another telewide works in {folder}; waiting until it is done"]


def test_a_folder_nothing_was_written_into_is_not_left(tmp_path: Path) -> None:
    with alone_in(tmp_path / "run", waiting=pytest.fail):
        assert (tmp_path / "run").is_dir()
    assert not (tmp_path / "run").exists()
    with alone_in(tmp_path / "run", waiting=pytest.fail):
        (tmp_path / "run" / "a").touch()
    assert (tmp_path / "run" / "a").exists()


def test_a_pipe_in_the_place_of_a_log_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.jsonl")
    with pytest.raises(UsageError, match=r"log\.jsonl cannot be written"):
        append_line(tmp_path / "log.jsonl", "a line")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_a_missing_part_also_where_a_line_is_appended() -> None:
    with pytest.raises(MissingPartError, match="No space left"):
        append_line(Path("/dev/full"), "a line")
