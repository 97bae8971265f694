"""Checkpoints and weights: nothing is lost on the way, and corrupt, foreign or half-written files are refused."""

from __future__ import annotations

import copy
import os
import pickle
import resource
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from training.small import CPU, WINDOW

from telewide.errors import InputError, TelewideError, UsageError
from telewide.matching.networks import build_network
from telewide.training.checkpoint import (
    TrainingState,
    frozen_extractor,
    load_state,
    load_weights,
    new_state,
    save_state,
    save_weights,
)
from telewide.training.options import StageOptions, TrainOptions
from telewide.training.stages import plan_stages
from telewide.training.weights_card import WeightsCard, read_card

CARD = WeightsCard(
    "lite", WINDOW, {"network": "lite", "seed": 3}, {"stage": "rehearsal", "step": 7, "clipped_px": [0.2]}
)


def a_state() -> TrainingState:
    """Of a training under way: moments, extractor and counters are filled."""
    state = new_state("lite", seed=1, device=CPU)
    sum(parameter.square().sum() for parameter in state.network.parameters()).backward()
    state.optimiser.step()
    state.teacher = frozen_extractor(build_network("lite", seed=2))
    state.stage_index, state.step, state.best_stage = 2, 41, 1
    state.judgements, state.stage_judgements = [0.5, 0.25], [0.75, 0.5]
    state.trained_s = 12.5
    return state


