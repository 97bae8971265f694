"""From the photos of a simulated phone to depth in metres, by the commands a user types."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from telewide.calibration.rig_file import StoredRig, read_rig
from telewide.capture.pair import find_captures
from telewide.capture.pfm import read_pfm
from telewide.cli import app
from telewide.errors import InputError, UsageError
from telewide.recipe import load_recipe
from telewide.simulate.phone import write_phone
from telewide.stages.align import alignment_as_json, alignment_from_json
from telewide.stages.prepare import prepare_captures
from telewide.stages.rig import locate_rig
from telewide.stages.run_folder import RunFolder

pytestmark = pytest.mark.slow

CAPTURES = 2


@pytest.fixture(scope="module")
def phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with boards/, captures/ and rig.yaml, as after ``telewide calibrate``."""
    folder = tmp_path_factory.mktemp("phone")
    write_phone(folder, captures=CAPTURES, boards=10, seed=3, width=720)
    words = ["calibrate", str(folder / "boards"), "--board", "chessboard_9x6", "--square-m", "0.025"]
    assert app._exit_code([*words, "--out", str(folder / "rig.yaml"), "-q"]) == 0
    return folder


@pytest.fixture(scope="module")
def stored(phone: Path) -> StoredRig:
    return read_rig(phone / "rig.yaml")


@pytest.fixture(scope="module")
def depths(phone: Path) -> list[dict[str, np.ndarray]]:
    """What ``telewide depth`` writes, with the true depth of every pixel."""
    words = ["depth", str(phone / "captures"), "--run", str(phone / "run"), "--method", "sgm", "-q"]
    assert app._exit_code(words) == 0
    return [_depth_beside_truth(phone, f"{number:03d}", "depth") for number in range(CAPTURES)]


def _depth_beside_truth(phone: Path, name: str, folder: str) -> dict[str, np.ndarray]:
    truth = json.loads((phone / "truth" / "rig.json").read_text())
    with np.load(phone / "run" / folder / name / "depth.npz") as written:
        depth = dict(written)
    disparity_px = read_pfm(phone / "captures" / name / "truth.pfm")
    return {**depth, "truth_m": truth["f_tele_px"] * truth["baseline_m"] / disparity_px}


def test_the_phone_is_found_from_its_board(phone: Path, stored: StoredRig) -> None:
    truth = json.loads((phone / "truth" / "rig.json").read_text())
    assert stored.rig.baseline_m == pytest.approx(truth["baseline_m"], rel=0.02)
    assert stored.rig.asymmetry == pytest.approx(truth["asymmetry"], rel=0.005)
    assert stored.facts.scale_verified


def test_depth_is_in_metres_and_says_how_sure_it_is(depths: list[dict[str, np.ndarray]]) -> None:
    for depth in depths:
        valid = depth["valid"]
        error_m = (depth["depth_m"] - depth["truth_m"])[valid]
        assert np.median(np.abs(error_m) / depth["truth_m"][valid]) < 0.08
        assert np.mean(np.abs(error_m) < 2 * depth["depth_std_m"][valid]) > 0.9
        np.testing.assert_allclose(
            depth["depth_m"][valid],
            depth["K"][0, 0] * depth["baseline_m"] / depth["disparity"][valid],
            rtol=1e-5,
        )


