"""Pictures: against Pillow, OpenCV and closed forms; every kind of file a phone or an editor writes; corrupt ones."""

from __future__ import annotations

import logging
import os
import struct
import tracemalloc
import zlib
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from capture.profiles import ADOBE_RGB, DISPLAY_P3, SRGB, matrix_profile
from numpy.typing import NDArray
from PIL import Image, ImageCms

from telewide.capture.images import read_image, resize_bicubic, write_image, write_png16
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.errors import InputError, UsageError


def random_levels(shape: tuple[int, ...], dtype: type = np.uint8, seed: int = 0) -> NDArray[np.integer]:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)


def smooth(hw: tuple[int, int] = (48, 64)) -> NDArray[np.uint8]:
    """A picture JPEG hardly changes, different in every corner."""
    y, x = np.mgrid[: hw[0], : hw[1]].astype(float)
    colours = np.stack([x / hw[1], y / hw[0], 0.5 + 0.4 * np.sin(x / 20)], axis=-1)
    return (colours * 255).astype(np.uint8)


def srgb_of(levels: NDArray[np.uint8], colorants: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    """Closed form: decode, change primaries, encode (IEC 61966-2-1); values out of gamut are clipped."""
    linear = (levels / 255.0) ** gamma @ (np.linalg.inv(SRGB) @ colorants).T
    clipped = np.clip(linear, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def save(path: Path, levels: NDArray[np.integer], **options: object) -> Path:
    Image.fromarray(levels).save(path, **options)  # type: ignore[arg-type]
    return path


# --- values


@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF", ".PNG"])
def test_eight_bits_are_read_exactly(tmp_path: Path, suffix: str) -> None:
    levels = random_levels((13, 17, 3))
    image = read_image(save(tmp_path / f"ä photo{suffix}", levels))
    assert image.dtype == np.float32
    assert image.flags.c_contiguous
    assert image.flags.writeable
    np.testing.assert_array_equal(np.rint(image * 255), levels)


@pytest.mark.parametrize("suffix", [".jpg", ".JPEG"])
def test_jpeg_agrees_with_opencv(tmp_path: Path, suffix: str) -> None:
    path = save(tmp_path / f"a{suffix}", smooth(), quality=95)
    np.testing.assert_allclose(read_image(path), cv2.imread(str(path))[..., ::-1] / 255.0, atol=2.1 / 255)


def test_sixteen_bit_png(tmp_path: Path) -> None:
    levels = random_levels((13, 17, 3), np.uint16)
    write_png16(tmp_path / "a.png", levels)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / "a.png").astype(np.float64) * 65535), levels)
    Image.fromarray(levels[..., 0]).save(tmp_path / "grey.png")
    grey = read_image(tmp_path / "grey.png").astype(np.float64)
    np.testing.assert_array_equal(np.rint(grey * 65535), np.repeat(levels[..., :1], 3, axis=2))


def test_sixteen_bit_png_with_alpha(tmp_path: Path) -> None:
    levels = random_levels((13, 17, 4), np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), levels[..., [2, 1, 0, 3]])
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), levels[..., :3] / 65535.0, atol=1e-6)


@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("planarconfig", ["contig", "separate"])
@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_sixteen_bit_tiff(tmp_path: Path, compression: str | None, planarconfig: str, byteorder: str) -> None:
    levels = random_levels((13, 17, 3), np.uint16)
    stored = levels if planarconfig == "contig" else np.ascontiguousarray(np.moveaxis(levels, -1, 0))
    tifffile.imwrite(
        tmp_path / "a.tif",
        stored,
        photometric="rgb",
        compression=compression,
        planarconfig=planarconfig,
        byteorder=byteorder,
    )
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), levels / 65535.0, atol=1e-6)


def test_sixteen_bit_tiff_with_lzw(tmp_path: Path) -> None:
    levels = random_levels((13, 17, 3), np.uint16)
    cv2.imwrite(str(tmp_path / "a.tif"), levels[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), levels / 65535.0, atol=1e-6)


