"""`iresnet` against a re-computation of its layers, the widths of its authors' code, windows, and its volume."""

from __future__ import annotations

import pytest
import torch
from plain_layers import Weights, conv, stir
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.iresnet import IresnetFeatures, IresnetMatching, search_centre_px
from telewide.matching.networks import StereoNetwork, build_network, comparable_map

# Facts of the authors' deploy file: a layer here, the layer there, and the sides of its weights as Caffe keeps them:
# c_out c_in k k, of a transposed one c_in c_out k k; c_in is that of what is concatenated there. The refinement has its
# layers there once an iteration, _itr1 and _itr2, with shared weights. up_conv1a2a has a twin there for the right view,
# up_conv1b2b, with weights of its own; here one serves both views.
PUBLISHED = """
features.conv1 conv1 64 3 7 7
features.conv2 conv2 128 64 5 5
features.up_conv1ab up_conv1ab 64 32 4 4
features.up_conv2ab up_conv2ab 128 32 8 8
features.up_conv1a2a up_conv1a2a 32 64 1 1
matching.conv_redir conv_redir 64 128 1 1
matching.conv3 conv3 256 145 5 5
matching.conv3_1 conv3_1 256 256 3 3
matching.conv4 conv4 512 256 3 3
matching.conv4_1 conv4_1 512 512 3 3
matching.conv5 conv5 512 512 3 3
matching.conv5_1 conv5_1 512 512 3 3
matching.conv6 conv6 1024 512 3 3
matching.conv6_1 conv6_1 1024 1024 3 3
matching.predict_flow6 Convolution1 1 1024 3 3
matching.ups.0.deconv deconv5 1024 512 4 4
matching.ups.0.upsample_flow upsample_flow6to5 1 1 4 4
matching.ups.0.concat Convolution2 512 1025 3 3
matching.ups.0.predict_flow Convolution3 1 512 3 3
matching.ups.1.deconv deconv4 512 256 4 4
matching.ups.1.upsample_flow upsample_flow5to4 1 1 4 4
matching.ups.1.concat Convolution4 256 769 3 3
matching.ups.1.predict_flow Convolution5 1 256 3 3
matching.ups.2.deconv deconv3 256 128 4 4
matching.ups.2.upsample_flow upsample_flow4to3 1 1 4 4
matching.ups.2.concat Convolution6 128 385 3 3
matching.ups.2.predict_flow Convolution7 1 128 3 3
matching.ups.3.deconv deconv2 128 64 4 4
matching.ups.3.upsample_flow upsample_flow3to2 1 1 4 4
matching.ups.3.concat Convolution8 64 193 3 3
matching.ups.3.predict_flow Convolution9 1 64 3 3
matching.ups.4.deconv deconv1 64 32 4 4
matching.ups.4.upsample_flow upsample_flow2to1 1 1 4 4
matching.ups.4.concat Convolution10 32 97 3 3
matching.ups.4.predict_flow Convolution11 1 32 3 3
matching.ups.5.deconv deconv0 32 32 4 4
matching.ups.5.upsample_flow upsample_flow1to0 1 1 4 4
matching.ups.5.concat Convolution21 32 65 3 3
matching.ups.5.predict_flow Convolution22 1 32 3 3
matching.conv1_mini compress_conv1a1b 16 64 3 3
matching.refinement.zoom_conv0 zoom_conv0 32 65 3 3
matching.refinement.zoom_conv1 zoom_conv1 64 32 3 3
matching.refinement.zoom_conv1b zoom_conv1b 64 105 3 3
matching.refinement.zoom_conv2 zoom_conv2 128 64 3 3
matching.refinement.zoom_conv2b zoom_conv2b 128 128 3 3
matching.refinement.zoom_predict2 zoom_Convolution2 1 128 3 3
matching.refinement.zoom_deconv2 zoom_deconv2 128 64 4 4
matching.refinement.zoom_upsample2 zoom_upsample_2to1 1 1 4 4
matching.refinement.zoom_fused1 zoom_fused1 64 129 3 3
matching.refinement.zoom_predict1 zoom_Convolution1 1 64 3 3
matching.refinement.zoom_deconv1 zoom_deconv1 64 32 4 4
matching.refinement.zoom_upsample1 zoom_upsample_1to0 1 1 4 4
matching.refinement.zoom_fused0 zoom_fused0 32 65 3 3
matching.refinement.zoom_predict0 zoom_Convolution0 1 32 3 3
"""


