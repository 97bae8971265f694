"""Scores by hand-made marks, on drawn maps whose errors are known."""

from __future__ import annotations

import json
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from telewide.benchmark.mark_scores import (
    FARTHEST_EDGE_PX,
    edge_offsets_px,
    plane_residuals_px,
    score_marks,
    thin_is_right,
)
from telewide.benchmark.mark_sheets import drawn_marks
from telewide.benchmark.marked import benchmark_marks, marks_table
from telewide.benchmark.marks import CaptureMarks, DepthEdge, Marks, ThinThing, read_marks
from telewide.capture.images import read_image
from telewide.capture.pair import find_captures
from telewide.cli.benchmark import benchmark_app
from telewide.errors import InputError, TelewideError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.matcher import Matcher
from telewide.matching.networks import build_network
from telewide.matching.window import Window
from telewide.recipe import Recipe, load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.run_folder import RunFolder
from telewide.training.checkpoint import save_weights
from telewide.training.weights_card import WeightsCard

P30_MARKS = Path(__file__).with_name("p30_marks.yaml")
HW = (120, 160)
WALL = ((10, 10), (150, 10), (150, 110), (10, 110))


def plane_px(*, hw: tuple[int, int] = HW) -> FloatMap:
    rows, columns = np.indices(hw)
    return (20 + 0.03 * columns - 0.02 * rows).astype(np.float32)


def checks(*, hw: tuple[int, int] = HW) -> FloatMap:
    rows, columns = np.indices(hw)
    return np.where((rows + columns) % 2, np.float32(1), np.float32(-1))


def bar(**changes: object) -> ThinThing:
    """A bar along row 60, 5 px wide, 4 px of disparity before its ground."""
    plain = {"line": [[20, 60], [140, 60]], "width_px": 5, "ground_px": [-9, 9], "step_px": [4, 4]}
    return ThinThing.model_validate(plain | changes)


def with_bar(step_px: float, *, columns: slice = slice(None)) -> FloatMap:
    map_px = plane_px()
    map_px[58:63, columns] += np.float32(step_px)
    return map_px


# Planes


def test_a_plane_has_no_deviation() -> None:
    residuals_px = plane_residuals_px(plane_px(), WALL)
    assert residuals_px.size == 141 * 101
    assert residuals_px.max() < 1e-4


def test_a_ripple_deviates_by_its_height() -> None:
    residuals_px = plane_residuals_px(plane_px() + np.float32(0.6) * checks(), WALL)
    assert residuals_px.mean() == pytest.approx(0.6, abs=0.01)


def test_a_hole_does_not_tilt_the_plane() -> None:
    """A corner of the wall, an eighth of it, is 12 px off: least squares would lean."""
    map_px = plane_px()
    map_px[70:, 107:] += 12
    residuals_px = plane_residuals_px(map_px, WALL)
    assert np.median(residuals_px) < 1e-3
    assert residuals_px.mean() == pytest.approx(12 * (44 * 41) / (141 * 101), abs=0.01)


def test_unknown_pixels_do_not_count() -> None:
    map_px = plane_px()
    map_px[30:50, 30:50] = np.nan
    assert plane_residuals_px(map_px, WALL).size == 141 * 101 - 400
    assert np.isnan(plane_residuals_px(np.full(HW, np.nan, np.float32), WALL)).all()


# Thin things


@pytest.mark.parametrize(
    ("found_px", "is_right"), [(4.0, True), (2.1, True), (1.9, False), (0.0, False), (-4.0, False)]
)
def test_a_thing_is_right_beyond_the_middle(found_px: float, is_right: bool) -> None:
    right = thin_is_right(with_bar(found_px), bar())
    assert right.size == 121
    assert (right == is_right).all()


def test_a_thing_behind_its_ground_is_judged_on_that_side() -> None:
    behind = bar(step_px=[-4, -4])
    assert thin_is_right(with_bar(-2.1), behind).all()
    assert not thin_is_right(with_bar(4), behind).any()


def test_half_a_thing_is_half_right() -> None:
    share = thin_is_right(with_bar(4, columns=slice(0, 80)), bar()).mean()
    assert share == pytest.approx(0.5, abs=0.02)


def test_the_step_runs_from_end_to_end() -> None:
    """Of a leg that meets the floor, the map's constant step is half of the true one in the middle."""
    share = thin_is_right(with_bar(2), bar(step_px=[6, 2])).mean()
    assert share == pytest.approx(0.5, abs=0.02)


def test_swallowed_ground_is_wrong() -> None:
    map_px = plane_px()
    map_px[45:76] += 4
    assert not thin_is_right(map_px, bar()).any()