@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
def test_sixteen_bit_grey_tiff_of_either_polarity(tmp_path: Path, photometric: str) -> None:
    levels = random_levels((13, 17), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", levels, photometric=photometric)
    light = levels if photometric == "minisblack" else 65535 - levels
    np.testing.assert_allclose(read_image(tmp_path / "a.tif")[..., 1], light / 65535.0, atol=1e-6)


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGBA", "1"])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_other_modes_become_rgb_as_pillow_has_them(tmp_path: Path, mode: str, suffix: str) -> None:
    photo = Image.fromarray(smooth()).convert(mode)
    photo.save(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(read_image(tmp_path / f"a{suffix}"), np.asarray(photo.convert("RGB")) / 255.0, atol=1e-6)


def test_transparent_pixels_are_read_as_opaque_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    levels = np.dstack([smooth(), np.full((48, 64), 100, np.uint8)])
    with caplog.at_level(logging.WARNING, "telewide"):
        image = read_image(save(tmp_path / "a.png", levels))
    np.testing.assert_allclose(image, levels[..., :3] / 255.0, atol=1e-6)
    assert "transparent" in caplog.text


def test_cmyk_jpeg(tmp_path: Path) -> None:
    photo = Image.fromarray(smooth()).convert("CMYK")
    photo.save(tmp_path / "a.jpg", quality=98)
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), np.asarray(photo.convert("RGB")) / 255.0, atol=6 / 255)


# --- orientation (CIPA DC-008, tag 274)