@contextmanager
def full_disk(max_bytes: int) -> Iterator[None]:
    """No file can grow beyond ``max_bytes``."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_state_comes_back_as_it_was(tmp_path: Path) -> None:
    state = a_state()
    save_state(state, tmp_path / "state.pt")
    back = load_state(tmp_path / "state.pt", network_name="lite", device=CPU)
    for name in ("stage_index", "step", "judgements", "stage_judgements", "is_finished", "best_stage", "trained_s"):
        assert getattr(back, name) == getattr(state, name)
    assert back.teacher is not None
    assert state.teacher is not None
    for kept, other in ((state.network, back.network), (state.average, back.average), (state.teacher, back.teacher)):
        for a, b in zip(kept.state_dict().values(), other.state_dict().values(), strict=True):
            assert torch.equal(a, b)
    for a, b in zip(state.network.parameters(), back.network.parameters(), strict=True):
        assert torch.equal(state.optimiser.state[a]["exp_avg"], back.optimiser.state[b]["exp_avg"])
        assert torch.equal(state.optimiser.state[a]["exp_avg_sq"], back.optimiser.state[b]["exp_avg_sq"])
        assert a.stride() == b.stride(), "the memory order decides how fast it computes, and how it rounds"
    assert not any(p.requires_grad for p in back.teacher.parameters())


def test_a_training_begins_with_the_weights_of_a_file(tmp_path: Path) -> None:
    weights = tmp_path / "lite.safetensors"
    save_weights(build_network("lite", seed=5), weights, card=CARD)
    state = new_state("lite", seed=1, device=CPU, weights=weights)
    for network in (state.network, state.average):
        for a, b in zip(build_network("lite", seed=5).parameters(), network.parameters(), strict=True):
            assert torch.equal(a, b)
    with pytest.raises(UsageError, match=r"lite\.safetensors holds the network lite, and the recipe trains guided"):
        new_state("guided", seed=1, device=CPU, weights=weights)


@pytest.mark.parametrize(
    ("recipe", "window"), [({"train": {"worlds": True}}, None), ({"train": {}}, WINDOW), ({}, WINDOW)]
)
def test_weights_taught_by_worlds_alone_ask_for_no_window(
    recipe: dict[str, object], window: tuple[int, int] | None
) -> None:
    assert WeightsCard("guided", WINDOW, recipe, {}).searched_window == window


def test_a_new_state_has_no_teacher(tmp_path: Path) -> None:
    save_state(new_state("lite", seed=1, device=CPU), tmp_path / "state.pt")
    assert load_state(tmp_path / "state.pt", network_name="lite", device=CPU).teacher is None


class _Bomb:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (Path.touch, (Path("exploded"),))


def test_corrupt_or_foreign_states_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "state.pt"
    save_state(new_state("lite", seed=1, device=CPU), path)
    whole = path.read_bytes()
    bad = {
        "empty": b"",
        "half": whole[: len(whole) // 2],
        "cut by a byte": whole[:-1],
        "text": b"no checkpoint at all",
        "pickle": pickle.dumps({"network": _Bomb()}, protocol=2),
    }
    for name, content in bad.items():
        path.write_bytes(content)
        with pytest.raises(InputError) as raised:
            load_state(path, network_name="lite", device=CPU)
        assert str(path) in raised.value.message, name
        assert "train again" in str(raised.value.hint)
    for foreign in ({"something": 1}, [1, 2], build_network("lite").state_dict()):
        torch.save(foreign, path)
        with pytest.raises(InputError):
            load_state(path, network_name="lite", device=CPU)
    assert not Path("exploded").exists(), "reading a checkpoint must not run what is in it"


def test_a_state_of_another_network_is_refused(tmp_path: Path) -> None:
    save_state(new_state("lite", seed=1, device=CPU), tmp_path / "state.pt")
    with pytest.raises(InputError, match="psmnet-s"):
        load_state(tmp_path / "state.pt", network_name="psmnet-s", device=CPU)


@pytest.mark.parametrize("name", ["lite", "psmnet-s"])
def test_weights_come_back_with_their_card(tmp_path: Path, name: str) -> None:
    network = build_network(name, seed=4)
    with torch.no_grad():  # running statistics as after a training
        for index, buffer in enumerate(network.buffers()):
            buffer.add_(index + 1)
    card = WeightsCard(name, (-16, 48), {"a": {"b": 1.5}}, {"step": 3})
    save_weights(network, tmp_path / "w.safetensors", card=card)
    back, read = load_weights(tmp_path / "w.safetensors", device=CPU)
    assert read == card
    assert not back.training
    for a, b in zip(network.state_dict().values(), back.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_equal_weights_are_equal_files(tmp_path: Path) -> None:
    """Results that are kept go by the bytes of their weights; safetensors alone sorts its facts anew each time."""
    network, path = build_network("lite", seed=4), tmp_path / "w.safetensors"
    contents = set()
    for _ in range(8):
        save_weights(network, path, card=CARD)
        contents.add(path.read_bytes())
    assert len(contents) == 1
    assert all(torch.equal(tensor, network.state_dict()[name]) for name, tensor in load_file(path).items())


def test_corrupt_or_foreign_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(build_network("lite"), path, card=CARD)
    whole = path.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2], whole[:-1]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"w\.safetensors"):
            load_weights(path, device=CPU)
    save_file({"x": torch.zeros(3)}, path)
    with pytest.raises(InputError):
        load_weights(path, device=CPU)
    unknown = WeightsCard("another-network", WINDOW, {}, {})
    save_weights(build_network("lite"), path, card=unknown)
    with pytest.raises(TelewideError, match="another-network"):
        load_weights(path, device=CPU)
    with pytest.raises(UsageError, match="does not exist"):
        load_weights(tmp_path / "missing.safetensors", device=CPU)


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path) -> None:
    state = a_state()
    save_state(state, tmp_path / "state.pt")
    save_weights(state.average, tmp_path / "w.safetensors", card=CARD)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    state.step += 1
    with full_disk(100_000):
        with pytest.raises(TelewideError, match=r"state\.pt was not written") as raised:
            save_state(state, tmp_path / "state.pt")
        with pytest.raises(TelewideError, match=r"w\.safetensors was not written"):
            save_weights(state.average, tmp_path / "w.safetensors", card=CARD)
    assert "space" in str(raised.value.hint)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert load_state(tmp_path / "state.pt", network_name="lite", device=CPU).step == state.step - 1
    load_weights(tmp_path / "w.safetensors", device=CPU)


PLAN = plan_stages(
    TrainOptions(
        rehearsal=StageOptions(steps=50, rehearsed=1),
        photometric=StageOptions(steps=50, captured=1),
        feature=StageOptions(steps=50, captured=1, captured_loss="feature"),
        stages=2,
    )
)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What `a_state` leaves on disk, as plain data."""
    path = tmp_path_factory.mktemp("state") / "state.pt"
    save_state(a_state(), path)
    return dict(torch.load(path, weights_only=True))


