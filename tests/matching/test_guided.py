"""`guided`: one function, whether trained, used or exported; the size and the windows it is made for."""

from __future__ import annotations

import pytest
import torch

from telewide.matching import guided
from telewide.matching.guided import Coarser
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


def undecided_network() -> StereoNetwork:
    """An untrained network that finds all planes alike, and whose updates change nothing."""
    network = build_network("guided").eval()
    with torch.no_grad():
        network.matching.correlation_scale.zero_()
        for residual in (network.matching.update.residual[-1], network.matching.half_residual):
            residual.bias.zero_()
    return network


@pytest.mark.parametrize(
    ("unsure_below", "coarser_confidence", "is_taken"), [(0.4, 0.9, True), (0.4, 0.1, False), (0.3, 0.9, False)]
)
def test_a_coarser_match_is_the_guess_where_the_volume_is_unsure(
    unsure_below: float, coarser_confidence: float, is_taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three of eight planes hold 3/8. Of a constant guess that no update changes, every upsampling is that constant."""
    monkeypatch.setattr(guided, "UNSURE", unsure_below)
    network = undecided_network()
    coarser = Coarser(*(torch.full((1, 16, 24), value) for value in (60.0, coarser_confidence)))
    with torch.inference_mode(), full_precision():
        alone, found = (network(*views(64, 96), (0, 32), coarser=aid) for aid in (None, coarser))
    expected_px = torch.full_like(alone.disparity_px, 60.0) if is_taken else alone.disparity_px
    torch.testing.assert_close(found.disparity_px, expected_px)
    torch.testing.assert_close(found.logits_BDHW, alone.logits_BDHW)


@pytest.mark.parametrize(("apart_px", "is_taken"), [(2.9, False), (3.1, True)])
def test_a_guess_near_the_own_one_changes_nothing(apart_px: float, is_taken: bool) -> None:
    """Where all planes are alike the own guess is the same everywhere."""
    network = undecided_network()
    with torch.inference_mode(), full_precision():
        own_px = network(*views(64, 96), (0, 32)).disparity_px
        coarser = Coarser(own_px[:, ::4, ::4] + apart_px, torch.ones(1, 16, 24))
        found = network(*views(64, 96), (0, 32), coarser=coarser)
    torch.testing.assert_close(found.disparity_px, own_px + apart_px if is_taken else own_px)


@pytest.mark.parametrize("scales", [2, 3])
def test_smaller_sizes_say_what_half_the_views_do(scales: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the size is the same network on views averaged by twos, its disparities doubled, and so on."""
    for name, limit in (("UNSURE", 2.0), ("NO_LESS_BY", 2.0), ("APART_PX", -1.0)):  # all of it is taken up
        monkeypatch.setattr(guided, name, limit)
    network = network_with_all_branches("guided")
    ref, src = views(128, 192)
    halves = [torch.nn.functional.avg_pool2d(view, 2) for view in (ref, src)]
    with torch.inference_mode(), full_precision():
        half = network.match_in_scales(*halves, (-4, 24), scales=scales - 1)
        heads = half.heads_BCHW
        assert heads is not None
        cells = (2 * half.disparity_px, heads[:, 0].sigmoid())
        coarser = Coarser(*(torch.nn.functional.avg_pool2d(map_[:, None], 2)[:, 0] for map_ in cells))
        assert_same(
            network.match_in_scales(ref, src, (-8, 44), scales=scales), network(ref, src, (-8, 44), coarser=coarser)
        )


def test_a_network_that_takes_up_no_match_makes_its_own() -> None:
    network = network_with_all_branches("lite")
    with torch.inference_mode(), full_precision():
        assert_same(network.match_in_scales(*views(64, 96), (0, 32)), network(*views(64, 96), (0, 32)))
