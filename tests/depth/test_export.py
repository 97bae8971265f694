"""Exports are read back by other programs' readers and compared with what was given."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rigs import phone

from telewide.capture.facts import CaptureFacts
from telewide.capture.pfm import read_pfm
from telewide.depth.export import write_depth
from telewide.depth.formats.disparity_png_file import png_from_disparity
from telewide.depth.formats.numpy_archive import read_disparity
from telewide.depth.result import DepthResult, depth_result, depth_result_of_rig
from telewide.errors import InputError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap

HW = (40, 56)


def result_of(disparity_px: FloatMap, *, valid: np.ndarray | None = None) -> DepthResult:
    valid = np.isfinite(disparity_px) if valid is None else valid
    disparity = DisparityMap(disparity_px, np.linspace(0, 1, valid.size, dtype=np.float32).reshape(valid.shape), valid)
    return DepthResult(name="capture", disparity=disparity)


@pytest.fixture
def disparity_px(rng: np.random.Generator) -> FloatMap:
    """Disparities of the whole range a 16-bit PNG holds, some unknown."""
    values = rng.uniform(0.01, 255.9, HW).astype(np.float32)
    values[3:6, 10:20] = np.nan
    return values


def test_pfm_holds_every_value_exactly(tmp_path: Path, disparity_px: FloatMap) -> None:
    write_depth(tmp_path, result_of(disparity_px))
    np.testing.assert_array_equal(read_pfm(tmp_path / "disparity.pfm"), disparity_px)
    by_opencv = cv2.imread(str(tmp_path / "disparity.pfm"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(by_opencv, np.where(np.isnan(disparity_px), np.inf, disparity_px))


def test_png_is_kittis_code(tmp_path: Path, disparity_px: FloatMap) -> None:
    written = write_depth(tmp_path, result_of(disparity_px))
    stored = cv2.imread(str(tmp_path / "disparity.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored == 0, np.isnan(disparity_px))
    known = stored > 0
    np.testing.assert_allclose(stored[known] / 256, disparity_px[known], atol=0.5 / 256 + 1e-5)
    assert not written.notes


def test_png_code_never_loses_a_known_value() -> None:
    edges_px = np.array([[1e-4, 0.5 / 256, 255.999, np.nan, 0.0, -1.0, 256.0]], dtype=np.float32)
    np.testing.assert_array_equal(png_from_disparity(edges_px), [[1, 1, 65535, 0, 0, 0, 0]])


@pytest.mark.parametrize("outlier_px", [-3.0, 0.0, 256.0, 300.0])
def test_png_is_left_out_where_it_cannot_hold_the_values(
    tmp_path: Path, disparity_px: FloatMap, outlier_px: float
) -> None:
    write_depth(tmp_path, result_of(disparity_px))  # of an earlier run
    disparity_px[0, 0] = outlier_px
    written = write_depth(tmp_path, result_of(disparity_px))
    assert not (tmp_path / "disparity.png").exists()
    assert "no disparity.png" in written.notes[0]
    assert read_pfm(tmp_path / "disparity.pfm")[0, 0] == outlier_px


def test_png_needs_only_the_measured_values_to_fit(tmp_path: Path, disparity_px: FloatMap) -> None:
    valid = np.isfinite(disparity_px)
    disparity_px[0, 0], valid[0, 0] = -2.0, False
    write_depth(tmp_path, result_of(disparity_px, valid=valid))
    assert cv2.imread(str(tmp_path / "disparity.png"), cv2.IMREAD_UNCHANGED)[0, 0] == 0


def test_npz_keeps_the_arrays(tmp_path: Path, disparity_px: FloatMap) -> None:
    plain = result_of(disparity_px)
    facts = CaptureFacts(f_px=800.0, baseline_m=0.01, doffs_px=2.0)
    result = depth_result("capture", plain.disparity, facts=facts)
    write_depth(tmp_path, result)
    with np.load(tmp_path / "depth.npz") as stored:
        assert set(stored) == {"format", "disparity", "confidence", "valid", "K", "baseline_m", "depth_m", "doffs_px"}
        np.testing.assert_array_equal(stored["disparity"], disparity_px)
        np.testing.assert_array_equal(stored["confidence"], plain.disparity.confidence)
        np.testing.assert_array_equal(stored["valid"], plain.disparity.valid)
        # What is stored suffices to compute the depth again.
        recomputed_m = stored["K"][0, 0] * stored["baseline_m"] / (stored["disparity"] + stored["doffs_px"])
        np.testing.assert_allclose(stored["depth_m"], recomputed_m, rtol=1e-6)
        assert int(stored["format"]) == 1


def test_npz_says_what_is_not_known(tmp_path: Path, disparity_px: FloatMap) -> None:
    write_depth(tmp_path, result_of(disparity_px))
    with np.load(tmp_path / "depth.npz") as stored:
        assert set(stored) == {"format", "disparity", "confidence", "valid", "K"}
        assert np.isnan(stored["K"]).all()


def test_npz_of_a_rig_says_how_sure_it_is(tmp_path: Path, disparity_px: FloatMap) -> None:
    rig = phone(shrink=72)
    result = depth_result_of_rig("capture", result_of(disparity_px).disparity, rig=rig)
    write_depth(tmp_path, result)
    with np.load(tmp_path / "depth.npz") as stored:
        metric = {"baseline_m", "doffs_px", "depth_m", "depth_std_m"}
        assert set(stored) == {"format", "disparity", "confidence", "valid", "K", "distortion"} | metric
        recomputed_m = stored["K"][0, 0] * stored["baseline_m"] / (stored["disparity"] + stored["doffs_px"])
        np.testing.assert_allclose(stored["depth_m"], recomputed_m, rtol=1e-5)
        np.testing.assert_array_equal(np.isnan(stored["depth_std_m"]), np.isnan(stored["depth_m"]))
        np.testing.assert_array_equal(stored["depth_std_m"], result.depth_std_m)
        np.testing.assert_array_equal(stored["distortion"], rig.tele.distortion)


def test_same_result_gives_the_same_bytes(tmp_path: Path, disparity_px: FloatMap) -> None:
    image = np.full((*HW, 3), 0.4, np.float32)
    first, second = tmp_path / "a", tmp_path / "b"
    names = [path.name for path in write_depth(first, result_of(disparity_px), image=image).paths]
    write_depth(second, result_of(disparity_px), image=image)
    assert names == ["disparity.pfm", "disparity.png", "depth.npz", "preview.png"]
    assert sorted(path.name for path in first.iterdir()) == sorted(names)
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes()


@pytest.mark.parametrize("rotated_deg", [0, 90, 180, 270])
def test_files_stand_upright_and_their_camera_sees_the_same_points(tmp_path: Path, rotated_deg: int) -> None:
    rng = np.random.default_rng(5)
    upright_px = rng.uniform(4, 9, (24, 40)).astype(np.float32)
    given_px = np.ascontiguousarray(np.rot90(upright_px, k=rotated_deg // 90))
    known = rng.random(given_px.shape) < 0.5
    facts = CaptureFacts(f_px=50.0, baseline_m=0.01)
    given = depth_result("one", DisparityMap(given_px, known.astype(np.float32), known), facts=facts)
    assert given.K is not None
    given = replace(given, K=given.K + np.array([[0, 0, 3.0], [0, 2.0, 5.0], [0, 0, 0]]), rotated_deg=rotated_deg)
    write_depth(tmp_path, given)
    np.testing.assert_array_equal(read_pfm(tmp_path / "disparity.pfm"), upright_px)
    with np.load(tmp_path / "depth.npz") as stored:
        np.testing.assert_array_equal(stored["valid"], np.rot90(known, k=-rotated_deg // 90))
        # A ray of the photo as given is turned about the optical axis by as much as the photo is.
        y, x = (int(each[0]) for each in np.nonzero(given_px == upright_px[3, 7]))
        turn_rad = math.radians(rotated_deg)
        clockwise = np.array([[math.cos(turn_rad), -math.sin(turn_rad)], [math.sin(turn_rad), math.cos(turn_rad)]])
        ray = np.linalg.solve(given.K, [x, y, 1.0])
        expected = np.linalg.solve(stored["K"], [7.0, 3.0, 1.0])
        np.testing.assert_allclose(clockwise @ ray[:2], expected[:2], atol=1e-12)


def test_nothing_measured_is_written_and_said(tmp_path: Path) -> None:
    unknown = np.full(HW, np.nan, np.float32)
    written = write_depth(tmp_path, result_of(unknown), image=np.zeros((*HW, 3), np.float32))
    assert "nothing was measured" in written.notes[0]
    assert np.isnan(read_pfm(tmp_path / "disparity.pfm")).all()


def test_what_is_read_back_is_what_was_written(tmp_path: Path, disparity_px: FloatMap) -> None:
    written = result_of(disparity_px).disparity
    write_depth(tmp_path, result_of(disparity_px))
    read = read_disparity(tmp_path / "depth.npz")
    for name in ("disparity_px", "confidence", "valid"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))


@pytest.mark.parametrize("kind", [np.int8, np.float16, np.float64, np.complex64, "S4", np.dtype(">f4")])
def test_maps_of_another_kind_are_refused_as_they_lie(tmp_path: Path, kind: object) -> None:
    """A gigabyte of single bytes would become four of real numbers."""
    maps = {"disparity": np.zeros(HW, kind), "confidence": np.zeros(HW, np.float32), "valid": np.zeros(HW, bool)}
    np.savez_compressed(tmp_path / "depth.npz", **maps)
    with pytest.raises(InputError, match="is corrupt: its maps are"):
        read_disparity(tmp_path / "depth.npz")


@pytest.mark.parametrize("hw", [(0, 5), (5,), (2, 2, 2)])
def test_maps_that_are_no_maps_are_refused(tmp_path: Path, hw: tuple[int, ...]) -> None:
    maps = {"disparity": np.zeros(hw, np.float32), "confidence": np.zeros(hw, np.float32), "valid": np.zeros(hw, bool)}
    np.savez_compressed(tmp_path / "depth.npz", **maps)
    with pytest.raises(InputError, match="not of one size"):
        read_disparity(tmp_path / "depth.npz")