def test_ground_lies_to_the_right_of_the_walk() -> None:
    """Walking towards larger x, larger y is on the right; what lies on the left must not count."""
    map_px = with_bar(4)
    map_px[:57] += 4
    assert thin_is_right(map_px, bar(ground_px=[9])).all()
    assert not thin_is_right(map_px, bar(ground_px=[-9])).any()
    assert not thin_is_right(map_px, bar(ground_px=[9], line=[[140, 60], [20, 60]])).any()


# Edges


def with_edge(x_px: int, *, step_px: float = 5) -> FloatMap:
    """Nearer from column x_px on: the edge lies half a pixel before it."""
    map_px = plane_px()
    map_px[:, x_px:] += np.float32(step_px)
    return map_px


@pytest.mark.parametrize("off_px", [-6, -3, 0, 2, 6])
def test_an_edge_is_as_far_off_as_it_was_moved(off_px: int) -> None:
    """Walking down the picture, larger x is on the left."""
    edge = DepthEdge(line=((79.5, 20), (79.5, 100)), near="left")
    offsets_px = edge_offsets_px(with_edge(80 + off_px), edge)
    assert offsets_px.size == 41
    np.testing.assert_allclose(offsets_px, off_px, atol=0.5)
    upwards = DepthEdge(line=((79.5, 100), (79.5, 20)), near="right")
    np.testing.assert_allclose(edge_offsets_px(with_edge(80 + off_px), upwards), off_px, atol=0.5)


def test_no_edge_is_found_where_there_is_none() -> None:
    edge = DepthEdge(line=((79.5, 20), (79.5, 100)), near="left")
    wrong_side = DepthEdge(line=((79.5, 20), (79.5, 100)), near="right")
    assert np.isnan(edge_offsets_px(plane_px(), edge)).all()
    assert np.isnan(edge_offsets_px(with_edge(80, step_px=0.6), edge)).all()
    assert np.isnan(edge_offsets_px(with_edge(80), wrong_side)).all()
    assert np.isnan(edge_offsets_px(with_edge(80 + int(FARTHEST_EDGE_PX) + 6), edge)).all()


def test_a_slanted_edge_is_found_along_its_normal() -> None:
    rows, columns = np.indices(HW)
    off_px = 2.0
    along_px = (columns - rows - 20) / np.sqrt(2)  # from the line through (20, 0) with a slope of 1, towards larger x
    map_px = (20 + 5 * (along_px > off_px)).astype(np.float32)
    edge = DepthEdge(line=((40, 20), (110, 90)), near="left")
    np.testing.assert_allclose(edge_offsets_px(map_px, edge), off_px, atol=0.75)


def test_a_blip_does_not_move_an_edge() -> None:
    map_px = with_edge(80)
    map_px[:, 84:86] -= 5
    edge = DepthEdge(line=((79.5, 20), (79.5, 100)), near="left")
    np.testing.assert_allclose(edge_offsets_px(map_px, edge), 0, atol=0.5)


def test_a_score_sums_up_all_marks() -> None:
    map_px = with_edge(80)
    marks = CaptureMarks(
        planes={"flat": ((10, 10), (70, 10), (70, 110), (10, 110)), "across": WALL},
        edges={
            "right": DepthEdge(line=((79.5, 20), (79.5, 100)), near="left"),
            "five off": DepthEdge(line=((74.5, 20), (74.5, 100)), near="left"),
            "none": DepthEdge(line=((30, 20), (30, 100)), near="left"),
        },
    )
    score = score_marks(map_px, marks)
    assert np.isnan(score.thin_right)
    assert score.edges_within_2px == pytest.approx(1 / 3)
    assert score.edges_found == pytest.approx(2 / 3)
    across_px = plane_residuals_px(map_px, WALL)
    assert score.plane_mean_px == pytest.approx(across_px.mean() / 2, abs=1e-3)


# The file


def plain_marks(**of_capture: object) -> dict[str, object]:
    return {"format": 1, "photo_wh": [160, 120], "captures": {"a": of_capture}}


THING = {"line": [[20, 60], [140, 60]], "width_px": 5, "ground_px": [9], "step_px": [4, 4]}


