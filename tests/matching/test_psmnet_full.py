"""`psmnet` against a re-computation of its layers, the names and shapes of its authors' code, and their checkpoints."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from plain_layers import Shapes, Weights, conv, conv_norm, norm, stir
from torch import Tensor
from torch.nn import functional

from telewide.errors import InputError, UsageError
from telewide.matching.networks import StereoNetwork, build_network, prepare_view, published_psmnet
from telewide.matching.psmnet_full import PsmnetFullMatching, PublishedPsmnetFeatures

# Names and shapes of the authors' code, as facts: a convolution with its normalisation is (c_out, c_in, side).
STAGES = {"layer1": (32, 32, 3), "layer2": (32, 64, 16), "layer3": (64, 128, 3), "layer4": (128, 128, 3)}


def conv_norm_shapes(name: str, c_out: int, c_in: int, kernel: tuple[int, ...], *, is_up: bool = False) -> Shapes:
    weight = (c_in, c_out, *kernel) if is_up else (c_out, c_in, *kernel)
    statistics = {f"{name}.1.{part}": (c_out,) for part in ("weight", "bias", "running_mean", "running_var")}
    return {f"{name}.0.weight": weight, **statistics, f"{name}.1.num_batches_tracked": ()}


def published_shapes() -> Shapes:
    side2, side3, shapes = (3, 3), (3, 3, 3), {}
    features = "feature_extraction"
    for index, c_in in ((0, 3), (2, 32), (4, 32)):
        shapes |= conv_norm_shapes(f"{features}.firstconv.{index}", 32, c_in, side2)
    for layer, (c_in, c_out, count) in STAGES.items():
        for block in range(count):
            name, first = f"{features}.{layer}.{block}", c_in if block == 0 else c_out
            shapes |= conv_norm_shapes(f"{name}.conv1.0", c_out, first, side2)
            shapes |= conv_norm_shapes(f"{name}.conv2", c_out, c_out, side2)
            if block == 0 and c_in != c_out:
                shapes |= conv_norm_shapes(f"{name}.downsample", c_out, c_in, (1, 1))
    for branch in range(1, 5):
        shapes |= conv_norm_shapes(f"{features}.branch{branch}.1", 32, 128, (1, 1))
    shapes |= conv_norm_shapes(f"{features}.lastconv.0", 128, 320, side2)
    shapes[f"{features}.lastconv.2.weight"] = (32, 128, 1, 1)
    for name, c_in in (("dres0.0", 64), ("dres0.2", 32), ("dres1.0", 32), ("dres1.2", 32)):
        shapes |= conv_norm_shapes(name, 32, c_in, side3)
    for name in ("dres2", "dres3", "dres4"):
        for part, c_in in (("conv1.0", 32), ("conv2", 64), ("conv3.0", 64), ("conv4.0", 64)):
            shapes |= conv_norm_shapes(f"{name}.{part}", 64, c_in, side3)
        shapes |= conv_norm_shapes(f"{name}.conv5", 64, 64, side3, is_up=True)
        shapes |= conv_norm_shapes(f"{name}.conv6", 32, 64, side3, is_up=True)
    for name in ("classif1", "classif2", "classif3"):
        shapes |= conv_norm_shapes(f"{name}.0", 32, 32, side3)
        shapes[f"{name}.2.weight"] = (1, 32, *side3)
    return shapes


def published_names(network: StereoNetwork) -> dict[str, Tensor]:
    features = {f"feature_extraction.{k}": v for k, v in network.features.state_dict().items()}
    return features | network.matching.state_dict()


def test_names_and_shapes_are_the_published_ones() -> None:
    network = build_network("psmnet")
    own = {name: tuple(value.shape) for name, value in published_names(network).items()}
    assert own == published_shapes()
    assert len(own) == 514
    assert sum(parameter.numel() for parameter in network.parameters()) == 5_224_768


# The layers once more, from the names alone


def plain_features(w: Weights, x: Tensor, *, corners: bool) -> Tensor:
    def block(name: str, x: Tensor, *, stride: int, dilation: int) -> Tensor:
        residual = conv_norm(w, f"{name}.conv1.0", x, stride=stride, dilation=dilation).relu()
        residual = conv_norm(w, f"{name}.conv2", residual, dilation=dilation)
        has_shortcut = f"{name}.downsample.0.weight" in w
        return residual + (conv_norm(w, f"{name}.downsample", x, stride=stride) if has_shortcut else x)

    for index, stride in ((0, 2), (2, 1), (4, 1)):
        x = conv_norm(w, f"firstconv.{index}", x, stride=stride).relu()
    kept = {}
    for layer, (_, _, count) in STAGES.items():
        for number in range(count):
            stride = 2 if layer == "layer2" and number == 0 else 1
            x = block(f"{layer}.{number}", x, stride=stride, dilation=2 if layer == "layer4" else 1)
        kept[layer] = x
    parts = [kept["layer2"], x]
    for branch, cells in ((4, 8), (3, 16), (2, 32), (1, 64)):
        pooled = functional.avg_pool2d(x, (min(cells, x.shape[2]), min(cells, x.shape[3])))
        pooled = conv_norm(w, f"branch{branch}.1", pooled).relu()
        parts.append(functional.interpolate(pooled, size=x.shape[2:], mode="bilinear", align_corners=corners))
    return conv(w, "lastconv.2", conv_norm(w, "lastconv.0", torch.cat(parts, 1)).relu())


def test_a_crop_is_pooled_on_the_grid_of_the_image() -> None:
    """A crop that ends within a cell has the image's features where the cells of both are whole."""
    features = build_network("psmnet", seed=1).features.eval()
    noise = torch.randn(1, 3, 9, 18, generator=torch.Generator().manual_seed(0))
    view = functional.interpolate(noise, size=(128, 512), mode="bicubic", align_corners=False)
    with torch.no_grad():
        of_crop, of_image = (features(part)[0][..., :28] for part in (view[..., :352], view))
    assert (of_crop - of_image).abs().max() < 1e-3 * of_image.std()