def test_every_layer_is_one_of_the_published_ones() -> None:
    stated = [row.split() for row in PUBLISHED.strip().splitlines()]
    shapes = {ours: tuple(map(int, sides)) for ours, _, *sides in stated}
    built = {
        name: layer
        for name, layer in build_network("iresnet").named_modules()
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d)
    }
    assert {name: tuple(layer.weight.shape) for name, layer in built.items()} == shapes
    assert len({theirs for _, theirs, *_ in stated}) == len(stated) == 54
    for ours, theirs, *_ in stated:
        layer = built[ours]
        assert layer.bias is not None
        assert layer.bias.shape == (layer.out_channels,)
        is_transposed = theirs.startswith(("deconv", "upsample_", "up_conv1ab", "up_conv2ab", "zoom_deconv", "zoom_up"))
        assert isinstance(layer, nn.ConvTranspose2d) == is_transposed, ours
    parameters = sum(p.numel() for p in build_network("iresnet").parameters())
    assert parameters == sum(p.numel() for layer in built.values() for p in layer.parameters())


def test_the_compact_one_is_as_large_as_psmnet_s() -> None:
    compact, psmnet_s = (sum(p.numel() for p in build_network(n).parameters()) for n in ("iresnet-s", "psmnet-s"))
    assert 0.9 < compact / psmnet_s < 1.1


def up(w: Weights, name: str, x: Tensor, like: Tensor, *, factor: int = 2) -> Tensor:
    risen = functional.conv_transpose2d(x, w[f"{name}.weight"], w[f"{name}.bias"], stride=factor, padding=factor // 2)
    return risen[..., : like.shape[2], : like.shape[3]]


def leaky(x: Tensor) -> Tensor:
    return torch.where(x > 0, x, 0.1 * x)


def rows(a: Tensor, b: Tensor, reach: int) -> Tensor:
    """Mean product at every displacement, pixel by pixel."""
    result = torch.zeros(a.shape[0], 2 * reach + 1, *a.shape[2:], dtype=a.dtype)
    for index, k in enumerate(range(-reach, reach + 1)):
        for x in range(a.shape[3]):
            if 0 <= x + k < a.shape[3]:
                result[:, index, :, x] = (a[..., x] * b[..., x + k]).mean(dim=1)
    return result


def plain_features(w: Weights, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    half = leaky(conv(w, "conv1", x, stride=2))
    quarter = leaky(conv(w, "conv2", half, stride=2))
    joined = torch.cat((leaky(up(w, "up_conv1ab", half, x)), leaky(up(w, "up_conv2ab", quarter, x, factor=4))), 1)
    return quarter, half, leaky(conv(w, "up_conv1a2a", joined))


def plain_matching(
    w: Weights, a: tuple[Tensor, ...], b: tuple[Tensor, ...], *, limits: tuple[int, int], unit_px: float
) -> Tensor:
    x = torch.cat((rows(a[0], b[0], 40), leaky(conv(w, "conv_redir", a[0]))), 1)
    levels = []
    for level in (3, 4, 5, 6):
        x = leaky(conv(w, f"conv{level}_1", leaky(conv(w, f"conv{level}", x, stride=2))))
        levels.append(x)
    flow = conv(w, "predict_flow6", x)
    for index, skip in enumerate((levels[2], levels[1], levels[0], *a)):
        name = f"ups.{index}"
        risen = leaky(up(w, f"{name}.deconv", x, skip))
        x = conv(w, f"{name}.concat", torch.cat((skip, risen, up(w, f"{name}.upsample_flow", flow, skip)), 1))
        flow = conv(w, f"{name}.predict_flow", x)
    correlation = rows(leaky(conv(w, "conv1_mini", a[1])), leaky(conv(w, "conv1_mini", b[1])), 20)
    w = {name.removeprefix("refinement."): value for name, value in w.items()}
    low, high = (limit / unit_px for limit in limits)
    for _ in range(2):
        flow = (flow + plain_residual(w, (a[2], b[2]), flow, correlation, unit_px=unit_px)).clamp(low, high)
    return unit_px * flow[:, 0]


def plain_residual(
    w: Weights, views: tuple[Tensor, Tensor], flow: Tensor, correlation: Tensor, *, unit_px: float
) -> Tensor:
    a, b = views
    height, width = a.shape[2:]
    x = torch.arange(width, dtype=a.dtype) - unit_px * flow[:, 0]
    y = torch.arange(height, dtype=a.dtype)[:, None].expand_as(x)
    grid = torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), -1)
    error = (functional.grid_sample(b, grid, align_corners=False) - a).abs()
    full = leaky(conv(w, "zoom_conv0", torch.cat((a, flow, error), 1)))
    half = torch.cat((correlation, leaky(conv(w, "zoom_conv1", full, stride=2))), 1)
    half = leaky(conv(w, "zoom_conv1b", half))
    quarter = leaky(conv(w, "zoom_conv2b", leaky(conv(w, "zoom_conv2", half, stride=2))))
    for index, skip in ((2, half), (1, full)):
        residual = up(w, f"zoom_upsample{index}", conv(w, f"zoom_predict{index}", quarter), skip)
        risen = leaky(up(w, f"zoom_deconv{index}", quarter, skip))
        quarter = conv(w, f"zoom_fused{index - 1}", torch.cat((skip, risen, residual), 1))
    return conv(w, "zoom_predict0", quarter)


