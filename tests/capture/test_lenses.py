"""Which lens took a photo, and tele photos that are pieces of the wide one."""

from __future__ import annotations

from pathlib import Path

import pytest
from capture.roll import TELE, ULTRA, WIDE, exif_of, write_photo

from telewide.capture.exif import PhotoFacts
from telewide.capture.layout import Capture, find_captures
from telewide.capture.lenses import check_lenses, find_lenses, lens_of, why_cropped, with_checked_lenses


def facts(focal: float, f35: float | None, *, model: str = "P", zoom: float | None = None) -> PhotoFacts:
    return PhotoFacts("jpeg", make="M", model=model, focal_length_mm=focal, f35_mm=f35, digital_zoom_ratio=zoom)


def capture(folder: Path, name: str, tele: dict[str, object], wide: dict[str, object]) -> Capture:
    """A capture of two JPEGs with this EXIF."""
    paths = {}
    for view, stated in (("tele", tele), ("wide", wide)):
        exif = exif_of(**stated) if stated else None  # type: ignore[arg-type]
        paths[view] = write_photo(folder / name / f"{view}.jpg", exif=exif)
    return Capture(name, paths["tele"], paths["wide"])


def test_lenses_are_told_by_focal_length_and_sorted_by_view() -> None:
    """The tele of this phone has the shorter physical focal length: its sensor is small."""
    photos = [facts(6.86, 24), facts(6.859, 24), facts(6.0, 77), facts(2.2, 13), facts(4.25, 26, model="Q")]
    lenses = find_lenses(photos)
    assert [(lens.camera, lens.focal_length_mm) for lens in lenses] == [
        ("M P", 2.2),
        ("M P", 6.859),
        ("M P", 6.0),
        ("M Q", 4.25),
    ]
    assert lens_of(photos[0], lenses) == lenses[1]
    assert lens_of(facts(5.0, 40), lenses) is None
    assert lens_of(facts(6.0, 77, model="Q"), lenses) is None
    assert find_lenses([PhotoFacts("jpeg")]) == ()


@pytest.mark.parametrize("f35", [26, 27, 28])
def test_rounding_and_other_shapes_are_no_crop(f35: int) -> None:
    photos = [facts(4.25, 26), facts(4.25, f35)]
    assert why_cropped(photos[1], lens_of(photos[1], find_lenses(photos))) is None


def test_a_crop_is_told_by_the_other_photos_of_its_lens() -> None:
    photos = [facts(4.25, 26), facts(4.25, 63)]
    reason = why_cropped(photos[1], lens_of(photos[1], find_lenses(photos)))
    assert reason == "a digital crop of the 4.25 mm lens: 63 mm equivalent, where other photos of it have 26"
    assert why_cropped(photos[0], lens_of(photos[0], find_lenses(photos))) is None
    assert why_cropped(photos[1], lens_of(photos[1], find_lenses(photos[1:]))) is None  # nothing to compare with


def test_digital_zoom_is_a_crop() -> None:
    reason = why_cropped(facts(6.0, None, zoom=2.0), None)
    assert reason is not None
    assert "DigitalZoomRatio is 2.00" in reason
    assert why_cropped(facts(6.0, None, zoom=1.0), None) is None


def test_two_lenses_raise_no_problem(tmp_path: Path) -> None:
    assert check_lenses([capture(tmp_path, "a", TELE, WIDE), capture(tmp_path, "b", WIDE, ULTRA)]) == ()
    assert check_lenses([capture(tmp_path, "none", {}, {})]) == ()


def test_a_tele_that_is_a_crop_of_wide_is_refused(tmp_path: Path) -> None:
    good, fake = capture(tmp_path, "good", TELE, WIDE), capture(tmp_path, "fake", {"focal": 4.25, "f35": 52}, WIDE)
    (problem,) = check_lenses([good, fake])
    assert (problem.name, problem.is_skipped) == ("fake", True)
    assert str(fake.tele_path) in problem.message
    assert "digital crop of the wide lens: both state 4.25 mm, with 52 and 26 mm equivalent" in problem.message
    assert "so that the phone uses its tele lens" in problem.message


def test_a_set_loses_its_crops_only(tmp_path: Path) -> None:
    capture(tmp_path, "good", TELE, WIDE)
    capture(tmp_path, "fake", {"focal": 4.25, "f35": 52}, WIDE)
    capture(tmp_path, "odd", TELE | {"model": "Phone 2"}, WIDE)
    checked = with_checked_lenses(find_captures(tmp_path))
    assert [one.name for one in checked.captures] == ["good", "odd"]
    assert [(problem.name, problem.is_skipped) for problem in checked.problems] == [("fake", True), ("odd", False)]


def test_a_crop_of_tele_is_refused(tmp_path: Path) -> None:
    good, zoomed = capture(tmp_path, "a", TELE, WIDE), capture(tmp_path, "b", {"focal": 6.0, "f35": 104}, WIDE)
    (problem,) = check_lenses([good, zoomed])
    assert (problem.name, problem.is_skipped) == ("b", True)
    assert "digital crop of the 6 mm lens: 104 mm equivalent, where other photos of it have 52" in problem.message


@pytest.mark.parametrize(
    ("tele", "wide", "told"),
    [
        (WIDE, WIDE, "both state 4.25 mm: are they from two lenses?"),
        (TELE | {"model": "Phone 2"}, WIDE, "different cameras: Maker Phone 2, Maker Phone 1"),
    ],
)
def test_doubts_are_said_only(tmp_path: Path, tele: dict[str, object], wide: dict[str, object], told: str) -> None:
    (problem,) = check_lenses([capture(tmp_path, "a", tele, wide)])
    assert not problem.is_skipped
    assert told in problem.message


def test_a_real_pair_has_two_lenses(data_root: Path) -> None:
    folder = data_root / "phone_tele_wide_exif"
    assert check_lenses([Capture("a", folder / "IMG_20_tele.jpg", folder / "IMG_20_wide.jpg")]) == ()