def test_a_state_has_a_place_in_its_plan(tmp_path: Path) -> None:
    save_state(a_state(), tmp_path / "state.pt")
    assert load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN).step == 41


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *[("stage_index", 77), ("stage_index", -1), ("stage_index", "2"), ("stage_index", True)],
        *[("step", 51), ("step", -1), ("step", 1.5), ("best_stage", 2), ("best_stage", None)],
        *[("trained_s", -1.0), ("trained_s", float("nan")), ("trained_s", "long"), ("trained_s", True)],
        *[("judgements", 3), ("judgements", ["a"]), ("judgements", [0.5] * 60), ("stage_judgements", [0.5])],
        *[("optimiser", 3), ("optimiser", {"state": {0: 3}}), ("optimiser", {"state": {10**6: {}}})],
        *[("best", 3), ("best", {"step": 1, "judgement": 0.5, "weights": {}}), ("teacher", None), ("teacher", 3)],
    ],
)
def test_a_state_that_no_training_comes_to_is_refused(
    tmp_path: Path, saved: dict[str, object], key: str, value: object
) -> None:
    path = tmp_path / "state.pt"
    torch.save({**saved, key: value}, path)
    with pytest.raises(InputError, match="not a checkpoint of this lite training") as raised:
        load_state(path, network_name="lite", device=CPU, plan=PLAN)
    assert "train again" in str(raised.value.hint)


@pytest.mark.parametrize("content", [b"K\x01.", b"\x80\x02N.", b"N.", b"...."])
def test_four_bytes_of_pickle_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "state.pt").write_bytes(content)
    with pytest.raises(InputError, match=r"state\.pt"):
        load_state(tmp_path / "state.pt", network_name="lite", device=CPU)


@pytest.mark.parametrize(
    "window", ["[0, 4000000]", "[1, 6]", "[0, Infinity]", "[8, 0]", "[0, 4.0]", "[0]", "{}", "[" * 100_000, '["0", 4]']
)
def test_a_window_no_pair_needs_is_refused(tmp_path: Path, window: str) -> None:
    path = tmp_path / "w.safetensors"
    metadata = {"format": "1", "network": "lite", "window": window, "recipe": "{}", "training": "{}"}
    save_file({"x": torch.zeros(3)}, path, metadata=metadata)
    with pytest.raises(InputError, match="no weights file of telewide"):
        read_card(path)


@pytest.mark.parametrize("part", ["recipe", "window", "names"])
def test_weights_whose_header_is_longer_than_any_networks_are_not_read(tmp_path: Path, part: str) -> None:
    """Each value in it becomes an object, and so does each tensor that it names."""
    weights = {f"tensor{number}": torch.zeros(0) for number in range(80_000 if part == "names" else 1)}
    metadata = {"network": "lite", "window": "[0, 64]", "recipe": "{}", "training": "{}"}
    if part != "names":
        metadata[part] = "[" + "[]," * 1_500_000 + "0]"
    save_file(weights, tmp_path / "w.safetensors", metadata=metadata)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="is no weights file of telewide"):
        load_weights(tmp_path / "w.safetensors", device=CPU)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 50_000


def test_weights_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    network = build_network("lite")
    with torch.no_grad():
        next(network.parameters())[0] = float("nan")
    save_weights(network, tmp_path / "w.safetensors", card=CARD)
    with pytest.raises(InputError, match="no weights file of telewide"):
        load_weights(tmp_path / "w.safetensors", device=CPU)


def doubled(depth: int) -> object:
    """A list of two lists of two lists: small in memory and in a file, endless for who walks through it."""
    content: object = [1.0]
    for _ in range(depth):
        content = [content, content]
    return content


@pytest.mark.parametrize("which", ["exp_avg", "exp_avg_sq"])
@pytest.mark.parametrize(
    "change",
    [
        lambda tensor: tensor * float("nan"),
        lambda tensor: tensor.to_sparse(),
        lambda tensor: tensor.to("meta"),
        lambda tensor: tensor.to(torch.complex64),
        lambda tensor: tensor.to(torch.int8),
        lambda tensor: tensor.double(),
        lambda tensor: tensor.tolist(),
    ],
)
def test_moments_that_adam_cannot_go_on_from_are_refused(
    tmp_path: Path, saved: dict[str, object], which: str, change: Callable[[torch.Tensor], object]
) -> None:
    content = copy.deepcopy(saved)
    moments = content["optimiser"]["state"][0]  # type: ignore[index]
    moments[which] = change(moments[which])
    torch.save(content, tmp_path / "state.pt")
    with pytest.raises(InputError, match="not a checkpoint of this lite training"):
        load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN)


