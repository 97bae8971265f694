"""Layers computed from named tensors by torch's functions alone: what the re-computations of published networks share.

``Weights`` are a state dict with the authors' names.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

Weights = Mapping[str, Tensor]
Shapes = dict[str, tuple[int, ...]]


def stir(module: nn.Module, *, seed: int = 0) -> None:
    """Draw every weight, bias and running statistic, small enough that no output explodes; in float64."""
    module.double().eval()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, value in module.state_dict().items():
            if value.dtype != torch.float64:
                continue
            drawn = torch.randn(value.shape, generator=generator, dtype=torch.float64)
            if name.endswith("running_var"):
                value.copy_(0.5 + drawn.abs())
            elif value.ndim < 2:
                value.copy_(0.3 * drawn + (1.0 if name.endswith("weight") else 0.0))
            else:
                value.copy_(drawn * (1.5 / value[0].numel()) ** 0.5)


def shapes_of(module: nn.Module) -> Shapes:
    """Names and shapes of a module's state."""
    return {name: tuple(value.shape) for name, value in module.state_dict().items()}


def conv(w: Weights, name: str, x: Tensor, *, stride: int = 1, dilation: int = 1) -> Tensor:
    """A convolution whose kernel keeps the size: 2-D or 3-D by its weight."""
    weight = w[f"{name}.weight"]
    padding = dilation * (weight.shape[-1] // 2)
    function = functional.conv2d if weight.ndim == 4 else functional.conv3d
    return function(x, weight, w.get(f"{name}.bias"), stride=stride, padding=padding, dilation=dilation)


def norm(w: Weights, name: str, x: Tensor) -> Tensor:
    """Batch normalisation by the running statistics."""
    shape = (1, -1, *(1,) * (x.ndim - 2))
    mean, variance, weight, bias = (
        w[f"{name}.{part}"].view(shape) for part in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / (variance + 1e-5).sqrt() * weight + bias


def conv_norm(w: Weights, name: str, x: Tensor, *, stride: int = 1, dilation: int = 1) -> Tensor:
    """``name.0`` and its normalisation ``name.1``."""
    return norm(w, f"{name}.1", conv(w, f"{name}.0", x, stride=stride, dilation=dilation))
