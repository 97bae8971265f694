"""From a camera roll on disk to capture folders."""

from __future__ import annotations

import json
import os
import pwd
import stat
from pathlib import Path

import numpy as np
import pytest
from capture.dng import write_dng
from capture.roll import TELE, WIDE, exif_of, write_photo
from ordinary_user import as_ordinary_user

from telewide.capture.importer import ImportPlan, carry_out, plan_import
from telewide.capture.layout import find_captures
from telewide.capture.lens_choice import LensChoice
from telewide.errors import InputError, UsageError

FLAT = np.full((40, 60), 0.5, np.float32)


def shoot(folder: Path, name: str, lens: dict[str, float], second: float) -> Path:
    return write_photo(folder / name, exif=exif_of(**lens, second=second))  # type: ignore[arg-type]


def shoot_raw(folder: Path, name: str, second: int) -> Path:
    """A DNG that states its time and camera, but not its lens: that stands in its twin alone."""
    texts = {271: "Maker", 272: "Phone 1", 36867: f"2026:05:01 12:00:{second:02d}"}
    return write_dng(folder / name, FLAT, texts=texts)


def planned(plan: ImportPlan) -> dict[str, tuple[str, str]]:
    return {one.name: (one.pair.tele.path.name, one.pair.wide.path.name) for one in plan.pairs}


@pytest.fixture
def roll(tmp_path: Path) -> Path:
    """Two pairs in two folders, and a photo of its own."""
    dcim = tmp_path / "DCIM"
    shoot(dcim / "100A", "IMG_1.jpg", WIDE, 0)
    shoot(dcim / "100A", "IMG_2.jpg", TELE, 2)
    shoot(dcim / "101A", "IMG_3.jpg", TELE, 100)
    shoot(dcim / "101A", "IMG_4.jpg", WIDE, 101)
    shoot(dcim / "101A", "IMG_5.jpg", WIDE, 500)
    return dcim


