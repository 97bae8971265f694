"""Pictures to keep, with what their photo said of itself: exiftool, Pillow, OpenCV and tifffile read them."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from capture.dng import write_dng
from capture.profiles import DISPLAY_P3, matrix_profile
from PIL import Image, ImageCms
from PIL.TiffImagePlugin import IFDRational

from telewide.capture.carried import CarriedFacts, read_carried
from telewide.capture.colour_profiles import srgb_profile
from telewide.capture.exr_attributes import exr_attributes
from telewide.capture.pictures import PictureFacts, write_picture
from telewide.errors import UsageError

needs_exiftool = pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
PROFILE = matrix_profile(DISPLAY_P3, 2.2)
XMP = b"""<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmlns:tiff="http://ns.adobe.com/tiff/1.0/"
 xmlns:xmpNote="http://ns.adobe.com/xmp/note/" xmlns:GDepth="http://ns.google.com/photos/1.0/depthmap/"
 xmlns:GCamera="http://ns.google.com/photos/1.0/camera/" xmlns:dc="http://purl.org/dc/elements/1.1/"
 xmp:Rating="4" tiff:Orientation="6" GCamera:MotionPhoto="1" GDepth:Near="0.5"
 xmpNote:HasExtendedXMP="0123456789ABCDEF0123456789ABCDEF">
<dc:creator><rdf:Seq><rdf:li>Ada L&#246;we</rdf:li></rdf:Seq></dc:creator>
</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end="w"?>"""


@pytest.fixture
def image(rng: np.random.Generator) -> np.ndarray:
    return cv2.GaussianBlur(rng.random((60, 40, 3)).astype(np.float32), (0, 0), 2)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    """A phone's photo, held upright."""
    exif = Image.Exif()
    exif[271], exif[272], exif[274] = "Maker", "Phone 8", 6
    exif[34665] = {
        33434: IFDRational(1, 120),
        36867: "2026:05:04 10:11:12",
        37377: IFDRational(69, 10),
        37380: IFDRational(-1, 3),
        37500: b"Apple iOS\0" + bytes(40),  # MakerNote
        37396: (2000, 1500, 300, 200),  # SubjectArea, in stored pixels
        41729: b"\1",  # SceneType: photographed
        42034: (IFDRational(6), IFDRational(6), IFDRational(14, 5), IFDRational(14, 5)),
        42036: "Phone 8 back dual camera 6mm f/2.8",
    }
    exif[34853] = {1: "N", 2: (IFDRational(48), IFDRational(8), IFDRational(30)), 3: "E", 4: (IFDRational(11), 34, 0)}
    path = tmp_path / "tele.jpg"
    Image.new("RGB", (60, 40), (200, 30, 60)).save(path, exif=exif, xmp=XMP, icc_profile=PROFILE)
    return path


def told_by_exiftool(path: Path, *options: str) -> dict[str, object]:
    command = ["exiftool", "-json", "-G0", "-n", *options, str(path)]
    (told,) = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    return told


@needs_exiftool
def test_a_jpeg_says_what_its_photo_said_and_stands_upright(tmp_path: Path, photo: Path, image: np.ndarray) -> None:
    facts = PictureFacts(software="telewide 9", done="focused on x 3, y 4", of_photo=read_carried(photo))
    write_picture(tmp_path / "bokeh.jpg", image, facts=facts)
    told, of_photo = told_by_exiftool(tmp_path / "bokeh.jpg"), told_by_exiftool(photo)
    kept = ("Make", "Model", "DateTimeOriginal", "ExposureTime", "SceneType", "LensModel", "LensInfo", "GPSLatitude")
    kept += ("ShutterSpeedValue", "ExposureCompensation")
    for name in (f"EXIF:{name}" for name in (*kept, "GPSLongitude")):
        assert told[name] == of_photo[name], name
    assert told["XMP:Creator"] == "Ada Löwe"
    assert told["XMP:Rating"] == 4
    assert told["EXIF:Orientation"] == 1
    assert (told["EXIF:ExifImageWidth"], told["EXIF:ExifImageHeight"]) == (40, 60)
    assert told["EXIF:Software"] == told["XMP:HistorySoftwareAgent"] == "telewide 9"
    assert told["XMP:HistoryParameters"] == "focused on x 3, y 4"
    false_of_it = ("MakerNotes:", "EXIF:SubjectArea", "XMP:Orientation", "XMP:MotionPhoto", "XMP:GDepth", "XMP:HasExt")
    assert [name for name in told if name.startswith(false_of_it)] == []
    assert of_photo["XMP:MotionPhoto"] == 1
    assert told_by_exiftool(tmp_path / "bokeh.jpg", "-validate")["ExifTool:Validate"] == "0 0 0"
    assert told["File:YCbCrSubSampling"] == "1 1"
    with Image.open(tmp_path / "bokeh.jpg") as read:
        assert read.info["icc_profile"] == PROFILE
        np.testing.assert_allclose(np.asarray(read) / 255, image, atol=0.03)


