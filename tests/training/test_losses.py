"""Losses: gradients against finite differences, zero at the truth, closed forms, and sums over split batches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter
from training.small import rendered, tensor_of

from telewide.matching.sampling import warp_to_ref
from telewide.matching.volume import plane_disparities_px
from telewide.training.losses import (
    Term,
    distribution_loss,
    feature_metric_loss,
    photometric_loss,
    reconstruction_difference,
    smoothness_loss,
    ssim,
    supervised_loss,
    visible_mask,
)

WINDOW = (-8, 16)


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def everywhere(x: torch.Tensor) -> torch.Tensor:
    return torch.ones(x.shape[0], *x.shape[-2:], dtype=torch.bool)


def mean(term: Term) -> float:
    return float(term.total / term.count)


def exact_pair(shift: int, *, hw: tuple[int, int] = (16, 40)) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """ref, src and truth of a plane at a whole disparity; only what both views see."""
    world = rand(1, 3, hw[0], hw[1] + abs(shift)).float()
    start = max(-shift, 0)
    ref = world[..., start : start + hw[1]]
    src = world[..., start + shift : start + shift + hw[1]]
    return ref, src, torch.full((1, *hw), float(shift))


# Gradients


def test_photometric_gradient() -> None:
    ref, src = rand(1, 3, 6, 8), rand(1, 3, 6, 8, seed=1)
    disparity = (1.1 + 0.6 * rand(1, 6, 8, seed=2)).requires_grad_()
    mask = everywhere(ref)
    assert torch.autograd.gradcheck(lambda d: photometric_loss(ref, src, d, mask_BHW=mask, alpha=3.0).total, disparity)


def test_feature_metric_gradient() -> None:
    target, warped = rand(1, 4, 6, 8), rand(1, 4, 6, 8, seed=1).requires_grad_()
    mask = everywhere(target)
    assert torch.autograd.gradcheck(
        lambda w: feature_metric_loss(target, w, mask_BHW=mask, alpha=3.0).total, warped, atol=1e-4
    )


def test_smoothness_gradient() -> None:
    ref, disparity = rand(1, 3, 6, 8), (10 * rand(1, 6, 8, seed=1)).requires_grad_()
    assert torch.autograd.gradcheck(lambda d: smoothness_loss(d, ref).total, disparity)


def test_supervised_gradient() -> None:
    truth = 9 * rand(1, 6, 8)
    truth[0, 2, 3] = torch.nan
    disparity = (9 * rand(1, 6, 8, seed=1)).requires_grad_()
    assert torch.autograd.gradcheck(lambda d: supervised_loss(d, truth).total, disparity)
    supervised_loss(disparity, truth).total.backward()
    assert disparity.grad is not None
    assert disparity.grad[0, 2, 3] == 0
    assert disparity.grad.isfinite().all()


def test_distribution_gradient() -> None:
    truth = 20 * rand(1, 8, 12) - 6
    logits = rand(1, 6, 2, 3, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: distribution_loss(x, truth, window=WINDOW).total, logits)


# At the truth and beside it


@pytest.mark.parametrize("shift", [-5, 0, 3, 8])
def test_photometric_loss_is_zero_at_the_truth_and_grows_beside_it(shift: int) -> None:
    ref, src, truth = exact_pair(shift)
    mask = everywhere(ref)
    edge = abs(shift) + 2
    mask[..., :edge], mask[..., -edge:] = False, False
    at_truth, beside, farther = (
        mean(photometric_loss(ref, src, truth + off, mask_BHW=mask, alpha=3.0)) for off in (0, 0.5, 1)
    )
    assert at_truth < 1e-3
    assert 0.1 < beside < farther


def test_halved_views_say_which_way_the_truth_lies_from_afar() -> None:
    """A bump 24 px off, six wide: fine views that do not overlap are as unlike everywhere, coarse ones get liker."""
    place = torch.arange(128.0)

    def view(at_px: float) -> torch.Tensor:
        return torch.exp(-(((place - at_px) / 6) ** 2)).repeat(3, 64, 1)[None]

    ref, src = view(70.0), view(46.0)

    def slope(halvings: int) -> float:
        """Change of the loss where the bump is, as its disparity rises."""
        start_px = torch.full((1, 64, 128), 0.5, requires_grad=True)
        term = photometric_loss(ref, src, start_px, mask_BHW=everywhere(ref), alpha=0.0, halvings=halvings)
        (gradient,) = torch.autograd.grad(term.total / term.count, start_px)
        return float(gradient[:, :, 64:76].sum())

    assert slope(4) < 3 * slope(0)


def test_small_views_are_halved_as_often_as_they_can_be() -> None:
    ref, src, truth = exact_pair(3, hw=(16, 40))
    once, often = (
        photometric_loss(ref, src, truth + 1, mask_BHW=everywhere(ref), alpha=3.0, halvings=halvings)
        for halvings in (1, 6)
    )
    assert torch.isfinite(often.total)
    assert float(often.total) > 0
    assert float(once.count) == float(often.count)
    scattered = everywhere(ref)
    scattered[..., ::2] = False  # no halved pixel is whole
    alone, halved = (
        photometric_loss(ref, src, truth + 1, mask_BHW=scattered, alpha=3.0, halvings=halvings) for halvings in (0, 1)
    )
    assert float(alone.total) == float(halved.total)


def test_halving_leaves_out_what_is_masked_and_its_gradient_is_exact() -> None:
    ref, src, truth = exact_pair(4)
    spoilt = src.clone()
    mask = everywhere(ref)
    mask[..., :16] = False
    spoilt[..., :8] = 7.0
    compared = [photometric_loss(ref, view, truth, mask_BHW=mask, alpha=3.0, halvings=1) for view in (src, spoilt)]
    assert mean(compared[0]) < 1e-3  # at the truth
    assert float(compared[0].total) == pytest.approx(float(compared[1].total), abs=1e-3)
    assert float(compared[0].count) == float(photometric_loss(ref, src, truth, mask_BHW=mask, alpha=3.0).count)
    disparity = (truth.double() + 0.3).requires_grad_()
    views = ref.double(), src.double()
    assert torch.autograd.gradcheck(
        lambda d: photometric_loss(*views, d, mask_BHW=mask, alpha=3.0, halvings=1).total, disparity
    )


def test_feature_metric_loss_is_zero_at_the_truth_and_grows_beside_it() -> None:
    features = torch.nn.Conv2d(3, 8, 3, padding=1, bias=False)
    ref, src, truth = exact_pair(4)
    mask = everywhere(ref)
    mask[..., :8], mask[..., -8:] = False, False
    with torch.no_grad():
        at_truth, beside = (
            mean(feature_metric_loss(features(ref), features(warp_to_ref(src, d)), mask_BHW=mask, alpha=3.0))
            for d in (truth, truth + 1)
        )
    assert at_truth < 1e-3
    assert beside > 0.1


def test_feature_metric_loss_does_not_see_the_size_of_features() -> None:
    target, warped = rand(1, 4, 6, 8), rand(1, 4, 6, 8, seed=1)
    mask = everywhere(target)
    small, large = (mean(feature_metric_loss(k * target, k * warped, mask_BHW=mask, alpha=1.0)) for k in (1, 50))
    assert small == pytest.approx(large, rel=1e-4)


def test_features_as_they_are_are_compared_like_pictures() -> None:
    """Eq. 5 is eq. 3 in another space: with the views themselves as features both are one."""
    ref, src, truth = exact_pair(4)
    mask, off_px = everywhere(ref), truth + 0.7
    as_features = feature_metric_loss(ref, warp_to_ref(src, off_px), mask_BHW=mask, alpha=3.0, has_unit_features=False)
    assert mean(as_features) == pytest.approx(mean(photometric_loss(ref, src, off_px, mask_BHW=mask, alpha=3.0)))


def test_masked_pixels_do_not_count() -> None:
    ref, src, truth = exact_pair(3)
    spoilt = src.clone()
    spoilt[..., 20:] = 0.0
    mask = torch.zeros(1, *ref.shape[-2:], dtype=torch.bool)
    mask[..., 8:18] = True  # these look up src at 5 to 15
    assert mean(photometric_loss(ref, spoilt, truth, mask_BHW=mask, alpha=3.0)) < 1e-3
    assert float(photometric_loss(ref, spoilt, truth, mask_BHW=mask, alpha=3.0).count) == 14 * 10  # border rows aside
    nothing = photometric_loss(ref, spoilt, truth, mask_BHW=torch.zeros_like(mask), alpha=3.0)
    assert float(nothing.total) == float(nothing.count) == 0


def test_supervised_loss_is_smooth_l1_where_the_truth_is_known() -> None:
    truth = torch.tensor([[[1.0, 2.0, torch.nan, 4.0]]])
    term = supervised_loss(torch.tensor([[[1.5, 5.0, 77.0, 4.0]]]), truth)
    assert float(term.total) == pytest.approx(0.5 * 0.5**2 + (3 - 0.5) + 0)
    assert float(term.count) == 3


# Closed forms


def test_ssim_against_its_definition() -> None:
    """Means and variances over 3x3 by scipy's box filter; the border has no whole window."""
    a, b = rand(1, 1, 9, 11), rand(1, 1, 9, 11, seed=1)
    x, y = a[0, 0].numpy(), b[0, 0].numpy()
    mu_x, mu_y = uniform_filter(x, 3), uniform_filter(y, 3)
    var_x, var_y = uniform_filter(x**2, 3) - mu_x**2, uniform_filter(y**2, 3) - mu_y**2
    covariance = uniform_filter(x * y, 3) - mu_x * mu_y
    expected = ((2 * mu_x * mu_y + 0.0001) * (2 * covariance + 0.0009)) / (
        (mu_x**2 + mu_y**2 + 0.0001) * (var_x + var_y + 0.0009)
    )
    np.testing.assert_allclose(ssim(a, b)[0, 0].numpy(), expected[1:-1, 1:-1], rtol=1e-9)


