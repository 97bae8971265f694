"""`psmnet-s` against its layer table written out by hand, planted volumes, and each branch with the others silenced."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from telewide.matching.networks import StereoNetwork, build_network
from telewide.matching.psmnet import PsmnetMatching
from telewide.matching.window import Window

# name: kind, channels in and out, kernel, stride, dilation; every convolution but the two last ones is normalised.
TABLE = """
first.0       2d   3  16 3 2 1
first.2       2d  16  16 3 1 1
first.4       2d  16  16 3 1 1
layer1.0-1    2d  16  16 3 1 1, 16 16 3 1 1
layer2.0      2d  16  32 3 2 1, 32 32 3 1 1, shortcut 16 32 1 2 1
layer2.1-7    2d  32  32 3 1 1, 32 32 3 1 1
layer3.0      2d  32  64 3 1 1, 64 64 3 1 1, shortcut 32 64 1 1 1
layer3.1      2d  64  64 3 1 1, 64 64 3 1 1
layer4.0-1    2d  64  64 3 1 2, 64 64 3 1 2
pools.0-1     2d  64  16 1 1 1
last.0        2d 128  64 3 1 1
last.2        2d  64  16 1 1 1
dres0.0       3d  32  16 3 1 1
dres0.2       3d  16  16 3 1 1
dres1.0       3d  16  16 3 1 1
dres1.2       3d  16  16 3 1 1
conv1.0       3d  16  32 3 2 1
conv2         3d  32  32 3 1 1
conv3.0       3d  32  32 3 2 1
conv4.0       3d  32  32 3 1 1
conv5         up  32  32 3 2 1
conv6         up  32  16 3 2 1
classify.0    3d  16  16 3 1 1
classify.2    3d  16   1 3 1 1
"""
KINDS = {"2d": nn.Conv2d, "3d": nn.Conv3d, "up": nn.ConvTranspose3d}


def stated_layers() -> list[tuple[str, tuple[int, ...]]]:
    """(kind, numbers) of every convolution in order, a block of the table once for each of its repetitions."""
    layers = []
    for line in TABLE.strip().splitlines():
        name, kind, numbers = line.split(maxsplit=2)
        first, _, last = name.partition("-")
        repetitions = int(last) - int(first.rpartition(".")[2]) + 1 if last else 1
        convolutions = [tuple(int(n) for n in part.split() if n != "shortcut") for part in numbers.split(",")]
        layers += [(kind, convolution) for convolution in convolutions] * repetitions
    return layers


def built_layers(network: nn.Module) -> list[tuple[str, tuple[int, ...]]]:
    layers = []
    for module in network.modules():
        for kind, convolution in KINDS.items():
            if isinstance(module, convolution):
                numbers = (module.in_channels, module.out_channels)
                sides = [set(of) for of in (module.kernel_size, module.stride, module.dilation)]
                assert all(len(side) == 1 for side in sides), "the same along every axis"
                layers.append((kind, (*numbers, *(side.pop() for side in sides))))
                assert module.bias is None
    return layers


def test_layers_are_those_of_the_table() -> None:
    network = build_network("psmnet-s")
    assert built_layers(network) == stated_layers()
    normalised = [m for m in network.modules() if isinstance(m, nn.BatchNorm2d | nn.BatchNorm3d)]
    assert len(normalised) == len(stated_layers()) - 2
    assert [m.kernel_size for m in network.modules() if isinstance(m, nn.AvgPool2d)] == [16, 8]


def test_the_number_of_weights_is_that_of_the_table() -> None:
    """Kernels, and two numbers for each channel that is normalised; 0.7 million in the paper."""
    dimensions = {"2d": 2, "3d": 3, "up": 3}
    layers = stated_layers()
    kernels = sum(c_in * c_out * kernel ** dimensions[kind] for kind, (c_in, c_out, kernel, _, _) in layers)
    plain = (16, 1)  # the last of the features, the last of the matching
    expected = kernels + 2 * (sum(c_out for _, (_, c_out, *_) in layers) - sum(plain))
    assert expected == 696_256
    assert sum(parameter.numel() for parameter in build_network("psmnet-s").parameters()) == expected


def test_weights_are_drawn_by_their_fan_out() -> None:
    """Normal, of variance 2 / (k^n c_out), as in PSMNet."""
    for module in build_network("psmnet-s").modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d) and module.weight.numel() > 4000:
            weight = module.weight.detach()
            fan_out = weight[0, 0].numel() * module.out_channels
            assert float(weight.std()) == pytest.approx((2 / fan_out) ** 0.5, rel=0.06)
            assert abs(float(weight.mean())) < 0.1 * (2 / fan_out) ** 0.5


# What a volume says


class _Planted(nn.Module):
    """Stands for the last layers: says that one plane is likeliest, of the window widened to whole cells."""

    def __init__(self, plane: int, sharpness: float) -> None:
        super().__init__()
        self.plane, self.sharpness = plane, sharpness

    def forward(self, x: Tensor) -> Tensor:
        planes = torch.arange(x.shape[2], dtype=x.dtype)[:, None, None]
        return (-self.sharpness * (planes - self.plane).abs()).expand(1, 1, *x.shape[2:])


@pytest.mark.parametrize("window", [(0, 64), (-32, 32), (-80, -16)])
@pytest.mark.parametrize("plane", [3, 8, 12])
def test_a_planted_peak_is_its_disparity(window: Window, plane: int) -> None:
    """Plane k is ``d_min + 4 k`` px, to a hundredth: levels between planes lie where trilinear enlarging puts them."""
    matching = PsmnetMatching().eval()
    matching.classify = _Planted(plane, sharpness=5.0)  # type: ignore[assignment]
    features = torch.zeros(1, 16, 4, 6)
    with torch.no_grad():
        (disparity_px,), logits = matching((features,), (features,), window)
    assert disparity_px.shape == (1, 16, 24)
    assert (logits.argmax(dim=1) == plane).all()
    torch.testing.assert_close(disparity_px, torch.full_like(disparity_px, window[0] + 4.0 * plane), atol=0.01, rtol=0)


# Branches


def silence(*layers: nn.Module) -> None:
    """Let a normalised convolution say nothing."""
    with torch.no_grad():
        for layer in layers:
            norm = layer[-1]  # type: ignore[index]
            assert isinstance(norm, nn.BatchNorm2d | nn.BatchNorm3d)
            norm.weight.zero_()
            norm.bias.zero_()


def network_of_seed(seed: int = 2) -> StereoNetwork:
    return build_network("psmnet-s", seed=seed).eval()


@pytest.mark.parametrize(("layer", "index"), [("layer1", 1), ("layer2", 0), ("layer2", 5), ("layer4", 1)])
def test_a_block_without_its_convolutions_is_its_shortcut(layer: str, index: int) -> None:
    block = getattr(network_of_seed().features, layer)[index]
    x = torch.randn(1, block.conv1[0].in_channels, 12, 16)
    shortcut = block.shortcut(x)
    with torch.no_grad():
        assert (block(x) - shortcut).abs().mean() > 0.1, "the convolutions add to it"
        silence(block.conv2)
        torch.testing.assert_close(block(x), shortcut)


def test_the_hourglass_carries_what_it_halves_past_its_bottom() -> None:
    """With the way up from the quarter silent, what was halved once still comes through, by itself."""
    hourglass = network_of_seed().matching.hourglass
    volume = torch.randn(1, 16, 8, 8, 8)
    with torch.no_grad():
        whole = hourglass(volume)[0]
        silence(hourglass.conv5)
        without_bottom = hourglass(volume)[0]
        assert without_bottom.std() > 0.05 * whole.std()
        assert (whole - without_bottom).std() > 0.05 * whole.std()
        expected = hourglass.conv6(torch.relu(hourglass.conv2(hourglass.conv1(volume))))
        torch.testing.assert_close(without_bottom, expected)


@pytest.mark.parametrize("silent", ["dres1", "hourglass"])
def test_the_volume_goes_past_what_refines_it(silent: str) -> None:
    matching = network_of_seed().matching
    ref, src = ((torch.randn(1, 16, 8, 12),) for _ in range(2))
    with torch.no_grad():
        whole = matching(ref, src, (0, 32))[1]
        silence(matching.dres1[-1] if silent == "dres1" else matching.hourglass.conv6)
        without = matching(ref, src, (0, 32))[1]
        silence(matching.dres1[-1], matching.hourglass.conv6)
        plain = matching(ref, src, (0, 32))[1]
    assert (whole - without).std() > 0.02 * whole.std(), "it takes part"
    assert without.std() > 0.02 * whole.std()
    assert plain.std() > 0.02 * whole.std(), "and what it refines comes through alone"


def test_features_hold_detail_depth_and_both_pools() -> None:
    """Each of the four parts that the last layers see reaches the result by itself."""
    features = network_of_seed().features
    image = torch.randn(1, 3, 128, 128)
    weight = features.last[0][0].weight
    parts = {"quarter": slice(0, 32), "deep": slice(32, 96), "pool of 16": slice(96, 112), "pool of 8": slice(112, 128)}
    with torch.no_grad():
        kept = weight.clone()
        for name, part in parts.items():
            weight.zero_()
            weight[:, part] = kept[:, part]
            alone = features(image)[0]
            assert (alone - alone.mean(dim=(-2, -1), keepdim=True)).std() > 1e-3, name
