"""What strangers hand over as YAML and JSON is read as plain data or refused with one message: nothing runs, nothing
hangs, nothing grows beyond all measure.
"""

from __future__ import annotations

import hashlib
import os
import socket
import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from ordinary_user import as_ordinary_user

from telewide.boards.board import load_board
from telewide.calibration.rig_file import read_rig
from telewide.capture.facts import read_facts
from telewide.capture.formats import read_bytes
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import (
    fingerprint,
    is_file,
    is_folder,
    is_there,
    once_a_file,
    read_regular,
    refuse_other_than_folder,
    refuse_unwritable,
    write_text,
)
from telewide.recipe import load_recipe
from telewide.records import read_json
from telewide.yaml_files import MAX_DEPTH, MAX_YAML_BYTES, parse_yaml, read_yaml


def plain(text: str) -> object:
    return parse_yaml(text, source="text", error=InputError)


def bomb(*, link: str) -> str:
    """Ten levels, each naming the one before nine times."""
    lines = ["a0: &a0 {x: 1}"]
    for level in range(1, 11):
        inner = ", ".join([f"*a{level - 1}"] * 9)
        lines.append(f"a{level}: &a{level} " + (f"[{inner}]" if link == "list" else f"{{<<: [{inner}], y: 1}}"))
    return "\n".join(lines)


SLIPS = {
    "a number of 5000 digits": "a: " + "9" * 5000,
    "a number of 65 bits": f"a: {1 << 64}",
    "half a hexadecimal": "a: 0x_",
    "no integer": "a: !!int abc",
    "no boolean": "a: !!bool x",
    "no float": "a: !!float x",
    "no base64": "a: !!binary zzz!",
    "a Python object": "a: !!python/object/apply:os.system [true]",
    "a list that holds itself": "&a [*a]",
    "a mapping that holds itself": "a: &a {b: *a}",
    "brackets": "[" * 100_000,
    "braces": "{a: " * 10_000,
    "a bomb of aliases": bomb(link="list"),
    "a chain of aliases": "- &a1 [x]\n" + "".join(f"- &a{i} [*a{i - 1}]\n" for i in range(2, 2000)),
    "a list as key": "? [1]\n: 2",
    "two documents": "--- a\n--- b",
    "a null character": "a: \x00",
    "a tab": "a:\n\t- x",
}


@pytest.mark.parametrize("text", SLIPS.values(), ids=SLIPS.keys())
def test_a_slip_in_yaml_is_one_message(text: str) -> None:
    begun_s = time.monotonic()
    with pytest.raises(InputError, match=r"^text: ") as caught:
        plain(text)
    assert len(caught.value.message) < 200
    assert time.monotonic() - begun_s < 10


def test_a_bomb_of_merges_is_refused_or_harmless() -> None:
    """PyYAML 6.0.4 copies a mapping that is merged nine times once."""
    begun_s = time.monotonic()
    with suppress(InputError):
        content = plain(bomb(link="merge"))
        assert isinstance(content, dict)
        assert sum(len(each) for each in content.values()) < 100
    assert time.monotonic() - begun_s < 10


READERS: dict[str, Callable[[Path], object]] = {
    "captures.yaml": read_facts,
    "rig.yaml": read_rig,
    "recipe": lambda path: load_recipe(str(path)),
    "board": lambda path: load_board(str(path)),
    "--set": lambda path: load_recipe("quick", settings=[f"description={path.read_text()}"]),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("slip", ["half a hexadecimal", "a number of 5000 digits", "a bomb of aliases", "brackets"])
def test_every_reader_of_yaml_refuses_it_alike(tmp_path: Path, reader: str, slip: str) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(SLIPS[slip])
    with pytest.raises(TelewideError, match=r"YAML") as caught:
        READERS[reader](path)
    assert caught.value.exit_code == (2 if reader in {"recipe", "--set"} else 3)


def test_dates_stay_texts() -> None:
    assert plain("a: 2024-13-45\nb: 2024-01-05\nc: !!timestamp x") == {"a": "2024-13-45", "b": "2024-01-05", "c": "x"}


def test_what_people_write_is_read() -> None:
    text = "base: &b {x: 1, y: [1.5, 2e3, true]}\nown: {<<: *b, x: 2}\nsame: *b\nn: null\ns: 'é'"
    base = {"x": 1, "y": [1.5, "2e3", True]}
    assert plain(text) == {"base": base, "own": {**base, "x": 2}, "same": base, "n": None, "s": "é"}
    assert plain("[" * MAX_DEPTH + "]" * MAX_DEPTH) is not None
    assert plain("") is None


@pytest.mark.parametrize("kind", ["pipe", "socket", "folder"])
@pytest.mark.parametrize("reader", [read_yaml, read_json, read_regular, read_facts, read_rig])
def test_only_regular_files_are_opened(tmp_path: Path, kind: str, reader: Callable[[Path], object]) -> None:
    path = tmp_path / "x"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        server = socket.socket(socket.AF_UNIX)
        server.bind(str(path))
        server.close()
    with pytest.raises(InputError, match=r"x (is a|cannot be read)"):
        reader(path)


def test_what_a_path_leads_to_is_told_without_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for name, target in (("to file", "file"), ("to folder", "."), ("nowhere", "none"), ("loop", "loop")):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "long").symlink_to("x" * 300)
    told = dict.fromkeys(("file", "to file"), (True, False, True))
    told |= dict.fromkeys((".", "to folder"), (False, True, True)) | {"pipe": (False, False, True)}
    told |= dict.fromkeys(("nowhere", "loop", "long", "x" * 300, "a\0b", "file/below"), (False, False, False))
    for name, expected in told.items():
        path = tmp_path / name
        assert (is_file(path), is_folder(path), is_there(path)) == expected, name
    for name, message in (("none", "does not exist"), ("file", "is a file"), ("loop", "cannot be opened: Too many")):
        with pytest.raises(UsageError, match=f"{name} {message}.*; a folder was expected"):
            refuse_other_than_folder(tmp_path / name, expected="a folder")
    refuse_other_than_folder(tmp_path / "to folder", expected="a folder")


