"""Several processes are one: the same gradients as one process on the joint batch, one writer, shared captures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from training.joint_step import PRECISE, joint_gradients, precise_psmnet, short_training, stopped_training
from training.small import CPU, WINDOW, rendered, source_of, write_pairs

from telewide.capture.pfm import write_pfm
from telewide.files import fingerprint
from telewide.matching.networks import NETWORKS
from telewide.simulate.captures import write_captures
from telewide.training.checkpoint import new_state
from telewide.training.log import read_log
from telewide.training.processes import Processes, joined_processes
from telewide.training.samples import SampleSource, disparity_path

pytestmark = pytest.mark.slow


def torchrun(*words: str, cwd: Path, repo: Path, processes: int = 2) -> subprocess.CompletedProcess[str]:
    """Start processes on this machine as a user would."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}", *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": f"{repo}{os.pathsep}{repo / 'tests'}"}
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=900)


@pytest.fixture(autouse=True)
def _precise_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(NETWORKS, PRECISE, precise_psmnet)


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Corrected pairs with their disparities."""
    folder = tmp_path_factory.mktemp("surveyed")
    for seed, capture in enumerate(write_pairs(folder)):
        write_pfm(disparity_path(folder / capture.name, window_px=WINDOW), rendered(seed).disparity_px)
    return folder


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory, repo: Path, surveyed: Path) -> Path:
    """What two processes found in a joint step and in short trainings."""
    out = tmp_path_factory.mktemp("joint")
    script = repo / "tests" / "training" / "joint_step.py"
    done = torchrun(str(script), str(out), str(surveyed), cwd=out, repo=repo)
    assert done.returncode == 0, done.stderr[-3000:]
    return out


@pytest.fixture
def source(tmp_path: Path, surveyed: Path) -> SampleSource:
    """The pairs of the two processes, for one."""
    return source_of(write_pairs(tmp_path / "again"), disparities=surveyed)


@pytest.mark.parametrize("name", ["lite", PRECISE])
def test_gradients_of_two_processes_are_those_of_one(joint: Path, source: SampleSource, name: str) -> None:
    """Batch statistics included: those of psmnet-s are of the joint batch, whoever has which of its crops."""
    by_rank = [torch.load(joint / f"{name}{rank}.pt", weights_only=True) for rank in (0, 1)]
    for key, expected in joint_gradients(source, Processes(), name=name).items():
        assert expected.abs().max() > 0
        for gradients in by_rank:
            torch.testing.assert_close(gradients[key], expected, rtol=0, atol=1e-5 * float(expected.abs().max()))


def test_a_training_of_two_processes_is_that_of_one(tmp_path: Path, joint: Path, source: SampleSource) -> None:
    heard = [json.loads((joint / f"heard{rank}.json").read_text()) for rank in (0, 1)]
    assert heard[0] == heard[1], "losses, judgements and weights are the same in all processes"
    assert heard[0]["best_stage"] == 1
    assert [answer for _, _, answer in heard[0]["judgements"]] == [0.5, 0.4]
    assert (joint / "train0" / "weights.safetensors").is_file()
    assert not (joint / "train1").exists(), "one process writes"
    one = json.loads(json.dumps(short_training(tmp_path / "one", source, Processes())))
    for (_, _, parts), (_, _, expected_parts) in zip(heard[0]["losses"], one["losses"], strict=True):
        assert parts == pytest.approx(expected_parts, rel=1e-3)


def test_psmnet_stopped_and_resumed_by_two_processes_is_psmnet_of_one(
    tmp_path: Path, joint: Path, source: SampleSource
) -> None:
    """Weights, running statistics and their average: three crops a step, two here and one there, stopped in between."""
    start = new_state(PRECISE, seed=1, device=CPU).network
    one = stopped_training(tmp_path / "one", source, Processes(), stop_rank=-1)
    for rank in (0, 1):
        found = torch.load(joint / f"stopped{rank}.pt", weights_only=True)
        for part, network in (("network", one.network), ("average", one.average)):
            # Adam divides each gradient by its own size, and with it the rounding of the losses, which are float32.
            for names, most in ((_parameters(network), 0.05), (_buffers(network), 1e-5)):
                states = (start.state_dict(), network.state_dict(), found[part])
                before, expected, joined = (_flat(state, names) for state in states)
                moved = float((expected - before).norm())
                assert float((joined - expected).norm()) < most * moved, f"{part} of rank {rank}"


def _parameters(network: torch.nn.Module) -> list[str]:
    return [name for name, _ in network.named_parameters()]


def _buffers(network: torch.nn.Module) -> list[str]:
    return [name for name, _ in network.named_buffers()]


def _flat(state: dict[str, torch.Tensor], names: list[str]) -> torch.Tensor:
    return torch.cat([state[name].flatten() for name in names])


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    """Three captures of which the second, in the other process' share, is torn, and the fourth is good."""
    write_captures(tmp_path / "captures", count=4, seed=1, hw=(128, 192), factor=2)
    (tmp_path / "captures" / "001" / "tele.png").write_bytes(b"torn")
    return tmp_path / "captures"


