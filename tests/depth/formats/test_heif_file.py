"""HEIC with a depth image, read by libheif through pillow-heif, and by exiftool."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth.formats.made_depth import BOX, HW, SKY, WALL, depth_m, made_photo, made_result
from PIL import Image

from telewide.depth.export import write_depth
from telewide.depth.formats.heif_file import DEPTH_URN, _encoded, heic_with_depth

pillow_heif = pytest.importorskip("pillow_heif", reason="the extra heif is not installed")


def opened(path: Path) -> tuple[np.ndarray, np.ndarray, Any]:
    """Photo, depth image, and the depth image's facts."""
    heic = pillow_heif.open_heif(path)
    (depth,) = heic.info["depth_images"]
    return np.asarray(heic), np.asarray(depth), depth.info


@pytest.mark.parametrize("has_metres", [True, False])
def test_libheif_finds_the_photo_and_its_depth(tmp_path: Path, has_metres: bool) -> None:
    write_depth(tmp_path, made_result(has_metres=has_metres), image=made_photo(), formats=("heic",))
    photo, grey, _ = opened(tmp_path / "depth.heic")
    assert photo.shape == (*HW, 3)
    np.testing.assert_allclose(photo / 255, made_photo(), atol=0.06)
    assert grey.shape == HW
    assert grey[BOX].min() > 250
    assert grey[WALL].mean() < 110
    assert grey[SKY].max() < grey[BOX].min()


def test_values_are_disparities_between_the_stated_ends(tmp_path: Path) -> None:
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("heic",))
    stated = dict(re.findall(rb'apdi:(\w+)="([^"]+)"', (tmp_path / "depth.heic").read_bytes()))
    low, high = float(stated[b"FloatMinValue"]), float(stated[b"FloatMaxValue"])
    _, grey, _ = opened(tmp_path / "depth.heic")
    known = np.isfinite(depth_m())
    seen = low + grey[known] / 255 * (high - low)
    np.testing.assert_allclose(seen, 1 / depth_m()[known], atol=2.5 / 255 * (high - low))


def test_the_photo_is_bit_by_bit_what_was_encoded(tmp_path: Path) -> None:
    levels = (made_photo() * 255).astype(np.uint8)
    photo, depth = _encoded(levels, quality=90), _encoded(levels[..., 0], quality=100)
    joined = pillow_heif.open_heif(io.BytesIO(heic_with_depth(photo, depth, xmp=b"<x/>")))
    np.testing.assert_array_equal(np.asarray(joined), np.asarray(pillow_heif.open_heif(io.BytesIO(photo))))
    (beside,) = joined.info["depth_images"]
    alone = np.asarray(pillow_heif.open_heif(io.BytesIO(depth)))
    np.testing.assert_array_equal(np.asarray(beside), alone)


def test_more_than_one_picture_is_refused() -> None:
    stream = io.BytesIO()
    two = pillow_heif.HeifFile()
    for _ in range(2):
        two.add_frombytes("L", (64, 64), bytes(64 * 64))
    two.save(stream)
    with pytest.raises(ValueError, match="2 items"):
        heic_with_depth(stream.getvalue(), stream.getvalue(), xmp=b"")


def test_by_pillow_and_exiftool(tmp_path: Path) -> None:
    pillow_heif.register_heif_opener()
    write_depth(tmp_path, made_result(), image=made_photo(), formats=("heic",))
    with Image.open(tmp_path / "depth.heic") as photo:
        assert photo.size == HW[::-1]
        photo.load()
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed")
    call = ["exiftool", "-a", "-ee", "-G1", "-s"]
    told = subprocess.run([*call, str(tmp_path / "depth.heic")], check=True, capture_output=True, text=True).stdout
    assert re.search(rf"AuxiliaryImageType\s+: {DEPTH_URN}", told), told
    assert re.search(r"FloatMaxValue\s+: 1\.25", told), told
    call = ["exiftool", "-validate", "-warning", "-a"]
    told = subprocess.run([*call, str(tmp_path / "depth.heic")], check=True, capture_output=True, text=True).stdout
    assert told.split() == ["Validate", ":", "OK"]
