"""`lite`: each branch with the others silenced, what its refinement is shown, and how far it looks."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from telewide.matching.inference import full_precision
from telewide.matching.networks import build_network, standardise


def silence(*layers: nn.Module) -> None:
    with torch.no_grad():
        for layer in layers:
            for parameter in layer.parameters():
                parameter.zero_()


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_the_hourglass_carries_every_level_past_the_one_below() -> None:
    hourglass = build_network("lite", seed=1).matching.hourglass
    volume = randn(1, 16, 8, 8, 12)
    with torch.no_grad():
        silence(hourglass.lift2)
        half = hourglass.mix1(hourglass.down1(volume))
        enlarged = nn.functional.interpolate(hourglass.lift1(half), size=volume.shape[2:], mode="nearest")
        torch.testing.assert_close(hourglass(volume), hourglass.mix0(enlarged + volume))
        silence(hourglass.lift1)
        torch.testing.assert_close(hourglass(volume), hourglass.mix0(volume))


def test_coarse_features_are_added_to_fine_ones() -> None:
    """With all that is coarser silent the detail comes through; with it, it is told apart."""
    features = build_network("lite", seed=1).features
    image = standardise(randn(1, 3, 64, 96))
    with torch.no_grad():
        whole = features(image)[0]
        silence(features.quarter_from_eighth)
        alone = features(image)[0]
    assert alone.std() > 0.1 * whole.std()
    assert (whole - alone).std() > 0.01 * whole.std()


def test_the_refinement_looks_farther_with_every_block() -> None:
    blocks = build_network("lite").matching.refine
    assert [(block.first.dilation, block.last.dilation) for block in blocks] == [((d, d), (d, d)) for d in (1, 2, 4)]


def test_the_refinement_compares_ref_with_what_src_shows_there() -> None:
    """A world moved by 16 px: where the disparity is right, the guide of src, looked up, is that of ref."""
    network = build_network("lite", seed=1).eval()
    shown: list[Tensor] = []
    network.matching.refine_views.register_forward_pre_hook(lambda _, entered: shown.append(entered[0]))
    world = nn.functional.avg_pool2d(randn(1, 3, 66, 226), 3, stride=1)
    ref, src = standardise(world[..., :192]), standardise(world[..., 16:208])
    with torch.no_grad(), full_precision():
        network.matching.correlation_scale.fill_(60.0)  # untrained, and yet sure
        disparity_px = network(ref, src, (0, 32)).disparities_px[1]
    right = (disparity_px - 16).abs()[:, 1::2, 1::2] < 0.1
    of_ref, of_src = (part[0].permute(1, 2, 0)[:, 16:-8] for part in shown[0].split(16, dim=1))
    right = right[0][:, 16:-8]
    assert right.float().mean() > 0.3
    apart = (of_ref - of_src)[right].abs().mean()
    assert apart < 0.1 * of_ref[right].std()
