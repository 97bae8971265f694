"""A training in its run folder: begun, stopped, killed, continued, refused, finished; and what it never reads."""

from __future__ import annotations

import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load_file
from training.small import Heard

import telewide.stages.train
import telewide.stages.training_log
import telewide.stages.training_record
from telewide.capture.pair import find_captures
from telewide.capture.pfm import read_pfm
from telewide.cli import main
from telewide.errors import UsageError
from telewide.matching.networks import build_network
from telewide.pipeline import depth_captures, train_captures
from telewide.recipe import Recipe, load_recipe
from telewide.simulate.captures import write_captures
from telewide.stages.depth import DepthOptions
from telewide.stages.prepare import prepare_captures
from telewide.stages.run_folder import RunFolder
from telewide.stages.train import TrainOutcome
from telewide.stages.training_log import LoggedReporter
from telewide.stages.training_record import read_training
from telewide.training import loop
from telewide.training.checkpoint import TrainingState
from telewide.training.loop import DECISIVE, Training
from telewide.training.samples import CropArea, SampleSource
from telewide.training.stages import plan_stages

NAN = math.nan
RECIPE: Mapping[str, object] = {
    "network": "lite",
    "window_px": [0, 32],
    "train": {
        "crop_hw": [64, 96],
        "stages": 1,
        "judge_every_steps": 4,
        "rehearsal": {"steps": 4, "rehearsed": 1, "retaken": 1},
        "photometric": {"steps": 4, "captured": 1, "swaps_views": True},
        "feature": {"steps": 2, "captured": 1, "captured_loss": "feature"},
    },
}
SETTINGS = "import telewide.stages.train, telewide.stages.training_log; from telewide.training import loop; "
SETTINGS += "loop.CHECKPOINT_EVERY_S = 0.0; "
SETTINGS += "telewide.stages.training_log.LOG_EVERY_STEPS = 1; "
NO_WORKERS = "telewide.stages.train.workers_for = lambda device: 0; "
RUN = "import sys; from telewide.cli import main; main(sys.argv[1:])"


SHORT = ("train.rehearsal.steps=1", "train.photometric.steps=0", "train.stages=0")


class Observer(Heard):
    """Hears the training, and not the rest."""

    invocation = None

    def warned(self, message: str) -> None: ...

    def preparing(self, captures: object) -> None: ...
    def pair_prepared(self, name: str, *, is_kept: bool = False) -> None: ...
    def set_prepared(self, prepared: object) -> None: ...
    def searching(self, window: object) -> None: ...
    def surveying(self, total: int) -> object:
        return lambda: None

    def matching(self, total: int, *, method: str) -> None: ...
    def depth_written(self, outcome: object) -> None: ...
    def depth_failed(self, problem: object) -> None: ...


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three simulated captures with their truth."""
    folder = tmp_path_factory.mktemp("simulated") / "captures"
    write_captures(folder, count=3, seed=1, hw=(128, 192), factor=2)
    return folder


@pytest.fixture
def captures(tmp_path: Path, simulated: Path) -> Path:
    """A copy of the captures to work on."""
    return Path(shutil.copytree(simulated, tmp_path / "captures"))


@pytest.fixture
def recipe_path(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(dict(RECIPE)))
    return path


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Batches are made here, every step is logged, and one thread computes: sums of two are rounded otherwise."""
    monkeypatch.setattr(telewide.stages.train, "workers_for", lambda device: 0)
    monkeypatch.setattr(telewide.stages.training_log, "LOG_EVERY_STEPS", 1)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def tiny(*settings: str, path: Path) -> Recipe:
    return load_recipe(str(path), settings=settings)


def run_training(
    captures: Path, run: Path, recipe: Recipe, *, fresh: bool = False, observer: Observer | None = None
) -> TrainOutcome:
    return train_captures(captures, run=run, recipe=recipe, fresh=fresh, device="cpu", observer=observer or Observer())


def logged_losses(run: Path) -> list[tuple[str, int, object]]:
    lines = [json.loads(line) for line in (run / "train" / "log.jsonl").read_text().splitlines()]
    return [(line["stage"], line["step"], line["losses"]) for line in lines if "losses" in line]