def test_ssim_of_equal_and_of_opposite_pictures() -> None:
    a = rand(1, 3, 8, 8)
    torch.testing.assert_close(ssim(a, a), torch.ones(1, 3, 6, 6, dtype=torch.float64))
    assert ssim(a, 1 - a).max() < 0.7


def test_ssim_constants_by_hand() -> None:
    """Flat windows show the first, C1 = 0.01^2; windows of one lit pixel each the second, C2 = 0.03^2, too.

    Flat, 0.2 and 0.6: (2 * 0.12 + 0.0001) / (0.04 + 0.36 + 0.0001) = 0.2401 / 0.4001. One pixel of 0.9 in nine, at two
    places: means 0.1, variances 0.08, covariance -0.01, so 0.0201 * -0.0191 / (0.0201 * 0.1609) = -0.0191 / 0.1609.
    """
    flat_a, flat_b = (torch.full((1, 1, 3, 3), value, dtype=torch.float64) for value in (0.2, 0.6))
    assert float(ssim(flat_a, flat_b)) == pytest.approx(0.600100, abs=1e-6)
    lit_a, lit_b = (torch.zeros(1, 1, 3, 3, dtype=torch.float64) for _ in range(2))
    lit_a[..., 0, 0], lit_b[..., 2, 1] = 0.9, 0.9
    assert float(ssim(lit_a, lit_b)) == pytest.approx(-0.118707, abs=1e-6)