def test_a_device_is_no_file() -> None:
    with pytest.raises(InputError, match="/dev/zero is a pipe, a socket or a device"):
        read_regular(Path("/dev/zero"))


@pytest.mark.skipif(not Path("/proc/self/pagemap").exists(), reason="a file of Linux")
def test_a_file_of_the_system_without_end_is_empty() -> None:
    """It calls itself a regular file of no bytes, and holds 2^47; a link to it may lie in a shared folder."""
    for path in (Path("/proc/self/pagemap"), Path("/proc/self/maps")):
        assert read_regular(path) == b""
        assert fingerprint(path) == hashlib.sha256().hexdigest()
        with pytest.raises(InputError, match="is empty"):
            read_bytes(path)


def test_a_limit_far_above_a_file_asks_for_no_memory(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"content")
    tracemalloc.start()
    assert read_bytes(tmp_path / "x", at_most=1 << 31) == b"content"
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    assert read_bytes(tmp_path / "x", at_most=3) == b"con"


def test_a_file_that_is_not_there_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        read_yaml(tmp_path / "none.yaml")
    (tmp_path / "dangling").symlink_to(tmp_path / "none")
    with pytest.raises(UsageError, match="does not exist"):
        read_json(tmp_path / "dangling")


def test_yaml_that_is_too_large_is_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.write_bytes(b"#" * (MAX_YAML_BYTES + 1))
    with pytest.raises(InputError, match="is larger than"):
        read_yaml(path)
    path.write_bytes(b"#" * MAX_YAML_BYTES)
    assert read_yaml(path) is None


class TestOnceAFile:
    """A file is read once until it changes, and anew wherever a change could hide."""

    @staticmethod
    def counting() -> tuple[list[Path], Callable[[Path], str]]:
        asked: list[Path] = []

        @once_a_file
        def read(path: Path) -> str:
            asked.append(path)
            return path.read_text()

        return asked, read

    def test_an_old_file_is_read_once(self, repo: Path) -> None:
        asked, read = self.counting()
        old = repo / "LICENSE"
        while time.time() - old.stat().st_ctime < 3:
            time.sleep(0.5)
        assert read(old) == read(old) == old.read_text()
        assert asked == [old]

    def test_a_file_that_was_just_written_is_read_each_time(self, tmp_path: Path) -> None:
        asked, read = self.counting()
        path = tmp_path / "a.txt"
        for text in ("one", "two"):  # of one size, perhaps within one tick of the clock
            path.write_text(text)
            assert read(path) == text
        assert len(asked) == 2

    def test_what_is_not_there_is_said_by_the_reader(self, tmp_path: Path) -> None:
        _, read = self.counting()
        with pytest.raises(FileNotFoundError):
            read(tmp_path / "none")


def test_a_place_for_a_result_is_refused_before_the_work_exactly_where_writing_fails(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for name, mode in (("open", 0o777), ("closed", 0o555)):
        (tmp_path / name).mkdir()
        (tmp_path / name).chmod(mode)
    places = [tmp_path / "open/rig.yaml", tmp_path / "open/new/rig.yaml"]
    refused = [tmp_path / "closed/rig.yaml", tmp_path / "closed/new/rig.yaml", tmp_path / "file/rig.yaml"]

    def write(place: Path) -> None:
        place.parent.mkdir(exist_ok=True)
        write_text(place, "")

    def look() -> None:
        for place in places:
            refuse_unwritable(place)
        assert not places[1].parent.exists()
        for place in places:
            write(place)
        for place in refused:
            with pytest.raises(UsageError, match="cannot be written") as told:
                refuse_unwritable(place)
            assert str(place) in told.value.message
            with pytest.raises((TelewideError, OSError)):
                write(place)

    as_ordinary_user(tmp_path, look)