@pytest.mark.parametrize(("divisor", "unit_px"), [(8, 1.0), (8, 20.0), (1, 1.0)])
def test_outputs_are_those_of_its_layers(divisor: int, unit_px: float) -> None:
    network = StereoNetwork(IresnetFeatures(divisor=divisor), IresnetMatching(divisor=divisor, unit_px=unit_px))
    stir(network)
    ref, src = torch.randn(2, 1, 3, 48, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        output = network(ref, src, (-32, 32))
        a, b = (plain_features(network.features.state_dict(), x) for x in (ref, src))
        expected = plain_matching(network.matching.state_dict(), a, b, limits=(-32, 31), unit_px=unit_px)
    assert expected.std() > 0.5
    # The grid of a warp is float32 by rule: 1e-7 of the width.
    assert (output.disparity_px - expected).abs().max() < 1e-5 * unit_px
    torch.testing.assert_close(comparable_map(network.features, ref), a[2], atol=1e-9, rtol=0)


@pytest.mark.parametrize("window", [(0, 32), (-16, 16), (160, 224), (-400, -320)])
def test_disparities_lie_in_any_window(window: tuple[int, int]) -> None:
    network = build_network("iresnet-s").eval()
    with torch.inference_mode():
        output = network(torch.randn(1, 3, 64, 96), torch.randn(1, 3, 64, 96), window)
    assert output.logits_BDHW.shape == (1, (window[1] - window[0]) // 4, 16, 24)
    assert output.disparity_px.min() >= window[0]
    assert output.disparity_px.max() < window[1]


def test_what_is_held_at_the_end_of_a_window_can_return() -> None:
    network = build_network("iresnet-s", seed=0)
    ref, src = (torch.rand(1, 3, 64, 128, generator=torch.Generator().manual_seed(seed)) for seed in range(2))
    results, _ = network.matching(network.features(ref), network.features(src), (40, 60))
    assert results[-1].min() >= 40
    held = results[-1][results[-1] == 40]  # an untrained network answers with about zero
    assert held.numel() > results[-1].numel() / 2
    matching = network.matching
    assert isinstance(matching, IresnetMatching)
    (gradient,) = torch.autograd.grad(held.sum(), matching.refinement.zoom_predict0.weight)
    assert gradient.abs().sum() > 0


def test_a_window_that_is_reached_is_searched_around_zero_and_a_far_one_around_its_middle() -> None:
    """A source view moved by 232 px and a window moved as far give the same disparities, plus 232."""
    assert search_centre_px((0, 164)) == search_centre_px((-160, 0)) == 0
    assert search_centre_px((200, 264)) == 232
    matching = build_network("iresnet-s").eval().matching
    ref, far = (tuple(torch.randn(1, c, 64 // n, 384 // n) for c, n in ((16, 4), (8, 2), (8, 1))) for _ in range(2))
    cells = [232 // n for n in (4, 2, 1)]
    far = tuple(functional.pad(m[..., :-n], (0, n)) for m, n in zip(far, cells, strict=True))  # nothing to fall out
    near = tuple(functional.pad(m[..., :-n], (n, 0)) for m, n in zip(far, cells, strict=True))
    with torch.no_grad():
        plain, moved = matching(ref, near, (-32, 32))[0], matching(ref, far, (200, 264))[0]
    torch.testing.assert_close(moved[-1], plain[-1] + 232, atol=1e-3, rtol=0)


def test_the_volume_is_likeliest_at_the_result() -> None:
    network = build_network("iresnet-s").eval()
    view = torch.nn.functional.avg_pool2d(torch.randn(1, 3, 66, 98), 3, stride=1)
    with torch.no_grad():
        output = network(view, view, (-32, 32))
    coarse_px = torch.nn.functional.avg_pool2d(output.disparity_px, 4)
    likeliest_px = -32 + 4 * output.logits_BDHW.argmax(dim=1)
    assert ((likeliest_px - coarse_px).abs() <= 8).float().mean() > 0.95


@pytest.mark.parametrize("name", ["psmnet", "iresnet-s"])
def test_every_weight_gets_a_gradient(name: str) -> None:
    network = build_network(name).train()
    views = torch.randn(2, 1, 3, 64, 128, generator=torch.Generator().manual_seed(1))
    output = network(*views, (-64, 64))
    loss = sum(d.square().mean() for d in output.disparities_px) + output.logits_BDHW.square().mean()
    if name == "iresnet-s":  # nothing but the feature-metric loss and the refinement sees the full size
        loss = loss + comparable_map(network.features, views[0]).square().mean()
    torch.autograd.backward(loss)
    assert [key for key, p in network.named_parameters() if p.grad is None or not p.grad.any()] == []
