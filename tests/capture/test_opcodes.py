"""Opcode lists against bytes laid out by the DNG specification, and their effect against closed forms and OpenCV."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from capture.dng import gain_map, opcode_list, vignette, warp

from telewide.capture.opcodes import (
    FixVignetteRadial,
    GainMap,
    UnreadOpcode,
    WarpRectilinear,
    apply_gain_maps,
    fix_vignette,
    parse_opcodes,
    warp_rectilinear,
)

PLAIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_every_field_of_a_gain_map(rng: np.random.Generator) -> None:
    gains = rng.uniform(1, 3, (3, 4, 2)).astype(np.float32)
    stored = gain_map(gains, area=(1, 2, 30, 40), pitch=(2, 3), planes=(1, 2), spacing=(0.5, 0.25), origin=(0.1, 0.2))
    (parsed,) = parse_opcodes(opcode_list(stored))
    assert isinstance(parsed, GainMap)
    assert (parsed.area, parsed.pitch, parsed.planes) == ((1, 2, 30, 40), (2, 3), (1, 2))
    assert (parsed.spacing, parsed.origin) == ((0.5, 0.25), (0.1, 0.2))
    np.testing.assert_array_equal(parsed.gains, gains)


def test_a_list_keeps_its_order_and_names_what_it_does_not_know() -> None:
    others = [(4, b"\0" * 8), (99, b"")]
    kinds = parse_opcodes(opcode_list(warp(PLAIN), vignette((1, 2, 3, 4, 5)), *others, flags=1))
    assert isinstance(kinds[0], WarpRectilinear)
    assert isinstance(kinds[1], FixVignetteRadial)
    np.testing.assert_array_equal(kinds[0].coefficients, [PLAIN])
    np.testing.assert_array_equal(kinds[1].coefficients, [1, 2, 3, 4, 5])
    assert kinds[2:] == (UnreadOpcode("FixBadPixelsConstant", True), UnreadOpcode("opcode 99", True))
    assert parse_opcodes(opcode_list()) == ()


@pytest.mark.parametrize("n_bytes", [0, 3, 10, 21, 60, 90, -1])
def test_a_list_cut_off_anywhere_is_refused(n_bytes: int) -> None:
    whole = opcode_list(gain_map(np.ones((2, 2, 1), np.float32), area=(0, 0, 9, 9)))
    with pytest.raises(ValueError, match=r"."):
        parse_opcodes(whole[:n_bytes])


@pytest.mark.parametrize(
    "body",
    [
        gain_map(np.full((2, 2, 1), np.nan, np.float32), area=(0, 0, 9, 9))[1],
        gain_map(np.ones((2, 2, 1), np.float32), area=(0, 0, 9, 9), pitch=(0, 1))[1],
        gain_map(np.ones((2, 2, 1), np.float32), area=(0, 0, 9, 9), spacing=(0.0, 1.0))[1],
        gain_map(np.ones((0, 2, 1), np.float32), area=(0, 0, 9, 9))[1],
    ],
)
def test_a_gain_map_that_makes_no_sense_is_refused(body: bytes) -> None:
    with pytest.raises(ValueError, match="GainMap"):
        parse_opcodes(opcode_list((9, body)))


def test_a_huge_count_is_refused() -> None:
    with pytest.raises(ValueError, match="a list of"):
        parse_opcodes(struct.pack(">I", 2**31) + b"\0" * 64)


def test_a_gain_map_sampled_from_a_plane_is_that_plane_between_its_points() -> None:
    height, width = 40, 60
    v, u = np.linspace(0, 1, 5)[:, None], np.linspace(0, 1, 7)[None]
    opcodes = parse_opcodes(opcode_list(gain_map((1 + v + 2 * u)[..., None], area=(0, 0, height, width))))
    image = np.ones((height, width), np.float32)
    apply_gain_maps(image, opcodes)
    rows, columns = (np.arange(height)[:, None] + 0.5) / height, (np.arange(width)[None] + 0.5) / width
    np.testing.assert_allclose(image, 1 + rows + 2 * columns, atol=1e-5)


def test_a_gain_map_is_held_beyond_its_borders_and_one_point_is_a_constant() -> None:
    narrow = gain_map(np.array([[[2.0], [4.0]]]), area=(0, 0, 2, 100), spacing=(1.0, 0.2), origin=(0.0, 0.4))
    image = np.ones((2, 100), np.float32)
    apply_gain_maps(image, parse_opcodes(opcode_list(narrow)))
    np.testing.assert_allclose(image[:, :40], 2)
    np.testing.assert_allclose(image[:, 60:], 4)
    np.testing.assert_allclose(image[:, 49:51].mean(), 3, atol=1e-6)


def test_four_maps_reach_the_four_colours_of_a_mosaic() -> None:
    image = np.ones((6, 8), np.float32)
    maps = [
        gain_map(np.full((1, 1, 1), 1 + 2 * top + left), area=(top, left, 6, 8), pitch=(2, 2))
        for top in (0, 1)
        for left in (0, 1)
    ]
    apply_gain_maps(image, parse_opcodes(opcode_list(*maps)))
    np.testing.assert_array_equal(image, np.tile([[1, 2], [3, 4]], (3, 4)))


def test_planes_and_area_of_a_gain_map() -> None:
    image = np.ones((6, 8, 3), np.float32)
    opcodes = parse_opcodes(opcode_list(gain_map(np.array([[[2.0, 5.0]]]), area=(2, 3, 99, 99), planes=(0, 3))))
    apply_gain_maps(image, opcodes)
    np.testing.assert_array_equal(image[3, 4], [2, 5, 5])  # beyond the map's planes the last one
    np.testing.assert_array_equal(image[1], 1)
    np.testing.assert_array_equal(image[:, 2], 1)


def test_a_warp_is_opencvs_distortion(rng: np.random.Generator) -> None:
    """With f = m and cx, cy the centre, kr1 kr2 kr3 are k1 k2 k3 and kt0 kt1 are p1 p2."""
    height, width = 90, 130
    image = cv2.GaussianBlur(rng.random((height, width, 3)).astype(np.float32), (0, 0), 2)
    centre = (0.45, 0.6)
    cx, cy = centre[0] * (width - 1), centre[1] * (height - 1)
    m = np.hypot(max(cx, width - 1 - cx), max(cy, height - 1 - cy))
    K = np.array([[m, 0, cx], [0, m, cy], [0, 0, 1]])
    maps = cv2.initUndistortRectifyMap(K, np.array([0.1, -0.05, 0.01, -0.02, 0.02]), None, K, (width, height), 5)
    expected = cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    (opcode,) = parse_opcodes(opcode_list(warp((1, 0.1, -0.05, 0.02, 0.01, -0.02), centre=centre)))
    assert isinstance(opcode, WarpRectilinear)
    np.testing.assert_allclose(warp_rectilinear(image, opcode), expected, atol=2e-3)


def test_a_warp_of_its_own_for_each_plane(rng: np.random.Generator) -> None:
    image = rng.random((300, 40, 3)).astype(np.float32)
    shift = 3 / np.hypot(149.5, 19.5)
    plane = parse_opcodes(opcode_list(warp(PLAIN, (1.01, 0, 0, 0, 0, 0), PLAIN)))[0]
    assert isinstance(plane, WarpRectilinear)
    warped = warp_rectilinear(image, plane)
    np.testing.assert_allclose(warped[..., [0, 2]], image[..., [0, 2]], atol=1e-6)
    assert np.abs(warped[..., 1] - image[..., 1]).max() > shift


def test_vignetting_is_taken_out() -> None:
    height, width = 31, 41
    y, x = np.mgrid[:height, :width]
    r2 = ((x - 20) ** 2 + (y - 15) ** 2) / (20**2 + 15**2)
    k = (0.5, 0.2, 0.1, -0.05, 0.02)
    gain = 1 + sum(coefficient * r2 ** (power + 1) for power, coefficient in enumerate(k))
    dark = np.repeat((0.3 / gain)[..., None], 3, axis=2).astype(np.float32)
    (opcode,) = parse_opcodes(opcode_list(vignette(k)))
    assert isinstance(opcode, FixVignetteRadial)
    np.testing.assert_allclose(fix_vignette(dark, opcode), 0.3, rtol=1e-5)
