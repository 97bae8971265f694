"""Files with depth say when and with what the photo was taken: read by Pillow, libheif, OpenEXR and exiftool."""

from __future__ import annotations

import shutil
import subprocess
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from capture.profiles import DISPLAY_P3, matrix_profile
from capture.roll import DATE, EXIF_IFD, MODEL, ORIENTATION, TELE, exif_of, write_photo
from PIL import Image, ImageCms, ImageOps
from PIL.TiffImagePlugin import IFDRational

from telewide.capture.carried import read_carried
from telewide.capture.pair import Capture, CaptureFacts
from telewide.capture.pictures import PictureFacts, write_picture
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut
from telewide.srgb import linear_from_srgb
from telewide.stages.capture_depth import DepthOutcome, depth_of_capture

GPS_IFD = 0x8825
RED = (230, 40, 30)
JPEGS = ("photo.jpg", "gdepth.jpg", "dynamic_depth.jpg")


def stepped(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
    """Far on the left, near on the right."""
    height, width = ref.shape[:2]
    row = np.where(np.arange(width) < width // 2, 4.0, 12.0).astype(np.float32)
    return DisparityMap(np.tile(row, (height, 1)), np.ones((height, width), np.float32), np.ones((height, width), bool))


def depth_files(
    folder: Path,
    *,
    formats: tuple[str, ...],
    orientation: int = 1,
    is_stripped: bool = False,
    profile: bytes | None = None,
) -> Path:
    """Depth files of a photo, which its EXIF turns; of one colour where it has a profile."""
    exif = exif_of(**TELE, second=3.0, offset="+02:00", distance=Fraction(5, 4), orientation=orientation)
    exif.get_ifd(EXIF_IFD).update({33434: IFDRational(1, 120), 33437: IFDRational(14, 5), 34855: 400})
    exif.get_ifd(GPS_IFD).update({1: "S", 2: (33.0, 30.0, 36.0), 3: "E", 4: (13.0, 24.0, 0.0)})
    paths = [write_photo(folder / "one" / f"{view}.jpg", wh=(96, 72), exif=exif) for view in ("tele", "wide")]
    if profile is not None:
        Image.new("RGB", (96, 72), RED).save(paths[0], icc_profile=profile, quality=100, subsampling=0)
    capture = Capture("one", *paths)
    outcome = depth_of_capture(
        capture,
        HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
        folder / "run",
        facts=CaptureFacts(rectified=True, f_px=90.0, baseline_m=0.01),
        match=stepped,
        window=(0, 32),
        bokeh=None,
        key={"is_stripped": is_stripped},
        formats=formats,
        is_stripped=is_stripped,
    )
    assert isinstance(outcome, DepthOutcome)
    return folder / "run"


@pytest.fixture(params=[1, 6])
def folder(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Files of a photo that was taken upright, and of one that its EXIF turns."""
    return depth_files(tmp_path, formats=("npz", "grey", "gdepth", "dynamic"), orientation=request.param)


def test_they_say_when_and_with_what_and_not_where(folder: Path) -> None:
    for name in JPEGS:
        with Image.open(folder / name) as picture:
            exif = picture.getexif()
            assert (exif[MODEL], exif[ORIENTATION]) == ("Phone 1", 1)
            assert exif.get_ifd(EXIF_IFD)[DATE] == "2026:05:01 12:00:03"
            assert dict(exif.get_ifd(GPS_IFD)) == {}


def test_exiftool_has_nothing_against_them(folder: Path) -> None:
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed")
    for name in JPEGS:
        call = ["exiftool", "-validate", "-warning", "-a", str(folder / name)]
        told = subprocess.run(call, check=True, capture_output=True, text=True).stdout
        assert told.split() == ["Validate", ":", "OK"], (name, told)


@pytest.mark.parametrize("orientation", [1, 6])
def test_heic_says_what_the_photo_said_and_stands_upright(tmp_path: Path, orientation: int) -> None:
    pillow_heif = pytest.importorskip("pillow_heif", reason="the extra heif is not installed")
    run = depth_files(tmp_path, formats=("npz", "heic"), orientation=orientation)
    heic = pillow_heif.open_heif(run / "depth.heic")
    assert heic.size == ((96, 72) if orientation == 1 else (72, 96))
    assert len(heic.info["depth_images"]) == 1
    exif = Image.Exif()
    exif.load(heic.info["exif"])
    assert (exif[MODEL], exif[ORIENTATION]) == ("Phone 1", 1)
    assert exif.get_ifd(EXIF_IFD)[DATE] == "2026:05:01 12:00:03"
    assert exif.get_ifd(GPS_IFD)[2] == (33.0, 30.0, 36.0)
    profile = ImageCms.ImageCmsProfile(BytesIO(heic.info["icc_profile"]))
    assert ImageCms.getProfileName(profile).startswith("sRGB")


def test_stripped_files_say_nothing_of_the_photo(tmp_path: Path) -> None:
    """All that were written before, and then stripped, are written once more."""
    pillow_heif = pytest.importorskip("pillow_heif", reason="the extra heif is not installed")
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    formats = ("npz", "grey", "gdepth", "dynamic", "exr", "heic")
    depth_files(tmp_path, formats=formats)
    run = depth_files(tmp_path, formats=formats, is_stripped=True)
    for name in JPEGS:
        with Image.open(run / name) as picture:
            assert dict(picture.getexif()) == {}
    heic = pillow_heif.open_heif(run / "depth.heic")
    assert not heic.info["exif"]
    assert heic.info["icc_profile"]
    with OpenEXR.File(str(run / "depth.exr")) as file:
        assert not {"capDate", "expTime", "latitude", "cameraModel"} & set(file.header())
    for path in run.iterdir():
        assert b"Phone 1" not in path.read_bytes(), path.name


def test_heic_keeps_the_colours_of_a_wider_profile(tmp_path: Path) -> None:
    """Red as the photo stores it, and its profile; in a JPEG the same red has other numbers, those of sRGB."""
    pillow_heif = pytest.importorskip("pillow_heif", reason="the extra heif is not installed")
    profile = matrix_profile(DISPLAY_P3, 2.2)
    run = depth_files(tmp_path, formats=("npz", "grey", "heic"), profile=profile)
    heic = pillow_heif.open_heif(run / "depth.heic")
    assert heic.info["icc_profile"] == profile
    np.testing.assert_allclose(np.asarray(heic).mean(axis=(0, 1)), RED, atol=4)
    with Image.open(run / "photo.jpg") as picture:
        assert np.asarray(picture).mean(axis=(0, 1))[0] > RED[0] + 8


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_files_for_3d_programs_of_a_photo_that_exif_turns_stand_upright(tmp_path: Path, orientation: int) -> None:
    """What lies right of the middle of the upright photo is near, at positive x, whichever way the sensor was held."""
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    trimesh = pytest.importorskip("trimesh", reason="the extra mesh is not installed")
    run = depth_files(tmp_path, formats=("npz", "exr", "ply", "glb"), orientation=orientation)
    height, width = (72, 96) if orientation == 3 else (96, 72)
    with OpenEXR.File(str(run / "depth.exr")) as file:
        depth_m, shown = (np.array(file.channels()[name].pixels) for name in ("Z", "RGB"))
    with Image.open(tmp_path / "one" / "tele.jpg") as photo:
        upright = linear_from_srgb(np.asarray(ImageOps.exif_transpose(photo)).astype(np.float32) / 255)
    np.testing.assert_allclose(shown, upright, atol=0.01)
    assert depth_m.shape == (height, width)
    near_m, far_m = depth_m[:, -1].max(), depth_m[:, 0].min()
    assert near_m < 0.5 * far_m
    (mesh,) = trimesh.load(run / "mesh.glb").geometry.values()
    assert mesh.visual.material.baseColorTexture.size == (width, height)
    for at_m in (np.asarray(trimesh.load(run / "points.ply").vertices), np.asarray(mesh.vertices) * [1, -1, -1]):
        is_near = np.isclose(at_m[:, 2], near_m, rtol=1e-4)
        assert at_m[is_near, 0].min() > -0.02 * near_m
        assert at_m[~is_near, 0].max() < 0.02 * far_m
        assert np.ptp(at_m[~is_near, 1]) / far_m == pytest.approx((height - 1) / 90, rel=0.02)


@pytest.mark.parametrize("name", ["bokeh", "depth"])
def test_exr_states_what_its_standard_attributes_are_for(tmp_path: Path, name: str) -> None:
    """Names, units and signs of ImfStandardAttributes.h: UTC is local time plus the offset, south is negative."""
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    run = depth_files(tmp_path, formats=("npz", "exr"))
    if name == "bokeh":
        facts = PictureFacts("telewide 9", done="blurred", of_photo=read_carried(tmp_path / "one" / "tele.jpg"))
        write_picture(run / "bokeh.exr", np.zeros((4, 6, 3), np.float32), facts=facts)
    with OpenEXR.File(str(run / f"{name}.exr")) as file:
        header = dict(file.header())
    expected = {"expTime": 1 / 120, "aperture": 2.8, "isoSpeed": 400, "nominalFocalLength": 6, "focus": 1.25}
    expected |= {"utcOffset": -7200, "latitude": -33.51, "longitude": 13.4}
    for attribute, value in expected.items():
        assert header[attribute] == pytest.approx(value, rel=1e-6), attribute
    assert header["capDate"] == "2026:05:01 12:00:03"
    assert (header["cameraMake"], header["cameraModel"]) == ("Maker", "Phone 1")
    assert not {"owner", "lensModel", "altitude"} & set(header), "of which the photo says nothing"
    assert ("blurred" if name == "bokeh" else "Z: m") in header["comments"]
