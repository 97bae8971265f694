"""What lies in a folder is taken as it is only where it was made from the same and is whole."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from telewide.errors import UsageError
from telewide.stages.kept_depth import (
    KEPT_NAME,
    BokehPart,
    DepthPart,
    KeptDepth,
    KeptRecord,
    listed_files,
    put_in_place,
    read_kept,
    refuse_foreign_files,
    write_kept,
)

KEY = {"tele": "abc", "options": {"strength_px": 3.0}, "window": (0, 32)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two files and the record of them."""
    for name in ("disparity.pfm", "depth.npz"):
        (tmp_path / name).write_bytes(b"0123456789")
    write_kept(
        tmp_path, KeptDepth(("disparity.pfm", "depth.npz"), ("a note",), {"EPE_px": 0.5, "3PE": math.nan}), key=KEY
    )
    return tmp_path


def test_what_was_made_comes_back(folder: Path) -> None:
    kept = read_kept(folder, KEY)
    assert kept is not None
    assert (kept.files, kept.notes) == (("disparity.pfm", "depth.npz"), ("a note",))
    assert kept.numbers["EPE_px"] == 0.5
    assert math.isnan(kept.numbers["3PE"])


@pytest.mark.parametrize(
    "changed", [{"tele": "other"}, {"options": {"strength_px": 4.0}}, {"window": (0, 36)}, {"new": 1}]
)
def test_what_was_made_from_something_else_is_made_again(folder: Path, changed: dict[str, object]) -> None:
    assert read_kept(folder, {**KEY, **changed}) is None


def test_what_is_no_longer_whole_is_made_again(folder: Path) -> None:
    (folder / "depth.npz").write_bytes(b"01234")
    assert read_kept(folder, KEY) is None, "cut off"
    (folder / "depth.npz").unlink()
    assert read_kept(folder, KEY) is None, "gone"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": 1}', '{"format": 2, "key": {}}'])
def test_a_record_that_says_nothing_is_none(folder: Path, content: str) -> None:
    (folder / KEPT_NAME).write_text(content)
    assert read_kept(folder, KEY) is None


@pytest.mark.parametrize("name", ["mine.txt", "..", ".", "/etc", "a/b", "tele.png"])
def test_a_record_lists_nothing_but_what_telewide_writes(tmp_path: Path, name: str) -> None:
    """Else a stranger's record would say what is removed."""
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / KEPT_NAME).write_text(json.dumps({"files_bytes": {name: 1, "preview.png": 2}}))
    assert listed_files(tmp_path) == {"preview.png", KEPT_NAME}


def test_files_of_others_stay_whatever_a_record_lists(tmp_path: Path) -> None:
    folder, staged = tmp_path / "000", tmp_path / "staged"
    for place in (folder, staged):
        place.mkdir()
    (folder / "mine.txt").write_text("mine")
    (folder / "bokeh.jpg").mkdir()
    (folder / "bokeh.jpg" / "also mine").touch()
    (folder / KEPT_NAME).write_text(json.dumps({"files_bytes": {"mine.txt": 4, "..": 1, "bokeh.jpg": 1}}))
    write_kept(staged, KeptDepth((), (), {}), key=KEY)
    put_in_place(staged, folder)
    assert {path.name for path in folder.iterdir()} == {"mine.txt", "bokeh.jpg", KEPT_NAME}
    with pytest.raises(UsageError, match=r"bokeh\.jpg"):
        refuse_foreign_files(folder, ("bokeh.jpg", KEPT_NAME))


def test_a_file_in_the_place_of_a_captures_folder_is_a_usage_error(tmp_path: Path) -> None:
    (tmp_path / "000").write_text("mine")
    (tmp_path / "staged").mkdir()
    write_kept(tmp_path / "staged", KeptDepth((), (), {}), key=KEY)
    with pytest.raises(UsageError, match="000 cannot be written: Not a directory"):
        put_in_place(tmp_path / "staged", tmp_path / "000")
    assert (tmp_path / "000").read_text() == "mine"


def test_a_page_tells_what_is_said_of_the_bokeh_that_lies_there_and_of_no_preview() -> None:
    lying = BokehPart(notes=("a: the bokeh was focused on x 1, y 2",))
    said = ("a: no disparity.png", "a: bokeh.jpg left out: its distance is not known")
    record = KeptRecord(notes=said, depth=DepthPart(file_notes=said[:1]), bokeh=lying)
    assert record.model_copy(update={"bokeh": None}).shown_notes == said
    assert record.shown_notes == (*said, *lying.notes)
    preview = record.model_copy(update={"key": {"bokeh": {"is_preview": True}}})
    assert preview.shown_notes == (said[0], *lying.notes)


def test_results_that_cannot_be_replaced_stay(folder: Path) -> None:
    capture = folder / "000"
    capture.mkdir()
    (capture / "disparity.pfm").write_bytes(b"0123456789")
    write_kept(capture, KeptDepth(("disparity.pfm",), (), {}), key=KEY)
    with pytest.raises((OSError, UsageError)):
        put_in_place(folder / "not there", capture)
    assert read_kept(capture, KEY) is not None
    assert not list(folder.glob(".telewide-*"))
