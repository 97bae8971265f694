"""Operations that inference computes in place or in pieces, against their plain form."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torch.nn import functional

from telewide.matching.overwriting import add_enlarged, is_overwriting_allowed, planar_conv1x1


def randn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_only_where_no_gradient_is_asked_for() -> None:
    assert not is_overwriting_allowed()
    with torch.no_grad():
        assert is_overwriting_allowed()


@pytest.mark.parametrize("batch", [1, 2])
@pytest.mark.parametrize("memory_format", [torch.channels_last, torch.contiguous_format])
def test_planar_convolution_is_the_convolution(batch: int, memory_format: torch.memory_format) -> None:
    torch.manual_seed(0)
    conv, x = nn.Conv2d(32, 36, 1), randn(batch, 32, 6, 10).contiguous(memory_format=memory_format)
    expected = conv(x)
    with torch.no_grad():
        computed = planar_conv1x1(conv, x)
    torch.testing.assert_close(computed, expected.detach(), atol=1e-5, rtol=1e-5)
    assert computed.is_contiguous()
    assert planar_conv1x1(conv, x).requires_grad


@pytest.mark.parametrize("fine_dhw", [(4, 6, 10), (4, 5, 9), (2, 6, 10), (3, 6, 10)])
@pytest.mark.parametrize("batch", [1, 2])
def test_adding_enlarged_is_enlarging_and_adding(batch: int, fine_dhw: tuple[int, int, int]) -> None:
    volumes = (randn(batch, 16, 2, 3, 5), randn(batch, 16, *fine_dhw, seed=1))
    coarse, fine = (x.contiguous(memory_format=torch.channels_last_3d) for x in volumes)
    expected = functional.interpolate(coarse, size=fine_dhw, mode="nearest") + fine
    with torch.no_grad():
        computed = add_enlarged(coarse, fine.clone(memory_format=torch.preserve_format))
    assert torch.equal(computed, expected)
    assert torch.equal(add_enlarged(coarse, fine), expected)