@pytest.mark.parametrize(("alpha", "expected"), [(0.0, 0.4), (1.0, 0.799900), (3.0, 1.599700)])
def test_photometric_loss_of_flat_pictures_by_hand(alpha: float, expected: float) -> None:
    """|0.2 - 0.6| + alpha (1 - 0.2401 / 0.4001), over the 2x3 pixels that have a whole window."""
    ref, src = (torch.full((1, 3, 4, 5), value, dtype=torch.float64) for value in (0.2, 0.6))
    term = photometric_loss(ref, src, torch.zeros(1, 4, 5), mask_BHW=everywhere(ref), alpha=alpha)
    assert float(term.count) == 6
    assert mean(term) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("alpha", "expected"), [(0.0, 0.2), (3.0, 0.319988)])
def test_feature_metric_loss_of_flat_features_by_hand(alpha: float, expected: float) -> None:
    """(3, 4) and (40, 30) at unit length: |0.6 - 0.8| + alpha (1 - 0.9601 / 1.0001) in either channel."""
    target, warped = (
        torch.tensor(pair, dtype=torch.float64)[None, :, None, None].expand(1, 2, 5, 4) for pair in ((3, 4), (40, 30))
    )
    term = feature_metric_loss(target, warped, mask_BHW=everywhere(target), alpha=alpha)
    assert float(term.count) == 6
    assert mean(term) == pytest.approx(expected, abs=1e-5)


