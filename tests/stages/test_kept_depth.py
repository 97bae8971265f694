"""What lies in a folder is taken as it is only where it was made from the same and is whole."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from telewide.stages.kept_depth import KEPT_NAME, KeptDepth, read_kept, write_kept

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
