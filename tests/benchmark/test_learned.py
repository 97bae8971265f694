"""Every system that learns resolves to what the paper says of it, and a new one is data and a network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from benchmark.paper.small_task import COLUMN, Told, scenes_of, task_of, write_scenes
from training.small import CPU, WINDOW, Heard, source_of, training_in, write_pairs

from telewide.benchmark.learned import LearnedSystem, read_learned_systems
from telewide.benchmark.paper.cells import CellPlan, Cells
from telewide.benchmark.paper.learned_rows import learned_row
from telewide.errors import InputError, UsageError
from telewide.matching.inference import match_with_network
from telewide.matching.networks import NETWORKS, StereoNetwork
from telewide.matching.volume import concatenate_views, expect_disparity
from telewide.restoration.restorers import RESTORERS
from telewide.training.checkpoint import new_state
from telewide.training.loop import train
from telewide.training.stages import plan_stages

# name: network, restorer, stages, loss and symmetries of the first, space of the last
EXPECTED = {
    "basenet": ("psmnet-s", None, 1, "photometric", (False, False), "own"),
    "basenet-s2": ("psmnet-s", None, 1, "photometric", (True, False), "own"),
    "basenet-s3": ("psmnet-s", None, 1, "photometric", (False, True), "own"),
    "basenet-s4": ("psmnet-s", None, 1, "photometric", (True, True), "own"),
    "rcan-basenet": ("psmnet-s", "rcan", 1, "photometric", (False, False), "own"),
    "dan-basenet": ("psmnet-s", "dan", 1, "photometric", (False, False), "own"),
    "basenet-cl": ("psmnet-s", None, 3, "photometric", (False, False), "contrastive"),
    "basenet-ae": ("psmnet-s", None, 3, "photometric", (False, False), "auto-encoder"),
    "method-k1": ("psmnet-s", None, 2, "photometric", (False, False), "own"),
    "method-k2": ("psmnet-s", None, 3, "photometric", (False, False), "own"),
    "method": ("psmnet-s", None, 4, "photometric", (False, False), "own"),
    **{
        f"method-k1-{change}": ("psmnet-s", None, 2, "photometric", (False, False), "own")
        for change in ("tenth", "raw", "smooth", "batch", "large", "frozen-norm", "unclipped")
    },
    "basenet-su": ("psmnet-s", None, 1, "supervised", (False, False), "own"),
    "basenet-iresnet": ("iresnet-s", None, 1, "photometric", (False, False), "own"),
    "method-iresnet": ("iresnet-s", None, 4, "photometric", (False, False), "own"),
    "psmnet": ("psmnet", None, 1, "photometric", (False, False), "own"),
    "iresnet": ("iresnet", None, 1, "photometric", (False, False), "own"),
    "ours-trained": ("guided", None, 1, "photometric", (False, False), "own"),
    "s1-space": ("psmnet-s", None, 1, "photometric", (False, False), "own"),
    "cl-space": ("psmnet-s", None, 3, "photometric", (False, False), "contrastive"),
    "ae-space": ("psmnet-s", None, 3, "photometric", (False, False), "auto-encoder"),
}


def test_every_system_is_what_the_paper_says() -> None:
    found = {}
    for name, system in read_learned_systems().items():
        recipe = system.resolved()
        plan = plan_stages(recipe.train)
        first = plan[0].options
        symmetries = (first.symmetric_input, first.symmetric_loss)
        found[name] = (recipe.network, system.restorer, len(plan), first.captured_loss, symmetries, plan[-1].space)
        assert recipe.network in NETWORKS
        assert system.restorer in {None, *RESTORERS}
    assert found == EXPECTED


def test_rows_that_differ_from_the_first_stage_make_one_change_each() -> None:
    systems = read_learned_systems()
    published = systems["method-k1"].resolved().train.feature.model_dump()
    assert published["learning_rate"] == 1e-3
    changes = {
        "tenth": {"learning_rate": 1e-4},
        "raw": {"unit_features": False},
        "smooth": {"smoothness": 0.1},
        "batch": {"captured": 6},
        "frozen-norm": {"batch_statistics": "kept"},
        "unclipped": {"gradient_norm": None},
    }
    for name, change in changes.items():
        assert systems[f"method-k1-{name}"].resolved().train.feature.model_dump() == {**published, **change}


def test_every_feature_metric_stage_of_the_paper_takes_the_published_rate() -> None:
    systems = read_learned_systems()
    for name in ("method", "method-k2", "basenet-cl", "basenet-ae", "cl-space", "ae-space"):
        assert systems[name].resolved().train.feature.learning_rate == 1e-3
    of_iresnet = systems["method-iresnet"].resolved().train  # which diverges at it
    assert of_iresnet.feature.learning_rate == of_iresnet.photometric.learning_rate == 3e-4


class _OneLayer(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.Conv2d(3, 8, 4, stride=4)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor]:
        return (self.layer(image),)


class _Plain(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.classify = torch.nn.Conv3d(16, 1, 1)

    def forward(
        self, ref: tuple[torch.Tensor], src: tuple[torch.Tensor], window: tuple[int, int]
    ) -> tuple[list[torch.Tensor], torch.Tensor]:
        logits = self.classify(concatenate_views(ref[0], src[0], window=window))[:, 0].float()
        disparity = expect_disparity(logits, window=window)
        return [torch.nn.functional.interpolate(disparity[:, None], scale_factor=4)[:, 0]], logits


OWN = """
format: 1
systems:
  plain:
    title: One layer
    network: plain
    settings: [train.stages=1, train.feature.learning_rate=1.0e-3]
