"""Reading pairs: one size for both views, refusals with both sizes, and memory that stays within its budget."""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from telewide.capture.images import read_image, resize_bicubic, write_image
from telewide.capture.pair import Capture, CaptureFacts, PairReader, find_captures, read_pair, read_truth
from telewide.capture.pfm import write_pfm
from telewide.errors import InputError, UsageError


def noise(hw: tuple[int, int], seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random((*hw, 3), np.float32)


def capture_of(folder: Path, tele: NDArray[np.float32], wide: NDArray[np.float32], name: str = "A") -> Capture:
    write_image(folder / name / "tele.png", tele)
    write_image(folder / name / "wide.png", wide)
    return Capture(name, folder / name / "tele.png", folder / name / "wide.png")


def test_equal_sizes_are_read_as_they_are(tmp_path: Path) -> None:
    capture = capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1))
    pair = read_pair(capture)
    np.testing.assert_array_equal(pair.tele, read_image(capture.tele_path))
    np.testing.assert_array_equal(pair.wide, read_image(capture.wide_path))
    assert pair.name == "A"


@pytest.mark.parametrize("factor", [1.3, 2.0, 2.97, 3.0])
@pytest.mark.parametrize("rounding", [np.floor, np.ceil, np.rint])
def test_a_smaller_wide_view_is_enlarged_in_place(tmp_path: Path, factor: float, rounding: np.ufunc) -> None:
    height, width = 123, 187
    y, x = np.mgrid[:height, :width].astype(np.float32)
    ramp = np.stack([x / width, y / height, 0.3 + 0 * x], axis=-1)
    small = resize_bicubic(ramp, wh=(int(rounding(width / factor)), int(rounding(height / factor))))
    pair = read_pair(capture_of(tmp_path, ramp[::-1], small))
    assert pair.wide.shape == pair.tele.shape
    # The half-pixel rule: nothing moves. An 8-bit step is worth 187 / 255 px.
    assert np.abs(pair.wide - ramp)[8:-8, 8:-8].max() < 1.5 / 255


@pytest.mark.parametrize(
    ("tele_hw", "wide_hw", "message", "hint"),
    [
        ((120, 160), (60, 100), "no common factor explains", "crop"),
        ((120, 160), (80, 60), "no common factor explains", "turn one of them"),
        ((60, 80), (120, 160), "tele must not be the smaller", "swapped"),
        ((120, 160), (119, 80), "no common factor explains", "crop"),
    ],
)
def test_sizes_that_do_not_fit(
    tmp_path: Path, tele_hw: tuple[int, int], wide_hw: tuple[int, int], message: str, hint: str
) -> None:
    capture = capture_of(tmp_path, noise(tele_hw), noise(wide_hw, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_pair(capture)
    for height, width in (tele_hw, wide_hw):
        assert f"{width} x {height} px" in caught.value.message
    assert hint in (caught.value.hint or "")


@pytest.mark.parametrize("rectified", [None, True])
def test_only_rectified_photos_are_to_be_cropped(tmp_path: Path, *, rectified: bool | None) -> None:
    capture = capture_of(tmp_path, noise((120, 160)), noise((60, 100), 1))
    with pytest.raises(InputError, match="no common factor") as caught:
        read_pair(capture, facts=CaptureFacts(rectified=rectified))
    hint = caught.value.hint or ""
    assert "crop wide" in hint
    assert ("not cropped, but need a rig" in hint) == (rectified is None)


@pytest.mark.parametrize("hw", [(1, 1), (31, 200), (200, 31)])
def test_a_tiny_view(tmp_path: Path, hw: tuple[int, int]) -> None:
    capture = capture_of(tmp_path, noise((40, 60)), noise(hw, 1))
    with pytest.raises(InputError, match=rf"wide\.png is {hw[1]} x {hw[0]} px; both sides .* 32 or more"):
        read_pair(capture)


def test_both_views_with_the_same_pixels_in_different_files(tmp_path: Path) -> None:
    image = noise((40, 60))
    write_image(tmp_path / "A" / "tele.png", image)
    Image.open(tmp_path / "A" / "tele.png").save(tmp_path / "A" / "wide.tif")
    (capture,) = find_captures(tmp_path).captures
    with pytest.raises(InputError, match="are the same picture"):
        read_pair(capture)


def test_a_truncated_view_names_its_file(tmp_path: Path) -> None:
    capture = capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1))
    capture.wide_path.write_bytes(capture.wide_path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"wide\.png cannot be read as an image, it is cut off or corrupt"):
        read_pair(capture)


