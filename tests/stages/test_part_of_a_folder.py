"""A call on a part of a folder keeps what a call on the whole has made: the bytes of the files tell."""

from __future__ import annotations

import hashlib
import html
import json
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane

from telewide.assets import BOX_WEIGHTS as BOX
from telewide.bokeh.picture import BokehOptions
from telewide.calibration.quality import CalibrationQuality, Check
from telewide.calibration.rig_file import RigFacts, StoredRig, write_stored_rig
from telewide.calibration.scene_quality import ZERO_CHECK
from telewide.capture.images import write_image
from telewide.cli import main
from telewide.stages.kept_depth import OF_SET, KeptDepth, of_set, read_kept, write_kept
from telewide.stages.lying_depth import lying_depths, names_lying
from telewide.stages.provenance import made_by, notes_of

Said = Callable[..., str]
QUALITY = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three captures at such distances that one alone asks for another window; depth and bokeh of all."""
    folder, rig, rng = tmp_path_factory.mktemp("whole"), phone_rig(width_px=320), np.random.default_rng(1)
    for name, depth_m in (("000", 0.2), ("001", 1.0), ("002", 3.0)):
        for view, photo in zip(("tele", "wide"), photos_of_a_plane(rig, rng, depth_m=depth_m), strict=True):
            write_image(folder / "captures" / name / f"{view}.png", photo)
    write_stored_rig(folder / "captures" / "rig.yaml", StoredRig(rig, None, None, None, QUALITY, RigFacts()))
    depth(folder, "captures", "--bokeh")
    (folder / "captures").rename(folder / "photos")  # where a copy would take them for other photos
    return folder


def depth(folder: Path, captures: str, *words: str) -> None:
    """Call ``telewide depth``."""
    with pytest.raises(SystemExit) as left:
        main(("depth", str(folder / captures), "--run", str(folder / "run"), "--method", "sgm", *words))
    assert not left.value.code


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    copy = Path(shutil.copytree(whole, tmp_path / "copy"))
    (copy / "photos").rename(copy / "captures")
    return copy


@pytest.fixture
def said(folder: Path, capsys: pytest.CaptureFixture[str]) -> Said:
    """Messages of a call of ``telewide depth``."""

    def call(captures: str, *words: str) -> str:
        depth(folder, captures, *words)
        return " ".join(capsys.readouterr().err.split())

    return call


def npz_of(folder: Path) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in sorted((folder / "run" / "depth").glob("*/depth.npz"))}


def facts_of(folder: Path, name: str) -> object:
    return json.loads((folder / "run" / "depth" / name / "depth.json").read_text())["key"][OF_SET]["facts"]


def test_a_call_on_one_of_a_folder_matches_nothing_again(folder: Path, said: Said) -> None:
    part = ("captures", "--only", "002")
    before, bokeh = npz_of(folder), (folder / "run" / "depth" / "002" / "bokeh.jpg").read_bytes()
    told = said(*part, "--bokeh", "--preview", "--focus", "160,120", "--f-number", "2")
    assert "not matched again: 1 of 1 capture" in told
    assert npz_of(folder) == before
    assert (folder / "run" / "depth" / "002" / "bokeh.jpg").read_bytes() == bokeh
    assert "not matched again: 1 of 1 capture" in said(*part, "--bokeh", "--focus", "near")
    told = said("captures", "--bokeh")
    assert "kept as they were: 2 of 3 captures" in told
    assert "not matched again: 1 of 3 captures" in told
    assert npz_of(folder) == before


def test_depth_of_one_alone_is_made_again_with_the_others(folder: Path, said: Said) -> None:
    """Also that one of these captures alone asks for something else than all of them do."""
    before, together = npz_of(folder), facts_of(folder, "002")
    shutil.rmtree(folder / "run" / "depth" / "002")
    said("captures/002", "--bokeh")
    assert facts_of(folder, "002") != together
    assert "kept as they were: 2 of 3 captures" in said("captures", "--bokeh")
    assert facts_of(folder, "002") == together
    assert npz_of(folder) == before


def test_a_rig_less_sure_of_its_zero_makes_one_again_as_well(folder: Path, said: Said) -> None:
    """The doubt adds up with how far the lenses move, which is of the set; by itself it is of each capture."""
    unsure = Check(ZERO_CHECK, "pass", 0.3, limit=5.0, advice="")
    rig = StoredRig(phone_rig(width_px=320), None, None, None, replace(QUALITY, checks=(unsure,)), RigFacts())
    write_stored_rig(folder / "captures" / "rig.yaml", rig)
    before = npz_of(folder)
    told = said("captures/002", "--bokeh")
    assert "kept as they were" not in told
    assert "not matched again" not in told
    assert npz_of(folder)["002"] != before["002"]


@pytest.mark.parametrize(
    ("captures", "window", "is_kept"),
    [
        (("a", "b"), 32, True),
        (("a", "b"), 36, False),
        (("a", "b", "c"), 32, True),
        (("a", "b", "c"), 36, False),
        (("a",), 36, True),
        (("a", "c"), 36, True),
    ],
)
def test_facts_of_a_set_count_where_all_of_it_is_there(
    tmp_path: Path, captures: tuple[str, ...], window: int, is_kept: bool
) -> None:
    write_kept(tmp_path, KeptDepth((), (), {}), key={"tele": "x", OF_SET: of_set(("b", "a"), {"window": (0, 32)})})
    asked = of_set(captures, {"window": (0, window)})
    assert (read_kept(tmp_path, {"tele": "x", OF_SET: asked}) is not None) == is_kept
    assert read_kept(tmp_path, {"tele": "y", OF_SET: asked}) is None
    assert read_kept(tmp_path, {"tele": "x"}) is None


def test_a_bokeh_that_was_not_stripped_is_named_beside_stripped_files(folder: Path, said: Said) -> None:
    still_there = "002: made without --strip and still there, with facts of the photo: bokeh.jpg; --bokeh --strip"
    one = ("captures", "--only", "002")
    assert still_there in said(*one, "--format", "grey", "--strip")
    assert still_there in said(*one, "--format", "grey", "--strip"), "as long as it lies there"
    assert still_there in said(*one, "--bokeh", "--preview", "--strip")
    assert "still there" not in said(*one, "--format", "grey"), "nothing was to be stripped"
    assert "still there" not in said(*one, "--bokeh", "--strip")
    assert "still there" not in said(*one, "--format", "grey", "--strip"), "it is stripped as well"
    assert (folder / "run" / "depth" / "002" / "bokeh.jpg").is_file()


@pytest.mark.parametrize("part", [("captures/002",), ("captures", "--only", "002")])
def test_what_next_names_the_capture_that_is_shown(folder: Path, said: Said, part: tuple[str, ...]) -> None:
    """After a call on one, beside which the page shows the others; each command is taken, and makes that capture's."""
    said("captures", "--bokeh", "--strength", "2")  # from the copies of the photos
    said(*part, "--bokeh", "--strength", "3")
    page = (folder / "run" / "report.html").read_text()
    found = re.findall(r'<script type="application/json" data-scene="(\d+)">(.*?)</script>', page, re.DOTALL)
    calls = {name: [shlex.split(call)[1:] for call in json.loads(told)["next"]] for name, told in found}
    assert sorted(calls) == ["000", "001", "002"]
    assert [words[1] for words in calls["002"]] == [str(folder / part[0])] * 2
    for name in ("000", "001"):
        for words in calls[name]:
            assert words[:2] == ["depth", str(folder / "captures")]
            assert words[words.index("--only") + 1] == name
            assert "--strength" not in words, "the bokeh of a former call is none of this one's"
    with pytest.raises(SystemExit) as left:
        main(calls["001"][0])
    assert not left.value.code
    focus = {name: read_kept_focus(folder, name) for name in calls}
    assert focus == {"000": "auto", "001": "near", "002": "auto"}


