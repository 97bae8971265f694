"""captures.yaml: what is read and how each mistake is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from telewide.capture.facts import CaptureFacts, read_facts
from telewide.errors import InputError


def _facts(folder: Path, text: str) -> CaptureFacts:
    path = folder / "captures.yaml"
    path.write_text(text, encoding="utf-8")
    return read_facts(path)


def test_all_keys_are_read(tmp_path: Path) -> None:
    text = (
        "format: 1\nrectified: true\nasymmetry: 3\nreference: tele\nrotated_deg: 90\n"
        "baseline_m: 0.012\nf_px: 3200.5\ndoffs_px: -12\nnotes: Grüße\n"
    )
    expected = CaptureFacts(
        rectified=True,
        asymmetry=3.0,
        reference="tele",
        rotated_deg=90,
        baseline_m=0.012,
        f_px=3200.5,
        doffs_px=-12.0,
        notes="Grüße",
    )
    assert _facts(tmp_path, text) == expected


@pytest.mark.parametrize("text", ["", "# nothing\n", "\ufeffformat: 1\n"])
def test_an_empty_file_states_nothing(tmp_path: Path, text: str) -> None:
    assert _facts(tmp_path, text) == CaptureFacts()


def test_a_missing_file_states_nothing(tmp_path: Path) -> None:
    assert read_facts(tmp_path / "captures.yaml") == CaptureFacts()


def test_an_unknown_key_names_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown key baseline_mm, did you mean baseline_m") as caught:
        _facts(tmp_path, "baseline_mm: 12\n")
    assert "known keys: asymmetry, baseline_m, doffs_px" in (caught.value.hint or "")


@pytest.mark.parametrize("key", ["7", "~", "2024-01-01", "[a, b]"])
def test_a_key_that_is_no_name_is_told_like_an_unknown_one(tmp_path: Path, key: str) -> None:
    with pytest.raises(InputError, match=r"unknown key|unhashable key"):
        _facts(tmp_path, f"{key}: 1\n")


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"baseline_m is -2, .*; unknown key zoom"):
        _facts(tmp_path, "baseline_m: -2\nzoom: 3\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- a\n- b\n", r"found \['a', 'b'\], expected keys and values"),
        ("just words\n", "found 'just words', expected keys and values"),
        ("a: [1\n", "cannot be read as YAML"),
        ("rectified: maybe\n", r"rectified is 'maybe', expected a valid boolean"),
        ("rectified: 1\n", r"rectified is 1, expected a valid boolean"),
        ("asymmetry: three\n", r"asymmetry is 'three', expected a valid number"),
        ("asymmetry: 0.5\n", r"asymmetry is 0\.5, expected f_tele / f_wide"),
        ("asymmetry: .nan\n", r"asymmetry is nan, expected a finite number"),
        ("reference: left\n", r"reference is 'left', expected 'tele'"),
        ("reference: wide\n", r"reference is 'wide', expected 'tele'"),
        ("rotated_deg: 45\n", r"rotated_deg is 45, expected 0, 90, 180 or 270"),
        ("format: 2\n", r"format is 2, expected 1"),
        ("baseline_m: 12\n", r"baseline_m is 12, expected metres"),
        ("baseline_m: 0\n", r"baseline_m is 0, expected metres"),
        ("f_px: -1\n", r"f_px is -1, expected a positive number"),
        ("notes: 2024-01-01\nf_px: 2024-01-01\n", r"f_px is '2024-01-01'"),
    ],
)
def test_a_wrong_value_is_told_with_the_file_and_what_was_expected(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        _facts(tmp_path, text)
    assert str(tmp_path / "captures.yaml") in caught.value.message


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "captures.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="cannot be read as YAML"):
        read_facts(tmp_path / "captures.yaml")


def test_the_values_are_checked_wherever_facts_are_made() -> None:
    with pytest.raises(ValueError, match="baseline_m"):
        CaptureFacts(baseline_m=12.0)