def test_a_known_distance_takes_the_lens_shift_out(phone: Path, depths: list[dict[str, np.ndarray]]) -> None:
    before = depths[0]
    is_sure = before["valid"] & (before["confidence"] > 0.8)
    y, x = np.argwhere(is_sure)[np.count_nonzero(is_sure) // 2]
    ray = np.linalg.solve(before["K"], [x, y, 1])
    distance_m = float(before["truth_m"][y, x] * np.linalg.norm(ray))
    words = ["--run", str(phone / "run"), "--method", "sgm", "-q", "--out", str(phone / "run" / "pinned")]
    words += ["--distance", f"{x},{y},{distance_m}"]
    assert app._exit_code(["depth", str(phone / "captures"), *words]) == 2  # whose photo?
    assert app._exit_code(["depth", str(phone / "captures" / "000"), *words]) == 0
    after = _depth_beside_truth(phone, "000", "pinned")

    def error(depth: dict[str, np.ndarray]) -> float:
        return float(np.median((np.abs(depth["depth_m"] - depth["truth_m"]) / depth["truth_m"])[is_sure]))

    assert error(after) < 0.02
    assert np.nanmedian(after["depth_std_m"]) < np.nanmedian(before["depth_std_m"])


def test_the_focus_that_exif_states_pins_where_it_is_trusted(
    phone: Path, depths: list[dict[str, np.ndarray]], capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy of the captures; one states its focus truly, the others nothing."""
    before = depths[0]
    copied = phone / "focused" / "captures"
    shutil.copytree(phone / "captures", copied)
    shutil.copy(phone / "rig.yaml", phone / "focused" / "rig.yaml")
    middle = tuple(size // 2 for size in before["truth_m"].shape)
    path = copied / "000" / "tele.jpg"
    with Image.open(path) as photo:
        exif = photo.getexif()
        exif.get_ifd(0x8769)[37382] = TiffImagePlugin.IFDRational(float(before["truth_m"][middle]))
        photo.save(copied / "stated.jpg", quality="keep", exif=exif)
    (copied / "stated.jpg").replace(path)
    words = ["--run", str(phone / "focused" / "run"), "--method", "sgm", "--distance", "exif"]
    assert app._exit_code(["depth", str(copied), *words, "--quiet"]) == 0
    assert "001: EXIF states no distance" in capsys.readouterr().err
    record = json.loads((phone / "focused" / "run" / "run.json").read_text())
    assert record["commands"]["depth"]["options"]["trusts_focus"] == ["000"]
    shifts_px = []
    for name, was in zip(("000", "001"), depths, strict=False):
        with np.load(phone / "focused" / "run" / "depth" / name / "depth.npz") as depth:
            shifts_px.append(float(np.nanmedian(np.abs(depth["disparity"] - was["disparity"]))))
            assert np.nanmedian(depth["depth_std_m"]) <= np.nanmedian(was["depth_std_m"]) * 1.001
    assert shifts_px[0] > 0.01
    assert shifts_px[1] < 1e-3


def test_an_alignment_survives_its_file(phone: Path, stored: StoredRig) -> None:
    recipe = load_recipe("default")
    prepared = prepare_captures(find_captures(phone / "captures"), RunFolder(phone / "run"), recipe=recipe, rig=stored)
    for item in prepared.pairs:
        assert item.alignment is not None
        assert item.alignment.refinement.residual_after_px < 0.3 < item.alignment.refinement.residual_before_px
        again = alignment_from_json(
            alignment_as_json(item.alignment), rig=stored.rig, working_width_px=recipe.working_width_px
        )
        points_px = np.array([[3.0, 5.0], [400.0, 300.0]])
        np.testing.assert_array_equal(
            again.geometry.ref_from_tele(points_px), item.alignment.geometry.ref_from_tele(points_px)
        )


def test_a_rig_that_is_not_found_any_more_is_missed(phone: Path, stored: StoredRig, tmp_path: Path) -> None:
    """Photos that were rectified with it are not taken for rectified ones."""
    captures, run, recipe = find_captures(phone / "captures"), RunFolder(tmp_path), load_recipe("default")
    first = dataclasses.replace(captures, captures=captures.captures[:1])
    made = prepare_captures(first, run, recipe=recipe, rig=stored).pairs[0].capture.tele_path.read_bytes()
    with pytest.raises(InputError, match="not found any more"):
        prepare_captures(first, run, recipe=recipe)
    again = prepare_captures(first, run, recipe=recipe, rig=stored).pairs[0].capture.tele_path
    assert again.read_bytes() == made


def test_a_rig_is_found_by_the_captures_or_named(phone: Path, tmp_path: Path) -> None:
    captures = find_captures(phone / "captures")
    assert locate_rig(None, captures) is not None  # beside the captures
    with pytest.raises(UsageError, match=r"nowhere\.yaml"):
        locate_rig(tmp_path / "nowhere.yaml", captures)
    (tmp_path / "other.yaml").write_text("format: 1\nlens: 3\n")
    with pytest.raises(InputError, match=r"other\.yaml"):
        locate_rig(tmp_path / "other.yaml", captures)


def test_a_rig_for_rectified_captures_is_refused(phone: Path) -> None:
    facts = phone / "captures" / "captures.yaml"
    facts.write_text("format: 1\nrectified: true\n")
    try:
        captures = find_captures(phone / "captures")
        assert locate_rig(None, captures) is None
        with pytest.raises(UsageError, match="rectified"):
            locate_rig(phone / "rig.yaml", captures)
        with pytest.raises(UsageError, match=r"no rig file nothere\.yaml") as missing:
            locate_rig(Path("nothere.yaml"), captures)
        assert "leave --rig out" in (missing.value.hint or "")
    finally:
        facts.unlink()


def test_photos_of_another_kind_than_the_calibration_are_refused(
    phone: Path, stored: StoredRig, tmp_path: Path
) -> None:
    of_raw = dataclasses.replace(stored, facts=dataclasses.replace(stored.facts, image_pipeline="raw:Some Phone"))
    with pytest.raises(InputError, match="RAW"):
        prepare_captures(
            find_captures(phone / "captures"), RunFolder(tmp_path), recipe=load_recipe("default"), rig=of_raw
        )