def read_kept_focus(folder: Path, name: str) -> object:
    return json.loads((folder / "run" / "depth" / name / "depth.json").read_text())["key"]["bokeh"]["focus"]


def test_the_page_says_what_made_each_depth_and_what_was_said_of_it(folder: Path, said: Said) -> None:
    """Fingerprints are those of the files, by hashlib; a doubt about photos is told with their capture alone."""
    pair = folder / "run" / "pairs" / "001" / "pair.json"
    doubted = json.loads(pair.read_text())
    doubted["report"]["reasons"] = ["its rows lie apart, see `rig`"]
    told = said("captures", "--bokeh", "--focus", "near")
    page = (folder / "run" / "report.html").read_text()
    focused = re.findall(r"(00\d): (the bokeh was focused on x .*? px )", told)
    assert len(focused) == 3
    for _, words in focused:
        assert page.count(html.escape(words)) >= 1, "with the pictures"
    assert page.count("Matched by sgm, telewide") == 6, "of each capture, to read and to look at"
    rig = hashlib.sha256((folder / "captures" / "rig.yaml").read_bytes()).hexdigest()[:12]
    assert f"rig.yaml, good, {rig}" in page
    assert re.search(r"<dt>written</dt><dd>20\d\d-\d\d-\d\d \d\d:\d\d UTC</dd>", page)
    pair.write_text(json.dumps(doubted))
    notes = {name: notes_of(name, depth=folder / "run" / "depth" / name, pair=pair.parent) for name in ("001", "002")}
    assert notes["001"][0] == "its rows lie apart, see `rig`"
    assert notes["001"][-1].startswith("the bokeh was focused on")


@pytest.mark.parametrize("weights", ["box", "run", "other"])
def test_weights_are_named_by_their_place_and_their_fingerprint(folder: Path, weights: str) -> None:
    run_weights = folder / "run" / "train" / "weights.safetensors"
    run_weights.parent.mkdir()
    run_weights.write_bytes(b"trained")
    stamps = {
        name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in (("box", BOX), ("run", run_weights))
    }
    stamp = stamps.get(weights, "0" * 64)
    kept = folder / "run" / "depth" / "000" / "depth.json"
    record = json.loads(kept.read_text())
    record["key"]["matcher"] = f"network {stamp}"
    kept.write_text(json.dumps(record))
    named = {"box": "the one that comes with telewide", "run": "trained here"}.get(weights, "other weights")
    told = made_by(kept.parent, run_weights=run_weights)
    assert told == f"Matched by network ({named}, {stamp[:12]}), telewide {record['key']['version']}."
    kept.write_text("cut off")
    assert made_by(kept.parent, run_weights=run_weights) == ""


def test_depth_of_former_calls_is_shown_as_it_was_asked_for(folder: Path, said: Said) -> None:
    """The photos have been moved, with all of their folder, since the depth was made; a preview is no picture."""
    run = folder / "run"
    said("captures", "--only", "001", "--bokeh", "--preview")
    (run / "depth" / "002" / "preview.png").unlink()
    found = lying_depths(
        run / "depth", names_lying(run / "depth"), pairs=run / "pairs", captures_root=folder / "captures"
    )
    assert [(one.capture.name, one.bokeh) for one in found] == [("000", BokehOptions()), ("001", BokehOptions())]
    assert found[0].capture.tele_path == folder / "captures" / "000" / "tele.png"
    assert {"match_s", "focus_px"} <= found[0].numbers.keys()
