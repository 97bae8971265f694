"""Volumes: planes at their disparities, and what is read out of them against closed forms."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from telewide.matching.volume import (
    concatenate_views,
    correlate_groups,
    expect_disparity,
    expect_disparity_at_mode,
    expect_full_size,
    peak_share,
    plane_disparities_px,
    shear_to_src,
    shifted_views,
)
from telewide.matching.window import VOLUME_STEP_PX, Window, check_window

WINDOWS = [(0, 32), (-32, 0), (-12, 20), (8, 12), (4, 40), (-40, -8)]


def randn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def shifted_pair(shift: int, *, channels: int = 16, hw: tuple[int, int] = (3, 40)) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of ref and src of a plane at ``shift`` feature pixels: src(x - shift) = ref(x)."""
    height, width = hw
    world = randn(1, channels, height, width + 40)
    start = 20
    return world[..., start : start + width], world[..., start + shift : start + shift + width]


@pytest.mark.parametrize("window", WINDOWS)
def test_planes_lie_every_step_from_the_windows_start(window: Window) -> None:
    planes = plane_disparities_px(window)
    assert planes.tolist() == list(range(window[0], window[1], VOLUME_STEP_PX))


@pytest.mark.parametrize("window", [(0, 0), (8, 4), (0, 30), (2, 32), (-3, 4)])
def test_windows_a_volume_cannot_hold_are_refused(window: Window) -> None:
    with pytest.raises(ValueError, match=r"multiples of 4"):
        check_window(window)
    with pytest.raises(ValueError, match=r"disparity window"):
        correlate_groups(randn(1, 8, 2, 9), randn(1, 8, 2, 9), window=window, groups=2)