@needs_exiftool
@pytest.mark.data
def test_facts_of_a_real_phone_are_carried_without_a_warning(
    tmp_path: Path, data_root: Path, image: np.ndarray
) -> None:
    photos = sorted((data_root / "phone_tele_wide_exif").glob("*.jpg"))
    if not photos:
        pytest.skip("no photos of a phone")
    for photo in photos:
        write_picture(tmp_path / "bokeh.jpg", image, facts=PictureFacts("telewide 9", of_photo=read_carried(photo)))
        told, of_photo = told_by_exiftool(tmp_path / "bokeh.jpg"), told_by_exiftool(photo)
        for name in ("Model", "FNumber", "BrightnessValue", "GPSLatitude", "LensModel", "SubSecTimeOriginal"):
            assert told.get(f"EXIF:{name}") == of_photo.get(f"EXIF:{name}"), name
        assert "EXIF:GPSLatitude" in told
        assert told_by_exiftool(tmp_path / "bokeh.jpg", "-validate")["ExifTool:Validate"] == "0 0 0"


@needs_exiftool
def test_a_stripped_picture_says_nothing_but_its_colours(tmp_path: Path, photo: Path, image: np.ndarray) -> None:
    facts = PictureFacts(software="telewide 9", of_photo=read_carried(photo), is_stripped=True)
    for name in ("bokeh.jpg", "bokeh.tif"):
        write_picture(tmp_path / name, image, facts=facts)
        told = told_by_exiftool(tmp_path / name)
        assert [key for key in told if key.startswith(("XMP", "MakerNotes")) or "GPS" in key or "Date" in key] == [
            key for key in told if key.startswith("File:File") and "Date" in key
        ] + [key for key in told if key.startswith("ICC_Profile:") and "Date" in key]
        assert not {"EXIF:Make", "EXIF:Model", "EXIF:Software", "EXIF:LensModel"} & set(told)
        with Image.open(tmp_path / name) as read:
            assert read.info["icc_profile"] == PROFILE
            assert not {34665, 34853} & set(read.getexif())
        assert told_by_exiftool(tmp_path / name, "-validate")["ExifTool:Validate"] == "0 0 0"
    with Image.open(tmp_path / "bokeh.jpg") as read:
        assert not read.getexif()


def test_a_tiff_has_sixteen_bits(tmp_path: Path, photo: Path, image: np.ndarray) -> None:
    facts = PictureFacts(software="telewide 9", done="blurred", of_photo=read_carried(photo))
    write_picture(tmp_path / "bokeh.tif", image, facts=facts)
    by_opencv = cv2.imread(str(tmp_path / "bokeh.tif"), cv2.IMREAD_UNCHANGED)
    assert by_opencv.dtype == np.uint16
    np.testing.assert_allclose(by_opencv[..., ::-1] / 65535, image, atol=0.51 / 65535)
    with tifffile.TiffFile(tmp_path / "bokeh.tif") as read:
        tags = read.pages[0].tags
        assert (tags[271].value, tags[305].value, tags[34675].value) == ("Maker", "telewide 9", PROFILE)
        assert b"blurred" in tags[700].value


