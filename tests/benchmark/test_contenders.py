"""The matchers of run folders and weights files: which, in which order, under which names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from telewide.benchmark.contenders import all_contenders
from telewide.errors import UsageError


def save(path: Path, *, seed: int) -> None:
    from telewide.matching.networks import build_network
    from telewide.training.checkpoint import save_weights
    from telewide.training.weights_card import WeightsCard

    path.parent.mkdir(parents=True, exist_ok=True)
    save_weights(build_network("lite", seed=seed), path, card=WeightsCard("lite", (0, 32), {}, {}))


def test_stages_come_in_the_order_of_training(tmp_path: Path) -> None:
    train = tmp_path / "mine" / "train"
    for seed, stage in enumerate(("feature-10", "feature-2", "rehearsal", "photometric")):
        save(train / f"{stage}.safetensors", seed=seed)
    save(train / "weights.safetensors", seed=0)  # the very weights of feature-10
    expected = ["rehearsal", "photometric", "feature-2", "feature-10"]
    found = all_contenders([tmp_path / "mine"], device="cpu")
    assert [contender.name for contender in found] == ["sgm", *(f"mine/{stage}" for stage in expected)]
    save(train / "weights.safetensors", seed=9)  # a training under way
    assert [m.name for m in all_contenders([tmp_path / "mine"], device="cpu")[-2:]] == [
        "mine/feature-10",
        "mine/result",
    ]


def test_a_weights_file_is_a_matcher_with_its_window(tmp_path: Path, rng: np.random.Generator) -> None:
    save(tmp_path / "kept.safetensors", seed=0)
    _, found = all_contenders([tmp_path / "kept.safetensors"], device="cpu")
    assert (found.name, found.window) == ("kept", (0, 32))
    ref, src = rng.random((2, 64, 96, 3), dtype=np.float32)
    assert found.match(ref, src, window=(0, 16)).disparity_px.shape == (64, 96)


def test_runs_of_one_name_are_told_apart(tmp_path: Path) -> None:
    runs = [tmp_path / place / "run" for place in ("a", "b")]
    for run in runs:
        save(run / "train" / "rehearsal.safetensors", seed=0)
    names = [contender.name for contender in all_contenders(runs, device="cpu")]
    assert len(set(names)) == 3


def test_weights_that_are_being_written_are_no_stage(tmp_path: Path) -> None:
    train = tmp_path / "mine" / "train"
    save(train / "rehearsal.safetensors", seed=0)
    (train / ".telewide-ab12.safetensors").write_bytes(b"cut off")
    assert [contender.name for contender in all_contenders([tmp_path / "mine"], device="cpu")] == [
        "sgm",
        "mine/rehearsal",
    ]


def test_a_folder_without_weights_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no trained network"):
        all_contenders([tmp_path], device="cpu")
