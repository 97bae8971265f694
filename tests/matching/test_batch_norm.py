"""Joint batch normalisation against torch's own, here in a group of one; `test_processes.py` has groups of two."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
import torch.distributed as dist
from torch import nn

from telewide.matching import batch_norm
from telewide.matching.batch_norm import BatchNorm2d, BatchNorm3d


@pytest.fixture
def _group(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A group of this process, in which the layers are told to add up over all."""
    dist.init_process_group("gloo", store=dist.HashStore(), rank=0, world_size=1)
    monkeypatch.setattr(batch_norm, "_is_shared", lambda: True)
    yield
    dist.destroy_process_group()


@pytest.mark.usefixtures("_group")
@pytest.mark.parametrize(
    ("joint", "plain", "shape"),
    [(BatchNorm2d, nn.BatchNorm2d, (3, 5, 8, 7)), (BatchNorm3d, nn.BatchNorm3d, (2, 5, 4, 6, 3))],
)
def test_values_gradients_and_running_statistics_are_those_of_torch(
    joint: type[nn.Module], plain: type[nn.Module], shape: tuple[int, ...]
) -> None:
    torch.manual_seed(0)
    x, seen_from_above = (3 + 2 * torch.randn(shape, dtype=torch.float64) for _ in range(2))
    answers = []
    for kind in (joint, plain):
        layer = kind(5).double()
        with torch.no_grad():
            layer.weight.copy_(torch.linspace(0.5, 2, 5))
            layer.bias.copy_(torch.linspace(-1, 1, 5))
        entered = x.clone().requires_grad_()
        for _ in range(2):
            left = layer(entered)
        gradients = torch.autograd.grad(left, (entered, layer.weight, layer.bias), seen_from_above)
        answers.append((left, *gradients, *layer.buffers()))
    for ours, torchs in zip(*answers, strict=True):
        torch.testing.assert_close(ours, torchs, rtol=1e-9, atol=1e-9)


@pytest.mark.usefixtures("_group")
def test_in_eval_mode_no_process_waits_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """One process alone judges between steps."""
    monkeypatch.setattr(dist, "all_reduce", lambda *_: pytest.fail("added up"))
    layer = BatchNorm2d(3).eval()
    x = torch.randn(2, 3, 4, 4)
    torch.testing.assert_close(layer(x), x / (1 + layer.eps) ** 0.5)
    assert int(layer.num_batches_tracked) == 0