UPRIGHT = random_levels((6, 9, 3))
STORED = {
    1: UPRIGHT,
    2: UPRIGHT[:, ::-1],
    3: np.rot90(UPRIGHT, 2),
    4: UPRIGHT[::-1],
    5: UPRIGHT.swapaxes(0, 1),
    6: np.rot90(UPRIGHT, 1),
    7: np.rot90(UPRIGHT, 2).swapaxes(0, 1),
    8: np.rot90(UPRIGHT, -1),
}


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_every_orientation_is_undone(tmp_path: Path, orientation: int, suffix: str) -> None:
    exif = Image.Exif()
    exif[274] = orientation
    path = save(tmp_path / f"a{suffix}", np.ascontiguousarray(STORED[orientation]), exif=exif)
    np.testing.assert_array_equal(np.rint(read_image(path) * 255), UPRIGHT)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_of_a_jpeg_agrees_with_opencv(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[274] = orientation
    path = save(tmp_path / "a.jpg", smooth(), exif=exif, quality=95)
    np.testing.assert_allclose(read_image(path), cv2.imread(str(path))[..., ::-1] / 255.0, atol=2.1 / 255)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("writer", ["plain", "lzw"])
def test_every_orientation_of_a_deep_tiff(tmp_path: Path, orientation: int, writer: str) -> None:
    stored = np.ascontiguousarray(STORED[orientation].astype(np.uint16) * 257)
    path = tmp_path / "a.tif"
    if writer == "plain":
        tifffile.imwrite(path, stored, photometric="rgb", extratags=[(274, 3, 1, orientation, True)])
    else:
        cv2.imwrite(str(path), stored[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
        _add_tiff_orientation(path, orientation)
    np.testing.assert_allclose(read_image(path), UPRIGHT / 255.0, atol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_of_a_deep_png(tmp_path: Path, orientation: int) -> None:
    write_png16(tmp_path / "a.png", np.ascontiguousarray(STORED[orientation].astype(np.uint16) * 257))
    exif = Image.Exif()
    exif[274] = orientation
    _insert_png_chunk(tmp_path / "a.png", b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0"))
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), UPRIGHT / 255.0, atol=1e-6)


def _add_tiff_orientation(path: Path, orientation: int) -> None:
    """Append a copy of the directory that has tag 274 too (TIFF 6.0, little endian)."""
    data = path.read_bytes()
    (start,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, start)
    entries = [data[start + 2 + 12 * i : start + 14 + 12 * i] for i in range(count)]
    entries.append(struct.pack("<HHIHxx", 274, 3, 1, orientation))
    entries.sort(key=lambda entry: struct.unpack_from("<H", entry))
    directory = struct.pack("<H", count + 1) + b"".join(entries) + bytes(4)
    data += bytes(len(data) % 2)
    path.write_bytes(data[:4] + struct.pack("<I", len(data)) + data[8:] + directory)


def _insert_png_chunk(path: Path, kind: bytes, content: bytes) -> None:
    data = path.read_bytes()
    chunk = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    path.write_bytes(data[:33] + chunk + data[33:])


# --- colour profiles


@pytest.mark.parametrize(("colorants", "gamma"), [(ADOBE_RGB, 563 / 256), (DISPLAY_P3, 2.2)])
def test_a_wide_gamut_profile_is_converted_to_srgb(
    tmp_path: Path, colorants: NDArray[np.float64], gamma: float
) -> None:
    levels = random_levels((16, 16, 3))
    path = save(tmp_path / "a.png", levels, icc_profile=matrix_profile(colorants, gamma))
    expected = srgb_of(levels.astype(np.uint8), colorants, gamma)
    # Little CMS and the closed form differ by rounding; dark colours are steep in sRGB.
    assert np.abs(read_image(path) - expected).max() < 3 / 255
    assert np.abs(levels / 255.0 - expected).max() > 20 / 255


def test_a_wide_gamut_jpeg_is_converted_too(tmp_path: Path) -> None:
    levels = np.full((32, 32, 3), (90, 200, 60), np.uint8)
    path = save(tmp_path / "a.jpg", levels, icc_profile=matrix_profile(DISPLAY_P3, 2.2), quality=98)
    np.testing.assert_allclose(read_image(path), srgb_of(levels, DISPLAY_P3, 2.2), atol=4 / 255)


def test_an_srgb_profile_changes_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    levels = random_levels((16, 16, 3))
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    np.testing.assert_array_equal(
        np.rint(read_image(save(tmp_path / "a.png", levels, icc_profile=profile)) * 255), levels
    )
    assert caplog.text == ""


def test_a_grey_photo_with_a_colour_profile(tmp_path: Path) -> None:
    levels = np.full((16, 16), 128, np.uint8)
    path = save(tmp_path / "a.png", levels, icc_profile=matrix_profile(SRGB, 1.0))
    expected = srgb_of(np.repeat(levels[..., None], 3, axis=2), SRGB, 1.0)
    np.testing.assert_allclose(read_image(path), expected, atol=2 / 255)


def test_a_deep_photo_with_another_profile_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    levels = random_levels((16, 16, 3), np.uint16)
    profile = matrix_profile(ADOBE_RGB, 2.2, b"Adobe RGB (1998)")
    tifffile.imwrite(tmp_path / "a.tif", levels, photometric="rgb", iccprofile=profile)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), levels / 65535.0, atol=1e-6)
    assert "Adobe RGB (1998)" in caplog.text


def test_a_broken_profile_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    levels = random_levels((16, 16, 3))
    image = read_image(save(tmp_path / "a.png", levels, icc_profile=b"no profile at all" * 20))
    np.testing.assert_array_equal(np.rint(image * 255), levels)
    assert "colour profile cannot be used" in caplog.text


# --- bad files


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.png", b"", "is empty"),
        ("a.jpg", b"hello", "no photo that can be read"),
        ("a.jpg", b"\xff\xd8\xff", "cut off or corrupt"),
        ("a.dng", b"II*\0", "cannot be developed as a RAW photo"),
        ("a.NEF", b"hello", "cannot be developed as a RAW photo"),
        ("a.webp", b"RIFF\0\0\0\0WEBP", "nothing in it can be recognised"),
    ],
)
def test_a_file_that_is_no_photo(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_image(tmp_path / name)
    assert str(tmp_path / name) in caught.value.message
    assert caught.value.hint


def test_a_folder_is_no_photo(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        read_image(tmp_path)


def test_a_dng_under_another_name(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", random_levels((9, 9), np.uint16), extratags=[(50706, 1, 4, b"\1\4\0\0", True)])
    with pytest.raises(InputError, match="cannot be developed as a RAW photo"):
        read_image(tmp_path / "a.tif")


def test_a_float_tiff(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((9, 9), np.float32))
    with pytest.raises(InputError, match="float32; TIFF with 8 or 16 bits"):
        read_image(tmp_path / "a.tif")


def _encoded(kind: str) -> bytes:
    stream, levels = BytesIO(), random_levels((40, 50, 3))
    if kind == "png16":
        return cv2.imencode(".png", levels.astype(np.uint16) * 257)[1].tobytes()
    if kind == "tif16":
        tifffile.imwrite(stream, levels.astype(np.uint16) * 257, photometric="rgb")
    else:
        Image.fromarray(levels).save(stream, {"jpg": "JPEG", "png": "PNG", "tif": "TIFF"}[kind])
    return stream.getvalue()


@pytest.mark.parametrize("kind", ["jpg", "png", "tif", "png16", "tif16"])
def test_a_cut_off_photo(tmp_path: Path, kind: str) -> None:
    data, path = _encoded(kind), tmp_path / f"a.{kind[:3]}"
    for share in (0.01, 0.3, 0.6, 0.9):
        path.write_bytes(data[: max(8, int(len(data) * share))])
        with pytest.raises(InputError, match="cut off or corrupt") as refusal:
            read_image(path)
        assert "not processed" not in refusal.value.message


@pytest.mark.parametrize("kind", ["jpg", "png", "tif", "png16", "tif16"])
def test_a_corrupt_photo_is_read_or_refused(tmp_path: Path, kind: str) -> None:
    data, path, rng = _encoded(kind), tmp_path / f"a.{kind[:3]}", np.random.default_rng(1)
    for _ in range(40):
        corrupt = np.frombuffer(data, np.uint8).copy()
        where = rng.integers(4, min(len(data), 400), 6)
        corrupt[where] = rng.integers(0, 256, 6)
        path.write_bytes(corrupt.tobytes())
        try:
            image = read_image(path)
        except InputError:
            continue
        assert image.dtype == np.float32
        assert image.shape[2] == 3


# --- writing


def test_write_image_png_round_trip_and_opencv(tmp_path: Path) -> None:
    levels = random_levels((13, 17, 3))
    write_image(tmp_path / "über uns" / "a.png", (levels / 255.0).astype(np.float32))
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / "über uns" / "a.png") * 255), levels)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "über uns" / "a.png")), levels)


