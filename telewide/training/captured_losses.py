"""Losses of real crops, by name. A new loss is a function of :class:`Comparison`, and a line in the table.

Letters: B batch, C channels, H W crop, h w volume.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.networks import comparable_map, prepare_view
from telewide.matching.sampling import is_inside_src, warp_to_ref
from telewide.matching.window import VOLUME_STEP_PX
from telewide.training.losses import Term, feature_metric_loss, photometric_loss, supervised_loss

_WHOLLY = 0.999  # of a warped mask


@dataclass(frozen=True)
class Comparison:
    """Real crops of one step, and one answer of the network.

    Attributes:
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        truth_px_BHW: (B, H, W) truth, NaN where unknown.
        disparity_px_BHW: (B, H, W) the answer.
        visible_Bhw: (B, H/4, W/4) bool, what passes the left-right check; None where nothing is left out.
        space: frozen extractor, where features are compared.
        alpha: weight of the structural part.
        has_unit_features: whether features are scaled to unit length before they are compared.
        valid: (B, H, W) bool each, where ref and src were photographed; None where they are whole.
        halvings: how often views are halved and compared again.
    """

    ref_BCHW: Tensor
    src_BCHW: Tensor
    truth_px_BHW: Tensor
    disparity_px_BHW: Tensor
    visible_Bhw: Tensor | None
    space: nn.Module | None
    alpha: float
    has_unit_features: bool = True
    valid: tuple[Tensor, Tensor] | None = None
    halvings: int = 0

    @property
    def counts(self) -> Tensor:
        """(B, H, W) bool, which pixels count: photographed, inside src, and visible as far as that is asked for."""
        mask = is_inside_src(self.disparity_px_BHW.detach())
        if self.valid is not None:
            mask = mask & _surrounded(self.valid[0] & _partner_of(self.valid[1], self.disparity_px_BHW.detach()))
        return mask if self.visible_Bhw is None else mask & _enlarge(self.visible_Bhw)


def photometric(crops: Comparison) -> Term:
    """Eq. 3 between ref and the warped source view."""
    return photometric_loss(
        crops.ref_BCHW,
        crops.src_BCHW,
        crops.disparity_px_BHW,
        mask_BHW=crops.counts,
        alpha=crops.alpha,
        halvings=crops.halvings,
    )


def feature_metric(crops: Comparison) -> Term:
    """Eq. 5: warp the image first, then extract features of it.

    Raises:
        ValueError: no extractor was handed over.
    """
    space, disparity_px = crops.space, crops.disparity_px_BHW
    if space is None:
        raise ValueError("a stage compares features, but no extractor was handed over")
    if not len(crops.ref_BCHW):  # this process has no real crop of the joint batch
        return Term(disparity_px.sum(), disparity_px.sum())
    with torch.no_grad():
        target = comparable_map(space, prepare_view(space, crops.ref_BCHW))
    # Prepared before the warp: the zeros that fall in from outside must not shift a mean.
    warped = comparable_map(space, warp_to_ref(prepare_view(space, crops.src_BCHW), disparity_px))
    step_px = disparity_px.shape[-1] // target.shape[-1]
    mask = functional.avg_pool2d(crops.counts.float()[:, None], step_px)[:, 0] > 0.99
    return feature_metric_loss(
        target, warped, mask_BHW=mask, alpha=crops.alpha, has_unit_features=crops.has_unit_features
    )


def supervised(crops: Comparison) -> Term:
    """Smooth L1 against the truth."""
    return supervised_loss(crops.disparity_px_BHW, crops.truth_px_BHW)


CAPTURED_LOSSES: dict[str, Callable[[Comparison], Term]] = {
    "photometric": photometric,
    "feature": feature_metric,
    "supervised": supervised,
}
"""By the name in ``captured_loss``."""


def _partner_of(src_BHW: Tensor, disparity_px_BHW: Tensor) -> Tensor:
    """(B, H, W) bool, where a ref pixel's partner is wholly mixed of pixels in the mask."""
    return warp_to_ref(src_BHW[:, None].float(), disparity_px_BHW)[:, 0] > _WHOLLY


def _surrounded(mask_BHW: Tensor) -> Tensor:
    """Pixels in the mask whose neighbours, which SSIM looks at, are in it too."""
    outside = functional.max_pool2d((~mask_BHW)[:, None].float(), 3, stride=1, padding=1)
    return outside[:, 0] == 0


def _enlarge(mask_Bhw: Tensor) -> Tensor:
    return mask_Bhw.repeat_interleave(VOLUME_STEP_PX, dim=1).repeat_interleave(VOLUME_STEP_PX, dim=2)