@pytest.mark.parametrize("step", [-1, 10**400, float("nan"), torch.tensor(-5.0), torch.ones(3)])
def test_a_step_of_adam_that_no_training_comes_to_is_refused(
    tmp_path: Path, saved: dict[str, object], step: object
) -> None:
    content = copy.deepcopy(saved)
    content["optimiser"]["state"][0]["step"] = step  # type: ignore[index]
    torch.save(content, tmp_path / "state.pt")
    with pytest.raises(InputError, match="not a checkpoint of this lite training"):
        load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN)


def test_what_lies_beside_the_moments_is_not_walked_through(tmp_path: Path, saved: dict[str, object]) -> None:
    """Else 40 levels of two would be 10^12 steps."""
    content = copy.deepcopy(saved)
    content["optimiser"]["state"][0]["more"] = doubled(40)  # type: ignore[index]
    torch.save(content, tmp_path / "state.pt")
    state = load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN)
    assert all(set(kept) == {"step", "exp_avg", "exp_avg_sq"} for kept in state.optimiser.state.values())


def test_a_state_of_a_version_that_kept_no_time_is_read(tmp_path: Path, saved: dict[str, object]) -> None:
    torch.save({name: value for name, value in saved.items() if name != "trained_s"}, tmp_path / "state.pt")
    assert load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN).trained_s == 0


@pytest.mark.parametrize("which", ["network", "average", "teacher"])
def test_weights_of_a_state_that_are_no_numbers_are_refused(
    tmp_path: Path, saved: dict[str, object], which: str
) -> None:
    content = copy.deepcopy(saved)
    next(iter(content[which].values()))[0] = float("inf")  # type: ignore[attr-defined]
    torch.save(content, tmp_path / "state.pt")
    with pytest.raises(InputError, match="not a checkpoint of this lite training"):
        load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN)


def test_a_state_that_unpacks_to_more_than_its_length_is_refused(tmp_path: Path) -> None:
    save_state(a_state(), tmp_path / "state.pt")
    with zipfile.ZipFile(tmp_path / "state.pt") as stored, zipfile.ZipFile(tmp_path / "packed.pt", "w") as packed:
        for entry in stored.infolist():
            packed.writestr(entry.filename, stored.read(entry), zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match="not a checkpoint of this lite training"):
        load_state(tmp_path / "packed.pt", network_name="lite", device=CPU, plan=PLAN)


def test_files_with_holes_and_pipes_are_no_weights(tmp_path: Path) -> None:
    save_weights(build_network("lite"), tmp_path / "w.safetensors", card=CARD)
    os.truncate(tmp_path / "w.safetensors", 1 << 40)
    os.mkfifo(tmp_path / "pipe")
    for name, told in (("w.safetensors", "bytes; files of up to"), ("pipe", "is a pipe")):
        with pytest.raises(InputError, match=told):
            load_weights(tmp_path / name, device=CPU)
        with pytest.raises(InputError, match=told):
            load_state(tmp_path / name, network_name="lite", device=CPU)


def test_moments_in_one_place_under_many_names_are_taken_apart(tmp_path: Path, saved: dict[str, object]) -> None:
    """Adam cannot write to a tensor whose numbers are all one number of the file."""
    content = copy.deepcopy(saved)
    moments = content["optimiser"]["state"][0]  # type: ignore[index]
    moments["exp_avg"] = moments["exp_avg_sq"] = torch.zeros(1).expand(moments["exp_avg"].shape)
    torch.save(content, tmp_path / "state.pt")
    state = load_state(tmp_path / "state.pt", network_name="lite", device=CPU, plan=PLAN)
    sum(parameter.square().sum() for parameter in state.network.parameters()).backward()
    state.optimiser.step()
    assert all(bool(torch.isfinite(parameter).all()) for parameter in state.network.parameters())