def test_a_tiff_has_the_exif_of_its_photo_by_pillow_and_tifffile(tmp_path: Path, photo: Path) -> None:
    """Of a picture with an odd number of bytes behind its tags, too."""
    for height in (3, 4):
        facts = PictureFacts(software="telewide 9", of_photo=read_carried(photo))
        write_picture(tmp_path / "bokeh.tif", np.full((height, 5, 3), 0.25, np.float32), facts=facts)
        with Image.open(photo) as picture:
            stated = picture.getexif()
            exif_stated, gps_stated = stated.get_ifd(34665), stated.get_ifd(34853)
        with tifffile.TiffFile(tmp_path / "bokeh.tif") as by_tifffile:
            (page,) = by_tifffile.pages
            assert [tag.code for tag in page.tags] == sorted(tag.code for tag in page.tags)
            assert page.tags[274].value == 1
            assert page.tags[34665].value["LensModel"] == exif_stated[42036]
            assert (page.asarray() == 16384).all()
        exif = Image.Exif()
        with (tmp_path / "bokeh.tif").open("rb") as stream:
            exif.load_from_fp(stream)
            told, gps_told = exif.get_ifd(34665), exif.get_ifd(34853)
        kept = set(exif_stated) - {37500, 37396}
        assert {tag: told[tag] for tag in kept} == {tag: exif_stated[tag] for tag in kept}
        assert {tag: gps_told[tag] for tag in gps_stated} == dict(gps_stated)
        assert (exif[271], exif[305]) == ("Maker", "telewide 9")


@needs_exiftool
@pytest.mark.parametrize("states_method", [False, True])
def test_exiftool_has_nothing_against_a_tiff(
    tmp_path: Path, photo: Path, image: np.ndarray, *, states_method: bool
) -> None:
    """It asks a TIFF how its place was found: what the photo does not say of that is not made up."""
    facts = PictureFacts(software="telewide 9", done="blurred", of_photo=read_carried(photo))
    if states_method:
        gps = {**facts.of_photo.gps, 27: b"ASCII\0\0\0GPS"}
        facts = replace(facts, of_photo=replace(facts.of_photo, gps=gps))
    write_picture(tmp_path / "bokeh.tif", image, facts=facts)
    told, of_photo = told_by_exiftool(tmp_path / "bokeh.tif"), told_by_exiftool(photo)
    kept = ("Make", "DateTimeOriginal", "ExposureTime", "SceneType", "LensModel", "LensInfo", "GPSLatitude")
    for name in (f"EXIF:{name}" for name in (*kept, "GPSLongitude", "ShutterSpeedValue", "ExposureCompensation")):
        assert told[name] == of_photo[name], name
    assert told["EXIF:Orientation"] == 1
    warnings = told_by_exiftool(tmp_path / "bokeh.tif", "-validate", "-warning", "-a").get("ExifTool:Warning")
    assert warnings == (None if states_method else "Missing required TIFF GPS tag 0x001b GPSProcessingMethod")


@pytest.mark.parametrize("name", ["bokeh.jpg", "bokeh.tif"])
@pytest.mark.parametrize("is_stripped", [False, True])
def test_a_picture_of_a_photo_without_a_profile_says_that_it_is_srgb(
    tmp_path: Path, image: np.ndarray, name: str, *, is_stripped: bool
) -> None:
    """Little CMS reads the profile and changes no colour by it."""
    Image.new("RGB", (8, 8)).save(tmp_path / "tele.jpg")
    facts = PictureFacts("telewide 9", of_photo=read_carried(tmp_path / "tele.jpg"), is_stripped=is_stripped)
    write_picture(tmp_path / name, image, facts=facts)
    with Image.open(tmp_path / name) as read:
        profile = ImageCms.ImageCmsProfile(BytesIO(read.info["icc_profile"]))
    colours = Image.fromarray((image * 255).astype(np.uint8))
    seen = ImageCms.profileToProfile(colours, profile, ImageCms.createProfile("sRGB"))
    assert seen is not None
    np.testing.assert_allclose(np.asarray(seen, dtype=int), np.asarray(colours, dtype=int), atol=1)