def answer_of(done: subprocess.CompletedProcess[str]) -> dict[str, object]:
    """The one object that all processes together print."""
    assert done.returncode == 0, done.stderr[-3000:]
    assert len(done.stdout.splitlines()) == 1
    return json.loads(done.stdout)


def test_captures_are_shared_among_processes(tmp_path: Path, repo: Path, captures: Path) -> None:
    """Both write their share, one answers for both: what one process alone would write and answer."""
    words = ("-m", "telewide", "depth", "captures", "--run-folder", "run", "--method", "sgm", "--json")
    done = torchrun(*words, "--out", "shared", cwd=tmp_path, repo=repo)
    answer = answer_of(done)
    assert done.stderr.count("4 captures in captures") == 1, "one process speaks"
    assert done.stderr.count("skipped: 001") == 1
    alone = answer_of(torchrun(*words, "--out", "alone", cwd=tmp_path, repo=repo, processes=1))
    for one, other in zip(answer["captures"], alone["captures"], strict=True):
        assert one["name"] == other["name"]
        assert [Path(file).name for file in one["files"]] == [Path(file).name for file in other["files"]]
        for file, same in zip(one["files"], other["files"], strict=True):
            if file.endswith(".pfm"):
                assert (tmp_path / file).read_bytes() == (tmp_path / same).read_bytes()
    assert [capture["name"] for capture in answer["captures"]] == ["000", "002", "003"]
    assert answer["problems"] == alone["problems"]


def test_a_capture_that_fails_in_the_other_process_is_answered_for(tmp_path: Path, repo: Path, captures: Path) -> None:
    """A truth that cannot be used is found while depth is computed: 003 falls to the second of two, after 000, 002."""
    words = ("-m", "telewide", "depth", "captures", "--method", "sgm", "--json")
    (captures / "002" / "truth.pfm").write_bytes(b"torn")
    done = torchrun(*words, cwd=tmp_path, repo=repo)
    answer = answer_of(done)
    assert [capture["name"] for capture in answer["captures"]] == ["000", "003"]
    assert [problem["name"] for problem in answer["problems"]] == ["001", "002"]
    assert done.stderr.count("skipped: 002") == 1
    for name in ("000", "003"):
        (captures / name / "truth.pfm").write_bytes(b"torn")
    assert torchrun(*words, cwd=tmp_path, repo=repo).returncode != 0, "nothing is left"


def test_the_report_of_several_processes_shows_all_captures(tmp_path: Path, repo: Path) -> None:
    write_captures(tmp_path / "captures", count=3, seed=1, hw=(96, 144), factor=2)
    settings = ("train.rehearsal.steps=2", "train.crop_hw=[64, 96]", "window_px=[-8, 32]")
    words = tuple(word for setting in settings for word in ("--set", setting))
    done = torchrun(
        *("-m", "telewide", "run", "captures", "--recipe", "quick", "--device", "cpu", "--json", *words),
        cwd=tmp_path,
        repo=repo,
    )
    answer = answer_of(done)
    assert [capture["name"] for capture in answer["captures"]] == ["000", "001", "002"]
    page = (tmp_path / str(answer["report"])).read_text()
    for name in ("000", "001", "002"):
        assert f"depth/{name}/preview.png" in page


