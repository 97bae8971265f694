"""The second view of a row with a restorer, against that restorer called on the view at the worse camera's size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from benchmark.paper.small_task import HW, Told, scenes_of, task_of, write_scenes
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from telewide.benchmark.damages import Damage, damaged_small_view, damaged_view
from telewide.benchmark.learned import LearnedSystem
from telewide.benchmark.paper.learned_rows import learned_row
from telewide.benchmark.paper.system import Prepared, System, Task
from telewide.capture.images import read_image, resize_bicubic
from telewide.restoration.restorers import RESTORERS, Restorer, absolute_loss, build_restorer

SMALL = ("train.crop_hw=[64, 96]", "train.photometric.captured=1", "train.stages=0")
DAMAGE = Damage(blur_sigma_px_per_factor=(0.6, 0.6), noise_std=(0.02, 0.02))


class Tiny(nn.Module):
    """Two convolutions and a shuffle of pixels."""

    def __init__(self, factor: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(3, 8, 3, padding=1), nn.ReLU(), nn.Conv2d(8, 3 * factor**2, 1), nn.PixelShuffle(factor)
        )

    def forward(self, image_BCHW: Tensor) -> Tensor:
        enlarged: Tensor = 0.5 + self.layers(image_BCHW)
        return enlarged


@pytest.fixture
def row(monkeypatch: pytest.MonkeyPatch) -> System:
    tiny = Restorer(build=Tiny, loss=absolute_loss, factors=(2, 5), kernels=None, learning_rate=1e-3)
    monkeypatch.setitem(RESTORERS, "tiny", tiny)
    return learned_row("small", LearnedSystem(title="Small", network="lite", settings=SMALL, restorer="tiny"))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data")
    write_scenes(root)
    return root


def restored_by(network: nn.Module, small: np.ndarray) -> np.ndarray:
    """What the layers answer, written out; enlarged the last few pixels where the factor does not divide a side."""
    with torch.no_grad():
        answer = network(torch.from_numpy(small.transpose(2, 0, 1).copy())[None])[0].clamp(0, 1)
    picture = answer.numpy().transpose(1, 2, 0)
    return picture if picture.shape[:2] == HW else resize_bicubic(picture, wh=HW[::-1])


def assert_sees_restored(prepared: Prepared, task: Task, network: nn.Module, out: Path) -> None:
    """What it learns from and what it is asked about are restored, and not the damaged view enlarged."""
    for split in ("training", "validation", "test"):
        for scene in scenes_of(task.training[0].root.parent, split):
            sharp = scene.read()
            how = {"factor": task.factor, "scene": scene.name, "seed": task.seed}
            expected = restored_by(network, damaged_small_view(sharp.right, DAMAGE, **how))
            enlarged = damaged_view(sharp.right, DAMAGE, **how)
            assert np.abs(expected - enlarged).mean() > 0.05
            seen = prepared.seen_pair(task, scene.name, sharp)
            np.testing.assert_array_equal(seen.left, sharp.left)
            np.testing.assert_allclose(seen.right, expected, atol=1e-5)
            if split == "training":
                (path,) = (out / "pairs").glob(f"*/captures-{scene.name}/wide.png")
                np.testing.assert_allclose(read_image(path), expected, atol=0.51 / 255)


@pytest.mark.parametrize("factor", [2, 5])
def test_with_weights_of_a_file(row: System, data: Path, tmp_path: Path, factor: int) -> None:
    network = build_restorer("tiny", factor=factor, seed=7)
    save_file(network.state_dict(), tmp_path / "tiny.safetensors")
    task = task_of(
        data, steps=1, factor=float(factor), damage=DAMAGE, weights={"tiny": (tmp_path / "tiny.safetensors",)}
    )
    prepared = row.prepare(task, Told().place(tmp_path / "out"))
    assert_sees_restored(prepared, task, network, tmp_path / "out")


def test_trained_here(row: System, data: Path, tmp_path: Path) -> None:
    task = task_of(data, steps=3, damage=DAMAGE)
    prepared = row.prepare(task, Told().place(tmp_path))
    (path,) = (tmp_path / "restorers").glob("*/tiny-x2.safetensors")
    network, fresh = (build_restorer("tiny", factor=2, seed=task.seed) for _ in range(2))
    network.load_state_dict(load_file(path))
    assert any(not torch.equal(a, b) for a, b in zip(network.parameters(), fresh.parameters(), strict=True))
    assert_sees_restored(prepared, task, network, tmp_path)