def test_an_import_makes_captures(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    plan = plan_import(roll, captures, choice=LensChoice())
    assert not captures.exists()
    assert planned(plan) == {"IMG_2": ("IMG_2.jpg", "IMG_1.jpg"), "IMG_3": ("IMG_3.jpg", "IMG_4.jpg")}
    assert [one.photo.path.name for one in plan.unpaired] == ["IMG_5.jpg"]
    carry_out(plan, captures)
    found = find_captures(captures)
    assert [capture.name for capture in found.captures] == ["IMG_2", "IMG_3"]
    assert found.problems == ()
    assert (captures / "IMG_2" / "tele.jpg").read_bytes() == (roll / "100A" / "IMG_2.jpg").read_bytes()
    assert (captures / "IMG_2" / "wide.jpg").read_bytes() == (roll / "100A" / "IMG_1.jpg").read_bytes()
    record = json.loads((captures / "IMG_2" / "pair.json").read_text())
    assert record["format"] == 1
    assert record["seconds_apart"] == -2
    assert record["tele"]["source"] == "IMG_2.jpg"
    assert record["wide"]["focal_length_mm"] == 4.25
    assert record["tele"]["image_pipeline"] == "jpeg:Maker Phone 1"
    assert sorted(entry.name for entry in captures.iterdir()) == ["IMG_2", "IMG_3"]


def test_a_second_import_adds_what_is_new(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    carry_out(plan_import(roll, captures, choice=LensChoice()), captures)
    again = plan_import(roll, captures, choice=LensChoice())
    assert (again.pairs, again.known) == ((), ("IMG_2", "IMG_3"))
    shoot(roll / "101A", "IMG_6.jpg", TELE, 505)
    shoot(roll / "101A", "IMG_7.jpg", TELE, 99.5)  # nearer to a photo that is imported already
    added = plan_import(roll, captures, choice=LensChoice())
    assert planned(added) == {"IMG_6": ("IMG_6.jpg", "IMG_5.jpg")}
    assert [one.photo.path.name for one in added.unpaired] == ["IMG_7.jpg"]
    kept = (captures / "IMG_2" / "tele.jpg").stat().st_mtime_ns
    carry_out(added, captures)
    assert len(find_captures(captures).captures) == 3
    assert (captures / "IMG_2" / "tele.jpg").stat().st_mtime_ns == kept


def test_a_new_pair_is_imported_though_its_names_and_sizes_are_known(tmp_path: Path) -> None:
    """A phone that counts anew, and photos of equal size, as RAW always has."""
    dcim, captures = tmp_path / "DCIM", tmp_path / "captures"

    def take(folder: str, second: int) -> None:
        for name, lens, later in (("T.dng", 6.0, 0), ("W.dng", 4.25, 1)):
            texts = {271: "Maker", 272: "Phone 1", 36867: f"2026:05:01 12:00:{second + later:02d}"}
            write_dng(dcim / folder / name, FLAT, texts=texts)
            shoot(dcim / folder, name.replace("dng", "jpg"), {"focal": lens, "f35": round(6 * lens)}, second + later)

    take("100A", 0)
    carry_out(plan_import(dcim, captures, choice=LensChoice()), captures)
    take("101A", 30)
    assert (dcim / "100A" / "T.dng").stat().st_size == (dcim / "101A" / "T.dng").stat().st_size
    plan = plan_import(dcim, captures, choice=LensChoice())
    assert [planned.pair.tele.path.parent.name for planned in plan.pairs] == ["101A"]
    assert plan.known == ("T",)
    carry_out(plan, captures)
    assert plan_import(dcim, captures, choice=LensChoice()).known == ("T", "T-2")


def test_no_capture_is_named_like_a_folder_of_views(tmp_path: Path) -> None:
    dcim, captures = tmp_path / "DCIM", tmp_path / "captures"
    for number, name in enumerate(("tele", "Wide", "TRUTH", "captures.yaml")):
        shoot(dcim, f"{name}.jpg", TELE, 100 * number)
        shoot(dcim, f"other{number}.jpg", WIDE, 100 * number + 1)
    carry_out(plan_import(dcim, captures, choice=LensChoice()), captures)
    found = find_captures(captures)
    assert [capture.name for capture in found.captures] == ["TRUTH-2", "Wide-2", "captures.yaml-2", "tele-2"]
    assert found.problems == ()


def test_equal_names_get_folders_of_their_own(tmp_path: Path) -> None:
    for number, folder in enumerate(("100A", "101A")):
        shoot(tmp_path / "DCIM" / folder, "IMG_1.jpg", TELE, 100 * number)
        shoot(tmp_path / "DCIM" / folder, "IMG_2.jpg", {**WIDE, "f35": 26 + number}, 100 * number + 1)
    (tmp_path / "captures" / "img_1-2").mkdir(parents=True)
    plan = plan_import(tmp_path / "DCIM", tmp_path / "captures", choice=LensChoice())
    assert list(planned(plan)) == ["IMG_1", "IMG_1-3"]


@pytest.mark.parametrize(
    ("raw_name", "twin_name"),
    [("{}.dng", "{}.jpg"), ("{}.DNG", "{}.JPG"), ("{}.RAW-02.ORIGINAL.dng", "{}.RAW-01.COVER.jpg")],
)
def test_raw_is_imported_and_its_twin_tells_the_lens(tmp_path: Path, raw_name: str, twin_name: str) -> None:
    dcim, captures = tmp_path / "DCIM", tmp_path / "captures"
    for name, lens, second in (("T1", TELE, 1), ("W1", WIDE, 3)):
        shoot_raw(dcim, raw_name.format(name), second)
        shoot(dcim, twin_name.format(name), lens, second)
    plan = plan_import(dcim, captures, choice=LensChoice())
    assert planned(plan) == {"T1": (raw_name.format("T1"), raw_name.format("W1"))}
    assert plan.unpaired == ()
    carry_out(plan, captures)
    (capture,) = find_captures(captures).captures
    assert (capture.tele_path.name, capture.wide_path.name) == ("tele.dng", "wide.dng")
    assert plan_import(dcim, captures, choice=LensChoice()).known == ("T1",)


def test_a_twin_is_imported_where_the_partner_has_no_raw(tmp_path: Path) -> None:
    dcim, captures = tmp_path / "DCIM", tmp_path / "captures"
    shoot_raw(dcim, "T1.dng", 1)
    shoot(dcim, "T1.jpg", TELE, 1)
    shoot(dcim, "W1.jpg", WIDE, 3)
    plan = plan_import(dcim, captures, choice=LensChoice())
    assert planned(plan) == {"T1": ("T1.jpg", "W1.jpg")}
    carry_out(plan, captures)
    assert plan_import(dcim, captures, choice=LensChoice()).pairs == ()


def test_links_share_their_bytes(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    carry_out(plan_import(roll, captures, choice=LensChoice()), captures, is_linked=True)
    assert (captures / "IMG_2" / "tele.jpg").samefile(roll / "100A" / "IMG_2.jpg")


@pytest.mark.parametrize("is_linked", [False, True])
def test_locked_photos_are_imported_by_an_ordinary_user(roll: Path, tmp_path: Path, *, is_linked: bool) -> None:
    """Photos of mode 0444, as on a card that was copied read-only; root may write to them, so it steps down."""
    for path in roll.rglob("*.jpg"):
        path.chmod(0o444)
        if os.geteuid() == 0:  # a hard link is its owner's to make
            os.chown(path, pwd.getpwnam("nobody").pw_uid, -1)
    captures = tmp_path / "captures"
    plan = plan_import(roll, captures, choice=LensChoice())
    as_ordinary_user(tmp_path, lambda: carry_out(plan, captures, is_linked=is_linked))
    lying = captures / "IMG_2" / "tele.jpg"
    assert lying.read_bytes() == (roll / "100A" / "IMG_2.jpg").read_bytes()
    assert (roll / "100A" / "IMG_2.jpg").stat().st_mode & 0o777 == 0o444
    assert lying.samefile(roll / "100A" / "IMG_2.jpg") == is_linked
    if not is_linked:
        assert lying.stat().st_mode & stat.S_IWUSR


def test_linked_folders_are_entered_once(roll: Path, tmp_path: Path) -> None:
    (tmp_path / "DCIM").rename(tmp_path / "card")
    roll.mkdir()
    (roll / "camera").symlink_to(tmp_path / "card", target_is_directory=True)
    (roll / "again").symlink_to(tmp_path / "card", target_is_directory=True)
    (tmp_path / "card" / "up").symlink_to(roll, target_is_directory=True)
    plan = plan_import(roll, tmp_path / "captures", choice=LensChoice())
    assert planned(plan) == {"IMG_2": ("IMG_2.jpg", "IMG_1.jpg"), "IMG_3": ("IMG_3.jpg", "IMG_4.jpg")}
    assert [one.photo.path.name for one in plan.unpaired] == ["IMG_5.jpg"]


def test_a_linked_photo_is_one_photo_and_a_hard_link_leads_to_its_bytes(roll: Path, tmp_path: Path) -> None:
    target = roll / "100A" / "IMG_2.jpg"
    target.rename(tmp_path / "elsewhere.jpg")
    target.symlink_to(tmp_path / "elsewhere.jpg")
    (roll / "101A" / "IMG_9.jpg").symlink_to(tmp_path / "elsewhere.jpg")
    captures = tmp_path / "captures"
    plan = plan_import(roll, captures, choice=LensChoice())
    assert len(plan.pairs) + len(plan.unpaired) == 3
    carry_out(plan, captures, is_linked=True)
    assert not (captures / "IMG_2" / "tele.jpg").is_symlink()
    assert (captures / "IMG_2" / "tele.jpg").samefile(tmp_path / "elsewhere.jpg")


def test_a_folder_that_cannot_be_opened_is_told(roll: Path, tmp_path: Path) -> None:
    def look() -> None:
        plan = plan_import(roll, tmp_path / "captures", choice=LensChoice())
        assert planned(plan) == {"IMG_2": ("IMG_2.jpg", "IMG_1.jpg")}
        assert [one.reason for one in plan.unpaired] == ["the folder cannot be opened: Permission denied"]

    def look_again() -> None:
        with pytest.raises(InputError, match=r"holds no photos; .*100A: the folder cannot be opened"):
            plan_import(roll, tmp_path / "captures", choice=LensChoice())

    try:
        for name, looking in (("101A", look), ("100A", look_again)):
            (roll / name).chmod(0)
            as_ordinary_user(tmp_path, looking)
    finally:
        for name in ("100A", "101A"):
            (roll / name).chmod(0o755)


def test_a_second_import_does_not_pair_the_lenses_that_were_left(tmp_path: Path) -> None:
    dcim, captures = tmp_path / "DCIM", tmp_path / "captures"
    lenses = {"U": (2.2, 13), "W": (6.3, 24), "T": (7.9, 70), "L": (18.6, 230)}
    for k, (name, (focal, f35)) in enumerate(lenses.items()):
        shoot(dcim, f"{name}.jpg", {"focal": focal, "f35": f35}, k)
    carry_out(plan_import(dcim, captures, choice=LensChoice()), captures)
    again = plan_import(dcim, captures, choice=LensChoice())
    assert (again.pairs, again.known) == ((), ("T",))
    asked = plan_import(dcim, captures, choice=LensChoice(tele_mm=18.6, wide_mm=2.2))
    assert planned(asked) == {"L": ("L.jpg", "U.jpg")}


def test_what_is_no_photo_is_not_looked_at(roll: Path, tmp_path: Path) -> None:
    for name in ("100A/MOV_1.mp4", "100A/IMG_1.AAE", "100A/._IMG_1.jpg", ".thumbnails/IMG_1.jpg"):
        (roll / name).parent.mkdir(exist_ok=True)
        (roll / name).write_text("nothing")
    (roll / "100A" / "IMG_0.jpg").write_text("this is no photo at all")
    plan = plan_import(roll, tmp_path / "captures", choice=LensChoice())
    assert len(plan.pairs) == 2
    assert {one.photo.path.name: one.reason.split(";")[0] for one in plan.unpaired} == {
        "IMG_0.jpg": "is no photo that can be read",
        "IMG_5.jpg": "the nearest photo of the other lens, IMG_3.jpg, is 400.0 s away",
    }


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_a_photo_that_was_cut_off_is_said_to_be_and_is_not_imported(tmp_path: Path, share: float) -> None:
    dcim = tmp_path / "DCIM"
    shoot(dcim, "T.jpg", TELE, 0)
    shoot(dcim, "W.jpg", WIDE, 2)
    cut = shoot(dcim, "W_cut.jpg", WIDE, 1)  # nearer to tele
    cut.write_bytes(cut.read_bytes()[: int(share * cut.stat().st_size)])
    plan = plan_import(dcim, tmp_path / "captures", choice=LensChoice())
    assert planned(plan) == {"T": ("T.jpg", "W.jpg")}
    (left,) = plan.unpaired
    assert left.photo.path == cut
    assert "cut off or corrupt" in left.reason
    assert "focal length" not in left.reason


def test_the_partner_of_a_corrupt_photo_is_left_alone(tmp_path: Path) -> None:
    dcim = tmp_path / "DCIM"
    shoot(dcim, "T.jpg", TELE, 0)
    cut = shoot(dcim, "W.jpg", WIDE, 1)
    cut.write_bytes(cut.read_bytes()[:-400])
    plan = plan_import(dcim, tmp_path / "captures", choice=LensChoice())
    assert plan.pairs == ()
    assert "corrupt" in {one.photo.path.name: one.reason for one in plan.unpaired}["W.jpg"]
    assert len(plan.unpaired) == 2


def test_captures_inside_the_roll_are_not_imported_again(roll: Path) -> None:
    captures = roll / "captures"
    carry_out(plan_import(roll, captures, choice=LensChoice()), captures)
    again = plan_import(roll, captures, choice=LensChoice())
    assert (again.pairs, len(again.unpaired), again.known) == ((), 1, ("IMG_2", "IMG_3"))


def test_a_failed_import_leaves_whole_captures_only(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    plan = plan_import(roll, captures, choice=LensChoice())
    (roll / "101A" / "IMG_4.jpg").unlink()
    with pytest.raises(InputError, match=r"IMG_4\.jpg cannot be read"):
        carry_out(plan, captures)
    assert [entry.name for entry in captures.iterdir()] == ["IMG_2"]
    rest = plan_import(roll, captures, choice=LensChoice())
    assert rest.known == ("IMG_2",)


def test_a_broken_record_does_not_stop_an_import(roll: Path, tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    carry_out(plan_import(roll, captures, choice=LensChoice()), captures)
    (captures / "IMG_3" / "pair.json").write_text("{")
    again = plan_import(roll, captures, choice=LensChoice())
    assert list(planned(again)) == ["IMG_3-2"]


def test_folders_that_cannot_be_used(roll: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    cases = [
        (tmp_path / "none", tmp_path / "c", UsageError, "does not exist"),
        (tmp_path / "file", tmp_path / "c", UsageError, "is a file"),
        (roll, tmp_path / "file", UsageError, "is a file"),
        (roll, roll, UsageError, "both where photos come from"),
        (tmp_path / "empty", tmp_path / "c", InputError, "holds no photos"),
    ]
    for dcim, captures, kind, told in cases:
        with pytest.raises(kind, match=told):
            plan_import(dcim, captures, choice=LensChoice())


def test_a_real_pair(data_root: Path, tmp_path: Path) -> None:
    """Taken 13.8 s apart: too far by default."""
    folder = data_root / "phone_tele_wide_exif"
    strict = plan_import(folder, tmp_path / "c", choice=LensChoice())
    assert strict.pairs == ()
    assert ["is 13.8 s away" in one.reason for one in strict.unpaired] == [True, True]
    plan = plan_import(folder, tmp_path / "c", choice=LensChoice(max_seconds=15))
    assert planned(plan) == {"IMG_20_tele": ("IMG_20_tele.jpg", "IMG_20_wide.jpg")}
    assert plan.pairs[0].pair.ratio == 2