def test_worlds_are_shared_among_processes(tmp_path: Path, repo: Path) -> None:
    """Half of the crops each, and the losses of one process that takes all."""
    settings = ("network=lite", "train.crop_hw=[64, 96]", "train.rehearsal.rehearsed=2", "train.rehearsal.steps=10")
    words = ("-m", "telewide", "train", "--recipe", "box", "--device", "cpu", "--json")
    words += tuple(word for setting in settings for word in ("--set", setting))
    losses = []
    for out, processes in (("shared", 2), ("alone", 1)):
        answer = answer_of(torchrun(*words, "--out", out, cwd=tmp_path, repo=repo, processes=processes))
        assert answer["is_new"]
        assert (tmp_path / str(answer["weights"])).is_file()
        lines = read_log(tmp_path / out / "train" / "log.jsonl")
        losses.append([line.losses for line in lines if line.losses])
    shared, alone = losses
    assert len(shared) == len(alone) == 1, "one process writes"
    assert shared[0] == pytest.approx(alone[0], rel=1e-2)


SLOW_WRITER = """
import sys, time
from pathlib import Path
import telewide.stages.match as match
import telewide.training.loop as loop
from telewide.cli import main
from telewide.training.checkpoint import new_state
from telewide.training.processes import this_process

save_weights, read_matcher = loop.save_weights, match.read_matcher

def late(*args, **kwargs):
    time.sleep(1)
    save_weights(*args, **kwargs)

def noted(*args, **kwargs):
    matcher = read_matcher(*args, **kwargs)
    Path(f"loaded_{this_process().rank}").write_text(matcher.name)
    return matcher

loop.save_weights, match.read_matcher = late, noted
if __name__ == "__main__":
    main(sys.argv[1:])
"""


@pytest.mark.parametrize("stages", [0, 1])
def test_all_processes_match_with_the_weights_the_writer_wrote_last(tmp_path: Path, repo: Path, stages: int) -> None:
    """However long it takes to write them, and be they the first."""
    write_captures(tmp_path / "captures", count=2, seed=1, hw=(96, 144), factor=2)
    (tmp_path / "script.py").write_text(SLOW_WRITER)
    feature = "train.feature={steps: 1, captured: 2, captured_loss: feature}"
    settings = (f"train.stages={stages}", "train.rehearsal.steps=1", feature, "window_px=[-8, 32]")
    words = tuple(word for setting in (*settings, "train.crop_hw=[64, 96]") for word in ("--set", setting))
    asked = ("run", "captures", "--recipe", "quick", "--device", "cpu", "--quiet", *words)
    done = torchrun(str(tmp_path / "script.py"), *asked, cwd=tmp_path, repo=repo)
    assert done.returncode == 0, done.stderr[-3000:]
    loaded = {(tmp_path / f"loaded_{rank}").read_text() for rank in range(2)}
    assert loaded == {f"network {fingerprint(tmp_path / 'run' / 'train' / 'weights.safetensors')}"}


def test_shares_are_disjoint_and_all() -> None:
    values = tuple(range(7))
    shares = [Processes(rank, 3).share(values) for rank in range(3)]
    assert sorted(sum(shares, ())) == list(values)
    assert Processes().gathered(Processes().share(values)) == values


def test_one_process_needs_no_group(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with joined_processes("cpu") as processes:
        assert processes.is_writer
        value = torch.tensor([1.0, 2.0])
        assert processes.global_sum(value) is value
        assert processes.from_writer([1.5]) == [1.5]
        assert processes.is_any(True)
        assert not processes.is_any(False)
        processes.wait()
