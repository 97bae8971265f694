"""What ``telewide depth`` leaves with where its metres mean nothing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.capture.images import read_image, write_image
from telewide.cli import main
from telewide.cli.console import console_observer, hand_over
from telewide.cli.depth import depth_as_json, why_not_good
from telewide.errors import QualityError
from telewide.simulate.captures import write_captures
from telewide.stages.capture_depth import DepthOutcome
from telewide.stages.depth import DepthRun

VIEWS = ("tele", "wide")


def run_of(*withheld: str | None) -> DepthRun:
    outcomes = (DepthOutcome(f"{k:03d}", (), (), {}, withheld=why) for k, why in enumerate(withheld))
    return DepthRun(Path("run/depth"), tuple(outcomes), ())


def test_results_are_good_as_long_as_one_capture_has_what_its_rig_promises() -> None:
    assert why_not_good(run_of(None, None)) is None
    assert why_not_good(run_of("no metres", None)) is None
    failure = why_not_good(run_of("no metres", "no metres"))
    assert failure is not None
    assert failure.exit_code == 4
    assert "run/depth" in failure.message
    assert failure.message.endswith("no metres")
    assert "--distance" in str(failure.hint)
    rectified = why_not_good(replace(run_of("no metres"), has_rig=False))
    assert rectified is not None
    assert "--distance" not in str(rectified.hint), "which needs a rig"


def test_json_says_what_the_exit_code_means(capsys: pytest.CaptureFixture[str]) -> None:
    done = run_of("no metres")
    failure = why_not_good(done)
    with console_observer(is_quiet=True) as observer:
        plain, whole = depth_as_json(done, observer), depth_as_json(run_of(None), observer)
    with pytest.raises(QualityError):
        hand_over(plain, failure=failure, as_json=False)
    with pytest.raises(typer.Exit) as left:
        hand_over(plain, failure=failure, as_json=True)
    assert left.value.exit_code == 4
    told = json.loads(capsys.readouterr().out)
    assert told["exit_code"] == 4
    assert told["captures"][0]["withheld"] == "no metres"
    hand_over(whole, failure=None, as_json=True)
    assert "exit_code" not in json.loads(capsys.readouterr().out)


def test_a_known_distance_gives_an_aperture_to_a_rig_of_unknown_scale(tmp_path: Path, rng: np.random.Generator) -> None:
    rig, one = phone_rig(width_px=320), tmp_path / "captures" / "one"
    for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(one / f"{view}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    unknown = StoredRig(replace(rig, is_scale_known=False), None, None, None, quality, RigFacts())
    write_stored_rig(tmp_path / "captures" / "rig.yaml", unknown)
    words = ("depth", str(tmp_path / "captures"), "--run", str(tmp_path / "run"), "--method", "sgm", "--bokeh")
    codes = []
    for distance in ((), ("--distance", "160,120,1.5")):
        with pytest.raises(SystemExit) as left:
            main((*words, "--f-number", "1.8", *distance))
        codes.append(left.value.code or 0)
    assert codes == [2, 0]
    assert (tmp_path / "run" / "depth" / "one" / "bokeh.jpg").is_file()


@pytest.mark.parametrize("orientation", [*(pytest.param(held, marks=pytest.mark.slow) for held in (3, 8)), 6])
def test_a_distance_counts_on_the_photo_that_exif_turns(
    tmp_path: Path, rng: np.random.Generator, orientation: int
) -> None:
    """The point lies far from where the sensor's own columns and rows would have it, by 6 and 8 outside of them."""
    rig, at_px, distance_m = phone_rig(width_px=320), (300, 25), 1.7
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    photos = {
        view: np.round(255 * p).astype(np.uint8) for view, p in zip(VIEWS, photos_of_a_plane(rig, rng), strict=True)
    }
    depths_m = []
    for name, stated, n_turns in (("upright", 1, 0), ("turned", orientation, {3: 2, 6: 1, 8: 3}[orientation])):
        folder, exif = tmp_path / name / "captures", Image.Exif()
        (folder / "one").mkdir(parents=True)
        exif[274] = stated
        for view, photo in photos.items():
            Image.fromarray(np.rot90(photo, k=n_turns)).save(folder / "one" / f"{view}.png", exif=exif)
        write_stored_rig(folder / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
        words = ("depth", str(folder), "--run", str(tmp_path / name / "run"), "--method", "sgm")
        with pytest.raises(SystemExit) as left:
            main((*words, "--distance", f"{at_px[0]},{at_px[1]},{distance_m}"))
        assert not left.value.code
        with np.load(tmp_path / name / "run" / "depth" / "one" / "depth.npz") as made:
            depths_m.append(made["depth_m"])
            ray = np.linalg.solve(made["K"], [*at_px, 1.0])
    np.testing.assert_array_equal(*depths_m)
    found_m = np.median(depths_m[1][at_px[1] - 2 : at_px[1] + 3, at_px[0] - 2 : at_px[0] + 3]) * np.linalg.norm(ray)
    assert 1.6 < found_m < distance_m, "drawn from the 1.5 m that the rig sees; how far, its deviation says"


def test_files_that_are_asked_for_by_name(tmp_path: Path, rng: np.random.Generator) -> None:
    rig = phone_rig(width_px=320)
    for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(tmp_path / "captures" / "one" / f"{view}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    write_stored_rig(tmp_path / "captures" / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    words = ("depth", str(tmp_path / "captures"), "--run", str(tmp_path / "run"), "--method", "sgm")
    codes = []
    for formats in (("--format", "mm,grey", "--format", "tiff"), ("--format", "jpeg2000")):
        with pytest.raises(SystemExit) as left:
            main((*words, *formats))
        codes.append(left.value.code or 0)
    assert codes == [0, 2]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert 'data-scene="one"' in page
    assert "0.012" in page.partition('"metric"')[2][:120]  # the distance of the lenses, m
    made = {path.name for path in (tmp_path / "run" / "depth" / "one").iterdir()}
    grey = {"photo.jpg", "photo_depth.png", "photo_depth_16.png"}
    assert made == {"depth.npz", "depth_mm.png", "depth.tif", "preview.png", "depth.json"} | grey


def test_run_without_a_network_trains_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    rig, one = phone_rig(width_px=320), tmp_path / "captures" / "one"
    for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng), strict=True):
        write_image(one / f"{view}.png", photo)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    write_stored_rig(tmp_path / "captures" / "rig.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    words = ("run", str(tmp_path / "captures"), "--out", str(tmp_path / "run"), "--method", "sgm")
    codes = []
    for more in ((), ("--device", "cuda")):
        with pytest.raises(SystemExit) as left:
            main((*words, *more))
        codes.append(left.value.code or 0)
    assert codes == [0, 2]
    assert not (tmp_path / "run" / "train" / "weights.safetensors").exists()
    assert (tmp_path / "run" / "depth" / "one" / "bokeh.jpg").is_file()
    assert 'data-scene="one"' in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def scenes_of(page: Path) -> list[str]:
    return re.findall(r'data-scene="([^"]*)"', page.read_text(encoding="utf-8"))


def test_a_page_goes_on_showing_what_former_calls_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    captures, page = tmp_path / "captures", tmp_path / "run" / "report.html"
    write_captures(captures, count=3, seed=1, hw=(96, 144), factor=2)
    calls: list[tuple[Path, tuple[str, ...], list[str]]] = [
        (captures, ("--bokeh", "--focus", "far"), ["000", "001", "002"]),
        (captures, ("--only", "001", "--format", "grey"), ["000", "001", "002"]),
        (captures / "002", ("--bokeh",), ["000", "001", "002"]),
    ]
    for place, words, shown in calls:
        depth(place, tmp_path / "run", *words)
        assert scenes_of(page) == shown
        assert "more lie in" not in capsys.readouterr().err
    write_image(captures / "000" / "tele.png", np.full((96, 144, 3), 0.5, np.float32))
    depth(captures / "002", tmp_path / "run", "--bokeh", "--focus", "near")
    assert scenes_of(page) == ["001", "002"], "of the other the photo has changed"
    said = " ".join(capsys.readouterr().err.split())
    assert "shows what this call was given and 1 of former calls; 1 more lie in" in said
    assert f"to see all: telewide depth {captures} --run" in said


def test_a_page_of_one_of_many_names_the_call_that_shows_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    captures, page = tmp_path / "captures", tmp_path / "run" / "report.html"
    write_captures(captures, count=13, seed=1, hw=(64, 96), factor=2)
    depth(captures, tmp_path / "run")
    assert len(scenes_of(page)) == 12
    capsys.readouterr()
    depth(captures, tmp_path / "run", "--only", "001", "--format", "grey")
    assert scenes_of(page) == ["001"]
    said = " ".join(capsys.readouterr().err.split())
    assert "shows what this call was given; 12 more lie in" in said
    assert f"to see all: telewide depth {captures} --run" in said
    assert "--only" not in said.partition("to see all")[2].partition("depth of")[0]


def test_another_bokeh_leaves_the_depth_files_and_a_picture_that_cannot_be_made_the_earlier_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A PNG has no linear light for an EXR."""
    captures, run = tmp_path / "captures", tmp_path / "run"
    write_captures(captures, count=1, seed=1, hw=(96, 144), factor=2)
    depth(captures, run, "--bokeh", "--format", "mm,tiff,grey", "--strip")
    made = {path.name: path.read_bytes() for path in (run / "depth" / "000").iterdir()}
    assert {"bokeh.jpg", "photo_depth.png"} <= made.keys()
    capsys.readouterr()
    depth(captures, run, "--bokeh", "--picture", "exr")
    assert "bokeh.exr left out" in capsys.readouterr().err
    for words in ((), ("--bokeh", "--focus", "near")):
        depth(captures, run, *words)
        now = {path.name: path.read_bytes() for path in (run / "depth" / "000").iterdir()}
        assert now.keys() == made.keys()
        assert [name for name in now if now[name] != made[name] and name not in {"bokeh.jpg", "depth.json"}] == []
        assert (now["bokeh.jpg"] != made["bokeh.jpg"]) is bool(words)
    depth(captures, run, "--format", "pfm")
    assert {path.name for path in (run / "depth" / "000").iterdir()} == {
        *("bokeh.jpg", "depth.json", "depth.npz", "disparity.pfm", "preview.png")
    }


def test_another_bokeh_makes_the_kinds_of_picture_anew_that_lie_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The TIFF of a call shows what its JPEG shows, whose pixels are those of no other call."""
    captures, run = tmp_path / "captures", tmp_path / "run"
    write_captures(captures, count=1, seed=1, hw=(96, 144), factor=2)
    folder, tries = run / "depth" / "000", ("near", "far", "auto")
    depth(captures, run, "--bokeh", "--picture", "jpg,tif", "--strength", "6", "--focus", tries[0])
    shown = []
    for focus in tries:
        capsys.readouterr()
        depth(captures, run, "--bokeh", "--strength", "6", "--focus", focus)
        told = capsys.readouterr().err
        assert "measuring and correcting" not in told, "nor is it matched again"
        assert "depth (sgm)" not in told
        shown.append([read_image(folder / name) for name in ("bokeh.jpg", "bokeh.tif")])
    for k, (jpg, tif) in enumerate(shown):
        off = [float(np.abs(jpg - other[1]).mean()) for other in shown]
        assert int(np.argmin(off)) == k
        assert np.abs(jpg - tif).mean() < 0.02
    depth(captures, run, "--bokeh", "--preview")
    assert f"to look at: {folder / 'bokeh_preview.jpg'}\n" in capsys.readouterr().err
    assert {path.name for path in folder.glob("bokeh*")} == {"bokeh.jpg", "bokeh.tif", "bokeh_preview.jpg"}
    depth(captures, run, "--bokeh", "--picture", "jpg")
    (folder / "bokeh.tif").write_bytes(b"mine")
    depth(captures, run, "--bokeh", "--focus", "far")
    assert (folder / "bokeh.tif").read_bytes() == b"mine", "no bokeh of telewide's lay there"


def depth(captures: Path, run: Path, *words: str) -> None:
    """Call ``telewide depth``."""
    with pytest.raises(SystemExit) as left:
        main(("depth", str(captures), "--run", str(run), "--method", "sgm", *words))
    assert not left.value.code