def plain_hourglass(
    w: Weights, name: str, x: Tensor, pre: Tensor | None, post: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    def up(part: str, x: Tensor) -> Tensor:
        weight = w[f"{name}.{part}.0.weight"]
        risen = functional.conv_transpose3d(x, weight, stride=2, padding=1, output_padding=1)
        return norm(w, f"{name}.{part}.1", risen)

    half = conv_norm(w, f"{name}.conv2", conv_norm(w, f"{name}.conv1.0", x, stride=2).relu())
    half = (half if post is None else half + post).relu()
    quarter = conv_norm(w, f"{name}.conv3.0", half, stride=2).relu()
    quarter = conv_norm(w, f"{name}.conv4.0", quarter).relu()
    risen = (up("conv5", quarter) + (half if pre is None else pre)).relu()
    return up("conv6", risen), half, risen


def plain_costs(w: Weights, left: Tensor, right: Tensor, *, planes: int) -> list[Tensor]:
    cost = torch.zeros(left.shape[0], 64, planes, *left.shape[2:], dtype=left.dtype)
    for i in range(min(planes, left.shape[3])):
        cost[:, :32, i, :, i:] = left[..., i:]
        cost[:, 32:, i, :, i:] = right[..., : right.shape[-1] - i]
    cost = conv_norm(w, "dres0.2", conv_norm(w, "dres0.0", cost).relu()).relu()
    cost = conv_norm(w, "dres1.2", conv_norm(w, "dres1.0", cost).relu()) + cost
    first, pre1, post1 = plain_hourglass(w, "dres2", cost, None, None)
    first = first + cost
    second, _, post2 = plain_hourglass(w, "dres3", first, pre1, post1)
    second = second + cost
    third = plain_hourglass(w, "dres4", second, pre1, post2)[0] + cost
    costs: list[Tensor] = []
    for number, volume in enumerate((first, second, third), start=1):
        read = conv(w, f"classif{number}.2", conv_norm(w, f"classif{number}.0", volume).relu())
        costs.append(read + costs[-1] if costs else read)
    return costs


@pytest.mark.parametrize(("is_published", "planes"), [(False, 8), (True, 48)])
def test_outputs_are_those_of_its_layers(is_published: bool, planes: int) -> None:
    """The published form is the authors' formula: corners aligned, level j of 192 is j px."""
    network = build_network("psmnet")
    if is_published:
        network = StereoNetwork(PublishedPsmnetFeatures(), PsmnetFullMatching(is_published=True))
    stir(network, seed=1)
    ref, src = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        output = network(ref, src, (0, 4 * planes))
        left, right = (plain_features(network.features.state_dict(), x, corners=is_published) for x in (ref, src))
        costs = plain_costs(network.matching.state_dict(), left, right, planes=planes)
        size = (4 * planes, 32, 64)
        full = functional.interpolate(costs[-1], size=size, mode="trilinear", align_corners=is_published)
        levels = torch.arange(4 * planes, dtype=torch.float64) - (0 if is_published else 1.5)
        expected = (full[:, 0].softmax(dim=1) * levels[:, None, None]).sum(dim=1)
    assert expected.std() > 1
    assert (output.disparity_px - expected).abs().max() < 1e-5
    torch.testing.assert_close(output.logits_BDHW, costs[-1][:, 0], atol=1e-5, rtol=0)


def test_training_reads_every_hourglass() -> None:
    network = build_network("psmnet").train()
    output = network(torch.randn(2, 3, 32, 48), torch.randn(2, 3, 32, 48), (0, 16))
    assert [tuple(d.shape) for d in output.disparities_px] == [(2, 32, 48)] * 3


# Checkpoints of the authors' code


def drawn_checkpoint() -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(5)
    return {name: torch.rand(shape, generator=generator) for name, shape in published_shapes().items()}


def test_a_published_checkpoint_loads(tmp_path: Path) -> None:
    """As it lies on disk: in a dictionary, written by a parallel module, without the counters of old versions."""
    drawn = {k: v for k, v in drawn_checkpoint().items() if not k.endswith("num_batches_tracked")}
    path = tmp_path / "published.tar"
    torch.save({"epoch": 9, "train_loss": 0.5, "state_dict": {f"module.{k}": v for k, v in drawn.items()}}, path)
    network = published_psmnet(path)
    assert not network.training
    names = published_names(network)
    assert all(torch.equal(names[name], value) for name, value in drawn.items())
    image = torch.rand(1, 3, 8, 8)
    mean, deviation = (torch.tensor(t)[:, None, None] for t in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    torch.testing.assert_close(prepare_view(network.features, image), (image - mean) / deviation)


@pytest.mark.parametrize("fault", ["missing", "unknown", "shape", "nan"])
def test_a_checkpoint_that_does_not_fit_is_refused_with_the_name(tmp_path: Path, fault: str) -> None:
    drawn, name = drawn_checkpoint(), "dres3.conv2.0.weight"
    if fault == "missing":
        del drawn[name]
    elif fault == "unknown":
        name = "dres5.conv2.0.weight"
        drawn[name] = torch.zeros(1)
    else:
        drawn[name] = torch.zeros(3) if fault == "shape" else torch.full_like(drawn[name], torch.nan)
    torch.save(drawn, tmp_path / "other.pth")
    with pytest.raises(InputError) as raised:
        published_psmnet(tmp_path / "other.pth")
    assert name in raised.value.message
    assert "other.pth" in raised.value.message


class _Runs:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (pytest.fail, ("a checkpoint was executed",))


def test_nothing_in_a_checkpoint_is_executed(tmp_path: Path) -> None:
    torch.save({"state_dict": {"a": torch.zeros(1)}, "extra": _Runs()}, tmp_path / "evil.tar")
    (tmp_path / "cut.tar").write_bytes(b"PK\x03\x04 cut off")
    for name in ("evil.tar", "cut.tar"):
        with pytest.raises(InputError, match="read safely"):
            published_psmnet(tmp_path / name)
    with pytest.raises(UsageError, match="no such"):
        published_psmnet(tmp_path / "none.tar")