def test_a_view_that_went_away(tmp_path: Path) -> None:
    capture = capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1))
    capture.wide_path.unlink()
    with pytest.raises(UsageError, match=r"wide\.png does not exist"):
        read_pair(capture)


@pytest.mark.parametrize(("asymmetry", "is_told"), [(2.0, False), (3.0, True), (None, False)])
def test_a_stated_asymmetry_that_contradicts_the_sizes_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, asymmetry: float | None, is_told: bool
) -> None:
    capture = capture_of(tmp_path, noise((80, 120)), noise((40, 60), 1))
    with caplog.at_level(logging.WARNING, "telewide"):
        read_pair(capture, facts=CaptureFacts(asymmetry=asymmetry))
    assert ("asymmetry" in caplog.text) is is_told


def test_reader_keeps_what_fits_and_drops_the_oldest(tmp_path: Path) -> None:
    captures = [capture_of(tmp_path, noise((40, 60), i), noise((40, 60), i + 9), name=f"{i}") for i in range(3)]
    pair_bytes = 2 * 40 * 60 * 3 * 4
    reader = PairReader(max_bytes=2 * pair_bytes)
    first, second = reader.read(captures[0]), reader.read(captures[1])
    assert reader.read(captures[0]) is first  # now the youngest
    assert reader.kept_bytes == 2 * pair_bytes
    reader.read(captures[2])
    assert reader.kept_bytes == 2 * pair_bytes
    assert reader.read(captures[0]) is first
    assert reader.read(captures[1]) is not second


def test_reader_reads_a_pair_larger_than_its_budget(tmp_path: Path) -> None:
    reader = PairReader(max_bytes=10)
    assert reader.read(capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1))).tele.shape == (40, 60, 3)
    assert reader.kept_bytes == 0


def test_a_reader_travels_without_its_pictures(tmp_path: Path) -> None:
    reader = PairReader(max_bytes=10**6)
    reader.read(capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1)))
    sent = pickle.dumps(reader)
    assert len(sent) < 1000
    assert pickle.loads(sent).kept_bytes == 0


def test_truth_is_read_with_its_size_checked(tmp_path: Path) -> None:
    capture_of(tmp_path, noise((40, 60)), noise((40, 60), 1))
    disparity_px = noise((40, 60))[..., 0] * 30
    disparity_px[3, 4] = np.nan
    write_pfm(tmp_path / "A" / "truth.pfm", disparity_px)
    (capture,) = find_captures(tmp_path).captures
    np.testing.assert_array_equal(read_truth(capture, hw=(40, 60)), disparity_px)
    with pytest.raises(InputError, match=r"truth\.pfm is 60 x 40; the size of the pair, 30 x 20, was expected"):
        read_truth(capture, hw=(20, 30))


def test_no_truth(tmp_path: Path) -> None:
    assert read_truth(Capture("A", tmp_path / "a", tmp_path / "b")) is None


def test_real_pairs(data_root: Path) -> None:
    captures = find_captures(data_root / "p30")
    pair = read_pair(captures.captures[0], facts=captures.facts)
    assert pair.tele.shape == pair.wide.shape == (640, 1280, 3)
    assert 0.05 < pair.tele.mean() < 0.95


def test_a_real_photo_is_read_upright_and_as_srgb(data_root: Path) -> None:
    path = data_root / "phone_tele_wide_exif" / "IMG_20_wide.jpg"  # Orientation 3, Display P3
    stored = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)[::-16, ::-16, ::-1] / 255.0
    image = read_image(path)[::16, ::16]
    # Turned rightly only the primaries differ: colours become purer, greys stay.
    assert float(np.abs(image - stored).mean()) < 4 / 255
    assert float(np.abs(image[::-1, ::-1] - stored).mean()) > 20 / 255
    assert float(np.ptp(image, axis=-1).mean()) > 1.05 * float(np.ptp(stored, axis=-1).mean())