@pytest.mark.parametrize(
    ("of_capture", "said"),
    [
        ({"planes": {"wall": [[0, 0], [160, 0], [9, 9]]}}, "160, 0 is not on a photo of 160 x 120"),
        ({"planes": {"wall": [[0, 0], [9, 9]]}}, "wall"),
        ({"thin": {"leg": THING | {"ground_px": [2]}}}, "lies on the thing"),
        ({"thin": {"leg": THING | {"step_px": [4, -1]}}}, "before its ground or behind it"),
        ({"thin": {"leg": THING | {"line": [[1, 1], [1, 1], [5, 5]]}}}, "twice in succession"),
        ({"thin": {"leg": THING | {"width_px": 1e300, "ground_px": [1e301]}}}, "width_px"),
        ({"thin": {"leg": THING | {"ground_px": [1e15]}}}, "ground_px"),
        ({"thin": {"leg": THING | {"step_px": [1e308, 1e308]}}}, "step_px"),
        ({"edges": {"door": {"line": [[1, 1], [5, 5]], "near": "above"}}}, "near"),
        ({"edge": {}}, "edge"),
    ],
)
def test_wrong_marks_are_named(tmp_path: Path, of_capture: dict[str, object], said: str) -> None:
    path = tmp_path / "marks.yaml"
    path.write_text(yaml.safe_dump(plain_marks(**of_capture)))
    with pytest.raises(InputError, match=said) as caught:
        read_marks(path)
    assert "marks.yaml" in str(caught.value)


