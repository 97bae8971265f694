"""Finding captures: the layouts, what surrounds them on real disks, and each kind of bad folder."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from ordinary_user import as_ordinary_user

from telewide.capture.images import write_image
from telewide.capture.layout import CaptureSet, find_captures
from telewide.errors import InputError, UsageError


def fill(root: Path, names: Iterable[str]) -> Path:
    """Create files that each hold different bytes."""
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return root


def found(captures: CaptureSet) -> dict[str, tuple[str, str]]:
    """Files of every capture, relative to the folder."""
    return {
        capture.name: (
            capture.tele_path.relative_to(captures.root).as_posix(),
            capture.wide_path.relative_to(captures.root).as_posix(),
        )
        for capture in captures.captures
    }


@pytest.mark.parametrize(
    ("tele", "wide"),
    [
        ("A/tele.jpg", "A/wide.png"),
        ("A/TELE.JPG", "A/Wide.TIFF"),
        ("A_tele.jpg", "A_wide.jpg"),
        ("A-Tele.jpeg", "A-WIDE.jpeg"),
        ("A tele.jpg", "A wide.jpg"),
        ("A-T.jpg", "A-W.jpg"),
        ("A_t.tif", "A_w.tif"),
        ("A_3x.JPG", "A_1x.JPG"),
        ("A_5X.png", "A_1X.png"),
        ("tele/A.jpg", "wide/A.jpg"),
        ("Tele/A.jpg", "WIDE/A.png"),
        ("tele/A.JPG", "wide/a.jpg"),
        ("A_tele.jpg", "a_WIDE.jpg"),
    ],
)
def test_every_layout(tmp_path: Path, tele: str, wide: str) -> None:
    captures = find_captures(fill(tmp_path, [tele, wide]))
    assert found(captures) == {"A": (tele, wide)}
    assert captures.problems == ()


def test_a_capture_that_is_called_like_a_view_is_a_capture(tmp_path: Path) -> None:
    captures = find_captures(
        fill(tmp_path, ["tele/tele.jpg", "tele/wide.jpg", "wide/B.jpg", "A/tele.jpg", "A/wide.jpg"])
    )
    assert found(captures) == {"A": ("A/tele.jpg", "A/wide.jpg"), "tele": ("tele/tele.jpg", "tele/wide.jpg")}


def test_layouts_mix_and_names_are_sorted(tmp_path: Path) -> None:
    names = ["c/tele.png", "c/wide.png", "b_tele.png", "b_wide.png", "tele/a.png", "wide/a.png"]
    captures = find_captures(fill(tmp_path, names))
    assert [capture.name for capture in captures.captures] == ["a", "b", "c"]


def test_one_capture_folder_takes_the_facts_of_its_set(tmp_path: Path) -> None:
    fill(tmp_path, ["set/IMG 01/tele.png", "set/IMG 01/wide.png"])
    (tmp_path / "set" / "captures.yaml").write_text("asymmetry: 3.0\n")
    captures = find_captures(tmp_path / "set" / "IMG 01")
    assert found(captures) == {"IMG 01": ("tele.png", "wide.png")}
    assert captures.facts.asymmetry == 3.0


def test_the_folder_itself_by_a_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(fill(tmp_path / "shot", ["tele.png", "wide.png"]))
    assert found(find_captures(Path())) == {"shot": ("tele.png", "wide.png")}


def test_a_set_does_not_take_the_facts_of_the_folder_above(tmp_path: Path) -> None:
    fill(tmp_path, ["set/A/tele.png", "set/A/wide.png"])
    (tmp_path / "captures.yaml").write_text("asymmetry: 3.0\n")
    assert find_captures(tmp_path / "set").facts.asymmetry is None


@pytest.mark.parametrize("name", ["captures.yml", "captures.YAML", "Captures.yaml", "CAPTURES.YML"])
def test_the_facts_are_found_by_any_spelling_of_their_name(tmp_path: Path, name: str) -> None:
    fill(tmp_path, ["A/tele.png", "A/wide.png"])
    (tmp_path / name).write_text("asymmetry: 3.0\n")
    assert find_captures(tmp_path).facts.asymmetry == 3.0
    assert find_captures(tmp_path / "A").facts.asymmetry == 3.0


def test_two_files_of_facts_are_refused(tmp_path: Path) -> None:
    fill(tmp_path, ["A/tele.png", "A/wide.png"])
    for name in ("captures.yml", "captures.yaml"):
        (tmp_path / name).write_text("asymmetry: 3.0\n")
    with pytest.raises(InputError, match=r"holds captures\.yaml and captures\.yml"):
        find_captures(tmp_path)


def test_names_that_differ_by_case_stay_two_captures_where_both_are_whole(tmp_path: Path) -> None:
    names = ["tele/A.jpg", "wide/A.jpg", "tele/a.jpg", "wide/a.jpg", "b_tele.jpg", "b_wide.jpg", "B_truth.pfm"]
    captures = find_captures(fill(tmp_path, names))
    assert [capture.name for capture in captures.captures] == ["A", "a", "b"]
    assert captures.captures[2].truth_path == tmp_path / "B_truth.pfm"
    assert captures.problems == ()


@pytest.mark.parametrize("truth", ["A/truth.pfm", "A_truth.pfm", "truth/A.pfm"])
def test_truth_is_found_in_every_layout(tmp_path: Path, truth: str) -> None:
    views = [truth.replace("truth", view).replace(".pfm", ".png") for view in ("tele", "wide")]
    captures = find_captures(fill(tmp_path, [*views, truth]))
    assert captures.captures[0].truth_path == tmp_path / truth


def test_names_with_spaces_and_letters_of_any_script(tmp_path: Path) -> None:
    names = ["Café am Öresund/tele.jpg", "Café am Öresund/wide.jpg", "写真 1_tele.png", "写真 1_wide.png"]
    captures = find_captures(fill(tmp_path, names))
    assert [capture.name for capture in captures.captures] == ["Café am Öresund", "写真 1"]


def test_two_spellings_of_one_letter_are_one_name(tmp_path: Path) -> None:
    captures = find_captures(fill(tmp_path, ["Cafe\u0301_tele.jpg", "Caf\u00e9_wide.jpg"]))
    assert [capture.name for capture in captures.captures] == ["Caf\u00e9"]


def test_what_lies_about_is_not_looked_at(tmp_path: Path) -> None:
    mess = ["__MACOSX/A/._tele.jpg", "__MACOSX/B/tele.jpg", ".hidden/tele.jpg", "A/._tele.jpg", "A/.DS_Store"]
    other = ["Thumbs.db", "notes.txt", "run/depth/A/depth.json", "run/run.json", "B_tele.txt", "A/notes_tele.txt"]
    captures = find_captures(fill(tmp_path, ["A/tele.jpg", "A/wide.jpg", *mess, *other]))
    assert found(captures) == {"A": ("A/tele.jpg", "A/wide.jpg")}
    assert captures.problems == ()


def test_raw_is_taken_before_its_twins(tmp_path: Path) -> None:
    captures = find_captures(fill(tmp_path, ["A_tele.dng", "A_tele.jpg", "A_wide.jpg", "A_wide.DNG", "A_wide.heic"]))
    assert found(captures) == {"A": ("A_tele.dng", "A_wide.DNG")}
    assert captures.problems == ()


def test_raw_is_not_paired_with_jpeg_where_its_twin_is_there(tmp_path: Path) -> None:
    names = ["A/tele.dng", "A/tele.jpg", "A/wide.jpg", "B/tele.heic", "B/wide.nef", "B/wide.heic", "C_t.dng", "C_w.jpg"]
    captures = find_captures(fill(tmp_path, names))
    expected = {"A": ("A/tele.jpg", "A/wide.jpg"), "B": ("B/tele.heic", "B/wide.heic"), "C": ("C_t.dng", "C_w.jpg")}
    assert found(captures) == expected
    assert captures.problems == ()


def test_of_two_files_for_one_view_the_better_is_taken_and_said(tmp_path: Path) -> None:
    names = ["A/tele.jpg", "A/tele.png", "A/wide.jpg", "B_3x.jpg", "B_5x.jpg", "B_1x.jpg"]
    captures = find_captures(fill(tmp_path, names))
    assert found(captures) == {"A": ("A/tele.png", "A/wide.jpg"), "B": ("B_3x.jpg", "B_1x.jpg")}
    assert [problem.is_skipped for problem in captures.problems] == [False, False]
    assert "tele.png is taken, tele.jpg is not" in captures.problems[0].message
    assert "B_3x.jpg is taken, B_5x.jpg is not" in captures.problems[1].message


def test_two_captures_of_one_name_are_never_mixed(tmp_path: Path) -> None:
    captures = find_captures(fill(tmp_path, ["A/tele.jpg", "A/wide.jpg", "A_tele.png", "A_wide.jpg"]))
    assert found(captures) == {"A": ("A/tele.jpg", "A/wide.jpg")}
    assert [problem.is_skipped for problem in captures.problems] == [True]
    assert "A_tele.png is not read" in captures.problems[0].message


# --- problems of one capture leave the others alone

GOOD = ("good/tele.png", "good/wide.png")


def the_problem(folder: Path) -> str:
    """The only problem of a folder that also holds a good capture."""
    captures = find_captures(fill(folder, GOOD))
    assert [capture.name for capture in captures.captures] == ["good"]
    (problem,) = captures.problems
    assert problem.is_skipped
    assert problem.name == "bad"
    return problem.message


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["bad/tele.jpg"], "the wide view is missing; found tele.jpg"),
        (["bad_wide.jpg"], "the tele view is missing; found bad_wide.jpg"),
        (["tele/bad.jpg"], "the wide view is missing; found bad.jpg"),
        (["bad/truth.pfm"], "the tele view is missing; found truth.pfm"),
        (["bad/one.jpg", "bad/two.jpg"], "bad holds neither tele.* nor wide.*"),
        (["bad/telle.jpg", "bad/one.jpg"], "neither tele.* nor wide.*; rename telle.jpg to tele.jpg if that is it"),
        (["bad/tel.jpg", "bad/wide.jpg"], "found wide.jpg; rename tel.jpg to tele.jpg if that is it"),
        (["bad/tele.jpg", "bad/Wiede.JPG"], "found tele.jpg; rename Wiede.JPG to wide.JPG if that is it"),
        (["bad/tele.pfm", "bad/wide.jpg"], "the tele view is missing; found wide.jpg"),
        (["bad/.DS_Store"], "bad holds no photo"),
        (["bad/tele.txt", "bad/.thumbs/tele.jpg"], "bad holds no photo"),
    ],
)
def test_a_capture_that_cannot_be_used(tmp_path: Path, names: list[str], message: str) -> None:
    assert message in the_problem(fill(tmp_path, names))


def test_no_photo_is_renamed_whose_name_is_not_near(tmp_path: Path) -> None:
    assert the_problem(fill(tmp_path, ["bad/IMG_2041.jpg", "bad/wide.jpg", "bad/wide_2.jpg"])).endswith("wide.jpg")


@pytest.mark.parametrize("link", ["hardlink", "symlink", "copy"])
def test_both_views_the_same_file(tmp_path: Path, link: str) -> None:
    tele, wide = tmp_path / "bad" / "tele.jpg", tmp_path / "bad" / "wide.jpg"
    fill(tmp_path, ["bad/tele.jpg"])
    write_image(tele, np.zeros((8, 8, 3), np.float32))
    if link == "hardlink":
        os.link(tele, wide)
    elif link == "symlink":
        wide.symlink_to(tele)
    else:
        wide.write_bytes(tele.read_bytes())
    assert "are the same picture" in the_problem(tmp_path)


@pytest.mark.parametrize("content", [b"", b"hi\n"])
def test_what_is_no_picture_is_not_the_same_picture(tmp_path: Path, content: bytes) -> None:
    """Whoever reads them says that they are empty, or no photos."""
    fill(tmp_path, ["bad/tele.jpg", "bad/wide.jpg"])
    for name in ("tele", "wide"):
        (tmp_path / "bad" / f"{name}.jpg").write_bytes(content)
    assert [capture.name for capture in find_captures(tmp_path).captures] == ["bad"]


def test_a_link_to_nowhere_is_a_missing_view(tmp_path: Path) -> None:
    fill(tmp_path, ["bad/tele.jpg"])
    (tmp_path / "bad" / "wide.jpg").symlink_to(tmp_path / "gone.jpg")
    assert "the wide view is missing" in the_problem(tmp_path)


def test_what_nobody_can_look_at_leaves_the_others(tmp_path: Path) -> None:
    """A folder that is closed, as lost+found is, and links with too long a name or into a closed folder."""
    fill(tmp_path, ["good/tele.jpg", "good/wide.jpg", "lost+found/tele.jpg"])
    for place in ("long", "good/truth.pfm", "good/tele.png", "long_tele.jpg", "captures.yaml"):
        (tmp_path / place).symlink_to("x" * 300)
    (tmp_path / "behind").symlink_to(tmp_path / "lost+found" / "tele.jpg")

    def look() -> None:
        captures = find_captures(tmp_path)
        assert found(captures) == {"good": ("good/tele.jpg", "good/wide.jpg")}
        assert [problem.message for problem in captures.problems] == [f"{tmp_path / 'lost+found'} cannot be opened"]

    def look_again() -> None:
        with pytest.raises(InputError, match=r"no capture that can be used:\n  good: .* cannot be opened"):
            find_captures(tmp_path)

    try:
        for name, looking in (("lost+found", look), ("good", look_again)):
            (tmp_path / name).chmod(0)
            as_ordinary_user(tmp_path, looking)
    finally:
        for name in ("lost+found", "good"):
            (tmp_path / name).chmod(0o755)


# --- folders without captures


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        find_captures(tmp_path / "nothing")
    with pytest.raises(UsageError, match="cannot be opened: File name too long; a folder with captures was expected"):
        find_captures(tmp_path / ("x" * 300))


def test_a_file_instead_of_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a file"):
        find_captures(fill(tmp_path, ["a.jpg"]) / "a.jpg")


@pytest.mark.parametrize(
    ("photos", "folder"),
    [
        (["set/000/tele.jpg", "set/000/wide.jpg"], "set/000"),
        (["set/a_tele.jpg", "set/a_wide.jpg"], "set"),
        (["set/tele/a.jpg", "set/wide/a.jpg"], "set"),
        (["set/odd.jpg"], "set"),
    ],
)
def test_a_photo_instead_of_its_folder_is_answered_with_the_folder(
    tmp_path: Path, photos: list[str], folder: str
) -> None:
    with pytest.raises(UsageError, match="is a file") as caught:
        find_captures(fill(tmp_path, photos) / photos[0])
    assert caught.value.hint == f"name the folder that holds it: {tmp_path / folder}"


def test_the_hint_on_a_photo_given_twice_does_not_speak_of_names(tmp_path: Path) -> None:
    for name in ("A/tele.jpg", "A/wide.jpg"):
        fill(tmp_path, [name])
        write_image(tmp_path / name, np.zeros((8, 8, 3), np.float32))
    with pytest.raises(InputError, match="same picture") as caught:
        find_captures(tmp_path)
    assert "other lens" in (caught.value.hint or "")
    fill(tmp_path, ["B/tele.jpg"])
    with pytest.raises(InputError, match="wide view is missing") as caught:
        find_captures(tmp_path)
    assert "<name>/tele.*" in (caught.value.hint or "")


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no captures: it is empty") as caught:
        find_captures(tmp_path)
    assert "<name>/tele.*" in (caught.value.hint or "")


def test_a_folder_of_other_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"it holds 1\.mp3, 2\.mp3, 3\.mp3, 4\.mp3, 5\.mp3 and 2 more") as caught:
        find_captures(fill(tmp_path, [f"{i}.mp3" for i in range(1, 8)]))
    assert "<name>/tele.*" in (caught.value.hint or "")


def test_a_folder_of_empty_folders_names_them(tmp_path: Path) -> None:
    for name in ("A", "B", "tele", "truth"):  # the latter two are those of the views
        (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=r"A holds no photo\n.*B holds no photo$"):
        find_captures(tmp_path)


def test_nothing_left_lists_the_problems(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no capture that can be used") as caught:
        find_captures(fill(tmp_path, ["A/tele.jpg", "B_wide.jpg"]))
    assert "A: the wide view is missing" in caught.value.message
    assert "B: the tele view is missing" in caught.value.message


def test_many_problems_are_cut_short(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="and 7 more"):
        find_captures(fill(tmp_path, [f"{i:02d}/tele.jpg" for i in range(12)]))


def test_one_folder_too_high_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"but .*photos does") as caught:
        find_captures(fill(tmp_path, ["photos/A/tele.jpg", "photos/A/wide.jpg"]))
    assert str(tmp_path / "photos") in (caught.value.hint or "")


def test_bad_facts_stop_the_whole_folder(tmp_path: Path) -> None:
    fill(tmp_path, GOOD)
    (tmp_path / "captures.yaml").write_text("rectifyed: true\n")
    with pytest.raises(InputError, match="unknown key rectifyed, did you mean rectified"):
        find_captures(tmp_path)


def test_a_real_set(data_root: Path) -> None:
    captures = find_captures(data_root / "p30")
    assert len(captures.captures) == 20
    assert captures.problems == ()
    assert captures.facts.asymmetry == 3.0
    assert captures.facts.rectified is True
    assert captures.facts.rotated_deg == 90


def test_real_phone_photos(data_root: Path) -> None:
    (capture,) = find_captures(data_root / "phone_tele_wide_exif").captures
    assert capture.name == "IMG_20"


def test_a_written_pair_is_found(tmp_path: Path) -> None:
    for view, level in (("tele", 0.2), ("wide", 0.4)):
        write_image(tmp_path / "A" / f"{view}.png", np.full((40, 40, 3), level, np.float32))
    assert [capture.name for capture in find_captures(tmp_path).captures] == ["A"]
