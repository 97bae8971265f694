"""Pictures and the page of a table: what is drawn is what was found, and nothing is fetched."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.paper.means import mean_errors
from telewide.benchmark.paper.page import factor_plots, stage_plots, write_paper_page
from telewide.benchmark.paper.pictures import (
    ERROR_SHOWN_PX,
    MAP_WIDTH_PX,
    Found,
    Sheet,
    keep_map,
    kept_map,
    write_scene_sheet,
)
from telewide.benchmark.paper.tables import Table, find_table
from telewide.benchmark.report import BenchmarkReport
from telewide.capture.images import read_image

HW = (60, 90)


def truth() -> StereoTruth:
    x = np.broadcast_to(np.arange(HW[1], dtype=np.float32), HW)
    view = np.repeat((x / HW[1])[..., None], 3, axis=2).astype(np.float32)
    return StereoTruth(view, view[:, ::-1].copy(), (5 + x / 3).astype(np.float32))


def rows_of(table: Table, errors: dict[str, float]) -> tuple[dict[str, object], ...]:
    """The same 3PE in every column for each system, with last and best weights."""
    return tuple(
        {
            **{
                "system": system,
                "column": column.heading,
                "seed": 0,
                "scene": "s",
                "weights": weights,
                "region": "all",
            },
            **{"off_3px_5percent": error, "end_point_error_px": 1.0, "space_psnr_db": None},
        }
        for system, error in errors.items()
        for column in table.columns
        for weights in ("last", "best")
    )


def test_kept_maps_are_small_and_say_what_was_found(tmp_path: Path) -> None:
    wide = np.full((100, 2 * MAP_WIDTH_PX), 8.0, np.float32)
    keep_map(tmp_path, "a&b", "", disparity_px=wide)
    kept = kept_map(tmp_path, "a&b", "")
    assert kept is not None
    assert kept.shape == (50, MAP_WIDTH_PX)
    assert (kept == 4).all(), "px of the map itself"
    assert kept_map(tmp_path, "a&b", "best") is None


def test_a_sheet_shows_the_errors_of_every_system(tmp_path: Path) -> None:
    pair = truth()
    right, wrong = pair.disparity_px, pair.disparity_px + np.float32(2 * ERROR_SHOWN_PX)
    write_scene_sheet(tmp_path / "s.png", pair, [Found("right", 0.0, right), Found("wrong", 1.0, wrong)])
    sheet = read_image(tmp_path / "s.png")
    width = sheet.shape[1] / 6
    middle_y = round(sheet.shape[0] * 0.7)

    def at(column: int) -> np.ndarray:
        return sheet[middle_y, round((column + 0.5) * width)]

    assert at(1).max() < 0.1, "no error is black"
    assert at(3).min() > 0.5, "the largest is bright"
    # Of one colour but for the 256 colours of the file.
    np.testing.assert_allclose(at(0), sheet[round(sheet.shape[0] * 0.2), round(2.5 * width)], atol=0.1)


def test_the_page_holds_tables_plots_and_pictures_and_fetches_nothing(tmp_path: Path) -> None:
    table = find_table("stages")
    rows = rows_of(table, {"basenet": 0.3, "method-k1": 0.2, "method": 0.1})
    write_scene_sheet(tmp_path / "stages" / "s.png", truth(), [Found("BaseNet", 0.3, truth().disparity_px)])
    report = BenchmarkReport("paper stages", {"budget": "8 min", "seeds": 1}, rows, notes=("a < b",))
    sheet = Sheet(table.columns[0].heading, "s", tmp_path / "stages" / "s.png")
    page = write_paper_page(tmp_path / "stages.html", table, report, sheets=[sheet]).read_text()
    assert "Inria_SLFD" in page
    assert "30.00 / 1.00 (12.56)" in page
    assert "BIC x4, best" in page
    assert "a &lt; b" in page
    assert 'href="stages/s.png"' in page
    assert not re.search(r'(src|href)="(?!data:|stages/)', page)
    assert "script" not in page.replace("default-src", "")


def test_plots_go_by_factor_and_by_stage_with_the_published_values_dashed() -> None:
    table = find_table("stages")
    means = mean_errors(rows_of(table, {"basenet": 0.3, "method-k1": 0.2, "method": 0.1}))
    by_factor, by_stage = list(factor_plots(table, means)), list(stage_plots(table, means))
    assert len(by_factor) == len(by_stage) == 2, "one for each data set"
    assert by_factor[0].count("<polyline") == 2 * 3, "ours and published of three systems"
    assert by_factor[1].count("<polyline") == 3 + 2, "published for Middlebury: the first and the last stage"
    assert by_stage[0].count("<polyline") == 2 * 3, "three factors"
    assert "dashed" in by_stage[0]
    single = find_table("spaces")
    assert list(factor_plots(single, mean_errors(rows_of(single, {"s1-space": 0.3})))) == []
    assert list(stage_plots(single, mean_errors(rows_of(single, {"s1-space": 0.3})))) == []
