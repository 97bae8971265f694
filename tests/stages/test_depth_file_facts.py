"""JPEGs with depth say when and with what the photo was taken, and not where; exiftool has nothing against them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from capture.roll import DATE, EXIF_IFD, MODEL, ORIENTATION, TELE, exif_of, write_photo
from PIL import Image

from telewide.capture.pair import Capture, CaptureFacts
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut
from telewide.stages.capture_depth import DepthOutcome, depth_of_capture

GPS_IFD = 0x8825
JPEGS = ("photo.jpg", "gdepth.jpg", "dynamic_depth.jpg")


def stepped(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
    """Far on the left, near on the right."""
    height, width = ref.shape[:2]
    row = np.where(np.arange(width) < width // 2, 4.0, 12.0).astype(np.float32)
    return DisparityMap(np.tile(row, (height, 1)), np.ones((height, width), np.float32), np.ones((height, width), bool))


@pytest.fixture(params=[1, 6])
def folder(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Files of a photo that was taken upright, and of one that its EXIF turns."""
    exif = exif_of(**TELE, second=3.0, orientation=request.param)
    exif.get_ifd(GPS_IFD).update({1: "N", 2: (52.0, 31.0, 0.0), 3: "E", 4: (13.0, 24.0, 0.0)})
    paths = [write_photo(tmp_path / "one" / f"{view}.jpg", wh=(96, 72), exif=exif) for view in ("tele", "wide")]
    capture = Capture("one", *paths)
    outcome = depth_of_capture(
        capture,
        HeldOut(capture, np.zeros((0, 2)), np.zeros(0)),
        tmp_path / "run",
        facts=CaptureFacts(rectified=True, f_px=90.0, baseline_m=0.01),
        match=stepped,
        window=(0, 32),
        bokeh=None,
        key={},
        formats=("npz", "grey", "gdepth", "dynamic"),
    )
    assert isinstance(outcome, DepthOutcome)
    return tmp_path / "run"


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
