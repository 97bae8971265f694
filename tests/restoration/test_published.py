"""RCAN and DAN against re-computations of their layers, and the names and shapes of their authors' code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from plain_layers import Shapes, Weights, conv, shapes_of, stir
from torch import Tensor
from torch.nn import functional

from telewide.errors import InputError, UsageError
from telewide.restoration.dan import Dan
from telewide.restoration.kernels import KERNEL_RANGES, kernel_components
from telewide.restoration.rcan import Rcan
from telewide.restoration.restorers import RESTORERS, build_restorer, restore

COMPONENTS = kernel_components(KERNEL_RANGES["isotropic"], length=10)


def conv_shapes(name: str, c_out: int, c_in: int, side: int) -> Shapes:
    return {f"{name}.weight": (c_out, c_in, side, side), f"{name}.bias": (c_out,)}


# RCAN


def rcan_shapes(factor: int, *, groups: int = 10, blocks: int = 20, c: int = 64) -> Shapes:
    """Names and shapes of the authors' code, as facts."""
    shapes = conv_shapes("sub_mean", 3, 3, 1) | conv_shapes("add_mean", 3, 3, 1) | conv_shapes("head.0", c, 3, 3)
    for group in range(groups):
        for block in range(blocks):
            name = f"body.{group}.body.{block}.body"
            shapes |= conv_shapes(f"{name}.0", c, c, 3) | conv_shapes(f"{name}.2", c, c, 3)
            shapes |= conv_shapes(f"{name}.3.conv_du.0", c // 16, c, 1)
            shapes |= conv_shapes(f"{name}.3.conv_du.2", c, c // 16, 1)
        shapes |= conv_shapes(f"body.{group}.body.{blocks}", c, c, 3)
    shapes |= conv_shapes(f"body.{groups}", c, c, 3) | conv_shapes("tail.1", 3, c, 3)
    for index in range({2: 1, 3: 1, 4: 2, 8: 3}[factor]):
        shapes |= conv_shapes(f"tail.0.{2 * index}", c * (9 if factor == 3 else 4), c, 3)
    return shapes


def plain_rcan(w: Weights, x: Tensor, *, groups: int, blocks: int, steps: list[int]) -> Tensor:
    x = shallow = conv(w, "head.0", conv(w, "sub_mean", 255 * x))
    for group in range(groups):
        start = x
        for block in range(blocks):
            name = f"body.{group}.body.{block}.body"
            residual = conv(w, f"{name}.2", conv(w, f"{name}.0", x).relu())
            mean = residual.mean(dim=(2, 3), keepdim=True)
            scale = conv(w, f"{name}.3.conv_du.2", conv(w, f"{name}.3.conv_du.0", mean).relu()).sigmoid()
            x = x + residual * scale
        x = start + conv(w, f"body.{group}.body.{blocks}", x)
    x = shallow + conv(w, f"body.{groups}", x)
    for index, step in enumerate(steps):
        x = functional.pixel_shuffle(conv(w, f"tail.0.{2 * index}", x), step)
    return conv(w, "add_mean", conv(w, "tail.1", x)) / 255


@pytest.mark.parametrize("factor", [2, 3, 4, 8])
def test_names_and_shapes_of_rcan_are_the_published_ones(factor: int) -> None:
    assert shapes_of(Rcan(factor, groups=2, blocks=1)) == rcan_shapes(factor, groups=2, blocks=1)
    if factor == 4:
        network = Rcan(factor)
        assert shapes_of(network) == rcan_shapes(factor)
        assert sum(p.numel() for p in network.parameters()) == 15_592_379


@pytest.mark.parametrize(("factor", "steps"), [(2, [2]), (3, [3]), (4, [2, 2]), (8, [2, 2, 2])])
def test_outputs_of_rcan_are_those_of_its_layers(factor: int, steps: list[int]) -> None:
    network = Rcan(factor, groups=2, blocks=2)
    stir(network)
    image = torch.rand(1, 3, 7, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        restored = network(image)
        expected = plain_rcan(network.state_dict(), image, groups=2, blocks=2, steps=steps)
    assert restored.shape == (1, 3, 7 * factor, 9 * factor)
    assert expected.std() > 0.01
    assert (restored - expected).abs().max() < 1e-5


# DAN


def dan_shapes(factor: int, *, blocks: int = 40) -> Shapes:
    """Names and shapes of the authors' code, version 1, as facts."""
    shapes: Shapes = {"encoder": (1, 441, 10), "init_kernel": (1, 21, 21), "init_ker_map": (1, 10)}
    for part, count, c, conditions in (("Restorer", blocks, 64, 10), ("Estimator", 5, 32, 32)):
        for block in range(count):
            name = f"{part}.body.{block}.body"
            shapes |= conv_shapes(f"{name}.0", c + conditions, c + conditions, 3)
            shapes |= conv_shapes(f"{name}.2", c, c + conditions, 3)
            shapes |= conv_shapes(f"{name}.3.body.0", c // 16, c, 1) | conv_shapes(f"{name}.3.body.2", c, c // 16, 1)
    shapes |= conv_shapes("Restorer.head", 64, 3, 3) | conv_shapes("Restorer.fusion", 64, 64, 3)
    shapes |= conv_shapes("Estimator.head_LR", 32, 3, 1) | conv_shapes("Estimator.head_HR", 32, 3, 9)
    shapes |= conv_shapes("Estimator.out", 10, 32, 3)
    widths = {2: [256], 3: [576], 4: [256, 256]}[factor]
    for index, width in enumerate(widths):
        shapes |= conv_shapes(f"Restorer.upscale.{2 * index}", width, 64, 3)
    return shapes | conv_shapes(f"Restorer.upscale.{2 * len(widths)}", 3, 64, 3)


def plain_dan(w: Weights, small: Tensor, *, blocks: int, factor: int) -> list[Tensor]:
    def leaky(x: Tensor) -> Tensor:
        return torch.where(x > 0, x, 0.2 * x)

    def body(name: str, x: Tensor, condition: Tensor, count: int) -> Tensor:
        for block in range(count):
            layer = f"{name}.body.{block}.body"
            residual = conv(w, f"{layer}.2", leaky(conv(w, f"{layer}.0", torch.cat((x, condition), 1))))
            mean = residual.mean(dim=(2, 3), keepdim=True)
            scale = conv(w, f"{layer}.3.body.2", leaky(conv(w, f"{layer}.3.body.0", mean))).sigmoid()
            x = x + residual * scale
        return x

    code, pictures = w["init_ker_map"], []
    for _ in range(4):
        condition = code.view(1, 10, 1, 1).expand(1, 10, *small.shape[2:])
        x = conv(w, "Restorer.fusion", body("Restorer", conv(w, "Restorer.head", small), condition, blocks))
        steps = [2, 2] if factor == 4 else [factor]
        for index, step in enumerate(steps):
            x = functional.pixel_shuffle(conv(w, f"Restorer.upscale.{2 * index}", x), step)
        pictures.append(conv(w, f"Restorer.upscale.{2 * len(steps)}", x))
        hr = conv(w, "Estimator.head_HR", pictures[-1], stride=factor)
        code = conv(w, "Estimator.out", body("Estimator", conv(w, "Estimator.head_LR", small), hr, 5)).mean(dim=(2, 3))
    return [*pictures, code]


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_names_and_shapes_of_dan_are_the_published_ones(factor: int) -> None:
    assert shapes_of(Dan(factor, COMPONENTS)) == dan_shapes(factor)


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_outputs_of_dan_are_those_of_its_layers(factor: int) -> None:
    network = Dan(factor, COMPONENTS, blocks=2)
    stir(network)
    image = torch.rand(1, 3, 6, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        pictures, codes = network.turns(image)
        *expected, code = plain_dan(network.state_dict(), image, blocks=2, factor=factor)
    assert (expected[1] - expected[0]).std() > 1e-3, "the code takes part"
    for picture, plain in zip(pictures, expected, strict=True):
        assert (picture - plain).abs().max() < 1e-5
    torch.testing.assert_close(codes[-1], code, atol=1e-9, rtol=0)


# Names, files, pictures


@pytest.mark.parametrize("name", ["rcan", "dan"])
def test_a_published_checkpoint_loads_and_restores(tmp_path: Path, name: str) -> None:
    network = build_restorer(name, factor=2, seed=3)
    torch.save(network.state_dict(), tmp_path / "published.pt")
    loaded = build_restorer(name, factor=2, weights=tmp_path / "published.pt", seed=4)
    assert all(
        torch.equal(a, b) for a, b in zip(network.state_dict().values(), loaded.state_dict().values(), strict=True)
    )
    small = np.random.default_rng(0).random((6, 8, 3), dtype=np.float32)
    restored = restore(small, loaded)
    assert restored.shape == (12, 16, 3)
    assert restored.dtype == np.float32
    assert restored.min() >= 0
    assert restored.max() <= 1


def test_what_does_not_fit_is_said(tmp_path: Path) -> None:
    torch.save(build_restorer("dan", factor=2).state_dict(), tmp_path / "x2.pth")
    with pytest.raises(InputError, match=r"dan for a factor of 3.*Restorer\.upscale"):
        build_restorer("dan", factor=3, weights=tmp_path / "x2.pth")
    with pytest.raises(UsageError, match="2, 3, 4, not by 8"):
        build_restorer("dan", factor=8)
    with pytest.raises(UsageError) as raised:
        build_restorer("ran", factor=2)
    assert all(name in str(raised.value.hint) for name in RESTORERS)
