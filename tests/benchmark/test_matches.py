"""Held-out matches as a judge, against the rendered truth and a shifted one; who saw which capture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rig_worlds import phone_rig, photos_of_a_plane
from typer.testing import CliRunner

from telewide.benchmark.matches import (
    ALL,
    AWAY_FROM_EDGES,
    EDGE_STEP_PX,
    Entrant,
    benchmark_matches,
    matches_table,
)
from telewide.benchmark.report import BenchmarkReport
from telewide.calibration.quality import CalibrationQuality
from telewide.calibration.rig_file import RigFacts, StoredRig, read_rig, write_stored_rig
from telewide.capture.images import write_image
from telewide.capture.pair import find_captures
from telewide.capture.pfm import read_pfm
from telewide.cli.benchmark import benchmark_app
from telewide.errors import UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.matcher import Matcher
from telewide.matching.networks import build_network
from telewide.matching.window import Window, joined_window
from telewide.recipe import Recipe, load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.prepare import prepare_captures
from telewide.stages.run_folder import RunFolder
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard

OFF_PX = 2.0
OF_ALL = {ALL, AWAY_FROM_EDGES}


def answering(name: str, disparity_px: FloatMap) -> Matcher:
    """A matcher that always gives one map."""

    def match(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        assert ref.shape == src.shape == (*disparity_px.shape, 3)
        return DisparityMap(disparity_px, np.ones_like(disparity_px), np.ones(disparity_px.shape, np.bool_))

    return Matcher(name, match)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("matches") / "captures"
    write_captures(root, count=1, seed=3, hw=(224, 320), factor=2)
    return root


def measured(captures: Path, *, trained_runs: tuple[RunFolder, ...] = ()) -> BenchmarkReport:
    (truth_path,) = captures.glob("*/truth.pfm")
    truth_px = read_pfm(truth_path)
    right, off = answering("right", truth_px), answering("off", truth_px + np.float32(OFF_PX))
    trained = replace(answering("trained", truth_px), window=(0, 32))
    return benchmark_matches(
        captures,
        [Entrant(right), Entrant(right, is_corrected=False), Entrant(off), Entrant(trained)],
        run=RunFolder(captures.parent / "run"),
        recipe=Recipe(),
        tell=lambda _: None,
        trained_runs=trained_runs,
    )


@pytest.fixture(scope="module")
def photographed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Captures as a phone took them, and the file of its rig, which lies elsewhere."""
    folder = tmp_path_factory.mktemp("photographed")
    rig = phone_rig(width_px=480)
    tele, wide = photos_of_a_plane(rig, np.random.default_rng(7))
    write_image(folder / "captures" / "plane" / "tele.png", tele)
    write_image(folder / "captures" / "plane" / "wide.png", wide)
    quality = CalibrationQuality(0.1, 0.1, 0.1, 0.2, 0.3, 0.1, checks=(), verdict="good")
    write_stored_rig(folder / "rigs" / "phone.yaml", StoredRig(rig, None, None, None, quality, RigFacts()))
    return folder / "captures", folder / "rigs" / "phone.yaml"


