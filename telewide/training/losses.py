"""The losses, each one a function that returns a sum and a count.

A :class:`Term` keeps sum and count apart, so that processes can add both up before they divide: the gradient of many
processes is then that of one process on all their pixels. All arithmetic is float32 whatever the autocast.
Letters: B batch, C channels, D planes, H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from telewide.matching.sampling import at_least_float32, warp_to_ref
from telewide.matching.volume import expect_disparity_at_mode, shear_to_src
from telewide.matching.window import VOLUME_STEP_PX, Window

SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2


LEAST_HALVED_PX = 8
"""Views are not halved to less, of either side."""


@dataclass(frozen=True)
class Term:
    """One loss over some pixels.

    Attributes:
        total: scalar, sum over the pixels.
        count: scalar, how many (or how much weight of them).
    """

    total: Tensor
    count: Tensor


NamedTerms = list[tuple[str, Term]]
"""Losses with the names that the log gives them."""


def ssim(a_BCHW: Tensor, b_BCHW: Tensor) -> Tensor:
    """Structural similarity over 3x3 windows (Wang et al., 2004), without padding.

    Args:
        a_BCHW: (B, C, H, W).
        b_BCHW: (B, C, H, W).

    Returns:
        (B, C, H - 2, W - 2) in [-1, 1].
    """
    mean_a, mean_b = (functional.avg_pool2d(x, 3, stride=1) for x in (a_BCHW, b_BCHW))
    var_a = functional.avg_pool2d(a_BCHW**2, 3, stride=1) - mean_a**2
    var_b = functional.avg_pool2d(b_BCHW**2, 3, stride=1) - mean_b**2
    covariance = functional.avg_pool2d(a_BCHW * b_BCHW, 3, stride=1) - mean_a * mean_b
    numerator = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
    return numerator / ((mean_a**2 + mean_b**2 + SSIM_C1) * (var_a + var_b + SSIM_C2))


def reconstruction_difference(target_BCHW: Tensor, warped_BCHW: Tensor, *, alpha: float) -> Tensor:
    """Per-pixel ``|a - b| + alpha (1 - SSIM(a, b))``, mean over channels (the common form of eq. 3 and eq. 5).

    Args:
        target_BCHW: (B, C, H, W).
        warped_BCHW: (B, C, H, W).
        alpha: weight of the structural part.

    Returns:
        (B, H - 2, W - 2): the border pixels, which have no whole window, are left out.
    """
    target, warped = at_least_float32(target_BCHW), at_least_float32(warped_BCHW)
    absolute = (target - warped).abs()[..., 1:-1, 1:-1]
    return (absolute + alpha * (1 - ssim(target, warped))).mean(dim=1)


def photometric_loss(
    ref_BCHW: Tensor, src_BCHW: Tensor, disparity_px_BHW: Tensor, *, mask_BHW: Tensor, alpha: float, halvings: int = 0
) -> Term:
    """Photometric loss, eq. 3 of the paper: ``|I_L - I_r->L|_1 + alpha (1 - SSIM(I_L, I_r->L))``.

    Args:
        ref_BCHW: (B, 3, H, W) I_L in [0, 1].
        src_BCHW: (B, 3, H, W) the other view, enlarged.
        disparity_px_BHW: (B, H, W) d_L, px.
        mask_BHW: (B, H, W) bool, the pixels that count.
        alpha: weight of the structural part; 3 in the paper.
        halvings: how often views and disparity are halved and compared again, down to `LEAST_HALVED_PX`; the mean
            counts, of a part of a batch its own. Fine views tell the direction of the truth only within a few px of it.
    """
    difference = reconstruction_difference(ref_BCHW, warp_to_ref(src_BCHW, disparity_px_BHW), alpha=alpha)
    fine = _masked(difference, mask_BHW[:, 1:-1, 1:-1])
    if not halvings or min(ref_BCHW.shape[-2:]) < 2 * LEAST_HALVED_PX:
        return fine
    ref, src, disparity, share = (
        functional.avg_pool2d(x, 2) for x in (ref_BCHW, src_BCHW, disparity_px_BHW[:, None], mask_BHW[:, None].float())
    )
    coarse = photometric_loss(
        ref, src, disparity[:, 0] / 2, mask_BHW=share[:, 0] == 1, alpha=alpha, halvings=halvings - 1
    )
    if not coarse.count:  # each of its cells holds pixels that do not count
        return fine
    coarse_total = coarse.total * fine.count / coarse.count
    return Term((fine.total + halvings * coarse_total) / (1 + halvings), fine.count)


def feature_metric_loss(
    target_BCHW: Tensor, warped_BCHW: Tensor, *, mask_BHW: Tensor, alpha: float, has_unit_features: bool = True
) -> Term:
    """Feature-metric loss, eq. 5: eq. 3 between features of ref and features of the warped source *image*.

    Features are scaled to unit length over the channels first, so that ``alpha`` means the same in every stage.

    Args:
        target_BCHW: (B, C, h, w) F_L, features of ref.
        warped_BCHW: (B, C, h, w) F_r->L, features of the source view warped to ref.
        mask_BHW: (B, h, w) bool, on the grid of the features.
        alpha: weight of the structural part.
        has_unit_features: whether they are scaled; as published they are not.
    """
    target, warped = at_least_float32(target_BCHW), at_least_float32(warped_BCHW)
    if has_unit_features:
        target, warped = (functional.normalize(features, dim=1, eps=1e-4) for features in (target, warped))
    return _masked(reconstruction_difference(target, warped, alpha=alpha), mask_BHW[:, 1:-1, 1:-1])


def smoothness_loss(disparity_px_BHW: Tensor, ref_BCHW: Tensor, *, mask_BHW: Tensor | None = None) -> Term:
    """Edge-aware smoothness, eq. 6: ``|dx d| exp(-|dx I|) + |dy d| exp(-|dy I|)``, divided by the sum of its weights.

    Args:
        disparity_px_BHW: (B, H, W) d_L, px.
        ref_BCHW: (B, 3, H, W) I_L in [0, 1]; gradients are means over the channels.
        mask_BHW: (B, H, W) bool, the pixels between which steps count; None for all.
    """
    disparity, ref = at_least_float32(disparity_px_BHW), at_least_float32(ref_BCHW)
    weight_x = torch.exp(-(ref[..., 1:] - ref[..., :-1]).abs().mean(dim=1))
    weight_y = torch.exp(-(ref[..., 1:, :] - ref[..., :-1, :]).abs().mean(dim=1))
    if mask_BHW is not None:
        weight_x = weight_x * (mask_BHW[..., 1:] & mask_BHW[..., :-1])
        weight_y = weight_y * (mask_BHW[..., 1:, :] & mask_BHW[..., :-1, :])
    step_x = (disparity[..., 1:] - disparity[..., :-1]).abs()
    step_y = (disparity[..., 1:, :] - disparity[..., :-1, :]).abs()
    total = (step_x * weight_x).sum() + (step_y * weight_y).sum()
    return Term(total, (weight_x.sum() + weight_y.sum()) / 2)


def supervised_loss(disparity_px_BHW: Tensor, truth_px_BHW: Tensor) -> Term:
    """Smooth L1 where the truth is known; NaN elsewhere."""
    known = truth_px_BHW.isfinite()
    disparity_px = at_least_float32(disparity_px_BHW)
    difference = functional.smooth_l1_loss(
        disparity_px, torch.where(known, truth_px_BHW, disparity_px.detach()), reduction="none"
    )
    return _masked(difference, known)


def state_loss(logits_BHW: Tensor, is_so_BHW: Tensor, *, known_BHW: Tensor) -> Term:
    """Cross-entropy of a yes or no at each pixel.

    Args:
        logits_BHW: (B, H, W).
        is_so_BHW: (B, H, W) bool, the truth.
        known_BHW: (B, H, W) bool, where it is known.
    """
    logits = at_least_float32(logits_BHW)
    difference = functional.binary_cross_entropy_with_logits(logits, is_so_BHW.to(logits.dtype), reduction="none")
    return _masked(difference, known_BHW)


def distribution_loss(logits_BDHW: Tensor, truth_px_BHW: Tensor, *, window: Window) -> Term:
    """Cross-entropy between a volume and the true disparities inside each of its cells.

    A cell of 4x4 pixels that two surfaces share has two modes in truth, and is taught both: an expectation around the
    likeliest mode gives no gradient to a mode it does not see, this loss does.

    Args:
        logits_BDHW: (B, D, H / 4, W / 4).
        truth_px_BHW: (B, H, W) px, NaN where unknown.
        window: disparities ``[d_min, d_max)`` of the volume, px.
    """
    planes = logits_BDHW.shape[1]
    position = (truth_px_BHW - window[0]) / VOLUME_STEP_PX
    known = position.isfinite() & (position > -1) & (position < planes)
    index = torch.arange(planes, device=position.device)[None, :, None, None]
    spread = (1 - (torch.where(known, position, -9.0)[:, None] - index).abs()).clamp(min=0)
    target = functional.avg_pool2d(spread, VOLUME_STEP_PX)
    mass = target.sum(dim=1)
    cross_entropy = -(target * at_least_float32(logits_BDHW).log_softmax(dim=1)).sum(dim=1)
    return Term(cross_entropy.sum(), mass.sum())


def visible_mask(logits_BDHW: Tensor, *, window: Window, tolerance_px: float = VOLUME_STEP_PX) -> Tensor:
    """Where both views agree: the left-right check, read from one volume (no gradient).

    Args:
        logits_BDHW: (B, D, h, w).
        window: disparities of the volume, px.
        tolerance_px: largest difference of the two views' disparities, px.

    Returns:
        (B, h, w) bool on the grid of the volume; False where ref's pixel is occluded or outside src.
    """
    with torch.no_grad():
        ref_px = expect_disparity_at_mode(logits_BDHW, window=window)
        src_px = expect_disparity_at_mode(shear_to_src(logits_BDHW, window=window), window=window)
        seen_px = warp_to_ref(src_px[:, None], ref_px / VOLUME_STEP_PX)[:, 0]
        inside = warp_to_ref(torch.ones_like(src_px)[:, None], ref_px / VOLUME_STEP_PX)[:, 0] > 0.99
    return inside & ((ref_px - seen_px).abs() <= tolerance_px)


def _masked(difference_BHW: Tensor, mask_BHW: Tensor) -> Term:
    mask = mask_BHW.to(difference_BHW.dtype)
    return Term((difference_BHW * mask).sum(), mask.sum())
