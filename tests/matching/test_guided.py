"""`guided`: one function, whether trained, used or exported; the size and the windows it is made for."""

from __future__ import annotations

import pytest
import torch

from telewide.matching.inference import full_precision
from telewide.matching.networks import NetworkOutput, StereoNetwork, build_network, standardise
from telewide.matching.window import Window


def views(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Two views 6 px apart, of smoothed noise."""
    noise = torch.randn(1, 3, height + 4, width + 20, generator=torch.Generator().manual_seed(0))
    world = torch.nn.functional.avg_pool2d(noise, 5, stride=1)
    return standardise(world[..., :width]), standardise(world[..., 6 : width + 6])


def network_with_all_branches(name: str) -> StereoNetwork:
    """A network none of whose branches is still zero."""
    network = build_network(name).eval()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.01 * torch.randn(parameter.shape, generator=generator))
    return network


def assert_same(one: NetworkOutput, other: NetworkOutput) -> None:
    torch.testing.assert_close(one.disparity_px, other.disparity_px, atol=1e-3, rtol=0)
    torch.testing.assert_close(one.logits_BDHW, other.logits_BDHW, atol=1e-4, rtol=1e-4)
    assert (one.heads_BCHW is None) == (other.heads_BCHW is None)
    if one.heads_BCHW is not None and other.heads_BCHW is not None:
        torch.testing.assert_close(one.heads_BCHW, other.heads_BCHW, atol=1e-3, rtol=1e-3)


def test_guided_is_as_small_as_promised() -> None:
    assert sum(parameter.numel() for parameter in build_network("guided").parameters()) < 4_000_000


@pytest.mark.parametrize(("window", "hw"), [((0, 32), (64, 96)), ((-20, 44), (80, 112))])
def test_inference_computes_what_training_does(window: Window, hw: tuple[int, int]) -> None:
    network = network_with_all_branches("guided")
    with full_precision():
        taught = network(*views(*hw), window)
        with torch.inference_mode():
            used = network(*views(*hw), window)
    assert used.disparity_px.shape == (1, *hw)
    assert_same(used, taught)


@pytest.mark.parametrize("name", ["guided", "lite"])
@pytest.mark.parametrize(("window", "hw"), [((0, 32), (64, 96)), ((-20, 44), (80, 112))])
def test_the_exported_form_computes_what_inference_does(
    name: str, window: Window, hw: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    network = network_with_all_branches(name)
    with torch.inference_mode(), full_precision():
        used = network(*views(*hw), window)
        monkeypatch.setattr(torch.compiler, "is_compiling", lambda: True)
        exported = network(*views(*hw), window)
    assert_same(exported, used)


def test_coarse_disparities_are_for_training_alone() -> None:
    network = build_network("guided")
    with torch.no_grad():
        taught = network.train()(*views(64, 96), (0, 32))
        used = network.eval()(*views(64, 96), (0, 32))
    assert len(used.disparities_px) == 1
    assert len(taught.disparities_px) == 5
