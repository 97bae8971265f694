"""Developing RAW: made-up DNGs come out as the scene they were made from; real ones by what their sensors counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from capture.dng import gain_map, mosaic_of, opcode_list, vignette, warp, write_dng
from numpy.typing import NDArray

from telewide.capture.images import read_image
from telewide.capture.pair import find_captures, read_pair
from telewide.capture.raw import read_raw, show_as_srgb
from telewide.errors import InputError, UsageError
from telewide.srgb import srgb_from_linear

HW = (96, 128)
INSIDE = (slice(4, -4), slice(4, -4))  # demosaicing guesses at the border
STEP = 2 / 959  # two levels of the sensor


def smooth_scene(hw: tuple[int, int] = HW) -> NDArray[np.float32]:
    y, x = np.mgrid[0 : hw[0], 0 : hw[1]] / max(hw)
    return np.stack([0.1 + 0.5 * x, 0.15 + 0.3 * y, 0.6 - 0.4 * x], axis=-1).astype(np.float32)


def shading(gains: NDArray[np.float32], hw: tuple[int, int] = HW) -> bytes:
    """Four gain maps as phones write them, one for each colour of the mosaic."""
    maps = [
        gain_map(gains[..., 2 * top + left, None], area=(top, left, *hw), pitch=(2, 2))
        for top in (0, 1)
        for left in (0, 1)
    ]
    return opcode_list(*maps)


@pytest.mark.parametrize("neutral", [(1, 1, 1), (0.5, 1, 0.6)])
def test_a_developed_photo_is_the_scene(tmp_path: Path, neutral: tuple[float, float, float]) -> None:
    scene = smooth_scene()
    photo = read_raw(write_dng(tmp_path / "a.dng", mosaic_of(scene, neutral=neutral), neutral=neutral))
    assert photo.linear.dtype == np.float32
    np.testing.assert_allclose(photo.linear[INSIDE], scene[INSIDE], atol=STEP)


def test_a_dark_photo_stays_dark_and_white_is_one(tmp_path: Path) -> None:
    dark = read_raw(write_dng(tmp_path / "dark.dng", np.full(HW, 0.05, np.float32)))
    np.testing.assert_allclose(dark.linear, 0.05, atol=STEP)
    dim = read_raw(write_dng(tmp_path / "dim.dng", np.full(HW, 0.9, np.float32)))  # LibRaw would stretch this one
    np.testing.assert_allclose(dim.linear, 0.9, atol=STEP)
    white = read_raw(write_dng(tmp_path / "white.dng", np.ones(HW, np.float32)))
    np.testing.assert_allclose(white.linear, 1, atol=1e-4)


def test_half_size_is_each_2_x_2_of_the_mosaic(tmp_path: Path) -> None:
    scene = smooth_scene()
    photo = read_raw(write_dng(tmp_path / "a.dng", mosaic_of(scene)), is_half_size=True)
    green = (scene[0::2, 1::2, 1] + scene[1::2, 0::2, 1]) / 2
    expected = np.stack([scene[0::2, 0::2, 0], green, scene[1::2, 1::2, 2]], axis=-1)
    np.testing.assert_allclose(photo.linear, expected, atol=STEP)


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (8, 1), (3, 2), (6, 3)])
def test_a_photo_comes_upright(tmp_path: Path, orientation: int, turns: int) -> None:
    scene = smooth_scene()
    photo = read_raw(write_dng(tmp_path / "a.dng", mosaic_of(scene), orientation=orientation))
    expected = np.rot90(scene, turns)
    assert photo.linear.shape == expected.shape
    np.testing.assert_allclose(photo.linear[INSIDE], expected[INSIDE], atol=STEP)


@pytest.mark.parametrize("is_half_size", [False, True])
def test_the_crop_is_taken(tmp_path: Path, is_half_size: bool) -> None:
    scene = smooth_scene()
    path = write_dng(tmp_path / "a.dng", mosaic_of(scene), crop=(8, 16, 60, 90))
    photo = read_raw(path, is_half_size=is_half_size)
    assert photo.linear.shape == ((30, 45, 3) if is_half_size else (60, 90, 3))
    if not is_half_size:
        np.testing.assert_allclose(photo.linear, scene[8:68, 16:106], atol=STEP)


def test_a_flat_field_comes_out_flat(tmp_path: Path) -> None:
    """Shading of a phone lens: a factor of up to 3 in the corners, another for each colour."""
    y, x = np.mgrid[-1:1:13j, -1:1:17j]
    gains = 1 + (x * x + y * y)[..., None] * np.array([1.0, 0.8, 0.8, 0.6])
    rows, columns = (np.arange(HW[0]) + 0.5) / HW[0] * 12, (np.arange(HW[1]) + 0.5) / HW[1] * 16
    shade = np.empty(HW, np.float32)
    for top in (0, 1):
        for left in (0, 1):
            plane = gains[..., 2 * top + left]
            at_rows = np.stack([np.interp(rows, np.arange(13), plane[:, j]) for j in range(17)], axis=1)
            full = np.stack([np.interp(columns, np.arange(17), row) for row in at_rows])
            shade[top::2, left::2] = (1 / full)[top::2, left::2]
    shaded, plain = tmp_path / "shaded.dng", tmp_path / "plain.dng"
    write_dng(shaded, 0.6 * shade, opcodes={2: shading(gains)})
    write_dng(plain, 0.6 * shade)
    photo = read_raw(shaded)
    assert photo.corrections == ("GainMap",) * 4
    np.testing.assert_allclose(photo.linear, 0.6, atol=2 * STEP)
    without = read_raw(plain).linear
    assert without.max() / without.min() > 2


def test_gains_that_are_one_change_nothing(tmp_path: Path) -> None:
    mosaic = mosaic_of(smooth_scene(), neutral=(0.5, 1, 0.6))
    plain = write_dng(tmp_path / "plain.dng", mosaic, neutral=(0.5, 1, 0.6))
    mapped = write_dng(
        tmp_path / "mapped.dng", mosaic, neutral=(0.5, 1, 0.6), opcodes={2: shading(np.ones((2, 2, 4), np.float32))}
    )
    np.testing.assert_allclose(read_raw(mapped).linear, read_raw(plain).linear, atol=1e-3)


def test_a_gain_beyond_white_clips_like_white(tmp_path: Path) -> None:
    opcodes = {2: shading(np.full((2, 2, 4), 4.0, np.float32))}
    photo = read_raw(write_dng(tmp_path / "a.dng", np.full(HW, 0.5, np.float32), opcodes=opcodes))
    np.testing.assert_allclose(photo.linear, 1, atol=1e-4)


def test_distortion_is_taken_out(tmp_path: Path) -> None:
    """A radial scale of 0.8 shows the middle of the scene 1.25 times larger."""
    scene = smooth_scene()
    path = write_dng(tmp_path / "a.dng", mosaic_of(scene), opcodes={3: opcode_list(warp((0.8, 0, 0, 0, 0, 0)))})
    photo = read_raw(path)
    assert photo.corrections == ("WarpRectilinear",)
    y, x = np.mgrid[0 : HW[0], 0 : HW[1]]
    centre = np.array([HW[1] - 1, HW[0] - 1]) / 2
    x, y = (centre[0] + 0.8 * (x - centre[0])) / max(HW), (centre[1] + 0.8 * (y - centre[1])) / max(HW)
    expected = np.stack([0.1 + 0.5 * x, 0.15 + 0.3 * y, 0.6 - 0.4 * x], axis=-1)
    np.testing.assert_allclose(photo.linear, expected, atol=STEP)


def test_each_plane_is_warped_as_the_sensor_saw_it(tmp_path: Path) -> None:
    """Lateral chromatic aberration, with a neutral that is not grey: colours are mixed after the warp."""
    scene, neutral = smooth_scene(), (0.5, 1, 0.6)
    sets = ((0.9, 0, 0, 0, 0, 0), (1.0, 0, 0, 0, 0, 0), (1.0, 0, 0, 0, 0, 0))
    path = write_dng(
        tmp_path / "a.dng", mosaic_of(scene, neutral=neutral), neutral=neutral, opcodes={3: opcode_list(warp(*sets))}
    )
    linear = read_raw(path).linear[INSIDE]
    np.testing.assert_allclose(linear[..., 1:], scene[INSIDE][..., 1:], atol=STEP)
    x = np.arange(HW[1])[INSIDE[1]]
    centre = (HW[1] - 1) / 2
    np.testing.assert_allclose(linear[10, :, 0], 0.1 + 0.5 * (centre + 0.9 * (x - centre)) / max(HW), atol=STEP)


def test_vignetting_of_list_3_is_taken_out(tmp_path: Path) -> None:
    y, x = np.mgrid[0 : HW[0], 0 : HW[1]]
    centre = np.array([HW[1] - 1, HW[0] - 1]) / 2
    r2 = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (centre**2).sum()
    opcodes = {3: opcode_list(vignette((1.0, 0, 0, 0, 0)))}
    path = write_dng(tmp_path / "a.dng", (0.5 / (1 + r2)).astype(np.float32), opcodes=opcodes)
    np.testing.assert_allclose(read_raw(path).linear[INSIDE], 0.5, atol=2 * STEP)


def test_what_is_not_carried_out_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    flat = np.full(HW, 0.5, np.float32)
    fisheye = {3: opcode_list((2, b"\0" * 52))}
    read_raw(write_dng(tmp_path / "fisheye.dng", flat, opcodes=fisheye))
    assert "fisheye.dng asks for WarpFisheye, which is not carried out" in caplog.text
    caplog.clear()
    read_raw(write_dng(tmp_path / "optional.dng", flat, opcodes={3: opcode_list((2, b"\0" * 52), flags=1)}))
    assert caplog.text == ""
    photo = read_raw(write_dng(tmp_path / "broken.dng", flat, opcodes={2: shading(np.ones((2, 2, 4)))[:-5]}))
    assert "OpcodeList2 cannot be read" in caplog.text
    np.testing.assert_allclose(photo.linear, 0.5, atol=STEP)


def test_a_shown_photo_is_the_linear_one_through_the_srgb_curve(tmp_path: Path) -> None:
    mosaic = mosaic_of(smooth_scene())
    plain, brighter = tmp_path / "a.dng", tmp_path / "b.DNG"
    write_dng(plain, mosaic)
    write_dng(brighter, mosaic, exposure_ev=1)
    linear = read_raw(plain).linear
    np.testing.assert_allclose(read_image(plain), srgb_from_linear(linear), atol=1e-6)
    assert read_raw(brighter).baseline_exposure_ev == 1
    np.testing.assert_array_equal(read_raw(brighter).linear, linear)
    np.testing.assert_allclose(read_image(brighter), srgb_from_linear(np.minimum(2 * linear, 1)), atol=1e-6)


def test_a_dng_of_another_suffix_is_one(tmp_path: Path) -> None:
    path = write_dng(tmp_path / "a.tif", mosaic_of(smooth_scene()))
    np.testing.assert_array_equal(read_image(path), show_as_srgb(read_raw(path)))


def test_a_capture_of_dngs_is_a_pair(tmp_path: Path) -> None:
    scene = smooth_scene()
    write_dng(tmp_path / "A" / "tele.dng", mosaic_of(scene))
    write_dng(tmp_path / "A" / "wide.dng", mosaic_of(0.5 * scene))
    (capture,) = find_captures(tmp_path).captures
    pair = read_pair(capture)
    np.testing.assert_array_equal(pair.tele, read_image(tmp_path / "A" / "tele.dng"))
    assert pair.tele.shape == pair.wide.shape == (*HW, 3)


def test_bad_files(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        read_raw(tmp_path / "a.dng")
    whole = write_dng(tmp_path / "whole.dng", mosaic_of(smooth_scene())).read_bytes()
    (tmp_path / "cut.dng").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.dng cannot be developed") as caught:
        read_raw(tmp_path / "cut.dng")
    assert caught.value.hint


@pytest.mark.slow
def test_a_real_dng_is_what_its_sensor_counted(data_root: Path) -> None:
    """Blackmagic camera: the mean of green is that of the mosaic; the file asks for 2.65 EV more and a crop."""
    path = data_root / "raw" / "Blackmagic.dng"
    photo = read_raw(path)
    assert photo.linear.shape == (2160, 4096, 3)
    assert photo.baseline_exposure_ev == pytest.approx(2.654, abs=1e-3)
    with rawpy.imread(str(path)) as raw:
        mosaic = raw.raw_image_visible[8:-8, 16:-16].astype(np.float64)
        colours, balance = raw.raw_colors_visible[8:-8, 16:-16], np.array(raw.camera_whitebalance[:3])
        matrix = np.array(raw.color_matrix)[:, :3]
    camera = [(mosaic[(colours == c) | (colours == {1: 3}.get(c, c))].mean() - 512) / (65535 - 512) for c in range(3)]
    expected = matrix @ (np.array(camera) * balance)
    # Clipping in single channels moves the means a little.
    np.testing.assert_allclose(photo.linear.mean((0, 1), dtype=np.float64), expected, rtol=0.02)


@pytest.mark.parametrize("name", ["Nikon_uncompressed.nef", "RAW_KODAK_DC50.KDC"])
def test_other_raw_is_read(data_root: Path, name: str) -> None:
    image = read_image(data_root / "raw" / name)
    assert min(image.shape[:2]) > 500
    assert 0.1 < image.mean() < 0.99
    if name.endswith(".nef"):  # a film scanner's, already in three colours: LibRaw must only scale it
        with tifffile.TiffFile(data_root / "raw" / name) as tiff:
            stored = tiff.pages.first.pages[0].asarray() / 255
        np.testing.assert_allclose(read_raw(data_root / "raw" / name).linear.mean(), stored.mean(), atol=0.01)