def test_difference_is_absolute_plus_structural_part() -> None:
    a, b = rand(1, 3, 7, 9), rand(1, 3, 7, 9, seed=1)
    plain, with_structure = (reconstruction_difference(a, b, alpha=alpha) for alpha in (0.0, 3.0))
    torch.testing.assert_close(plain, (a - b).abs()[..., 1:-1, 1:-1].mean(dim=1))
    torch.testing.assert_close(with_structure - plain, 3 * (1 - ssim(a, b)).mean(dim=1))


def test_smoothness_of_a_constant_map_is_zero() -> None:
    assert float(smoothness_loss(torch.full((1, 6, 8), 7.0), rand(1, 3, 6, 8)).total) == 0


def test_smoothness_of_a_ramp_is_its_slope() -> None:
    """Over a plain picture all weights are one: |dx d| everywhere, |dy d| nowhere."""
    ramp = 0.25 * torch.arange(10.0).expand(1, 5, 10)
    term = smoothness_loss(ramp, torch.zeros(1, 3, 5, 10))
    assert float(term.total) == pytest.approx(0.25 * 9 * 5)
    assert float(term.count) == pytest.approx((9 * 5 + 10 * 4) / 2)


def test_steps_are_cheaper_across_edges_of_the_picture() -> None:
    disparity = torch.zeros(1, 6, 12)
    disparity[..., 6:] = 5.0
    at_edge, elsewhere = torch.zeros(1, 3, 6, 12), torch.zeros(1, 3, 6, 12)
    at_edge[..., 6:], elsewhere[..., 3:] = 1.0, 1.0
    cheap, dear = smoothness_loss(disparity, at_edge), smoothness_loss(disparity, elsewhere)
    assert float(cheap.total) == pytest.approx(float(dear.total) * np.exp(-1))


def test_distribution_loss_is_least_at_the_true_distribution() -> None:
    """Cross-entropy is the entropy of the truth where the volume says just that, and more anywhere else."""
    truth = torch.full((1, 8, 8), 4.0)
    truth[:, :, 4:] = 1.0  # between the planes at 0 and at 4: a quarter and three quarters
    truth[:, :4, :1] = -8.0  # a quarter of the first cell is another surface
    planes = plane_disparities_px(WINDOW)
    target = torch.zeros(1, len(planes), 2, 2)
    target[0, 3, :, 0], target[0, 2, :, 1], target[0, 3, :, 1] = 1.0, 0.75, 0.25
    target[0, 3, 0, 0], target[0, 0, 0, 0] = 0.75, 0.25
    best = mean(distribution_loss((target + 1e-12).log(), truth, window=WINDOW))
    entropy = float(torch.special.entr(target).sum() / 4)
    assert best == pytest.approx(entropy, abs=1e-5)
    for seed in range(5):
        noise = 0.3 * torch.randn(target.shape, generator=torch.Generator().manual_seed(seed))
        assert mean(distribution_loss((target + 1e-3).log() + noise, truth, window=WINDOW)) > best