def test_the_p30_marks_are_whole() -> None:
    """At least eight pairs with two planes each; every thing and edge is long enough to be judged."""
    marks = read_marks(P30_MARKS)
    assert len([m for m in marks.captures.values() if len(m.planes) >= 2]) >= 8
    things = [thing for m in marks.captures.values() for thing in m.thin.values()]
    edges = [edge for m in marks.captures.values() for edge in m.edges.values()]
    assert len(things) >= 20
    assert len(edges) >= 40
    for line in (mark.line for mark in [*things, *edges]):
        assert sum(np.hypot(x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in pairwise(line)) >= 20
    assert min(min(map(abs, thing.step_px)) for thing in things) >= 1.5


def test_the_p30_marks_are_of_the_p30_photos(data_root: Path) -> None:
    marks, captures = read_marks(P30_MARKS), find_captures(data_root / "p30")
    paths = {capture.name: capture.tele_path for capture in captures.captures}
    assert marks.captures.keys() <= paths.keys()
    for name in marks.captures:
        height, width = read_image(paths[name]).shape[:2]
        assert (width, height) == marks.photo_wh


# The benchmark


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("marked") / "captures"
    write_captures(root, count=1, seed=3, hw=(224, 320), factor=2)
    return root


def answering(name: str, disparity_px: FloatMap) -> Matcher:
    def match(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        ones = np.ones(ref.shape[:2], np.float32)
        return DisparityMap(disparity_px, ones, ones > 0)

    return Matcher(name, match)


def write_marks(path: Path, *, capture: str, wh: tuple[int, int] = (320, 224)) -> Path:
    wall = [[20, 20], [wh[0] - 20, 20], [wh[0] - 20, wh[1] - 20]]
    edge = {"line": [[60, 30], [60, 90]], "near": "left"}
    of_capture = {"planes": {"wall": wall}, "thin": {"leg": THING}, "edges": {"door": edge}}
    path.write_text(yaml.safe_dump({"format": 1, "photo_wh": list(wh), "captures": {capture: of_capture}}))
    return path


def judged(captures: Path, marks: Marks, contenders: list[Matcher], **options: object) -> list[dict[str, object]]:
    report = benchmark_marks(
        captures,
        contenders,
        marks,
        run=RunFolder(captures.parent / "run"),
        recipe=Recipe(),
        tell=lambda _: None,
        **options,  # type: ignore[arg-type]
    )
    assert marks_table(report).count("\n") == 1 + len(contenders)
    return [dict(row) for row in report.rows]


def test_matchers_are_judged_by_their_marks(captures: Path, tmp_path: Path) -> None:
    (capture,) = find_captures(captures).captures
    flat_px = plane_px(hw=(224, 320))
    contenders = [answering("flat", flat_px), answering("rippled", flat_px + np.float32(0.4) * checks(hw=(224, 320)))]
    marks = read_marks(write_marks(tmp_path / "marks.yaml", capture=capture.name))
    rows = judged(captures, marks, contenders, sheets=tmp_path / "sheets")
    mean_px = {row["matcher"]: row["plane_mean_px"] for row in rows if row["capture"] == "mean"}
    assert mean_px["flat"] == pytest.approx(0, abs=0.01)
    assert mean_px["rippled"] == pytest.approx(0.4, abs=0.02)
    sheet = read_image(tmp_path / "sheets" / f"{capture.name}.png")
    assert sheet.shape[1] == 3 * 320


def test_marks_of_another_size_are_scaled(captures: Path, tmp_path: Path) -> None:
    """Half as large a photo has half the disparities, so half the ripple."""
    (capture,) = find_captures(captures).captures
    step_px = plane_px(hw=(224, 320))
    step_px[:, ::4] += 2
    step_px[:, 1::4] += 2
    marks = read_marks(write_marks(tmp_path / "marks.yaml", capture=capture.name, wh=(160, 112)))
    rows = judged(captures, marks, [answering("stripes", step_px)])
    assert rows[0]["plane_mean_px"] == pytest.approx(0.5, abs=0.05)


def test_marks_of_another_photo_are_refused(captures: Path, tmp_path: Path) -> None:
    (capture,) = find_captures(captures).captures
    square = read_marks(write_marks(tmp_path / "marks.yaml", capture=capture.name, wh=(300, 300)))
    with pytest.raises(InputError, match="made on a photo of 300 x 300"):
        judged(captures, square, [])
    others = read_marks(write_marks(tmp_path / "marks.yaml", capture="another"))
    with pytest.raises(InputError, match="is marked") as caught:
        judged(captures, others, [])
    assert "another" in (caught.value.hint or "")


def test_drawn_marks_leave_the_rest_of_the_photo_alone() -> None:
    photo = np.full((*HW, 3), 0.5, np.float32)
    edge = DepthEdge(line=((79, 20), (79, 100)), near="left")
    drawn = drawn_marks(photo, CaptureMarks(planes={"wall": WALL}, thin={"bar": bar()}, edges={"edge": edge}))
    changed = np.abs(drawn - photo).max(axis=2) > 0.1
    assert changed[10, 80]
    assert changed[60, 30]
    assert changed[30, 79]
    assert changed[20, 83]
    assert not changed[20, 75]
    assert changed.mean() < 0.1


def test_the_command_prints_a_table_and_writes_pictures(captures: Path, tmp_path: Path) -> None:
    (capture,) = find_captures(captures).captures
    marks = write_marks(tmp_path / "marks.yaml", capture=capture.name)
    words = ["marks", str(captures), "--marks", str(marks), "--sheets", str(tmp_path / "sheets")]
    done = CliRunner().invoke(benchmark_app, [*words, "--json", str(tmp_path / "marks.json")])
    assert done.exit_code == 0, done.output
    assert "| sgm" in done.output
    assert (tmp_path / "sheets" / f"{capture.name}.png").is_file()
    content = json.loads((tmp_path / "marks.json").read_text())
    assert [row["capture"] for row in content["rows"]] == [capture.name, "mean"]


def test_a_network_is_judged_beside_sgm(captures: Path, tmp_path: Path) -> None:
    (capture,) = find_captures(captures).captures
    card = WeightsCard("lite", (0, 16), load_recipe("quick").model_dump(mode="json"), {})
    save_weights(build_network("lite"), tmp_path / "kept.safetensors", card=card)
    marks = write_marks(tmp_path / "marks.yaml", capture=capture.name)
    words = ["marks", str(captures), "--marks", str(marks), "--run", str(tmp_path / "kept.safetensors")]
    done = CliRunner().invoke(benchmark_app, [*words, "--json", str(tmp_path / "marks.json")])
    assert done.exit_code == 0, done.output
    means = [row for row in json.loads((tmp_path / "marks.json").read_text())["rows"] if row["capture"] == "mean"]
    assert [row["matcher"] for row in means] == ["sgm", "kept"]


def test_missing_marks_are_a_clear_error(captures: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(benchmark_app, ["marks", str(captures), "--marks", str(tmp_path / "none.yaml")])
    assert isinstance(done.exception, TelewideError)
    assert "none.yaml" in done.exception.message


def test_a_file_in_the_place_of_the_pictures_is_a_clear_error(captures: Path, tmp_path: Path) -> None:
    (capture,) = find_captures(captures).captures
    marks = write_marks(tmp_path / "marks.yaml", capture=capture.name)
    done = CliRunner().invoke(benchmark_app, ["marks", str(captures), "--marks", str(marks), "--sheets", str(marks)])
    assert isinstance(done.exception, TelewideError)
    assert "cannot be made" in done.exception.message


@pytest.mark.slow
def test_semiglobal_matching_keeps_to_the_marks_of_a_phone_pair(data_root: Path, tmp_path: Path) -> None:
    """Tiles are textured, and the umbrella stands far before them."""
    (tmp_path / "p30").mkdir()
    shutil.copytree(data_root / "p30" / "10", tmp_path / "p30" / "10")
    shutil.copy(data_root / "p30" / "captures.yaml", tmp_path / "p30")
    words = ["marks", str(tmp_path / "p30"), "--marks", str(P30_MARKS), "--json", str(tmp_path / "marks.json")]
    done = CliRunner().invoke(benchmark_app, words)
    assert done.exit_code == 0, done.output
    mean = json.loads((tmp_path / "marks.json").read_text())["rows"][-1]
    assert mean["plane_mean_px"] < 1.0
    assert mean["edges_within_2px"] > 0.5