def test_the_profile_of_srgb_is_the_same_at_any_time() -> None:
    """Of all its bytes, those that a second changes are set: Little CMS dates what it makes."""
    first = srgb_profile()
    srgb_profile.cache_clear()
    time.sleep(1.1)
    assert srgb_profile() == first
    assert len(first) == int.from_bytes(first[:4], "big")
    dated = ImageCms.ImageCmsProfile(BytesIO(first)).profile.creation_date
    assert dated is not None
    assert dated.year == 1999


@pytest.mark.parametrize(("space", "has_profile"), [(None, True), (1, True), (2, False), (65535, False)])
def test_what_says_that_it_is_not_srgb_is_not_called_so(
    tmp_path: Path, image: np.ndarray, space: int | None, *, has_profile: bool
) -> None:
    exif = Image.Exif()
    exif[34665] = {} if space is None else {40961: space}
    Image.new("RGB", (8, 8)).save(tmp_path / "tele.jpg", exif=exif)
    write_picture(tmp_path / "bokeh.jpg", image, facts=PictureFacts(of_photo=read_carried(tmp_path / "tele.jpg")))
    with Image.open(tmp_path / "bokeh.jpg") as read:
        assert ("icc_profile" in read.info) == has_profile


@pytest.mark.parametrize(
    ("exif", "gps"),
    [
        ({33434: 0, 33437: "f/2", 34855: 65535, 36867: "0000:00:00 00:00:00", 37382: IFDRational(0xFFFFFFFF)}, {}),
        ({33434: IFDRational(1, 0), 36867: "2026:05:04 10:11", 36881: "+0200", 37386: (6, 7)}, {1: "N", 2: (91, 0, 0)}),
        ({36867: 7, 34855: (), 42036: "a\nb"}, {1: "N", 2: (48, 8, 0)}),
        ({42036: b"Phone"}, {1: "X", 2: (4, 8, 0), 3: "E", 4: (1, 2, 3)}),
    ],
)
def test_what_a_damaged_photo_states_is_no_attribute(exif: dict[int, object], gps: dict[int, object]) -> None:
    told = exr_attributes(CarriedFacts({}, exif, gps), done="")
    assert told in ({}, {"nominalFocalLength": 6.0})


def test_facts_of_a_raw_are_carried_too(tmp_path: Path) -> None:
    write_dng(tmp_path / "tele.dng", np.full((32, 48), 0.4, np.float32))
    with tifffile.TiffFile(tmp_path / "tele.dng") as dng:
        stated = {tag: dng.pages[0].tags[tag].value for tag in (271, 272) if tag in dng.pages[0].tags}
    carried = read_carried(tmp_path / "tele.dng")
    assert {tag: carried.lasting.get(tag) for tag in stated} == stated
    assert carried.profile is None


@pytest.mark.parametrize(
    "xmp",
    [
        b"<!DOCTYPE x [<!ENTITY a 'b'>]><x:xmpmeta xmlns:x='adobe:ns:meta/'>&a;</x:xmpmeta>",
        b"<x:xmpmeta",
        bytes(range(256)),
    ],
)
def test_what_is_no_packet_is_not_carried(tmp_path: Path, image: np.ndarray, xmp: bytes) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "tele.jpg", xmp=xmp, exif=b"Exif\0\0MM\0*\0\0\0\x08\xff\xff" + xmp)
    facts = PictureFacts(software="telewide 9", done="a < b", of_photo=read_carried(tmp_path / "tele.jpg"))
    write_picture(tmp_path / "bokeh.jpg", image, facts=facts)
    with Image.open(tmp_path / "bokeh.jpg") as read:
        assert b"a &lt; b" in read.info["xmp"]
        assert read.getexif()[305] == "telewide 9"


def test_another_kind_of_file_is_refused(tmp_path: Path, image: np.ndarray) -> None:
    with pytest.raises(UsageError, match=r"\.jpg, \.tif or \.exr"):
        write_picture(tmp_path / "bokeh.png", image, facts=PictureFacts())
    assert list(tmp_path.iterdir()) == []