"""


def test_a_system_is_added_with_a_network_and_an_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As CONTRIBUTING says: a line in NETWORKS, an entry of YAML; the loop, the losses and the matching serve it."""
    monkeypatch.setitem(NETWORKS, "plain", lambda: StereoNetwork(_OneLayer(), _Plain()))
    path = tmp_path / "mine.yaml"
    path.write_text(OWN)
    steps = ("train.photometric.steps=2", "train.feature.steps=2", "train.crop_hw=[64, 96]")
    recipe = read_learned_systems(path=path)["plain"].resolved(settings=steps, seed=3)
    source = source_of(write_pairs(tmp_path / "pairs"))
    training = training_in(tmp_path, source, options=recipe.train, network=recipe.network)
    heard = Heard()
    state = train(training, new_state(recipe.network, seed=recipe.seed, device=CPU), reporter=heard)
    assert heard.finished == ["photometric", "feature-1"]
    view = np.random.default_rng(0).random((48, 64, 3), dtype=np.float32)
    assert match_with_network(view, view, network=state.average, window=WINDOW).disparity_px.shape == (48, 64)


def test_an_entry_of_ones_own_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(NETWORKS, "plain", lambda: StereoNetwork(_OneLayer(), _Plain()))
    path = tmp_path / "mine.yaml"
    path.write_text(OWN.replace("train.stages=1", "train.stages=1, 'train.crop_hw=[64, 96]'"))
    write_scenes(tmp_path)
    row = learned_row("plain", read_learned_systems(path=path)["plain"])
    cells = Cells(tmp_path / "out", Told())
    task = task_of(tmp_path, steps=4)
    ((_, lines),) = cells.rows([CellPlan(row, COLUMN, task, scenes_of(tmp_path, "test"))])
    assert cells.problems == []
    assert {line["weights"] for line in lines} == {"last", "best"}
    assert all(np.isfinite(float(str(line["end_point_error_px"]))) for line in lines)


def test_what_an_entry_gets_wrong_is_said(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(OWN.replace("network:", "netwrok:"))
    with pytest.raises(InputError, match=r"unknown key .*netwrok"):
        read_learned_systems(path=path)
    with pytest.raises(UsageError, match=r"train\.stage"):
        LearnedSystem(title="x", settings=("train.stage=1",)).resolved()
