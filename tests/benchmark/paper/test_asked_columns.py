"""Data sets and factors asked for instead of a table's, on pairs written with the shift that they were made with."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from telewide.benchmark.paper.run import PaperOptions, planned_cells
from telewide.benchmark.paper.tables import Published, find_table, with_columns
from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.cli.app import app
from telewide.errors import UsageError

SHIFT_PX = 12
HW = (80, 160)
HALF_HW = (540, 160)


def pair(rng: np.random.Generator, hw: tuple[int, int] = HW) -> tuple[np.ndarray, np.ndarray]:
    """Two views of one smooth canvas, `SHIFT_PX` apart."""
    noise = rng.random((hw[0], hw[1] + SHIFT_PX, 3), dtype=np.float32)
    canvas = np.clip(cv2.GaussianBlur(noise, (0, 0), 2.0) * 6 - 2.5, 0, 1)
    return canvas[:, : hw[1]], canvas[:, SHIFT_PX:]


def write_middlebury_half(folder: Path, rng: np.random.Generator) -> None:
    for name, view in zip(("view1", "view5"), pair(rng, HALF_HW), strict=True):
        write_image(folder / f"{name}.png", view)
    for name in ("disp1", "disp5"):
        cv2.imwrite(str(folder / f"{name}.png"), np.full(HALF_HW, 2 * SHIFT_PX, np.uint8))


@pytest.fixture
def data(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Each set in its own layout and with its own scale of disparities."""
    root = tmp_path / "data"
    training = root / "kitti_2012" / "training"
    for folder, view in zip(("colored_0", "colored_1"), pair(rng), strict=True):
        write_image(training / folder / "000007_10.png", view)
    for folder in ("disp_occ", "disp_noc"):
        (training / folder).mkdir()
        cv2.imwrite(str(training / folder / "000007_10.png"), np.full(HW, 256 * SHIFT_PX, np.uint16))
    venus = root / "middlebury_2001" / "venus"
    venus.mkdir(parents=True)
    for name, view in zip(("im2", "im6"), pair(rng), strict=True):
        cv2.imwrite(str(venus / f"{name}.ppm"), np.rint(view[..., ::-1] * 255).astype(np.uint8))
    cv2.imwrite(str(venus / "disp2.pgm"), np.full(HW, 8 * SHIFT_PX, np.uint8))
    write_middlebury_half(root / "middlebury_2005_half" / "Art", rng)
    write_middlebury_half(root / "middlebury_2006_half" / "Wood1", rng)
    own = root / "captures" / "vase"
    for name, view in zip(("tele", "wide"), pair(rng), strict=True):
        write_image(own / f"{name}.png", view)
    write_pfm(own / "truth.pfm", np.full(HW, SHIFT_PX, np.float32))
    return root


ASKED = ("kitti_2012", "middlebury_2001", "middlebury_2005_half", "middlebury_2006_half", "captures")


def test_sets_of_no_table_are_reached_by_the_command(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["--table", "prior", "--data", str(data), "--systems", "sgm-opencv", "--out", str(out)]
    asked = ["--data-sets", ",".join(ASKED), "--factors", "1, 3"]
    result = CliRunner().invoke(app, ["benchmark", "paper", *words, *asked])
    assert result.exit_code == 0, result.output
    rows = [row for row in csv.DictReader((out / "prior.csv").read_text().splitlines()) if row["region"] == "all"]
    assert [row["column"] for row in rows] == [f"{name} BIC x{factor}" for name in ASKED for factor in (1, 3)]
    for row in rows:
        # What the right view shows of the left one is matched; holes are filled from it by rows.
        assert float(row["off_3px_5percent"]) < 0.05, row["column"]
        assert float(row["end_point_error_px"]) < 1, row["column"]
    for name in ASKED:
        assert f"**{name}**" in result.stdout
        assert (out / "prior" / f"{name}-BIC-x3-{rows[2 * ASKED.index(name)]['scene']}.png").is_file()


def test_published_values_stay_with_the_columns_they_are_of() -> None:
    asked = with_columns(find_table("large-factor"), data_sets=("HCI", "kitti-2012"), factors=(3, 8))
    assert [column.heading for column in asked.columns] == [
        *("HCI BIC x3", "HCI BIC x8", "kitti-2012 BIC x3", "kitti-2012 BIC x8")
    ]
    assert asked.rows["method"] == (None, Published(6.17, 1.008), None, None)
    assert asked.columns[2].test == ("kitti-2012",)
    for name in ("overall", "prior"):
        assert with_columns(find_table(name)) == find_table(name)


def test_one_scene_of_two_sizes_is_not_learned_from_where_it_is_judged(data: Path, rng: np.random.Generator) -> None:
    for scene in ("Wood1", "Cloth1", "Aloe"):
        folder = data / "middlebury_2006_third" / scene
        for name, view in zip(("view1", "view5"), pair(rng, (370, 160)), strict=True):
            write_image(folder / f"{name}.png", view)
        cv2.imwrite(str(folder / "disp1.png"), np.full((370, 160), 3 * SHIFT_PX, np.uint8))
    table = with_columns(find_table("stages"), data_sets=("middlebury_2006_half", "captures"), factors=(3,))
    plans, _ = planned_cells(table, PaperOptions(data, data.parent / "out"))
    learned = {plan.column.data_set: {scene.name for scene in plan.task.training} for plan in plans}
    assert learned == {"middlebury_2006_half": {"Cloth1"}, "captures": {"Wood1", "Cloth1"}}


def test_slips(data: Path) -> None:
    with pytest.raises(UsageError, match="unknown data set 'kiti_2012'") as caught:
        with_columns(find_table("prior"), data_sets=("captures", "kiti_2012"))
    assert "kitti_2012" in (caught.value.hint or "")
    with pytest.raises(UsageError) as caught:
        with_columns(find_table("prior"), data_sets=("Middelbury",))
    assert "Middlebury" in (caught.value.hint or "")
    words = ["benchmark", "paper", "--table", "prior", "--data", str(data), "--factors"]
    for stated in ("0.5", "two", "3,nan", "inf"):
        result = CliRunner().invoke(app, [*words, stated])
        assert isinstance(result.exception, UsageError), stated
        assert f"--factors {stated}: numbers of at least 1 were expected" in result.exception.message
