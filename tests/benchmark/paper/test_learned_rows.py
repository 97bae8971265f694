"""Rows that learn, each trained for a few steps on two small scenes: what they see, what they share, how they go on."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch
from benchmark.paper.small_task import COLUMN, HW, WINDOW, Told, cell_of, scenes_of, task_of, write_scenes
from safetensors.torch import load_file

from telewide.benchmark.damages import damaged_view
from telewide.benchmark.learned import LearnedSystem, read_learned_systems
from telewide.benchmark.paper.cells import Cells
from telewide.benchmark.paper.chain import StageRecord
from telewide.benchmark.paper.learned_rows import learned_row
from telewide.benchmark.paper.system import Budget, System, undamaged_view, weights_fingerprints
from telewide.benchmark.paper.systems import SYSTEMS
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm
from telewide.errors import InputError, UsageError
from telewide.matching.inference import match_with_network
from telewide.matching.networks import build_network, published_psmnet
from telewide.records import read_record
from telewide.restoration.restorers import build_restorer

LEARNED = tuple(read_learned_systems())
Shows = Literal["disparity", "space"]
SMALL = ("train.crop_hw=[64, 96]", "train.photometric.captured=1", "train.feature.captured=1")


def small_row(
    *settings: str, restorer: str | None = None, shows: Literal["disparity", "space"] = "disparity"
) -> System:
    """A row as small as its stages allow."""
    system = LearnedSystem(title="Small", network="lite", settings=(*SMALL, *settings), restorer=restorer, shows=shows)
    return learned_row("small", system)


def of_space(name: str) -> tuple[str, ...]:
    """Settings of one feature-metric stage in a space of its own."""
    return "train.stages=1", f"train.feature_space={name}", "train.space.steps=1", "train.space.captured=1"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    write_scenes(root)
    return root


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shared by the tests of this file, as by the tables of a user."""
    return tmp_path_factory.mktemp("out")


def stages_in(out: Path) -> dict[str, int]:
    """How many trainings of each stage lie in a folder."""
    kept = [p for p in (out / "trainings").glob("*/*.safetensors") if p.name != "weights.safetensors"]
    names = [path.stem for path in kept if not path.stem.endswith("-best")]
    return {name: names.count(name) for name in sorted(set(names))}


def test_a_row_learns_once_and_answers_with_its_last_and_its_best_weights(data: Path, out: Path) -> None:
    task, told = task_of(data, steps=4), Told()
    row = small_row("train.stages=0")
    prepared = row.prepare(task, told.place(out))
    assert list(prepared.matchers) == ["last", "best"]
    assert prepared.steps == 4
    assert any("step 4" in line and "validation" in line for line in told.lines)
    (scene,) = scenes_of(data, "test")
    sharp = scene.read()
    seen = prepared.seen_pair(task, "d", sharp)
    expected = damaged_view(sharp.right, task.damage, factor=2, scene="d", seed=0)
    np.testing.assert_array_equal(seen.right, expected)
    answers = [match(seen.left, seen.right, WINDOW) for match in prepared.matchers.values()]
    assert all(answer.shape == HW and np.isfinite(answer).all() for answer in answers)
    again = Told()
    kept = row.prepare(task, again.place(out))
    assert again.lines == []
    np.testing.assert_array_equal(kept.matchers["last"](seen.left, seen.right, WINDOW), answers[0])


def test_rows_share_the_stages_they_begin_with(data: Path, out: Path, tmp_path: Path) -> None:
    task, told = task_of(data, steps=4), Told()
    small_row("train.stages=1").prepare(task, told.place(tmp_path))
    assert stages_in(tmp_path) == {"feature-1": 1, "photometric": 1}
    prepared = small_row("train.stages=2").prepare(task, told.place(tmp_path))
    # Half of the budget for the first stage in both; the rest for one stage, or for two.
    assert stages_in(tmp_path) == {"feature-1": 2, "feature-2": 1, "photometric": 1}
    assert prepared.steps == 4
    small_row("train.stages=1").prepare(replace(task, seed=1), told.place(tmp_path))
    assert stages_in(tmp_path)["photometric"] == 2


