"""The Middlebury protocol: perfect maps score zero, rows and columns that count are those of the data set."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.benchmark.contenders import semiglobal_contender
from telewide.benchmark.datasets.middlebury import middlebury_2006_scenes
from telewide.benchmark.datasets.protocols import find_protocol
from telewide.benchmark.middlebury_scores import (
    PROTOCOL,
    benchmark_middlebury,
    middlebury_table,
    score_map,
)
from telewide.benchmark.report import BenchmarkReport
from telewide.capture.images import write_image
from telewide.errors import UsageError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching.matcher import Matcher
from telewide.matching.window import Window

WINDOW, LEFT_OUT = find_protocol(PROTOCOL).window_px, find_protocol(PROTOCOL).left_out_columns

DISPARITY_PX = 9
HW = (64, 128)


def constant(name: str, disparity_px: float, *, wrong_columns: int = 0) -> Matcher:
    """A matcher that knows the answer, but in its first columns."""

    def match(ref: FloatMap, src: FloatMap, *, window: Window, valid: ValidMasks | None = None) -> DisparityMap:
        assert window == WINDOW
        found_px = np.full(ref.shape[:2], disparity_px, np.float32)
        found_px[:, :wrong_columns] = 70
        return DisparityMap(found_px, np.ones_like(found_px), np.ones(found_px.shape, np.bool_))

    return Matcher(name, match)


@pytest.fixture
def scenes_root(tmp_path: Path, rng: np.random.Generator) -> Path:
    root = tmp_path / "scenes"
    for scene in ("One", "Two"):
        noise = rng.random((HW[0], HW[1] + DISPARITY_PX, 3), dtype=np.float32)
        canvas = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.5) * 4 - 1.5, 0, 1)
        write_image(root / scene / "view1.png", canvas[:, : HW[1]])
        write_image(root / scene / "view5.png", canvas[:, DISPARITY_PX:])
        truth = np.full((*HW, 3), 3 * DISPARITY_PX / 255, np.float32)
        truth[: HW[0] // 2, -10:] = 0  # unknown
        write_image(root / scene / "disp1.png", truth)
    return root


def measured(root: Path, *contenders: Matcher) -> BenchmarkReport:
    return benchmark_middlebury(
        root, contenders, scenes=("One", "Two"), factor=2, captures=root.parent / "captures", tell=lambda _: None
    )


def test_a_perfect_map_scores_zero(rng: np.random.Generator) -> None:
    truth_px = rng.uniform(5, 70, (20, 90)).astype(np.float32)
    truth_px[:5] = np.nan
    score = score_map(np.nan_to_num(truth_px), truth_px, left_out_columns=LEFT_OUT)
    assert (score.off_3px_5percent, score.end_point_error_px) == (0, 0)


def test_the_first_columns_do_not_count() -> None:
    truth_px = np.full((4, LEFT_OUT + 10), 20, np.float32)
    estimate_px = truth_px.copy()
    estimate_px[:, :LEFT_OUT] = 0
    assert score_map(estimate_px, truth_px, left_out_columns=LEFT_OUT).end_point_error_px == 0
    estimate_px[:, LEFT_OUT] = 0  # the first one that counts: a tenth of all
    score = score_map(estimate_px, truth_px, left_out_columns=LEFT_OUT)
    assert score.off_3px_5percent == pytest.approx(0.1)
    assert score.end_point_error_px == pytest.approx(2.0)


def test_rows_follow_the_protocol(scenes_root: Path) -> None:
    off_px = 4.0
    contenders = (constant("perfect", DISPARITY_PX, wrong_columns=40), constant("off", DISPARITY_PX + off_px))
    report = measured(scenes_root, *contenders)
    assert len(report.rows) == len(contenders) * 2 * 3  # edges followed or not; two scenes and their mean
    plain = [row for row in report.rows if not row["follow_edges"]]
    for row in plain:
        is_off = row["matcher"] == "off"
        assert (row["3PE"], row["EPE_px"]) == pytest.approx((float(is_off), is_off * off_px)), row
    assert {row["scene"] for row in plain} == {"One", "Two", "mean"}


def test_the_table_has_a_line_for_each_matcher_and_kind(scenes_root: Path) -> None:
    shown = middlebury_table(measured(scenes_root, constant("a", 1), constant("b", 2)))
    table = shown.split("\n\n")[0].splitlines()
    firsts = [line.split("|")[1].strip() for line in table[2:]]
    assert firsts == ["a", "a, edges followed", "b", "b, edges followed"]
    assert [cell.strip() for cell in table[0].split("|")[2:-1]] == ["One", "Two", "mean"]


def test_confidence_and_hidden_pixels_of_all_scenes_are_judged_together(scenes_root: Path) -> None:
    for scene in ("One", "Two"):
        other = np.full((*HW, 3), 3 * DISPARITY_PX / 255, np.float32)
        other[HW[0] // 2 :, 80:90] = 0  # so that the other view does not see columns 89 to 98 of the lower half
        write_image(scenes_root / scene / "disp5.png", other)
    report = measured(scenes_root, constant("perfect", DISPARITY_PX), constant("off", DISPARITY_PX + 4))
    sure = [row for row in report.further["reliability"] if row["share"]]
    assert [(row["matcher"], row["from"], row["right_1px"]) for row in sure] == [("perfect", 0.9, 1), ("off", 0.9, 0)]
    assert [row["recall"] for row in report.further["hidden"]] == [0, 0], "they call nothing hidden"
    shown = middlebury_table(report)
    assert "confidence of perfect" in shown
    assert "called hidden" in shown


def test_semiglobal_matching_sees_the_pairs_the_right_way_round(scenes_root: Path) -> None:
    report = measured(scenes_root, semiglobal_contender())
    assert report.rows[-2]["scene"] == "mean"
    assert float(str(report.rows[-2]["EPE_px"])) < 1


def test_an_unknown_scene_is_refused(scenes_root: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="Three"):
        benchmark_middlebury(
            scenes_root, (), scenes=("Three",), factor=2, captures=tmp_path / "captures", tell=lambda _: None
        )


def test_splits_share_no_scene_and_miss_none(data_root: Path) -> None:
    scenes = [scene for split in find_protocol(PROTOCOL).splits.values() for scene in split]
    assert sorted(scenes) == list(middlebury_2006_scenes(data_root / "middlebury_2006_third"))
