"""The 3-D convolution: the same numbers as torch's own, whichever kernel computes them."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from telewide.matching.conv3d import Conv3d


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("batch", [1, 2])
@pytest.mark.parametrize("bias", [True, False])
def test_equals_the_functional_form_and_its_gradients(stride: int, batch: int, bias: bool) -> None:
    torch.manual_seed(0)
    conv = Conv3d(8, 16, stride=stride, bias=bias)
    volume = torch.randn(batch, 8, 6, 10, 14, requires_grad=True)
    expected_bias = None if conv.bias is None else conv.bias.double()
    expected = functional.conv3d(volume.double(), conv.weight.double(), expected_bias, stride=stride, padding=1)
    computed = conv(volume)
    assert computed.shape == expected.shape
    assert torch.allclose(computed.double(), expected, atol=1e-5)
    seen_from_above = torch.randn_like(expected)
    variables = (volume, *conv.parameters())
    gradients = torch.autograd.grad(computed, variables, seen_from_above.float())
    expected_gradients = torch.autograd.grad(expected, variables, seen_from_above)
    for gradient, expected_gradient in zip(gradients, expected_gradients, strict=True):
        assert torch.allclose(gradient, expected_gradient, atol=1e-4, rtol=1e-4)


def test_float64_and_bf16_take_torchs_own_way() -> None:
    conv = Conv3d(4, 4).double()
    assert conv(torch.zeros(1, 4, 2, 3, 3, dtype=torch.float64)).dtype == torch.float64
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert Conv3d(4, 4)(torch.zeros(1, 4, 2, 3, 3)).dtype == torch.bfloat16