@pytest.mark.parametrize("window", WINDOWS)
def test_correlation_peaks_at_the_true_shift(window: Window) -> None:
    for disparity_px in range(window[0], window[1], VOLUME_STEP_PX):
        ref, src = shifted_pair(disparity_px // VOLUME_STEP_PX)
        volume = correlate_groups(ref, src, window=window, groups=4)
        plane = (disparity_px - window[0]) // VOLUME_STEP_PX
        assert volume.shape == (1, 4, (window[1] - window[0]) // VOLUME_STEP_PX, 3, 40)
        seen = slice(10, -10)
        torch.testing.assert_close(volume[:, :, plane, :, seen], torch.ones(1, 4, 3, 20))
        assert (volume.mean(dim=1).argmax(dim=1)[..., seen] == plane).all()
        assert volume.abs().max() <= 1 + 1e-5


def test_correlation_is_the_cosine_of_each_group() -> None:
    ref, src = randn(2, 12, 3, 8), randn(2, 12, 3, 8, seed=1)
    volume = correlate_groups(ref, src, window=(0, 4), groups=3)[:, :, 0]
    for group in range(3):
        part = slice(4 * group, 4 * group + 4)
        expected = torch.cosine_similarity(ref[:, part], src[:, part], dim=1)
        torch.testing.assert_close(volume[:, group], expected, rtol=1e-4, atol=1e-5)


def test_correlation_has_the_gradient_of_its_finite_differences() -> None:
    ref = randn(1, 4, 2, 5).double().requires_grad_()
    src = randn(1, 4, 2, 5, seed=1).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda a, b: correlate_groups(a, b, window=(-4, 8), groups=2), (ref, src))


def test_views_outside_src_are_zero() -> None:
    views = shifted_views(torch.ones(1, 1, 2, 6), (-8, 8))
    sums = [int(view[0, 0, 0].sum()) for view in views]  # shifts -2, -1, 0, 1
    assert sums == [4, 5, 6, 5]
    assert views[0][0, 0, 0].tolist() == [1, 1, 1, 1, 0, 0]
    assert views[3][0, 0, 0].tolist() == [0, 1, 1, 1, 1, 1]


def test_a_window_beyond_the_picture_holds_nothing() -> None:
    volume = correlate_groups(randn(1, 4, 2, 5), randn(1, 4, 2, 5), window=(40, 48), groups=2)
    assert not volume.any()


def test_concatenation_holds_ref_and_shifted_src() -> None:
    ref, src = randn(1, 2, 3, 10), randn(1, 5, 3, 10, seed=1)
    volume = concatenate_views(ref, src, window=(-4, 8))
    assert volume.shape == (1, 7, 3, 3, 10)
    for plane, shifted in enumerate(shifted_views(src, (-4, 8))):
        assert torch.equal(volume[:, :2, plane], ref)
        assert torch.equal(volume[:, 2:, plane], shifted)


@pytest.mark.parametrize("window", WINDOWS)
def test_expectation_of_equal_logits_is_the_middle(window: Window) -> None:
    planes = (window[1] - window[0]) // VOLUME_STEP_PX
    expected = (window[0] + window[1] - VOLUME_STEP_PX) / 2
    disparity = expect_disparity(torch.zeros(1, planes, 2, 3), window=window)
    torch.testing.assert_close(disparity, torch.full((1, 2, 3), expected))


def test_expectation_of_two_planes_is_a_logistic_curve() -> None:
    """E = d0 + step / (1 + exp(-(b - a))), in closed form."""
    gap = torch.linspace(-6, 6, 25)
    logits = torch.stack((torch.zeros(25), gap))[None, :, None]
    disparity = expect_disparity(logits, window=(-4, 4))[0, 0]
    torch.testing.assert_close(disparity, -4 + 4 / (1 + torch.exp(-gap)))


def test_expectation_of_a_symmetric_peak_is_its_centre() -> None:
    window = (-16, 48)
    planes = plane_disparities_px(window)
    for centre_px in (-4.0, 10.0, 17.3):
        logits = -(((planes - centre_px) / 6) ** 2)
        disparity = expect_disparity(logits[None, :, None, None], window=window)
        assert float(disparity) == pytest.approx(centre_px, abs=0.05)


@pytest.mark.parametrize("window", WINDOWS)
def test_expectation_at_full_size_and_its_gradient_are_those_of_torchs_interpolation(window: Window) -> None:
    planes = (window[1] - window[0]) // VOLUME_STEP_PX
    logits = (5 * randn(2, planes, 6, 9)).double().requires_grad_()
    weights = randn(2, 24, 36).double()
    found = expect_full_size(logits, window=window)
    full = functional.interpolate(logits[:, None], scale_factor=4, mode="trilinear", align_corners=False)[:, 0]
    levels = window[0] - 1.5 + torch.arange(4 * planes, dtype=torch.float64)
    expected = torch.einsum("bdhw,d->bhw", full.softmax(dim=1), levels)
    torch.testing.assert_close(found, expected)
    gradients = [torch.autograd.grad((weights * value).sum(), logits)[0] for value in (found, expected)]
    torch.testing.assert_close(*gradients)


def test_expectations_stay_float32_under_autocast() -> None:
    logits = 3 * randn(1, 32, 4, 5)
    window = (0, 128)
    for expect in (expect_disparity, expect_disparity_at_mode, expect_full_size):
        with torch.autocast("cpu", dtype=torch.bfloat16):
            low = expect(logits, window=window)
        assert low.dtype == torch.float32
        assert torch.equal(low, expect(logits, window=window))


def test_at_the_mode_nothing_lies_between_two_surfaces() -> None:
    """Two peaks 40 px apart, every mixture of them: the answer stays at one of the two; the full mean does not."""
    window = (0, 64)
    planes = plane_disparities_px(window)
    near, far = -(((planes - 50) / 3) ** 2), -(((planes - 10) / 3) ** 2)
    shares = torch.linspace(0.01, 0.99, 99)
    logits = torch.stack([torch.log(s * near.exp() + (1 - s) * far.exp() + 1e-30) for s in shares])[:, :, None, None]
    at_mode = expect_disparity_at_mode(logits, window=window).flatten()
    distance = torch.minimum((at_mode - 50).abs(), (at_mode - 10).abs())
    assert distance.max() < 0.5
    assert (at_mode > 30).sum() in (49, 50)
    mean = expect_disparity(logits, window=window).flatten()
    assert ((mean > 15) & (mean < 45)).sum() > 50


def test_at_the_mode_a_lone_peak_is_the_full_expectation() -> None:
    window = (-8, 56)
    logits = -(((plane_disparities_px(window) - 21.5) / 2) ** 2)[None, :, None, None]
    full = expect_disparity(logits, window=window)
    torch.testing.assert_close(expect_disparity_at_mode(logits, window=window, reach=3), full, atol=1e-3, rtol=0)


def test_at_the_mode_values_keep_to_the_window() -> None:
    window = (-8, 24)
    disparity = expect_disparity_at_mode(20 * randn(1, 8, 6, 7), window=window)
    assert disparity.min() >= -8
    assert disparity.max() <= 20


def test_peak_share_is_the_probability_around_the_mode() -> None:
    logits = 2 * randn(2, 9, 4, 5)
    probability = logits.softmax(dim=1)
    share = peak_share(logits, reach=1)
    # The best three neighbouring planes hold at least what lies around the mode, and never more than all.
    padded = torch.nn.functional.pad(probability, (0, 0, 0, 0, 1, 1))
    sums = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    torch.testing.assert_close(share, sums.amax(dim=1))
    assert (share > 0).all()
    assert (share <= 1).all()


def test_sharp_peaks_are_sure_and_flat_volumes_are_not() -> None:
    sharp = torch.zeros(1, 12, 1, 1)
    sharp[0, 5] = 30
    assert float(peak_share(sharp)) == pytest.approx(1.0, abs=1e-5)
    assert float(peak_share(torch.zeros(1, 12, 1, 1))) == pytest.approx(3 / 12)


@pytest.mark.parametrize("window", WINDOWS)
def test_volume_of_src_is_the_volume_of_the_mirrored_pair(window: Window) -> None:
    """Mirrored and exchanged, src becomes the reference, and disparities keep their sign."""
    ref, src = randn(1, 6, 3, 24), randn(1, 6, 3, 24, seed=1)
    volume = correlate_groups(ref, src, window=window, groups=2).sum(dim=1)
    exchanged = correlate_groups(src.flip(-1), ref.flip(-1), window=window, groups=2).sum(dim=1).flip(-1)
    sheared = shear_to_src(volume, window=window)
    is_outside = sheared < -1e3
    torch.testing.assert_close(sheared[~is_outside], exchanged[~is_outside])
    assert (exchanged[is_outside] == 0).all()  # there is nothing of ref there
    src_px = torch.arange(24)[:, None] + torch.tensor(range(window[0], window[1], VOLUME_STEP_PX)) // VOLUME_STEP_PX
    expected_outside = ((src_px < 0) | (src_px >= 24)).T
    assert torch.equal(is_outside, expected_outside[None, :, None].expand_as(is_outside))


def test_disparity_of_src_agrees_with_that_of_ref() -> None:
    ref, src = shifted_pair(3)
    logits = 40 * correlate_groups(ref, src, window=(0, 32), groups=1)[:, 0]
    src_px = expect_disparity_at_mode(shear_to_src(logits, window=(0, 32)), window=(0, 32))
    torch.testing.assert_close(src_px[..., :30], torch.full((1, 3, 30), 12.0), atol=0.05, rtol=0)