def test_write_image_clips_rounds_and_takes_grey(tmp_path: Path) -> None:
    image = np.array([[-1.0, 0.4999 / 255, 0.501 / 255, 2.0, np.nan]], np.float32)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), [[0, 0, 1, 255, 0]])


def test_write_image_jpeg(tmp_path: Path) -> None:
    image = (smooth() / 255.0).astype(np.float32)
    write_image(tmp_path / "low.jpg", image, quality=30)
    write_image(tmp_path / "high.JPG", image, quality=98)
    np.testing.assert_allclose(read_image(tmp_path / "high.JPG"), image, atol=6 / 255)
    assert (tmp_path / "low.jpg").stat().st_size < (tmp_path / "high.JPG").stat().st_size


def test_write_image_of_another_kind(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.png or \.jpg"):
        write_image(tmp_path / "a.bmp", np.zeros((4, 4, 3), np.float32))


def test_write_png16_refuses_other_types(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="uint16"):
        write_png16(tmp_path / "a.png", np.zeros((4, 4), np.uint8))  # type: ignore[arg-type]


# --- PFM


def _disparity() -> NDArray[np.float32]:
    disparity = np.random.default_rng(0).normal(10, 20, (7, 5)).astype(np.float32)
    disparity[2, 3] = np.nan
    return disparity


def test_pfm_round_trip_keeps_unknown_as_nan(tmp_path: Path) -> None:
    write_pfm(tmp_path / "a.pfm", _disparity())
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), _disparity())


