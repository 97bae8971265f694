"""PNG, TIFF, grey maps and EXR, read by readers that know nothing of telewide."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from depth.formats.made_depth import (
    BASELINE_M,
    BOX,
    HW,
    SKY,
    WALL,
    depth_m,
    made_photo,
    made_result,
    turned,
    turned_result,
)
from PIL import Image

from telewide.capture.facts import CaptureFacts
from telewide.depth.export import write_depth
from telewide.depth.formats.depth_png_file import png_from_depth
from telewide.depth.result import FARTHEST_M, depth_result
from telewide.geometry.stereo import DisparityMap
from telewide.srgb import linear_from_srgb


def test_millimetres_by_opencv_and_pillow(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), formats=("mm",))
    by_opencv = cv2.imread(str(tmp_path / "depth_mm.png"), cv2.IMREAD_UNCHANGED)
    by_pillow = np.asarray(Image.open(tmp_path / "depth_mm.png"))
    assert by_opencv.dtype == np.uint16
    np.testing.assert_array_equal(by_opencv, by_pillow)
    np.testing.assert_array_equal(by_opencv == 0, np.isnan(depth_m()))
    known = by_opencv > 0
    np.testing.assert_allclose(by_opencv[known] / 1000, depth_m()[known], atol=0.0005001)


def test_millimetres_never_lose_a_known_value() -> None:
    edges_m = np.array([[1e-5, 0.0014, 65.535, 65.54, np.nan, -1.0, 900.0]], np.float32)
    np.testing.assert_array_equal(png_from_depth(edges_m), [[1, 1, 65535, 0, 0, 0, 0]])


def test_what_lies_too_far_for_millimetres_is_counted(tmp_path: Path) -> None:
    disparity_px = np.full((10, 10), 2.0, np.float32)
    disparity_px[:3] = 0.05
    far = DisparityMap(disparity_px, np.ones((10, 10), np.float32), np.ones((10, 10), np.bool_))
    facts = CaptureFacts(f_px=1000.0, baseline_m=0.012)  # 240 m
    notes = write_depth(tmp_path, depth_result("shot", far, facts=facts), formats=("mm",)).notes
    assert ["30% of depth_mm.png is 0" in note for note in notes] == [True]


def test_a_depth_beyond_what_can_be_told_is_unknown_and_not_measured() -> None:
    disparity_px = np.array([[2.0, 0.0126, 0.0114, 0.00025]], np.float32)
    known = np.ones((1, 4), np.bool_)
    facts = CaptureFacts(f_px=1000.0, baseline_m=0.012)
    result = depth_result("shot", DisparityMap(disparity_px, known.astype(np.float32), known), facts=facts)
    assert result.depth_m is not None
    assert np.nanmax(result.depth_m) <= FARTHEST_M == 1000
    np.testing.assert_array_equal(np.isfinite(result.depth_m), [[True, True, False, False]])  # the last: 48 km
    np.testing.assert_array_equal(result.disparity.valid, np.isfinite(result.depth_m))


def test_tiff_by_tifffile_pillow_and_opencv(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), formats=("tiff",))
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        (page,) = file.pages
        told = json.loads(page.description)
        np.testing.assert_array_equal(page.asarray(), depth_m())
    assert (told["unit"], told["unknown"], told["baseline_m"]) == ("m", "NaN", BASELINE_M)
    with Image.open(tmp_path / "depth.tif") as by_pillow:
        np.testing.assert_array_equal(np.asarray(by_pillow), depth_m())
    by_opencv = cv2.imread(str(tmp_path / "depth.tif"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(by_opencv, depth_m())


def test_exiftool_has_nothing_against_a_tiff_of_depth(tmp_path: Path) -> None:
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed")
    write_depth(tmp_path, made_result(), formats=("tiff",))
    call = ["exiftool", "-validate", "-warning", "-a", "-s3", str(tmp_path / "depth.tif")]
    assert subprocess.run(call, check=True, capture_output=True, text=True).stdout == "OK\n"


def test_tiff_without_metres_holds_disparity_and_says_so(tmp_path: Path) -> None:
    written = write_depth(tmp_path, made_result(has_metres=False), formats=("tiff",))
    assert [path.name for path in written.paths] == ["disparity.tif"]
    assert "holds px" in written.notes[0]
    with tifffile.TiffFile(tmp_path / "disparity.tif") as file:
        assert json.loads(file.pages[0].description)["unit"] == "px"
        np.testing.assert_array_equal(file.pages[0].asarray(), made_result().disparity.disparity_px)


@pytest.mark.parametrize(("name", "white"), [("photo_depth.png", 255), ("photo_depth_16.png", 65535)])
def test_grey_is_white_where_it_is_near(name: str, white: int, tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(has_metres=False), image=made_photo(), formats=("grey",))
    with Image.open(tmp_path / name) as picture:
        grey = np.asarray(picture)
    np.testing.assert_array_equal(grey, cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED))
    assert grey.shape == HW
    assert (grey[BOX] == white).all()
    assert (grey[SKY] == 0).all()
    assert 0 < grey[WALL].mean() < 0.4 * white
    with Image.open(tmp_path / "photo.jpg") as photo:
        assert photo.size == HW[::-1]
        np.testing.assert_allclose(np.asarray(photo) / 255, made_photo(), atol=0.03)


def test_exr_by_openexr(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("exr",))
    with OpenEXR.File(str(tmp_path / "depth.exr")) as file:
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
        header = dict(file.header())
    assert set(pixels) == {"RGB", "Z", "disparity", "confidence"}
    np.testing.assert_array_equal(pixels["Z"], np.where(np.isnan(depth_m()), np.inf, depth_m()))
    np.testing.assert_array_equal(pixels["disparity"], made_result().disparity.disparity_px)
    np.testing.assert_allclose(pixels["RGB"], linear_from_srgb(made_photo()), atol=1e-3)
    assert pixels["RGB"].dtype == np.float16
    measured = made_result().disparity.valid
    np.testing.assert_array_equal(pixels["confidence"], np.where(measured, 0.75, 0))
    np.testing.assert_allclose(header["cameraIntrinsicsPx"], made_result().K)
    assert header["baselineMetres"] == pytest.approx(BASELINE_M)


@pytest.mark.parametrize("rotated_deg", [90, 180, 270])
def test_exr_of_turned_photos_is_that_of_upright_ones(tmp_path: Path, rotated_deg: int) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    write_depth(tmp_path / "upright", made_result(), image=made_photo(), formats=("exr",))
    photo = turned(made_photo(), rotated_deg)
    write_depth(tmp_path / "turned", turned_result(rotated_deg), image=photo, formats=("exr",))
    expected, found = (OpenEXR.File(str(tmp_path / name / "depth.exr")) for name in ("upright", "turned"))
    assert found.channels().keys() == expected.channels().keys()
    for name, channel in expected.channels().items():
        np.testing.assert_allclose(found.channels()[name].pixels, channel.pixels, rtol=1e-6, err_msg=name)
    K, turned_K = (np.asarray(file.header()["cameraIntrinsicsPx"]) for file in (expected, found))
    np.testing.assert_allclose(turned_K, K)


def test_exr_without_metres_has_no_z(tmp_path: Path) -> None:
    OpenEXR = pytest.importorskip("OpenEXR", reason="the extra exr is not installed")
    assert "has no Z" in write_depth(tmp_path, made_result(has_metres=False), formats=("exr",)).notes[0]
    with OpenEXR.File(str(tmp_path / "depth.exr")) as file:
        assert set(file.channels()) == {"disparity", "confidence"}
        assert file.header()["comments"] == "disparity: px"