def assert_same_weights(run: Path, other: Path) -> None:
    """Every weights file of two runs, bit for bit; a kill may leave an unfinished file under a hidden name."""
    names = sorted(path.name for path in (run / "train").glob("[!.]*.safetensors"))
    assert names == sorted(path.name for path in (other / "train").glob("[!.]*.safetensors"))
    for name in names:
        weights, expected = (load_file(folder / "train" / name) for folder in (run, other))
        assert all(torch.equal(weights[key], expected[key]) for key in expected), name


def test_a_stage_that_learns_from_a_truth_is_refused(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    """Beside a truth.pfm too, which is for scoring alone."""
    asked = ("train.rehearsal.captured=1", "train.rehearsal.captured_loss=supervised")
    with pytest.raises(UsageError, match="stage rehearsal learns from a truth, which captures do not have"):
        run_training(captures, tmp_path / "run", tiny(*asked, path=recipe_path))
    assert not list(tmp_path.rglob("state.pt"))


def test_training_on_captures_as_they_are_needs_no_surfaces(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    """As the paper's recipe does: photometric and feature-metric stages alone."""
    run = tmp_path / "run"
    run_training(captures, run, tiny("train.rehearsal.steps=0", path=recipe_path))
    assert not list(run.rglob("disparity_*.pfm"))


def test_training_leaves_weights_record_log_and_sheets(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    run = tmp_path / "run"
    outcome = run_training(captures, run, tiny(path=recipe_path))
    assert outcome.is_new
    assert outcome.weights == run / "train" / "weights.safetensors"
    assert {"rehearsal", "photometric", "feature-1"} == set(outcome.stages)
    for name in outcome.stages:
        assert (run / "train" / f"{name}.png").is_file()
        assert (run / "train" / f"{name}.safetensors").is_file()
    assert [(stage, step) for stage, step, _ in logged_losses(run)] == [
        *(("rehearsal", step) for step in (1, 2, 3, 4)),
        *(("photometric", step) for step in (1, 2, 3, 4)),
        *(("feature-1", step) for step in (1, 2)),
    ]
    options = json.loads((run / "run.json").read_text())["commands"]["train"]["options"]
    assert (options["window_px"], options["rig"], options["device"], options["fresh"]) == ([0, 32], None, "cpu", False)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[Training]:
    """The trainings that were begun."""
    noted_so_far: list[Training] = []
    train = telewide.stages.train.run_training

    def noted(training: Training, state: TrainingState, *, reporter: Observer) -> TrainingState:
        noted_so_far.append(training)
        return train(training, state, reporter=reporter)

    monkeypatch.setattr(telewide.stages.train, "run_training", noted)
    return noted_so_far


def test_crops_are_no_larger_than_the_part_of_the_pictures_that_training_sees(
    captures: Path, tmp_path: Path, recipe_path: Path, begun: list[Training]
) -> None:
    """Pictures of 128 x 192 px, a fifth of their width held out: they are not enlarged to fill 256 x 384 px."""
    asked = ("train.crop_hw=[256, 384]", "train.rehearsal.steps=0", "train.photometric.steps=1", "train.stages=0")
    run_training(captures, tmp_path / "run", tiny(*asked, path=recipe_path))
    assert begun[0].source.crop_hw == (128, 144)


@pytest.mark.slow
@pytest.mark.parametrize(("network", "enlargement"), [("lite", 1.0), ("guided", 1.5)])
def test_small_pictures_are_trained_on_at_the_size_at_which_they_are_matched(
    network: str, enlargement: float, captures: Path, tmp_path: Path, recipe_path: Path, begun: list[Training]
) -> None:
    """128 x 192 px, of which `guided` sees half as much again; the window stays that of the pictures."""
    asked = (f"network={network}", "train.crop_hw=[256, 384]", "train.rehearsal.steps=1", "train.stages=0")
    run_training(captures, tmp_path / "run", tiny(*asked, "train.photometric.steps=0", path=recipe_path))
    source = begun[0].source
    assert isinstance(source, SampleSource)
    assert source.enlargement == enlargement
    assert source.crop_hw == ((192, 224) if network == "guided" else (128, 144))
    assert begun[0].window == source.window_px == (0, 32)


def test_what_is_held_out_is_never_trained_on(
    captures: Path, tmp_path: Path, recipe_path: Path, monkeypatch: pytest.MonkeyPatch, begun: list[Training]
) -> None:
    """Of three captures one is kept for judging: crops come from the two others, and the judge asks that one alone."""
    monkeypatch.setattr(telewide.stages.training_record, "FEWEST_TO_HOLD_OUT", 3)
    run_training(captures, tmp_path / "run", tiny(*SHORT, path=recipe_path))
    record = read_training(RunFolder(tmp_path / "run"))
    assert record is not None
    assert len(record.held_out) == 1
    assert record.judged == record.held_out
    assert {capture.name for capture in begun[0].source.captures} == set(record.captures) - set(record.held_out)
    assert begun[0].source.area == CropArea()


@pytest.mark.slow
def test_ground_truth_is_not_read_in_training(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    """Truths that no reader accepts, and none at all: the same losses, the same weights."""
    recipe = tiny(path=recipe_path)
    bare = Path(shutil.copytree(captures, tmp_path / "bare" / "captures"))
    for name in ("000", "001", "002"):
        (bare / name / "truth.pfm").unlink()
        (captures / name / "truth.pfm").write_bytes(b"poison")
    for folder, run in ((captures, tmp_path / "poisoned"), (bare, tmp_path / "without")):
        run_training(folder, run, recipe)
    assert logged_losses(tmp_path / "poisoned") == logged_losses(tmp_path / "without")
    assert_same_weights(tmp_path / "poisoned", tmp_path / "without")


def test_another_recipe_is_refused_by_the_names_of_its_keys(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    run = tmp_path / "run"
    run_training(captures, run, tiny(*SHORT, path=recipe_path))
    before = (run / "train" / "state.pt").read_bytes()
    other = tiny(*SHORT, "train.photometric.alpha=1.5", "network=psmnet-s", path=recipe_path)
    with pytest.raises(UsageError) as raised:
        run_training(captures, run, other)
    assert "train.photometric.alpha" in raised.value.message
    assert "network" in raised.value.message
    assert "--fresh" in str(raised.value.hint)
    assert (run / "train" / "state.pt").read_bytes() == before
    renamed = tiny(*SHORT, "description=the same in other words", path=recipe_path)
    assert not run_training(captures, run, renamed).is_new


def test_a_finished_training_says_so(
    captures: Path, tmp_path: Path, recipe_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["train", str(captures), "--recipe", str(recipe_path), "--out", str(tmp_path / "run"), "--device", "cpu"]
    for times in (1, 2):
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code == 0
        said = capsys.readouterr().err
        assert ("finished already" in said.replace("\n", " ")) == (times == 2)
        told = [line for line in said.splitlines() if " is done: " in line or line.startswith("result: ")]
        assert len(told) == (0 if times == 2 else 4), "one line a stage, and one at the end"


@pytest.mark.parametrize(
    ("judged_px", "result_px", "told"),
    [
        ({0: 0.4, 20: 0.45}, 0.4, "the weights it began with are kept, judged 0.400 px off; no step"),
        (
            {0: 0.4, 20: 0.35, 40: 0.37},
            0.35,
            "the weights of step 20 are kept, judged 0.350 px off, 0.400 px before",
        ),
        ({20: 0.35}, 0.35, "the weights of step 20 are kept, judged 0.350 px off"),
        ({20: NAN}, NAN, "its last weights are kept; too few matches to judge by"),
    ],
)
def test_a_stage_says_at_its_end_what_is_kept_of_it(
    judged_px: dict[int, float], result_px: float, told: str, tmp_path: Path
) -> None:
    heard, stages = Observer(), plan_stages(load_recipe("paper").train)
    stage = stages[0]
    reporter = LoggedReporter(heard, RunFolder(tmp_path), rows=lambda network: [], is_writer=True)
    for step, off_px in judged_px.items():
        reporter.judged(stage, step=step, judgement={"clipped_px": off_px})
    reporter.is_writer = False  # which draws no sheet
    reporter.stage_finished(stage, network=build_network("lite"), judgement={"clipped_px": result_px})
    assert heard.messages[-1].startswith(f"{stage.name} is done: {told}")
    reporter.stage_finished(stages[1], network=build_network("lite"), judgement={"clipped_px": 0.2})
    before = "" if math.isnan(result_px) else f", {result_px:.3f} px before"
    assert heard.messages[-1].endswith(f"judged 0.200 px off{before}"), "it began with what the first one led to"


@pytest.mark.parametrize(
    ("best_step", "off_px", "told"),
    [
        (
            0,
            0.4,
            "result: the weights that a began with, judged 0.400 px off; no step was judged better",
        ),
        (20, 0.35, "result: a, step 20, judged 0.350 px off"),
        (20, NAN, "result: a, step 20, too few matches to judge by"),
    ],
)
def test_a_training_says_at_its_end_what_it_results_in(best_step: int, off_px: float, told: str) -> None:
    assert TrainOutcome(Path("w"), True, {"a": off_px, "b": 1.0}, "a", best_step=best_step).told == told


@pytest.mark.slow
def test_fresh_starts_over(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    run = tmp_path / "run"
    recipe = tiny(path=recipe_path)
    run_training(captures, run, recipe)
    first = logged_losses(run)
    (run / "train" / "notes.txt").write_text("mine")
    heard = Observer()
    outcome = run_training(captures, run, recipe, fresh=True, observer=heard)
    assert outcome.is_new
    assert len(heard.losses) == 10
    assert logged_losses(run) == first
    assert (run / "train" / "notes.txt").read_text() == "mine"
    other = tiny("train.feature.alpha=1.0", path=recipe_path)
    assert run_training(captures, run, other, fresh=True).is_new, "another recipe is welcome then"


@pytest.mark.slow
def test_new_captures_are_taken_in(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    run_training(captures, run, recipe)
    add_capture(captures, tmp_path / "more")
    heard = Observer()
    outcome = run_training(captures, run, recipe, observer=heard)
    assert outcome.is_new
    assert any("later" in message for message in heard.messages)
    assert {stage for stage, _ in heard.losses} == {"feature-1"}, "the last stage is taken again, from its result"
    record = read_training(RunFolder(run))
    assert record is not None
    assert "later" in record.captures
    assert record.window == (0, 32)


def add_capture(captures: Path, scratch: Path, *, name: str = "later") -> None:
    write_captures(scratch, count=1, seed=9, hw=(128, 192), factor=2)
    shutil.copytree(scratch / "000", captures / name)


@pytest.mark.slow
def test_new_captures_are_trained_on_after_a_stop_that_came_early(
    captures: Path, tmp_path: Path, recipe_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    run_training(captures, run, recipe)
    add_capture(captures, tmp_path / "more")

    def stop(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(telewide.stages.train, "network_judge", stop)
        with pytest.raises(KeyboardInterrupt):
            run_training(captures, run, recipe)
    heard = Observer()
    assert run_training(captures, run, recipe, observer=heard).is_new
    assert {stage for stage, _ in heard.losses} == {"feature-1"}


@pytest.mark.slow
def test_new_captures_do_not_change_the_judge(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    run_training(captures, run, recipe)
    add_capture(captures, tmp_path / "more")
    run_training(captures, run, recipe)
    record = read_training(RunFolder(run))
    assert record is not None
    assert record.judged == ("000", "001", "002")
    prepared = prepare_captures(find_captures(captures), RunFolder(run), recipe=recipe)
    judged = telewide.stages.train.judged_captures(prepared, record, recipe)
    assert [item.capture.name for item in judged] == ["000", "001", "002"]


def test_a_training_without_its_judge_or_its_pictures_is_refused(
    captures: Path, tmp_path: Path, recipe_path: Path
) -> None:
    run, recipe = tmp_path / "run", tiny(*SHORT, path=recipe_path)
    for name in ("003", "004"):
        add_capture(captures, tmp_path / f"more_{name}", name=name)
    run_training(captures, run, recipe)
    record = read_training(RunFolder(run))
    assert record is not None
    held_out, seen = set(record.held_out), set(record.captures) - set(record.held_out)
    assert held_out
    assert seen
    for names, message in ((held_out, "judged by are no longer there"), (seen, "none to train on")):
        for name in names:
            (captures / name).rename(tmp_path / name)
        with pytest.raises(UsageError, match=message):
            run_training(captures, run, recipe)
        for name in names:
            (tmp_path / name).rename(captures / name)


@pytest.mark.slow
def test_a_reopened_training_ends_no_worse(
    captures: Path, tmp_path: Path, recipe_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The judge likes the first result and nothing that comes later."""
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    answers = iter([0.5, 0.4, 0.2])

    def judge(*args: object, **kwargs: object) -> Callable[[object], dict[str, float]]:
        return lambda network: {DECISIVE: next(answers, 0.3)}

    monkeypatch.setattr(telewide.stages.train, "network_judge", judge)
    monkeypatch.setattr(telewide.stages.train, "joined_judge", lambda matches, worlds: matches)
    run_training(captures, run, recipe)
    result = load_file(run / "train" / "weights.safetensors")
    add_capture(captures, tmp_path / "more")
    outcome = run_training(captures, run, recipe)
    assert outcome.is_new
    assert outcome.best_stage == "feature-1"
    again = load_file(run / "train" / "weights.safetensors")
    assert all(torch.equal(again[name], result[name]) for name in result)


@pytest.mark.slow
def test_depth_takes_the_newest_checkpoint_while_training_goes_on(
    captures: Path, tmp_path: Path, recipe_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "CHECKPOINT_EVERY_S", 0.0)
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    alone, disturbed = Observer(), Observer()
    run_training(captures, tmp_path / "alone", recipe, observer=alone)

    def look(name: str, step: int) -> None:
        if (name, step) == ("rehearsal", 3):
            done = depth_captures(
                captures, run=run, recipe=recipe, options=DepthOptions(device="cpu"), observer=Observer()
            )
            assert [outcome.name for outcome in done.outcomes] == ["000", "001", "002"]
            assert np.isfinite(read_pfm(run / "depth" / "000" / "disparity.pfm")).any()

    disturbed.after_step = look
    run_training(captures, run, recipe, observer=disturbed)
    assert disturbed.losses == alone.losses


@pytest.mark.slow
def test_depth_says_that_its_weights_will_be_better(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    """Of a training stopped by hand, until it is finished, where depth is made by them; never of a copied file."""
    run, recipe = tmp_path / "run", tiny(path=recipe_path)

    def stop(name: str, step: int) -> None:
        if step == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_training(captures, run, recipe, observer=Observer(after_step=stop))

    def told(weights: Path | None) -> list[str]:
        heard = Observer()
        options = DepthOptions(weights=weights, device="cpu")
        depth_captures(captures, run=run, recipe=recipe, options=options, observer=heard)
        return [message for message in heard.messages if "training" in message]

    unfinished = "the training of these weights is not finished (rehearsal, step 2 of 4)"
    assert told(run / "train" / "weights.safetensors") == [unfinished]
    assert told(None) == []  # the same depth, kept
    shutil.rmtree(run / "depth")
    assert told(None) == [f"{unfinished}; telewide train {captures} --out {run} goes on"]
    alone = Path(shutil.copy(run / "train" / "weights.safetensors", tmp_path / "weights.safetensors"))
    shutil.rmtree(run / "depth")
    assert told(alone) == []
    run_training(captures, run, recipe)
    assert told(None) == []


# Processes that are stopped


def command(captures: Path, run: Path, recipe_path: Path, *, before: str) -> list[str]:
    words = ["train", str(captures), "--recipe", str(recipe_path), "--out", str(run), "--device", "cpu", "--quiet"]
    return [sys.executable, "-c", before + RUN, *words]


def wait_for(path: Path, process: subprocess.Popen[bytes], *, seconds: float = 600) -> None:
    end = time.monotonic() + seconds
    while not path.is_file():
        assert process.poll() is None, "the training ended before it wrote anything"
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
def test_a_killed_training_goes_on_as_if_nothing_had_been(
    captures: Path, tmp_path: Path, recipe_path: Path, repo: Path
) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    recipe = tiny(path=recipe_path)
    run_training(captures, whole, recipe)
    process = subprocess.Popen(
        command(captures, killed, recipe_path, before=SETTINGS + NO_WORKERS), cwd=repo, stderr=subprocess.DEVNULL
    )
    wait_for(killed / "train" / "state.pt", process)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    heard = Observer()
    run_training(captures, killed, recipe, observer=heard)
    assert 0 < len(heard.losses) < 10
    assert any("resuming" in message for message in heard.messages)
    assert logged_losses(killed) == logged_losses(whole)
    assert_same_weights(killed, whole)


@pytest.mark.slow
def test_an_interrupt_leaves_a_checkpoint_to_go_on_from(
    captures: Path, tmp_path: Path, recipe_path: Path, repo: Path
) -> None:
    """Ctrl-C reaches the whole group, the worker process too; exit code 130, no traceback."""
    run = tmp_path / "run"
    long = tiny("train.rehearsal.steps=4000", path=recipe_path)
    words = command(captures, run, recipe_path, before=SETTINGS)
    process = subprocess.Popen(
        [*words, "--set", "train.rehearsal.steps=4000"], cwd=repo, stderr=subprocess.PIPE, start_new_session=True
    )
    wait_for(run / "train" / "log.jsonl", process)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 130, said.decode()
    assert b"Traceback" not in said
    done = depth_captures(captures, run=run, recipe=long, options=DepthOptions(device="cpu"), observer=Observer())
    assert len(done.outcomes) == 3
    steps = len(logged_losses(run))
    heard = Observer(after_step=lambda name, step: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        run_training(captures, run, long, observer=heard)
    assert list(heard.losses) == [("rehearsal", steps + 1)]


@pytest.mark.slow
def test_a_full_disk_stops_with_the_last_checkpoint_kept(
    captures: Path, tmp_path: Path, recipe_path: Path, repo: Path
) -> None:
    run = tmp_path / "run"
    recipe = tiny(path=recipe_path)
    stopped = Observer(after_step=lambda name, step: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        run_training(captures, run, recipe, observer=stopped)
    before = (run / "train" / "state.pt").read_bytes()
    limit = 200_000

    def fill_the_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(
        command(captures, run, recipe_path, before=SETTINGS + NO_WORKERS),
        cwd=repo,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=fill_the_disk,
    )
    assert done.returncode == 5
    assert "was not written" in done.stderr
    assert "Traceback" not in done.stderr
    assert (run / "train" / "state.pt").read_bytes() == before
    assert run_training(captures, run, recipe).is_new


@pytest.mark.slow
def test_replaced_photos_are_trained_on(captures: Path, tmp_path: Path, recipe_path: Path) -> None:
    """Another picture under the name of one that was seen: the last stage is taken again, its judge asked anew."""
    run, recipe = tmp_path / "run", tiny(path=recipe_path)
    run_training(captures, run, recipe)
    write_captures(tmp_path / "more", count=1, seed=9, hw=(128, 192), factor=2)
    shutil.rmtree(captures / "001")
    shutil.copytree(tmp_path / "more" / "000", captures / "001")
    heard = Observer()
    assert run_training(captures, run, recipe, observer=heard).is_new
    assert any("1 changed capture: 001" in message for message in heard.messages)
    assert {stage for stage, _ in heard.losses} == {"feature-1"}
    assert not run_training(captures, run, recipe).is_new


def test_a_stop_while_starting_over_leaves_no_state_of_another_record(
    captures: Path, tmp_path: Path, recipe_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is removed first: as long as something is left, so is the record it was made by."""
    run = RunFolder(tmp_path / "run")
    run_training(captures, run.root, tiny(*SHORT, path=recipe_path))
    remove, names = Path.unlink, [path.name for path in run.train.iterdir()]

    def noted(path: Path, **kwargs: bool) -> None:
        assert run.training_record.is_file()
        remove(path, **kwargs)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", noted)
        for listed in (sorted(names), sorted(names, reverse=True)):
            patched.setattr(Path, "iterdir", lambda folder, listed=listed: iter([folder / name for name in listed]))
            for name in names:
                (run.train / name).touch()
            telewide.stages.train.forget(run)
            assert not any((run.train / name).exists() for name in ("state.pt", "training.json"))