def test_pfm_on_disk_is_what_middlebury_states(tmp_path: Path) -> None:
    write_pfm(tmp_path / "a.pfm", _disparity())
    data = (tmp_path / "a.pfm").read_bytes()
    assert data.startswith(b"Pf\n5 7\n-1.0\n")
    rows = struct.unpack("<35f", data[-140:])
    assert rows[:5] == tuple(_disparity()[-1])
    assert rows[4 * 5 + 3] == np.inf
    known = ~np.isnan(_disparity())
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.pfm"), cv2.IMREAD_UNCHANGED)[known], _disparity()[known])


def test_pfm_big_endian_with_a_scale(tmp_path: Path) -> None:
    body = _disparity()[::-1].astype(">f4").tobytes()
    (tmp_path / "a.pfm").write_bytes(b"Pf\n5 7\n0.0039\n" + body)
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), _disparity())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PF\n5 7\n-1.0\n" + bytes(420), "three channels"),
        (b"\x89PNG\r\n\x1a\n", "no PFM"),
        (b"Pf\n5 7\n-1.0\n" + bytes(100), "holds 100 bytes of values; 5 x 7 floats need 140"),
        (b"Pf\n5\n-1.0\n" + bytes(100), "broken PFM header"),
        (b"Pf\n", "broken PFM header"),
        (b"", "is empty"),
    ],
)
def test_a_broken_pfm(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.pfm").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_pfm(tmp_path / "a.pfm")


def test_a_pfm_of_more_pixels_than_any_photo_is_read_with_is_refused(tmp_path: Path) -> None:
    """A hole: it takes no space, and would be read four times over."""
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n20000 20000\n-1.0\n")
    os.truncate(path, 20 + 4 * 20000**2)
    tracemalloc.start()
    with pytest.raises(InputError, match="larger than the disparities of any photo"):
        read_pfm(path)
    assert tracemalloc.get_traced_memory()[1] < 300e6
    tracemalloc.stop()


# --- resizing


@pytest.mark.parametrize("wh", [(90, 60), (45, 31), (20, 15), (10, 10)])
def test_resizing_keeps_a_ramp_where_the_half_pixel_rule_puts_it(wh: tuple[int, int]) -> None:
    y, x = np.mgrid[:30, :45].astype(np.float32)
    image = np.stack([x / 45, y / 30, np.full_like(x, 0.25)], axis=-1)
    resized = resize_bicubic(image, wh=wh)
    assert resized.shape == (wh[1], wh[0], 3)
    y_old = (np.arange(wh[1]) + 0.5) * 30 / wh[1] - 0.5
    x_old = (np.arange(wh[0]) + 0.5) * 45 / wh[0] - 0.5
    inner_y, inner_x = slice(wh[1] // 4, -wh[1] // 4), slice(wh[0] // 4, -wh[0] // 4)
    expected_x, expected_y = np.meshgrid(x_old / 45, y_old / 30)
    # A widened kernel sampled at pixels moves a ramp by a few thousandths of a pixel.
    np.testing.assert_allclose(resized[inner_y, inner_x, 0], expected_x[inner_y, inner_x], atol=0.01 / 45)
    np.testing.assert_allclose(resized[inner_y, inner_x, 1], expected_y[inner_y, inner_x], atol=0.01 / 30)
    np.testing.assert_allclose(resized[..., 2], 0.25, atol=1e-6)


def test_resizing_stays_in_range_and_takes_grey() -> None:
    steps = np.kron(random_levels((5, 5)) > 127, np.ones((4, 4))).astype(np.float32)
    resized = resize_bicubic(steps, wh=(61, 61))
    assert resized.shape == (61, 61)
    assert resized.min() >= 0
    assert resized.max() <= 1