@pytest.mark.slow
def test_rows_of_other_spaces_share_what_comes_before_them(data: Path, tmp_path: Path) -> None:
    task = task_of(data, steps=8)
    for row in (small_row("train.stages=1"), small_row(*of_space("contrastive")), small_row(*of_space("auto-encoder"))):
        row.prepare(task, Told().place(tmp_path))
    assert stages_in(tmp_path) == {"feature-1": 3, "photometric": 1}
    n_folders = len(list((tmp_path / "trainings").iterdir()))
    assert n_folders == 1 + 2 + 3, "a space has no weights of a network"
    small_row("train.stages=0").prepare(task, Told().place(tmp_path))
    assert len(list((tmp_path / "trainings").iterdir())) == n_folders + 1, "one stage alone has the whole budget"
    for settings in (of_space("contrastive"), of_space("auto-encoder"), ("train.stages=0",)):
        told = Told()
        assert small_row(*settings, shows="space").prepare(task, told.place(tmp_path)).encoder is not None
        assert told.lines == [], "what a row is judged by matters to no training"
    assert len(list((tmp_path / "trainings").iterdir())) == n_folders + 1


def test_a_training_cut_off_ends_as_one_that_was_not(data: Path, tmp_path: Path) -> None:
    def stop(line: str) -> None:
        if "photometric: step 3" in line:
            signal.raise_signal(signal.SIGINT)

    task = task_of(data, steps=5)
    with pytest.raises(KeyboardInterrupt):
        small_row("train.stages=0").prepare(task, Told(then=stop).place(tmp_path / "cut"))
    told = Told()
    small_row("train.stages=0").prepare(task, told.place(tmp_path / "cut"))
    assert "photometric: 5 steps, from step 4" in told.lines
    small_row("train.stages=0").prepare(task, Told().place(tmp_path / "whole"))
    first, second = (
        load_file(next((tmp_path / name / "trainings").glob("*/photometric.safetensors"))) for name in ("cut", "whole")
    )
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_minutes_become_steps_that_stay(data: Path, tmp_path: Path) -> None:
    task = replace(task_of(data, steps=1), budget=Budget(0.02), validation=())
    told = Told()
    prepared = small_row("train.stages=0").prepare(task, told.place(tmp_path))
    assert list(prepared.matchers) == ["last"], "nothing judges which weights are best"
    assert any("photometric: step" in line for line in told.lines)
    assert [line for line in told.lines if "nan" in line] == []
    record = read_record(next((tmp_path / "trainings").glob("*/stage.json")), StageRecord)
    assert record.steps == prepared.steps
    assert 1 <= record.steps < 200
    assert small_row("train.stages=0").prepare(task, Told().place(tmp_path)).steps == record.steps


def test_symmetric_settings_see_undamaged_views(data: Path, tmp_path: Path) -> None:
    """S4 never looks at a damage, so one training serves every factor; S2 learns by the damaged view, and sees none."""
    task, (scene,) = task_of(data, steps=2), scenes_of(data, "test")
    sharp = scene.read()
    sees = "train.photometric.symmetric_input=true"
    settings = {"s4": (sees, "train.photometric.symmetric_loss=true"), "s2": (sees,)}
    for name, n_trainings in (("s4", 1), ("s2", 2)):
        folder = tmp_path / name
        for factor in (2.0, 4.0):
            row = small_row("train.stages=0", *settings[name])
            prepared = row.prepare(replace(task, factor=factor), Told().place(folder))
            np.testing.assert_array_equal(prepared.seen_pair(task, "d", sharp).right, undamaged_view(task)("d", sharp))
        assert stages_in(folder) == {"photometric": n_trainings}
        wide, undamaged = (read_image(next((folder / "pairs").glob(f"*/*-a/{view}.png"))) for view in ("wide", "sharp"))
        assert np.array_equal(wide, undamaged) == (name == "s4")


