"""Corrected pairs in the run folder: what is taken as it lies there, and what is made again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from capture.dng import write_dng
from numpy.typing import NDArray
from rig_worlds import phone_rig, photos_of_a_plane

import telewide.stages.prepare
from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, read_rig, write_stored_rig
from telewide.capture.facts import CaptureFacts
from telewide.capture.images import read_image, write_image
from telewide.capture.pair import find_captures, read_pair
from telewide.capture.pfm import read_pfm
from telewide.cli import main
from telewide.correction.rectify import rectify_pair
from telewide.errors import InputError, QualityError
from telewide.files import fingerprint
from telewide.recipe import load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.pairs import PreparedPair, PreparedSet
from telewide.stages.prepare import prepare_captures
from telewide.stages.rig import locate_rig, lying_rig, refuse_without_rig, where_rig_lies
from telewide.stages.run_folder import RunFolder
from telewide.stages.surfaces import surveyor_of, write_surfaces
from telewide.training.options import TrainOptions
from telewide.training.samples import disparity_path


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "captures"
    write_captures(folder, count=2, seed=1, hw=(128, 192), factor=2)
    return folder


def prepared(captures: Path, run: Path, *settings: str) -> PreparedSet:
    recipe = load_recipe("quick", settings=settings)
    return prepare_captures(find_captures(captures), RunFolder(run), recipe=recipe)


@pytest.mark.parametrize(
    ("fault", "needs_rig"), [("cut off", False), ("same", False), ("exchanged", False), ("unlike", True)]
)
def test_a_rig_is_advised_where_it_would_help(tmp_path: Path, fault: str, *, needs_rig: bool) -> None:
    """Not against a photo that cannot be read, one given twice, or exchanged names."""
    tele, wide = np.random.default_rng(3).random((2, 96, 144, 3)).astype(np.float32)
    of_wide = {"same": tele, "unlike": wide[:40], "exchanged": np.kron(wide, np.ones((2, 2, 1), np.float32))}
    path = tmp_path / "captures" / "one" / "wide.png"
    write_image(path.with_name("tele.png"), tele)
    write_image(path, of_wide.get(fault, wide))
    written = path.read_bytes()
    path.write_bytes(written[:500] if fault == "cut off" else written + b"one more")  # files are never the same
    with pytest.raises(InputError, match="no capture can be used") as caught:
        prepared(tmp_path / "captures", tmp_path / "run")
    hint = caught.value.hint or ""
    assert hint.startswith("mend the captures")
    assert ("telewide calibrate" in hint) == needs_rig


def test_a_stopped_preparation_vouches_for_nothing(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made with colour correction, begun again without, stopped; asked for with it again, it is not the other's."""
    run, asked = tmp_path / "run", ("correction.colour=true", "correction.vertical=true")
    wide_path = prepared(captures, run, *asked).pairs[0].capture.wide_path
    expected = read_image(wide_path)

    def stop(*args: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(telewide.stages.prepare, "fit_blur", stop)
        with pytest.raises(KeyboardInterrupt):
            prepared(captures, run, "correction.colour=false", "correction.vertical=false")
    assert not np.array_equal(read_image(wide_path), expected), "the other kind was written before the stop"
    prepared(captures, run, *asked)
    assert np.array_equal(read_image(wide_path), expected)


def test_a_rig_that_is_not_good_enough_is_said_quietly_too(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, captures = phone_rig(width_px=320), tmp_path / "captures"
    for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(captures / "one" / f"{view}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="insufficient")
    write_stored_rig(captures / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    words = ("depth", str(captures), "--run", str(tmp_path / "run"), "--method", "sgm", "--json")
    with pytest.raises(SystemExit):
        main(words)
    assert f"rig: {captures / 'rig.yaml'}" in capsys.readouterr().err.splitlines()
    with pytest.raises(SystemExit):
        main((*words, "--quiet"))
    told = capsys.readouterr()
    assert f"the rig is marked insufficient: telewide show {captures / 'rig.yaml'} says" in told.err
    assert any("marked insufficient" in warning for warning in json.loads(told.out)["warnings"])


def test_exchanged_photos_are_refused_with_a_rig_too(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, captures = phone_rig(width_px=640), tmp_path / "captures"
    for view, photo in zip(("wide", "tele"), photos_of_a_plane(rig, rng), strict=True):
        write_image(captures / "one" / f"{view}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    write_stored_rig(captures / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    with pytest.raises(SystemExit) as left:
        main(("depth", str(captures), "--run", str(tmp_path / "run"), "--method", "sgm"))
    assert left.value.code == 4
    told = capsys.readouterr().err
    assert "one: the views look swapped" in told
    assert "digital zoom" not in told


def test_a_set_without_matches_says_where_its_reports_lie(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    for view in ("tele", "wide"):
        noise = rng.random((96, 128, 3)).astype(np.float32)
        write_image(tmp_path / "captures" / "one" / f"{view}.png", noise)
    with pytest.raises(SystemExit) as left:
        main(("depth", str(tmp_path / "captures"), "--run", str(tmp_path / "run"), "--method", "sgm"))
    assert left.value.code == 3
    told = capsys.readouterr().err
    assert str(tmp_path / "run" / "pairs" / "one" / "pair.json") in told
    assert (tmp_path / "run" / "pairs" / "one" / "pair.json").is_file()


def test_photos_that_fail_and_those_that_are_kept_are_counted_by_their_names(captures: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(captures, tmp_path / "captures"))
    (root / "001" / "wide.png").write_bytes(b"no picture")
    done: list[tuple[str, bool]] = []

    def tick(name: str, *, is_kept: bool) -> None:
        done.append((name, is_kept))

    for _ in range(2):
        prepare_captures(find_captures(root), RunFolder(tmp_path / "run"), recipe=load_recipe("quick"), tick=tick)
    assert done == [("000", False), ("001", False), ("000", True), ("001", False)]


def test_where_the_photos_of_a_rectified_pair_reach_lies_beside_it(
    tmp_path: Path, rng: np.random.Generator, repo: Path
) -> None:
    rig, recipe, run = phone_rig(width_px=480), load_recipe("quick"), RunFolder(tmp_path / "run")
    for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(tmp_path / "captures" / "one" / f"{view}.png", photo)
    found = find_captures(tmp_path / "captures")
    stored = dataclasses.replace(read_rig(repo / "calib" / "rigs" / "example_phone.yaml"), rig=rig, facts=RigFacts())

    def made() -> PreparedPair:
        (pair,) = prepare_captures(found, run, recipe=recipe, rig=stored).pairs
        return pair

    pair = made()
    assert pair.alignment is not None
    photos = (read_image(path) for path in (pair.source.tele_path, pair.source.wide_path))
    expected = rectify_pair(*photos, rig=pair.alignment.geometry.rig, working_width_px=recipe.working_width_px).pair
    valid = read_pair(pair.capture).valid
    assert valid is not None
    assert expected.valid is not None
    assert 0.5 < valid.ref.mean() < 1
    np.testing.assert_array_equal(valid.ref, expected.valid.ref)
    np.testing.assert_array_equal(valid.src, expected.valid.src)
    points_px = np.round(pair.held_out.ref_px).astype(int)
    assert len(points_px) > 20
    assert valid.ref[points_px[:, 1], points_px[:, 0]].all(), "judged by what no photo shows"
    mask, record = run.pairs / "one" / "tele_valid.png", run.pairs / "one" / "pair.json"
    written = mask.read_bytes()
    mask.unlink()
    assert read_pair(made().capture).valid is not None
    assert mask.read_bytes() == written
    write_image(mask, np.ones((64, 48), np.float32))
    record.write_text(record.read_text().replace(hashlib.sha256(written).hexdigest(), fingerprint(mask)))
    made()
    assert mask.read_bytes() == written, "a mask of another size, though the record vouches for it"


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("tele.png", "cut"),
        ("wide.png", "flipped"),
        ("matches.npz", "cut"),
        ("matches.npz", "flipped"),
        ("pair.json", "empty"),
        ("tele.png", "gone"),
    ],
)
def test_kept_files_that_are_corrupt_are_made_again(captures: Path, tmp_path: Path, name: str, fault: str) -> None:
    run = tmp_path / "run"
    first = prepared(captures, run)
    path = run / "pairs" / first.pairs[0].capture.name / name
    whole = path.read_bytes()
    if fault == "gone":
        path.unlink()
    elif fault == "flipped":
        middle = len(whole) // 2
        path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :])
    else:
        path.write_bytes(whole[: len(whole) // 2 if fault == "cut" else 0])
    again = prepared(captures, run)
    assert again.problems == ()
    assert again.pairs[0].report == first.pairs[0].report
    np.testing.assert_array_equal(again.pairs[0].held_out.ref_px, first.pairs[0].held_out.ref_px)
    if name.endswith(".png"):
        assert path.read_bytes() == whole


def test_surfaces_that_were_cut_off_are_written_again(captures: Path, tmp_path: Path) -> None:
    pairs = prepared(captures, tmp_path / "run")
    path = disparity_path(pairs.pairs[0].capture.tele_path.parent, window_px=(0, 32))
    names = [pairs.pairs[0].capture.name]
    write_surfaces(pairs, names=names, window=(0, 32))
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    write_surfaces(pairs, names=names, window=(0, 32))
    assert path.read_bytes() == whole


def test_surfaces_of_another_window_are_not_taken(captures: Path, tmp_path: Path) -> None:
    pairs = prepared(captures, tmp_path / "run")
    folder = pairs.pairs[0].capture.tele_path.parent
    for end_px in (8, 32):
        write_surfaces(pairs, names=[pairs.pairs[0].capture.name], window=(0, end_px))
    narrow_px, wide_px = (read_pfm(disparity_path(folder, window_px=(0, end_px))) for end_px in (8, 32))
    assert np.nanmax(narrow_px) <= 8
    assert np.nanmax(wide_px) > 10


def test_a_training_from_the_box_is_surveyed_by_it(captures: Path, tmp_path: Path) -> None:
    """Its surfaces lie beside those of semi-global matching, known everywhere and right in most of the picture."""
    pairs = prepared(captures, tmp_path / "run")
    item, surveyor = pairs.pairs[0], surveyor_of(TrainOptions(start="box"))
    by_box, by_sgm = (
        disparity_path(item.capture.tele_path.parent, window_px=(0, 32), surveyor=name) for name in (surveyor, "")
    )
    write_surfaces(pairs, names=[item.capture.name], window=(0, 32), surveyor=surveyor)
    assert by_box.is_file()
    assert not by_sgm.exists()
    truth_px, surface_px = read_pfm(captures / item.capture.name / "truth.pfm"), read_pfm(by_box)
    assert np.isfinite(surface_px).all()
    assert np.mean(np.abs(surface_px - truth_px)[np.isfinite(truth_px)] < 1) > 0.75
    assert surveyor_of(TrainOptions(start="scratch")) == ""


def test_pairs_whose_rows_disagree_are_refused_by_what_was_measured(captures: Path, tmp_path: Path) -> None:
    """None left is no bad input but a matter of quality; beside a good pair it is a problem like another."""
    shutil.copytree(captures, tmp_path / "captures")
    for number, name in enumerate(("000", "001")):
        path = tmp_path / "captures" / name / "wide.png"
        write_image(path, np.roll(read_image(path), 2, axis=0))  # of 64 rows
        if number == 0:
            some = prepared(tmp_path / "captures", tmp_path / "run")
            assert [pair.source.name for pair in some.pairs] == ["001"]
            assert ["rows disagree" in problem.message for problem in some.problems] == [True]
    with pytest.raises(QualityError, match="rows disagree by up to") as caught:
        prepared(tmp_path / "captures", tmp_path / "run")
    assert caught.value.exit_code == 4


@pytest.mark.parametrize("stated", ["f_px: 200.0", "doffs_px: 3.0", "asymmetry: 2.0"])
def test_pixels_that_are_stated_of_photos_of_several_sizes_are_doubted(
    captures: Path, tmp_path: Path, stated: str
) -> None:
    shutil.copytree(captures, tmp_path / "captures")
    shutil.copytree(captures / "000", tmp_path / "captures" / "002")
    for path in (tmp_path / "captures" / "001").glob("*.png"):
        write_image(path, read_image(path)[:-32, :-48])
    (tmp_path / "captures" / "001" / "truth.pfm").unlink()
    (tmp_path / "captures" / "captures.yaml").write_text(f"rectified: true\n{stated}\n")
    problems = prepared(tmp_path / "captures", tmp_path / "run").problems
    told = [problem.message for problem in problems if problem.name == "001" and not problem.is_skipped]
    assert any("its tele photo is 144 x 96 px, most are 192 x 128 px" in one for one in told) == ("px" in stated)


def test_a_photo_that_cannot_be_read_leaves_the_others(captures: Path, tmp_path: Path) -> None:
    found = find_captures(captures)
    gone = found.captures[0].tele_path
    kept = gone.read_bytes()
    gone.unlink()
    try:
        pairs = prepare_captures(found, RunFolder(tmp_path / "run"), recipe=load_recipe("quick"))
    finally:
        gone.write_bytes(kept)
    assert [item.capture.name for item in pairs.pairs] == [found.captures[1].name]
    assert [problem.name for problem in pairs.problems] == [found.captures[0].name]


def test_a_stated_window_that_cuts_disparities_off_is_told(captures: Path, tmp_path: Path) -> None:
    wide, narrow = (prepared(captures, tmp_path / "run", f"window_px={window}") for window in ("[-32, 96]", "[0, 12]"))
    assert wide.problems == ()
    assert {problem.name for problem in narrow.problems} == {"000", "001"}
    assert not any(problem.is_skipped for problem in narrow.problems)
    assert all("window_px: [0, 12]" in problem.message for problem in narrow.problems)
    assert len(narrow.pairs) == 2


def test_what_was_searched_before_is_searched_again_and_what_new_pairs_need_besides(
    captures: Path, tmp_path: Path
) -> None:
    measured = prepared(captures, tmp_path / "run")
    first, end = measured.window
    assert measured.window_with(None) == measured.window
    assert measured.window_with((first + 4, first + 12)) == measured.window
    assert measured.window_with((first - 40, end - 4)) == (first - 40, end)
    assert prepared(captures, tmp_path / "run", "window_px=[0, 12]").window_with((0, 96)) == (0, 12)
    report = dataclasses.replace(measured.pairs[0].report, n_matches=0)
    blank = dataclasses.replace(measured, pairs=(dataclasses.replace(measured.pairs[0], report=report),))
    assert blank.window_with((0, 32)) == (0, 32)
    with pytest.raises(InputError):
        blank.window_with(None)


@pytest.mark.parametrize("name", ["rig.yaml", "rig.yml", "Rig.YAML"])
def test_a_rig_is_found_by_any_spelling_of_its_name(captures: Path, tmp_path: Path, repo: Path, name: str) -> None:
    shutil.copy(repo / "calib" / "rigs" / "example_phone.yaml", tmp_path / name)
    found = dataclasses.replace(find_captures(captures), root=tmp_path, facts=CaptureFacts())
    assert locate_rig(None, found) is not None


@pytest.mark.parametrize("above", [0, 1, 2])
def test_a_rig_from_outside_the_captures_folder_is_named_by_its_path(
    above: int, captures: Path, tmp_path: Path, repo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "deep" / "captures"
    shutil.copytree(captures, root)
    rig = (root, *root.parents)[above] / "rig.yaml"
    shutil.copy(repo / "calib" / "rigs" / "example_phone.yaml", rig)
    monkeypatch.chdir(tmp_path)
    found = find_captures(Path("deep/captures"))
    lying = lying_rig(found)
    assert lying is not None
    told = where_rig_lies(lying, found, is_stated=False)
    if above:
        assert told.startswith(f"{rig}, found outside deep/captures; ")
        assert "--rig" in told
    else:
        assert told == "deep/captures/rig.yaml"
    assert where_rig_lies(rig, found, is_stated=True) == str(rig)


def test_captures_stated_as_not_rectified_get_no_depth_without_a_rig(captures: Path) -> None:
    found = find_captures(captures)
    for rectified in (True, None):
        stated = dataclasses.replace(found, facts=found.facts.model_copy(update={"rectified": rectified}))
        refuse_without_rig(stated, rig=None)
    stated = dataclasses.replace(found, facts=found.facts.model_copy(update={"rectified": False}))
    with pytest.raises(InputError, match="states that the captures are not rectified"):
        refuse_without_rig(stated, rig=None)


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("pair.json", "", "[" * 100_000),
        ("pair.json", '"n_matches": ', '"n_matches": 1e400, "m": '),
        ("pair.json", '"n_matches": ', '"n_matches": "many", "m": '),
        ("pair.json", '"verdict": ', '"verdict": [], "v": '),
        ("pair.json", '"colour_ratio": [', '"colour_ratio": [[], '),
        ("pair.json", '"scale": ', '"scale": [], "s": '),
        ("pair.json", '"scale": ', '"scale": 1e-300, "s": '),
        ("pair.json", '"disparity_p98_px": ', '"disparity_p98_px": 1e300, "disparity_p02_px": '),
        ("matches.npz", "", "garbage"),
        ("tele.png", "", "garbage"),
    ],
)
def test_a_pair_that_cannot_be_read_is_made_again(
    captures: Path, tmp_path: Path, name: str, before: str, after: str
) -> None:
    made = prepared(captures, tmp_path / "run").pairs[0]
    path = made.capture.tele_path.with_name(name)
    whole = path.read_bytes()
    assert before.encode() in whole
    path.write_bytes(whole.replace(before.encode(), after.encode()) if before else after.encode())
    again = prepared(captures, tmp_path / "run").pairs[0]
    assert again.report == made.report
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    "points", [np.full((9, 2), 1e300), np.full((9, 2), np.nan), np.ones((9, 2), bool), np.ones((9, 2), complex)]
)
def test_matches_that_lie_in_no_picture_are_made_again(
    captures: Path, tmp_path: Path, points: NDArray[np.generic]
) -> None:
    """Though the record vouches for them."""
    made = prepared(captures, tmp_path / "run").pairs[0]
    path, record = (made.capture.tele_path.with_name(name) for name in ("matches.npz", "pair.json"))
    whole, before = path.read_bytes(), fingerprint(path)
    np.savez(path, held_out_ref_px=points, held_out_src_px=points, fitted_ref_px=points, fitted_src_px=points)
    record.write_text(record.read_text().replace(before, fingerprint(path)))
    prepared(captures, tmp_path / "run")
    assert path.read_bytes() == whole


@pytest.mark.parametrize("name", ["tele.png", "wide.png"])
def test_a_pair_of_another_size_than_its_photos_is_made_again(captures: Path, tmp_path: Path, name: str) -> None:
    """Though the record vouches for it: matching takes as long as it is large."""
    made = prepared(captures, tmp_path / "run").pairs[0]
    path, record = (made.capture.tele_path.with_name(name) for name in (name, "pair.json"))
    whole, before = path.read_bytes(), fingerprint(path)
    write_image(path, np.full((640, 900, 3), 0.5, np.float32))
    record.write_text(record.read_text().replace(before, fingerprint(path)))
    prepared(captures, tmp_path / "run")
    assert path.read_bytes() == whole


def test_a_raw_photo_whose_tags_state_another_size_than_it_has_is_kept(captures: Path, tmp_path: Path) -> None:
    """Its crop reaches beyond the sensor, so that nothing is cropped."""
    for view in ("tele", "wide"):
        (tmp_path / "raw" / "one").mkdir(parents=True, exist_ok=True)
        mosaic = np.ascontiguousarray(read_image(captures / "000" / f"{view}.png")[:, :, 1])
        write_dng(tmp_path / "raw" / "one" / f"{view}.dng", mosaic, crop=(0, 0, 500, 500))
    (tmp_path / "raw" / "captures.yaml").write_text("rectified: true\n")
    path = prepared(tmp_path / "raw", tmp_path / "run").pairs[0].capture.tele_path
    before = path.stat().st_mtime_ns
    prepared(tmp_path / "raw", tmp_path / "run")
    assert path.stat().st_mtime_ns == before


def test_surfaces_that_cannot_be_read_are_made_again(captures: Path, tmp_path: Path) -> None:
    pairs = prepared(captures, tmp_path / "run")
    name, folder = pairs.pairs[0].capture.name, pairs.pairs[0].capture.tele_path.parent
    write_surfaces(pairs, names=[name], window=(0, 32))
    path = disparity_path(folder, window_px=(0, 32))
    whole = path.read_bytes()
    for corrupt in (b"garbage", whole[:-4], b"Pf\n1 1\n-1\n\0\0\0\0"):
        path.write_bytes(corrupt)
        write_surfaces(pairs, names=[name], window=(0, 32))
        assert path.read_bytes() == whole
