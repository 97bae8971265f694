"""Captures and board shots are looked for by one scan: of the same files both take the same ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from telewide.boards.shots import find_board_shots
from telewide.capture.layout import find_captures
from telewide.capture.view_files import best_photos, passed_over, photos_among


def filled(folder: Path, names: tuple[str, ...]) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())  # no two alike
    return folder


@pytest.mark.parametrize(
    "names",
    [
        ("one/tele.jpg", "one/wide.jpg"),
        ("one/tele.dng", "one/tele.jpg", "one/wide.jpg"),
        ("one/tele.dng", "one/tele.jpg", "one/wide.dng", "one/wide.heic"),
        ("one/tele.webp", "one/tele.jpg", "one/wide.tif", "one/wide.png"),
        ("one/Tele.JPG", "one/WIDE.heic", "one/tele.png", "one/.wide.png"),
        ("tele/a.dng", "tele/a.jpg", "wide/A.jpg", "tele/.a.png", "__MACOSX/tele.jpg"),
        ("tele/e\u0301.jpg", "wide/\u00e9.jpg"),
        ("one/tele.mpo", "one/tele.avif", "one/wide.cr3", "one/wide.mpo"),
    ],
)
def test_captures_and_board_shots_take_the_same_files(tmp_path: Path, names: tuple[str, ...]) -> None:
    folder = filled(tmp_path / "photos", names)
    (capture,), (shot,) = find_captures(folder).captures, find_board_shots(folder)
    assert (capture.name, capture.tele_path, capture.wide_path) == (shot.name, shot.tele_path, shot.wide_path)


def test_all_views_are_raw_or_none_is() -> None:
    tele, wide = [Path("tele.jpg"), Path("tele.dng")], [Path("wide.jpg")]
    assert best_photos({"tele": tele, "wide": wide}) == {"tele": tele[0], "wide": wide[0]}
    assert best_photos({"tele": tele}) == {"tele": tele[1]}
    assert best_photos({"tele": tele[1:], "wide": wide}) == {"tele": tele[1], "wide": wide[0]}, "no choice is left"


def test_what_lost_least_comes_first_and_only_the_twin_of_a_phone_is_passed_over_in_silence() -> None:
    paths = [Path(f"tele{suffix}") for suffix in (".mpo", ".jpg", ".webp", ".heic", ".png", ".tiff", ".dng", ".mov")]
    assert [path.suffix for path in photos_among(paths)] == [".dng", ".tiff", ".png", ".heic", ".webp", ".jpg", ".mpo"]
    assert passed_over(Path("tele.dng"), [Path("tele.dng"), Path("tele.jpg")]) == []
    assert passed_over(Path("tele.png"), [Path("tele.png"), Path("tele.jpg")]) == [Path("tele.jpg")]