def test_distribution_loss_leaves_out_what_the_window_does_not_hold() -> None:
    truth = torch.full((1, 4, 8), torch.nan)
    logits = torch.zeros(1, 6, 1, 2)
    assert float(distribution_loss(logits, truth, window=WINDOW).count) == 0
    truth[..., :4], truth[..., 4:] = 100.0, -100.0
    term = distribution_loss(logits, truth, window=WINDOW)
    assert float(term.count) == float(term.total) == 0


# Sums


def test_terms_of_a_split_batch_add_up() -> None:
    ref, src = rand(4, 3, 8, 12), rand(4, 3, 8, 12, seed=1)
    disparity = 3 * rand(4, 8, 12, seed=2)
    truth = torch.where(rand(4, 8, 12, seed=3) > 0.3, 10 * rand(4, 8, 12, seed=4), torch.nan)
    logits = rand(4, 6, 2, 3, seed=5)
    mask = rand(4, 8, 12, seed=6) > 0.4
    losses: list[Callable[[slice], Term]] = [
        lambda p: photometric_loss(ref[p], src[p], disparity[p], mask_BHW=mask[p], alpha=3.0),
        lambda p: feature_metric_loss(ref[p], src[p], mask_BHW=mask[p], alpha=3.0),
        lambda p: smoothness_loss(disparity[p], ref[p]),
        lambda p: supervised_loss(disparity[p], truth[p]),
        lambda p: distribution_loss(logits[p], truth[p], window=WINDOW),
    ]
    for loss in losses:
        whole, first, rest, none = (loss(part) for part in (slice(4), slice(1), slice(1, 4), slice(0, 0)))
        torch.testing.assert_close(first.total + rest.total, whole.total)
        torch.testing.assert_close(first.count + rest.count, whole.count)
        assert float(none.total) == float(none.count) == 0


# Occlusion


def test_occluded_pixels_of_a_rendered_pair_are_masked() -> None:
    """Logits made from the truth: the left-right check finds what the other view does not see."""
    window = (0, 32)
    planes = plane_disparities_px(window)[:, None, None]
    found, kept, n_occluded, n_seen = 0, 0, 0, 0
    for seed in range(4):
        pair = rendered(seed, hw=(128, 192))
        coarse_px = torch.from_numpy(pair.disparity_px[2::4, 2::4].copy())
        occluded = torch.from_numpy(pair.occluded)
        share = torch.nn.functional.avg_pool2d(occluded.float()[None], 4)[0]
        logits = -(((coarse_px - planes) / 3) ** 2)
        visible = visible_mask(logits[None], window=window)[0]
        found += int((~visible & (share == 1)).sum())
        n_occluded += int((share == 1).sum())
        kept += int((visible & (share == 0)).sum())
        n_seen += int((share == 0).sum())
    assert n_occluded > 100
    assert found / n_occluded > 0.75
    assert kept / n_seen > 0.9


def test_what_lies_outside_src_is_masked() -> None:
    logits = torch.zeros(1, 8, 4, 12)
    logits[:, 4] = 20.0  # a plane at 16 px, four cells
    visible = visible_mask(logits, window=(0, 32))
    assert not visible[..., :4].any()
    assert visible[..., 4:].all()


def test_rendered_truth_is_the_best_disparity() -> None:
    """On a whole rendered scene, in the visible pixels, moving the truth aside makes the loss larger."""
    pair = rendered(3, hw=(128, 192))
    ref, src = tensor_of(pair.ref), tensor_of(pair.src)
    truth, mask = torch.from_numpy(pair.disparity_px)[None], ~torch.from_numpy(pair.occluded)[None]
    losses = [mean(photometric_loss(ref, src, truth + off, mask_BHW=mask, alpha=3.0)) for off in (-2, -1, 0, 1, 2)]
    assert min(losses) == losses[2]
