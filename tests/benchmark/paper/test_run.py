"""Tables of small scenes with known disparity: cells are kept, shared, and made anew when what they depend on is."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import subprocess
import sys
import time
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from telewide.benchmark.datasets.catalogue import DATA_SETS
from telewide.benchmark.paper import systems as systems_module
from telewide.benchmark.paper.means import paper_table
from telewide.benchmark.paper.run import PaperOptions, benchmark_table, planned_cells
from telewide.benchmark.paper.system import Budget, Place, Prepared, System, Task
from telewide.benchmark.paper.systems import SYSTEMS, match_like_opencv
from telewide.benchmark.paper.tables import Column, Published, Table, find_table, load_tables
from telewide.benchmark.paper.write import write_table
from telewide.capture.images import read_image, write_image
from telewide.capture.pfm import write_pfm
from telewide.cli.app import app
from telewide.cores import usable_cores
from telewide.errors import InputError, UsageError
from telewide.simulate.degrade import shrink_and_enlarge

DISPARITY_PX = 6
HW = (64, 128)
COLUMNS = tuple(Column("Own", ("captures",), ("captures",), damage, 2.0) for damage in ("BIC", "IG"))
TABLE = Table("own", "Own photos", COLUMNS, {"known": (Published(12.34, 1.5), None), "not-built": (None, None)})


@pytest.fixture
def data(tmp_path: Path, rng: np.random.Generator) -> Path:
    for scene in ("one", "two"):
        noise = rng.random((HW[0], HW[1] + DISPARITY_PX, 3), dtype=np.float32)
        canvas = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.5) * 4 - 1.5, 0, 1)
        folder = tmp_path / "data" / "captures" / scene
        write_image(folder / "tele.png", canvas[:, : HW[1]])
        write_image(folder / "wide.png", canvas[:, DISPARITY_PX:])
        write_pfm(folder / "truth.pfm", np.full(HW, DISPARITY_PX, np.float32))
    return tmp_path / "data"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Task]:
    """The tasks that a system which is off by 4 px is given."""
    tasks: list[Task] = []

    def prepare(task: Task, place: Place) -> Prepared:
        tasks.append(task)
        wrong = np.full(HW, DISPARITY_PX + 4, np.float32)
        return Prepared({"last": lambda ref, src, window: wrong, "best": lambda ref, src, window: wrong - 4})

    monkeypatch.setitem(SYSTEMS, "known", System("known", "Known", prepare, ("metrics",)))
    return tasks


def options(data: Path, **changes: object) -> PaperOptions:
    return replace(PaperOptions(data, data.parent / "out"), **changes)


def test_cells_are_kept(data: Path, asked: list[Task]) -> None:
    result = benchmark_table(TABLE, options(data), tell=lambda _: None)
    assert len(asked) == 2
    assert benchmark_table(TABLE, options(data), tell=lambda _: None).report.rows == result.report.rows
    assert len(asked) == 2
    benchmark_table(TABLE, options(data, seeds=2), tell=lambda _: None)
    assert len(asked) == 4
    benchmark_table(TABLE, options(data, budget=Budget(1.0)), tell=lambda _: None)
    assert len(asked) == 6


def test_a_changed_picture_makes_its_cells_anew(data: Path, asked: list[Task]) -> None:
    benchmark_table(TABLE, options(data), tell=lambda _: None)
    write_pfm(data / "captures/two/truth.pfm", np.full(HW, DISPARITY_PX + 1, np.float32))
    benchmark_table(TABLE, options(data), tell=lambda _: None)
    assert len(asked) == 4


def test_a_changed_system_makes_its_own_cells_anew(
    data: Path, asked: list[Task], monkeypatch: pytest.MonkeyPatch
) -> None:
    other = replace(SYSTEMS["known"], name="other")
    monkeypatch.setitem(SYSTEMS, "other", other)
    both = options(data, systems=("known", "other"), damages=("bic",))
    benchmark_table(TABLE, both, tell=lambda _: None)
    assert len(asked) == 2
    monkeypatch.setitem(SYSTEMS, "other", replace(other, sources=("metrics", "matching.semiglobal")))
    benchmark_table(TABLE, both, tell=lambda _: None)
    assert len(asked) == 3


def test_cut_off_cells_are_made_again(data: Path, asked: list[Task]) -> None:
    benchmark_table(TABLE, options(data), tell=lambda _: None)
    for path in (data.parent / "out" / "cells").glob("*/cell.json"):
        path.write_text(path.read_text()[:50])
    benchmark_table(TABLE, options(data), tell=lambda _: None)
    assert len(asked) == 4


def test_the_table_shows_both_weights_and_what_is_published(data: Path, asked: list[Task]) -> None:
    result = benchmark_table(TABLE, options(data), tell=lambda _: None)
    head, _, known = (
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in paper_table(TABLE, result.report.rows).splitlines()[2:]
    )
    assert head[0] == "3PE % / EPE px"
    assert head[1:] == ["BIC x2", "BIC x2, best", "IG x2", "IG x2, best"]
    assert known == ["Known", "100.00 / 4.00 (12.34 / 1.50)", "0.00 / 0.00", "100.00 / 4.00", "0.00 / 0.00"]
    assert any("not-built" in note for note in result.report.notes)
    paths = write_table(TABLE, result, data.parent / "out")
    assert "budget" in paths[0].read_text().lower()
    machine = result.report.machine
    (line,) = (line for line in paths[0].read_text().splitlines() if line.startswith("Machine: "))
    processor, cores, torch_version, own_version = line.removeprefix("Machine: ").rstrip(".").rsplit(", ", 3)
    assert processor == "; ".join(str(machine[name]) for name in ("processor", "gpu") if machine.get(name))
    assert cores == f"{usable_cores()} core{'' if usable_cores() == 1 else 's'}"
    assert torch_version == f"torch {metadata.version('torch')}"
    assert own_version == f"telewide {metadata.version('telewide')}"
    of_best = [row for row in result.report.rows if row["weights"] == "best"]
    assert all(row["bad_1px"] == 0 and row["density"] == 1 for row in of_best)
    rows = list(csv.DictReader(paths[1].read_text().splitlines()))
    assert len(rows) == len(result.report.rows) == 2 * 2 * 2
    for row in rows:
        assert row["budget"] == "8 min"
        assert (row["torch"], row["telewide"]) == (metadata.version("torch"), metadata.version("telewide"))
        assert (row["processor"], row["cores"]) == (machine["processor"], str(usable_cores()))
        assert row["gpu"] == machine.get("gpu", "")
    assert json.loads(paths[2].read_text())["machine"]["versions"]["numpy"]


def test_what_fails_leaves_the_other_cells(data: Path, asked: list[Task], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(task: Task, place: Place) -> Prepared:
        raise InputError("no weights")

    monkeypatch.setitem(SYSTEMS, "broken", replace(SYSTEMS["known"], name="broken", title="Broken", prepare=refuse))
    result = benchmark_table(TABLE, options(data, systems=("broken", "known")), tell=lambda _: None)
    assert {row["system"] for row in result.report.rows} == {"known"}
    assert any("Broken" in note and "no weights" in note for note in result.report.notes)
    with pytest.raises(InputError, match="no cell"):
        benchmark_table(TABLE, options(data, systems=("broken",)), tell=lambda _: None)


def test_the_picture_as_a_space(data: Path) -> None:
    table = Table("spaces", "Spaces", COLUMNS[:1], {"image-space": (Published(55.3, None, 24.65),)})
    result = benchmark_table(table, options(data), tell=lambda _: None)
    pictures = [read_image(data / "captures" / scene / "wide.png") for scene in ("one", "two")]
    expected_db = [
        -10 * np.log10(np.mean((shrink_and_enlarge(picture, factor=2) - picture) ** 2) / np.ptp(picture) ** 2)
        for picture in pictures
    ]
    assert [row["space_psnr_db"] for row in result.report.rows] == pytest.approx(expected_db, abs=0.01)
    assert all(float(str(row["off_3px_5percent"])) < 0.2 for row in result.report.rows)
    text = paper_table(table, result.report.rows)
    assert f"{np.mean(expected_db):.2f} dB (55.30 / 24.65 dB)" in text
    assert "| 3PE % / EPE px / PSNR dB |" in text


def test_missing_data_and_slips(data: Path, asked: list[Task]) -> None:
    (data / "captures").rename(data / "elsewhere")
    with pytest.raises(InputError, match="no data set of the table") as caught:
        benchmark_table(TABLE, options(data), tell=lambda _: None)
    assert DATA_SETS["captures"].source in (caught.value.hint or "")
    with pytest.raises(UsageError, match="unknown system"):
        benchmark_table(TABLE, options(data, systems=("knwon",)), tell=lambda _: None)
    with pytest.raises(UsageError, match="none of the damages"):
        benchmark_table(TABLE, options(data, damages=("AG",)), tell=lambda _: None)


def _one_process(data: Path, log: Path) -> None:
    def slow(task: Task, place: Place) -> Prepared:
        with log.open("a") as stream:
            stream.write("computed\n")
        time.sleep(0.5)
        return Prepared({"": lambda ref, src, window: np.zeros(HW, np.float32)})

    systems_module.SYSTEMS["slow"] = System("slow", "Slow", slow, ("metrics",))
    benchmark_table(TABLE, options(data, systems=("slow",)), tell=lambda _: None)


def test_processes_share_cells(data: Path, tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    log = tmp_path / "log"
    processes = [context.Process(target=_one_process, args=(data, log)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    assert log.read_text().splitlines() == ["computed"] * len(COLUMNS)


def test_opencv_sees_the_pairs_the_right_way_round(rng: np.random.Generator) -> None:
    canvas = cv2.GaussianBlur(rng.random((HW[0], HW[1] + 8, 3), dtype=np.float32), (0, 0), 1.2)
    canvas = np.clip((canvas - 0.5) * 4 + 0.5, 0, 1)
    for true_px, window in ((8, (0, 16)), (-8, (-16, 16))):
        left, right = canvas[:, : HW[1]], canvas[:, 8:]
        ref, src = (left, right) if true_px > 0 else (right, left)
        found_px = match_like_opencv(ref, src, window)
        assert np.isfinite(found_px).all()
        assert np.median(np.abs(found_px[:, 24:-24] - true_px)) < 0.5


def test_lists_and_a_table_by_the_command(data: Path) -> None:
    run = CliRunner()
    tables = run.invoke(app, ["benchmark", "paper", "--list-tables"])
    assert tables.exit_code == 0
    assert "overall: Every system" in tables.stdout
    assert "sgm-opencv: SGM (OpenCV)" in run.invoke(app, ["benchmark", "paper", "--list-systems"]).stdout
    scene = data / "middlebury_2014" / "Own"
    for name, view in (("im0.png", "tele.png"), ("im1.png", "wide.png"), ("disp0.pfm", "truth.pfm")):
        scene.mkdir(parents=True, exist_ok=True)
        (scene / name).write_bytes((data / "captures/one" / view).read_bytes())
    words = ["--table", "open", "--data", str(data), "--damages", "GAIN", "--out", str(data.parent / "out")]
    result = run.invoke(app, ["benchmark", "paper", *words, "--systems", "sgm-opencv"])
    assert result.exit_code == 0, result.output
    assert "**Middlebury 2014**" in result.stdout
    assert "GAIN x4" in result.stdout
    assert (data.parent / "out" / "open.md").is_file()


def test_of_several_processes_one_speaks_and_writes(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = data / "middlebury_2014" / "Own"
    scene.mkdir(parents=True)
    for name, view in (("im0.png", "tele.png"), ("im1.png", "wide.png"), ("disp0.pfm", "truth.pfm")):
        (scene / name).write_bytes((data / "captures/one" / view).read_bytes())
    out, run = data.parent / "out", CliRunner()
    words = ["benchmark", "paper", "--table", "open", "--data", str(data), "--systems", "sgm-opencv", "--out", str(out)]
    second = run.invoke(app, words, env={"RANK": "1", "WORLD_SIZE": "2"})
    assert (second.exit_code, second.output) == (0, "")
    cells = sorted(path.name for path in (out / "cells").iterdir())
    assert len(cells) == 9
    assert not (out / "open.md").exists()
    first = run.invoke(app, words, env={"RANK": "0", "WORLD_SIZE": "2"})
    assert "**Middlebury 2014**" in first.stdout
    assert sorted(path.name for path in (out / "cells").iterdir()) == cells
    assert (out / "open.html").is_file()
    assert len(list((out / "open").glob("*.png"))) == 9


def test_restorer_weights_that_do_not_exist(data: Path) -> None:
    words = ["benchmark", "paper", "--table", "overall", "--data", str(data), "--restorer-weights"]
    for stated, expected in (("rcan", "rcan=FILE"), ("ran=x.pt", "dan=FILE"), ("rcan=x.pt", "x.pt does not exist")):
        result = CliRunner().invoke(app, [*words, stated])
        assert isinstance(result.exception, UsageError)
        assert expected in result.exception.message


@pytest.mark.data
@pytest.mark.parametrize("name", [name for name in load_tables() if name != "prior"])
def test_every_row_of_every_table_has_cells_on_the_photographed_sets(
    name: str, data_root: Path, tmp_path: Path
) -> None:
    """What each cell would learn from and be judged by; nothing of the test is learned from."""
    table = find_table(name)
    plans, _ = planned_cells(table, PaperOptions(data_root, tmp_path))
    headings = {plan.column.heading for plan in plans}
    assert {plan.system.name for plan in plans} == set(table.rows)
    assert len(plans) == len(headings) * len(table.rows)
    assert {c.data_set for c in table.columns} - {plan.column.data_set for plan in plans} <= {"Inria_SLFD"}
    for plan in plans:
        tested = {(scene.root, scene.name) for scene in plan.scenes}
        assert plan.task.training
        assert plan.task.validation
        for scene in (*plan.task.training, *plan.task.validation):
            assert (scene.root, scene.name) not in tested


@pytest.mark.slow
def test_processes_of_torchrun_share_the_cells_of_a_table(data: Path, repo: Path) -> None:
    out = data.parent / "out"
    words = ["-m", "telewide", "benchmark", "paper", "--table", "prior", "--systems", "sgm", "--data-sets", "captures"]
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    done = subprocess.run(
        [*launch, *words, "--data", str(data), "--out", str(out)],
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(repo)},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("| sgm") == 1, "one process prints"
    assert (out / "prior.md").is_file()
    assert len(list((out / "cells").iterdir())) == 3
