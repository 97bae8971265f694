"""What photos state: written by Pillow and tifffile, read back; and real phone photos."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta, timezone
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from capture.dng import write_dng
from capture.roll import EXIF_IFD, SUBSECOND, ULTRA, WIDE, exif_of, write_photo
from PIL import Image

from telewide.capture.exif import (
    PhotoFacts,
    image_pipeline,
    least_seconds_between,
    pipeline_conflict,
    read_photo_facts,
    seconds_between,
)
from telewide.capture.images import focal_length_mm, read_image
from telewide.errors import InputError, UsageError

FLAT = np.full((40, 60), 0.5, np.float32)


def test_everything_a_jpeg_states(tmp_path: Path) -> None:
    exif = exif_of(**WIDE, second=1.25, offset="+02:00", zoom=2.0, distance=Fraction(3, 4), orientation=6)
    facts = read_photo_facts(write_photo(tmp_path / "a.jpg", exif=exif))
    assert facts == PhotoFacts(
        kind="jpeg",
        hw=(48, 36),
        make="Maker",
        model="Phone 1",
        focal_length_mm=4.25,
        f35_mm=26,
        taken=datetime(2026, 5, 1, 12, 0, 1, 250_000, tzinfo=timezone(timedelta(hours=2))),
        taken_step_s=0.001,
        orientation=6,
        digital_zoom_ratio=2,
        subject_distance_m=0.75,
    )
    assert facts.crop_35 == pytest.approx(26 / 4.25)


def test_a_photo_without_exif_states_its_size(tmp_path: Path) -> None:
    assert read_photo_facts(write_photo(tmp_path / "a.jpg")) == PhotoFacts("jpeg", (36, 48))
    assert read_photo_facts(write_photo(tmp_path / "a.png")) == PhotoFacts("png", (36, 48))
    assert read_photo_facts(write_photo(tmp_path / "a.tif")) == PhotoFacts("tiff", (36, 48))


def test_numbers_that_are_no_numbers_are_not_stated(tmp_path: Path) -> None:
    exif = exif_of(focal=0.0, f35=0, zoom=0.0)
    facts = read_photo_facts(write_photo(tmp_path / "a.jpg", exif=exif))
    assert (facts.focal_length_mm, facts.f35_mm, facts.crop_35) == (None, None, None)
    assert facts.digital_zoom_ratio == 1  # 0 is how EXIF says that there was none
    assert focal_length_mm(tmp_path / "a.jpg") is None


@pytest.mark.parametrize("stated", [Fraction(0xFFFFFFFF, 1)])
def test_focus_at_infinity(tmp_path: Path, stated: Fraction) -> None:
    facts = read_photo_facts(write_photo(tmp_path / "a.jpg", exif=exif_of(distance=stated)))
    assert facts.subject_distance_m == math.inf


@pytest.mark.parametrize("orientation", range(1, 9))
def test_sizes_are_upright(tmp_path: Path, orientation: int) -> None:
    path = write_photo(tmp_path / "a.jpg", wh=(48, 36), exif=exif_of(orientation=orientation))
    assert read_photo_facts(path).hw == ((36, 48) if orientation <= 4 else (48, 36))


def test_a_dng_states_the_same(tmp_path: Path) -> None:
    path = write_dng(
        tmp_path / "a.dng",
        FLAT,
        orientation=6,
        crop=(2, 4, 30, 50),
        texts={271: "Maker", 272: "Phone 1", 36867: "2026:05:01 12:00:01", 37521: "25"},
        rationals={37386: (425, 100), 37382: (3, 4)},
    )
    facts = read_photo_facts(path)
    assert (facts.kind, facts.hw, facts.camera) == ("raw", (50, 30), "Maker Phone 1")
    assert (facts.focal_length_mm, facts.subject_distance_m) == (4.25, 0.75)
    assert facts.taken == datetime(2026, 5, 1, 12, 0, 1, 250_000)


@pytest.mark.parametrize("n_bytes", [40, 60, 100, 200, 500])
def test_a_cut_photo_states_nothing_or_less(tmp_path: Path, n_bytes: int) -> None:
    photo = write_photo(tmp_path / "a.jpg", exif=exif_of(**WIDE, second=1)).read_bytes()
    dng = write_dng(tmp_path / "a.dng", FLAT).read_bytes()
    (tmp_path / "a.jpg").write_bytes(photo[:n_bytes])
    (tmp_path / "a.dng").write_bytes(dng[:n_bytes])
    assert read_photo_facts(tmp_path / "a.jpg").kind == "jpeg"
    assert read_photo_facts(tmp_path / "a.dng").kind == "raw"


def test_files_that_are_no_photos(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        read_photo_facts(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_text("no photo, but a long enough text")
    with pytest.raises(InputError, match="no photo that can be read"):
        read_photo_facts(tmp_path / "a.jpg")
    assert focal_length_mm(tmp_path / "a.jpg") is None


def test_seconds_count_time_zones_where_both_have_one() -> None:
    noon = datetime(2026, 5, 1, 12)
    east = noon.replace(tzinfo=timezone(timedelta(hours=2)))
    assert seconds_between(east, noon.replace(tzinfo=UTC)) == 7200
    assert seconds_between(east, noon) == 0
    assert seconds_between(noon, noon + timedelta(milliseconds=1500)) == 1.5


@pytest.mark.parametrize(
    ("seconds", "has_fractions", "least_s"),
    [
        ((1.0, 2.0), (False, False), 0.0),  # 1.99 and 2.00 are possible
        ((1.0, 2.0), (True, False), 0.0),
        ((3.0, 1.0), (False, False), 1.0),
        ((1.0, 2.0), (True, True), 0.999),
        ((1.25, 1.25), (True, True), 0.0),
    ],
)
def test_whole_seconds_may_differ_for_photos_taken_at_once(
    tmp_path: Path, seconds: tuple[float, float], has_fractions: tuple[bool, bool], least_s: float
) -> None:
    photos = []
    for number, (second, has_fraction) in enumerate(zip(seconds, has_fractions, strict=True)):
        exif = exif_of(**WIDE, second=second)
        if not has_fraction:
            del exif.get_ifd(EXIF_IFD)[SUBSECOND]
        photos.append(read_photo_facts(write_photo(tmp_path / f"{number}.jpg", exif=exif)))
    assert least_seconds_between(*photos) == pytest.approx(least_s)
    assert least_seconds_between(photos[0], PhotoFacts("jpeg")) is None


@pytest.mark.parametrize(
    ("make", "model", "camera"),
    [
        ("Apple", "iPhone 11 Pro", "Apple iPhone 11 Pro"),
        ("HUAWEI", "HUAWEI P30", "HUAWEI P30"),
        ("Maker", None, "Maker"),
        (None, "P1", "P1"),
        (None, None, "unknown"),
    ],
)
def test_a_camera_is_named_once(make: str | None, model: str | None, camera: str) -> None:
    assert PhotoFacts("jpeg", make=make, model=model).camera == camera


def test_pipelines_of_files(tmp_path: Path) -> None:
    jpeg = write_photo(tmp_path / "a.jpg", exif=exif_of(**ULTRA))
    raw = write_dng(tmp_path / "a.dng", FLAT, texts={271: "Maker", 272: "Phone 1"})
    assert image_pipeline(jpeg) == "jpeg:Maker Phone 1"
    assert image_pipeline(raw) == "raw:Maker Phone 1"
    assert image_pipeline(write_photo(tmp_path / "a.png")) == "png:unknown"


@pytest.mark.parametrize(
    ("calibrated", "found", "told"),
    [
        ("jpeg:A B", "jpeg:A B", None),
        ("jpeg:A B", "png:unknown", None),
        ("jpeg:unknown", "jpeg:A B", None),
        ("jpeg:A B", "raw:A B", "made from JPEG, .* this photo is RAW"),
        ("raw:A B", "jpeg:A B", "made from RAW, this photo is JPEG"),
        ("raw:A B", "raw:A C", "calibration is of a A B, this photo of a A C"),
    ],
)
def test_a_calibration_holds_for_its_own_pipeline(calibrated: str, found: str, told: str | None) -> None:
    conflict = pipeline_conflict(calibrated, found)
    if told is None:
        assert conflict is None
    else:
        assert conflict is not None
        assert re.search(told, conflict)


def test_16_bit_tiff_states_its_size(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((20, 30), np.uint16)).save(tmp_path / "a.tif")
    assert read_photo_facts(tmp_path / "a.tif").hw == (20, 30)


def test_a_real_phone(data_root: Path) -> None:
    folder = data_root / "phone_tele_wide_exif"
    tele, wide = read_photo_facts(folder / "IMG_20_tele.jpg"), read_photo_facts(folder / "IMG_20_wide.jpg")
    assert (tele.focal_length_mm, tele.f35_mm, wide.focal_length_mm, wide.f35_mm) == (6.0, 52, 4.25, 26)
    assert tele.camera == wide.camera == "Apple iPhone 11 Pro"
    assert tele.orientation == wide.orientation == 3
    assert tele.hw == wide.hw == (3024, 4032)
    assert tele.taken is not None
    assert wide.taken is not None
    assert seconds_between(tele.taken, wide.taken) == pytest.approx(13.787, abs=1e-3)


def test_real_raw(data_root: Path) -> None:
    assert image_pipeline(data_root / "raw" / "Blackmagic.dng") == "raw:Blackmagic Pocket Cinema Camera 4K"
    facts = read_photo_facts(data_root / "raw" / "RAW_KODAK_DC50.KDC")
    assert (facts.focal_length_mm, facts.subject_distance_m) == (37, 8.2)
    assert facts.taken == datetime(1997, 4, 23, 8, 0, 47)


@pytest.mark.parametrize("place", ["before the pixels", "behind the pixels"])
def test_exif_of_a_png_is_found_without_decoding_it(tmp_path: Path, place: str) -> None:
    """As exiftool and others write it; the pixels are corrupt, so that whoever decodes them finds nothing."""
    exif = Image.Exif()
    exif[271], exif[274] = "Maker", 6
    Image.new("RGB", (64, 48)).save(tmp_path / "a.png", exif=exif)
    data = (tmp_path / "a.png").read_bytes()
    at = data.index(b"eXIf") - 4
    chunk = data[at : at + 12 + int.from_bytes(data[at : at + 4], "big")]
    rest = data.replace(chunk, b"")
    split = 33 if place == "before the pixels" else len(rest) - 12
    content = rest[:split] + chunk + rest[split:]
    pixels = content.index(b"IDAT")
    (tmp_path / "a.png").write_bytes(content[: pixels + 6] + b"corrupt!" + content[pixels + 14 :])
    facts = read_photo_facts(tmp_path / "a.png")
    assert (facts.make, facts.orientation, facts.hw) == ("Maker", 6, (64, 48))


def test_a_text_of_exif_is_one_short_line(tmp_path: Path) -> None:
    """It stands in messages and tables, where a second line could say anything."""
    exif = Image.Exif()
    exif[271], exif[272] = "Maker\nerror: all is lost\t!", "x" * 60_000
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg", exif=exif)
    facts = read_photo_facts(tmp_path / "a.jpg")
    assert facts.make == "Maker error: all is lost !"
    assert facts.model == "x" * 100


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("area", [(45, 8), (45, 8, 6), (45, 8, 10, 6)])
def test_the_place_that_was_focused_on_is_that_of_the_upright_photo(
    tmp_path: Path, orientation: int, area: tuple[int, ...]
) -> None:
    levels = np.zeros((40, 60, 3), np.uint8)
    levels[6:11, 43:48] = 255
    exif = Image.Exif()
    exif[274], exif[34665] = orientation, {37396: area, 40962: 60, 40963: 40}
    Image.fromarray(levels).save(tmp_path / "a.png", exif=exif)
    bright_y, bright_x = (at.mean() for at in np.nonzero(read_image(tmp_path / "a.png")[..., 0] > 0.5))
    facts = read_photo_facts(tmp_path / "a.png")
    assert facts.subject_uv is not None
    assert facts.hw is not None
    assert facts.subject_uv[0] * facts.hw[1] - 0.5 == pytest.approx(bright_x)
    assert facts.subject_uv[1] * facts.hw[0] - 0.5 == pytest.approx(bright_y)


@pytest.mark.parametrize("tags", [{}, {37396: (70, 8)}, {37396: (20, 8), 40962: 40, 40963: 60}, {37396: (1,) * 9}])
def test_a_place_outside_the_photo_or_of_another_one_is_not_stated(tmp_path: Path, tags: dict[int, object]) -> None:
    exif = Image.Exif()
    exif[34665] = tags
    Image.new("RGB", (60, 40)).save(tmp_path / "a.jpg", exif=exif)
    assert read_photo_facts(tmp_path / "a.jpg").subject_uv is None