def test_supervised_rows_are_taught_the_truth(data: Path, out: Path) -> None:
    small_row("train.stages=0", "train.photometric.captured_loss=supervised", "train.photometric.smoothness=0").prepare(
        task_of(data, steps=2), Told().place(out)
    )
    (path,) = {p.name: p for p in (out / "pairs").glob("*/truth/captures-a/disparity_0_32.pfm")}.values()
    np.testing.assert_array_equal(read_pfm(path), scenes_of(data, "training")[0].read().disparity_px)


@pytest.mark.slow
def test_weights_of_a_restorer_are_taken_where_they_fit(data: Path, tmp_path: Path) -> None:
    from safetensors.torch import save_file

    for factor in (2, 3):
        save_file(build_restorer("dan", factor=factor, seed=factor).state_dict(), tmp_path / f"x{factor}.safetensors")
    files = tuple(tmp_path / f"x{factor}.safetensors" for factor in (3, 2))
    row, task = small_row("train.stages=0", restorer="dan"), task_of(data, steps=1, weights={"dan": files})
    prepared = row.prepare(task, Told().place(tmp_path / "out"))
    assert not (tmp_path / "out" / "restorers").exists()
    (scene,) = scenes_of(data, "test")
    assert prepared.seen_pair(task, "d", scene.read()).right.shape == (*HW, 3)
    with pytest.raises(InputError, match="does not hold dan for a factor of 4"):
        row.prepare(replace(task, factor=4.0), Told().place(tmp_path / "out"))
    with pytest.raises(UsageError, match="whole factors"):
        row.prepare(replace(task, factor=2.5), Told().place(tmp_path / "out"))


def test_a_checkpoint_of_psmnet_answers_without_a_training(data: Path, tmp_path: Path) -> None:
    network = build_network("psmnet", seed=3)
    named = {f"feature_extraction.{name}": value for name, value in network.features.state_dict().items()}
    torch.save({"state_dict": {**named, **network.matching.state_dict()}}, tmp_path / "published.tar")
    task = task_of(data, steps=1, weights={"psmnet": (tmp_path / "published.tar",)})
    prepared = SYSTEMS["psmnet"].prepare(task, Told().place(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    (scene,) = scenes_of(data, "test")
    seen = prepared.seen_pair(task, "d", scene.read())
    expected = match_with_network(
        seen.left, seen.right, network=published_psmnet(tmp_path / "published.tar"), window=WINDOW
    )
    np.testing.assert_array_equal(prepared.matchers[""](seen.left, seen.right, WINDOW), expected.disparity_px)
    assert weights_fingerprints(SYSTEMS["psmnet"], task) != weights_fingerprints(SYSTEMS["basenet"], task) == []


def test_without_scenes_to_learn_from_a_row_says_so(data: Path, out: Path) -> None:
    with pytest.raises(InputError, match="no scene to learn from"):
        small_row("train.stages=0").prepare(task_of(data, steps=1, training=()), Told().place(out))


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNED)
def test_every_row_learns_and_is_judged(data: Path, out: Path, name: str) -> None:
    is_large = name in {"rcan-basenet", "dan-basenet", "iresnet", "psmnet", "ours-trained"}
    cells = Cells(out, Told())
    ((_, rows),) = cells.rows([cell_of(data, name, task_of(data, steps=2 if is_large else 8))])
    assert cells.problems == []
    expected = {""} if name.endswith("-space") else {"last", "best"}
    assert {row["weights"] for row in rows} == expected
    for row in rows:
        assert row["region"] != "all" or 0 <= float(str(row["off_3px_5percent"])) <= 1
        assert np.isfinite(float(str(row["end_point_error_px"])))
        assert (row["space_psnr_db"] is not None) == name.endswith("-space")
    assert COLUMN.heading
