"""Warps against shifts, the half-pixel rule against OpenCV, convex upsampling against its definition."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from torch.nn import functional

from telewide.matching.sampling import is_inside_src, pad_to_multiple, upsample_convex, warp_to_ref


def randn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def constant(value: float, *, hw: tuple[int, int]) -> torch.Tensor:
    return torch.full((1, *hw), value)


@pytest.mark.parametrize("width", [16, 97, 1536])
def test_zero_disparity_changes_nothing(width: int) -> None:
    src = randn(1, 3, 5, width).clamp(-1, 1)
    # Rounding of the lookup grid: 1e-7 of the width, times the slope of the picture, which is at most 2.
    torch.testing.assert_close(warp_to_ref(src, constant(0.0, hw=(5, width))), src, rtol=0, atol=3e-7 * width)


@pytest.mark.parametrize("shift", [-7, -1, 1, 4, 12])
def test_whole_disparity_is_a_shift(shift: int) -> None:
    src = randn(1, 2, 6, 33)
    warped = warp_to_ref(src, constant(float(shift), hw=(6, 33)))
    expected = torch.zeros_like(src)
    if shift >= 0:
        expected[..., shift:] = src[..., : 33 - shift]
    else:
        expected[..., :shift] = src[..., -shift:]
    torch.testing.assert_close(warped, expected, rtol=0, atol=1e-4)


def test_fractions_are_linear_between_pixels() -> None:
    src = torch.arange(20.0)[None, None, None].expand(1, 1, 3, 20)
    warped = warp_to_ref(src, constant(2.25, hw=(3, 20)))
    torch.testing.assert_close(warped[0, 0, 1, 3:], torch.arange(3.0, 20.0) - 2.25)


def test_every_pixel_has_its_own_disparity() -> None:
    """Against cv2.remap, which looks up by pixel coordinates."""
    rng = np.random.default_rng(0)
    src = rng.random((9, 31), dtype=np.float32)
    disparity_px = rng.uniform(-6, 6, (9, 31)).astype(np.float32)
    x, y = np.meshgrid(np.arange(31, dtype=np.float32), np.arange(9, dtype=np.float32))
    # cv2 keeps 5 bits of a coordinate's fraction.
    expected = cv2.remap(src, x - disparity_px, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    warped = warp_to_ref(torch.from_numpy(src)[None, None], torch.from_numpy(disparity_px)[None])[0, 0].numpy()
    np.testing.assert_allclose(warped, expected, atol=1 / 32)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_warps_are_float32_whatever_comes_in(dtype: torch.dtype) -> None:
    src = torch.linspace(0, 1, 2048)[None, None, None].expand(1, 1, 2, 2048)
    disparity = constant(3.0, hw=(2, 2048))
    warped = warp_to_ref(src.to(dtype), disparity.to(dtype))
    assert warped.dtype == torch.float32
    torch.testing.assert_close(warped[..., 3:], src.to(dtype).float()[..., :-3], rtol=0, atol=1e-3)


def test_what_lies_outside_src_is_zero_and_known() -> None:
    disparity = torch.tensor([[[0.0, 1.0, 2.5, -1.0, -0.5]]])
    inside = is_inside_src(disparity)
    assert inside.tolist() == [[[True, True, False, True, False]]]
    far = warp_to_ref(torch.ones(1, 1, 4, 8), constant(9.0, hw=(4, 8)))
    assert not far.any()


def test_warp_has_the_gradient_of_its_finite_differences() -> None:
    src = torch.rand(1, 2, 6, 8, dtype=torch.float64, requires_grad=True)
    disparity = (torch.rand(1, 6, 8, dtype=torch.float64) * 0.8 + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(warp_to_ref, (src, disparity))


@pytest.mark.parametrize("factor", [2, 4])
def test_resizing_follows_the_half_pixel_rule(factor: int) -> None:
    """What the networks enlarge and shrink by lies where OpenCV puts it."""
    rng = np.random.default_rng(1)
    image = rng.random((8, 12), dtype=np.float32)
    tensor = torch.from_numpy(image)[None, None]
    larger = functional.interpolate(tensor, scale_factor=factor, mode="bilinear", align_corners=False)[0, 0]
    expected = cv2.resize(image, (12 * factor, 8 * factor), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(larger.numpy(), expected, atol=1e-5)
    smaller = functional.avg_pool2d(tensor, factor)[0, 0]
    np.testing.assert_allclose(
        smaller.numpy(), cv2.resize(image, (12 // factor, 8 // factor), interpolation=cv2.INTER_AREA), atol=1e-5
    )


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_convex_weights_sum_to_one(factor: int) -> None:
    """A constant map stays constant, at the border too, whatever the weights."""
    weights = 5 * randn(2, 9 * factor**2, 5, 7)
    fine = upsample_convex(torch.full((2, 5, 7), -13.25), weights, factor=factor)
    assert fine.shape == (2, 5 * factor, 7 * factor)
    torch.testing.assert_close(fine, torch.full_like(fine, -13.25))


def test_convex_upsampling_stays_within_its_neighbours() -> None:
    coarse = 30 * randn(1, 6, 9)
    fine = upsample_convex(coarse, 4 * randn(1, 36, 6, 9, seed=1), factor=2)
    padded = functional.pad(coarse[:, None], (1, 1, 1, 1), mode="replicate")
    highest = functional.max_pool2d(padded, 3, stride=1)[:, 0]
    lowest = -functional.max_pool2d(-padded, 3, stride=1)[:, 0]
    for row in (0, 1):
        for column in (0, 1):
            part = fine[:, row::2, column::2]
            assert ((part <= highest + 1e-4) & (part >= lowest - 1e-4)).all()


def test_convex_upsampling_can_choose_any_neighbour() -> None:
    """All the weight on one neighbour moves the map by one coarse pixel, in each of the new pixels by its own."""
    coarse = randn(1, 4, 5)
    weights = torch.full((1, 9, 4, 4, 5), -50.0)
    for subpixel, neighbour in enumerate((4, 3, 1, 8)):  # itself, left, above, below right
        weights[:, neighbour, subpixel] = 50.0
    fine = upsample_convex(coarse, weights.view(1, 36, 4, 5), factor=2)
    torch.testing.assert_close(fine[:, ::2, ::2], coarse)
    torch.testing.assert_close(fine[:, ::2, 3::2], coarse[:, :, :-1])
    torch.testing.assert_close(fine[:, 3::2, ::2], coarse[:, :-1])
    torch.testing.assert_close(fine[:, 1:-1:2, 1:-1:2], coarse[:, 1:, 1:])


def test_convex_upsampling_survives_huge_logits() -> None:
    fine = upsample_convex(randn(1, 3, 3), 1e4 * randn(1, 36, 3, 3), factor=2)
    assert fine.isfinite().all()


@pytest.mark.parametrize("hw", [(31, 47), (32, 48), (33, 1)])
def test_padding_keeps_the_picture_where_it_is(hw: tuple[int, int]) -> None:
    image = randn(1, 3, *hw)
    padded = pad_to_multiple(image, multiple=16)
    assert padded.shape[-2] % 16 == padded.shape[-1] % 16 == 0
    assert padded.shape[-2] - hw[0] < 16
    assert torch.equal(padded[..., : hw[0], : hw[1]], image)
    assert torch.equal(padded[..., hw[0] :, : hw[1]], image[..., -1:, :].expand(-1, -1, padded.shape[-2] - hw[0], -1))