def flat(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
    height, width = ref.shape[:2]
    return DisparityMap(*(np.zeros((height, width), kind) for kind in (np.float32, np.float32, np.bool_)))


def test_photos_are_rectified_with_the_rig_and_the_pairs_of_the_run_stay(
    photographed: tuple[Path, Path], tmp_path: Path
) -> None:
    captures, rig = photographed
    run = RunFolder(tmp_path / "run")
    prepare_captures(find_captures(captures), run, recipe=Recipe(), rig=read_rig(rig))
    pair = run.pairs / "plane" / "pair.json"
    written_ns = pair.stat().st_mtime_ns
    entrants = [Entrant(Matcher("flat", flat))]
    report = benchmark_matches(captures, entrants, run=run, recipe=Recipe(), tell=lambda _: None, rig=rig)
    assert pair.stat().st_mtime_ns == written_ns
    assert int(str(report.rows[0]["matches"])) > 20


def test_all_search_what_the_captures_need_and_networks_were_trained_for(captures: Path, tmp_path: Path) -> None:
    searched: dict[str, Window] = {}

    def note(name: str, trained: Window | None) -> Entrant:
        def match(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
            searched[name] = window
            return flat(ref, src, window=window)

        return Entrant(Matcher(name, match, trained))

    run = RunFolder(tmp_path / "run")
    needed = prepare_captures(find_captures(captures), run, recipe=Recipe()).window
    entrants = [note("sgm", None), note("near", (needed[0] + 4, needed[0] + 16)), note("far", (needed[1], 144))]
    report = benchmark_matches(captures, entrants, run=run, recipe=Recipe(), tell=lambda _: None)
    assert set(searched.values()) == {(needed[0], 144)}
    assert report.options["window"] == [needed[0], 144]


def test_pairs_that_need_a_rig_cannot_be_judged_uncorrected(photographed: tuple[Path, Path], tmp_path: Path) -> None:
    captures, rig = photographed
    entrants, run = [Entrant(Matcher("flat", flat), is_corrected=False)], RunFolder(tmp_path / "run")
    with pytest.raises(UsageError, match="rectified with a rig"):
        benchmark_matches(captures, entrants, run=run, recipe=Recipe(), tell=lambda _: None, rig=rig)
    assert not run.root.exists()


def test_the_truth_misses_few_matches_and_a_shifted_one_nearly_all(captures: Path) -> None:
    right, uncorrected, off, _ = measured(captures).rows[:4]
    assert int(str(right["matches"])) > 20
    assert float(str(right["off_1px"])) < 0.1
    assert uncorrected == {**right, "matcher": "right, uncorrected"}
    assert float(str(off["off_1px"])) > 0.9
    assert float(str(off["off_3px"])) < 0.1
    assert float(str(off["mean_px"])) == pytest.approx(OFF_PX, abs=0.3)


def test_without_a_training_nothing_is_said_of_one(captures: Path) -> None:
    report = measured(captures)
    assert {row["captures"] for row in report.rows} == OF_ALL
    assert report.notes == ()


def test_matches_by_an_edge_of_any_map_are_not_among_those_away_from_edges(captures: Path) -> None:
    """Rendered truth: the matches whose surroundings of 4 px hold one surface, counted one by one."""
    (capture,) = find_captures(captures).captures
    truth_px = read_pfm(capture.tele_path.with_name("truth.pfm"))
    halved = truth_px + np.float32(20) * (np.arange(truth_px.shape[1]) < truth_px.shape[1] // 2).astype(np.float32)
    run = RunFolder(captures.parent / "run")
    (item,) = prepare_captures(find_captures(captures), run, recipe=Recipe()).pairs

    def counted(*maps_px: FloatMap) -> int:
        entrants = [Entrant(answering(f"map {i}", map_px)) for i, map_px in enumerate(maps_px)]
        report = benchmark_matches(captures, entrants, run=run, recipe=Recipe(), tell=lambda _: None)
        (count,) = {int(str(row["matches"])) for row in report.rows if row["captures"] == AWAY_FROM_EDGES}
        return count

    def is_smooth(map_px: FloatMap, x: float, y: float, reach: int) -> bool:
        column, row = round(x), round(y)
        around = map_px[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
        return float(np.ptp(around)) <= EDGE_STEP_PX

    points = item.held_out.ref_px
    surely = sum(is_smooth(truth_px, x, y, 7) for x, y in points)
    perhaps = sum(is_smooth(truth_px, x, y, 2) for x, y in points)
    assert surely <= counted(truth_px) <= perhaps < len(points)
    assert counted(np.zeros_like(truth_px)) == len(points)
    by_the_middle = sum(abs(x - truth_px.shape[1] / 2) < 3 for x, _ in points)
    assert by_the_middle > 0
    assert counted(truth_px, halved) <= counted(truth_px) - sum(
        is_smooth(truth_px, x, y, 7) for x, y in points if abs(x - truth_px.shape[1] / 2) < 3
    )


def test_without_a_record_no_capture_counts_as_unseen(captures: Path, tmp_path: Path) -> None:
    report = measured(captures, trained_runs=(RunFolder(tmp_path / "unrecorded"),))
    assert {row["captures"] for row in report.rows} == OF_ALL
    assert "unseen" in report.notes[-1]
    assert len(matches_table(report).splitlines()) == 2 + 2 * 4


def test_captures_that_every_training_held_out_get_their_own_lines(captures: Path, tmp_path: Path) -> None:
    (folder,) = (path for path in captures.iterdir() if path.is_dir())
    runs = tuple(RunFolder(tmp_path / name) for name in ("first", "second"))
    for run, held_out in zip(runs, ([folder.name], []), strict=True):
        record = {"recipe": {}, "window": [0, 64], "captures": [folder.name], "held_out": held_out}
        run.train.mkdir(parents=True)
        (run.train / "training.json").write_text(json.dumps(record))
    report = measured(captures, trained_runs=runs[:1])
    of_runs = [row["captures"] for row in report.rows][8:]
    assert of_runs == ["held out"] * 3 + ["held out, chose the weights"]
    assert "| held out, chose the weights |" in matches_table(report).splitlines()[-1]
    assert "held-out captures chose the best weights" in report.notes[-1]
    both = measured(captures, trained_runs=runs)  # the second training has seen it
    assert {row["captures"] for row in both.rows} == OF_ALL


@pytest.mark.parametrize("place", ["kept.safetensors", "run/train/kept.safetensors"])
def test_a_lone_weights_file_is_judged_on_the_pairs_it_was_taught_on(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """Kept anywhere, what its training has seen is not known, and is said so; in its run folder the record tells."""
    taught = load_recipe("quick", settings=["working_width_px=128"])
    needed = prepare_captures(find_captures(captures), RunFolder(tmp_path / "like"), recipe=taught).window
    monkeypatch.chdir(tmp_path)
    Path(place).parent.mkdir(parents=True, exist_ok=True)
    card = WeightsCard("lite", (0, 16), taught.model_dump(mode="json"), {})
    save_weights(build_network("lite"), Path(place), card=card)
    names = [path.name for path in captures.iterdir() if path.is_dir()]
    if "/" in place:
        record = {"recipe": {}, "window": [0, 64], "captures": names, "held_out": names}
        Path(place).with_name("training.json").write_text(json.dumps(record))
    done = CliRunner().invoke(benchmark_app, ["matches", str(captures), "--run", place, "--json", "told.json"])
    assert done.exit_code == 0, done.output
    assert "| kept " in done.output
    assert ("no capture is known to be unseen" in done.output) == ("/" not in place)
    assert ("held out, chose the weights" in done.output) == ("/" in place)
    assert json.loads(Path("told.json").read_text())["options"]["window"] == list(joined_window([(0, 16), needed]))


@pytest.mark.parametrize(
    "words",
    [("metres", "--keep"), ("middlebury", ".", "--captures"), ("marks", ".", "--marks", "mine.yaml", "--sheets")],
)
def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path, words: tuple[str, ...]) -> None:
    kept = tmp_path / "mine" / "captures.yaml"
    kept.parent.mkdir()
    kept.write_text("format: 1\n")
    done = CliRunner().invoke(benchmark_app, [*words, str(kept.parent)])
    assert isinstance(done.exception, UsageError)
    assert "is not empty" in done.exception.message
    assert [path.name for path in kept.parent.iterdir()] == ["captures.yaml"]
