"""The contrastive feature space of DeFeat-Net (Spencer et al., 2020), at the widths of the compact network.

Matching points are drawn together, others along the row pushed apart. Points and offsets are fixed where the authors
draw them, so that a step is a function of its batch. Letters: B batch, C channels, H W crop.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.batch_norm import BatchNorm2d
from telewide.matching.networks import prepare_view
from telewide.matching.psmnet import PsmnetPyramid, initialise_psmnet
from telewide.matching.sampling import at_least_float32, is_inside_src, warp_to_ref
from telewide.training.losses import NamedTerms, Term

DIMENSIONS = 3
MARGIN = 0.5
"""Distance from which on another point does not matter."""
NEGATIVE_OFFSETS_PX = (4, 8, 12, 18, 25, -4, -8, -12, -18, -25)
"""Where the ten other points of a pixel lie, along the row of src."""
_WHOLLY = 0.999  # of a warped mask


Valid = tuple[Tensor, Tensor]


class ContrastiveFeatures(nn.Module):
    """A standardised view to (unit vectors at full size,)."""

    def __init__(self) -> None:
        super().__init__()
        self.trunk = PsmnetPyramid()
        self.decode = nn.Sequential(
            nn.Conv2d(128, 64, 3, padding=1, padding_mode="reflect", bias=False),
            BatchNorm2d(64),
            nn.ReLU(),
            nn.Conv2d(64, 16, 1),
        )
        self.head = nn.Conv2d(16, DIMENSIONS, 1)
        initialise_psmnet(self)

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor]:
        """(B, 3, H, W) to ((B, 3, H, W),), of length 1 over the channels."""
        half, quarter = self.trunk.pyramid(image_BCHW)
        half = half + self.decode(_double(quarter))
        return (functional.normalize(at_least_float32(self.head(_double(half))), dim=1, eps=1e-4),)


def _double(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def contrastive_terms(
    space: nn.Module, ref_BCHW: Tensor, src_BCHW: Tensor, *, disparity_px_BHW: Tensor, valid: Valid | None = None
) -> NamedTerms:
    """Draw matches together and others apart.

    Args:
        space: a :class:`ContrastiveFeatures`.
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        disparity_px_BHW: (B, H, W) matches of a network, px.
        valid: (B, H, W) bool each, where ref and src were photographed; None where they are whole.
    """
    views = torch.cat([prepare_view(space, view) for view in (ref_BCHW, src_BCHW)])
    ref, src = space(views)[0].chunk(2) if len(views) else (views, views)
    return [("contrastive", contrastive_loss(ref, src, disparity_px_BHW, valid=valid))]


def contrastive_loss(
    ref_BCHW: Tensor, src_BCHW: Tensor, disparity_px_BHW: Tensor, *, valid: Valid | None = None
) -> Term:
    """``d^2 / 2`` of a match plus the mean of ``max(0, 0.5 - d)^2 / 2`` of the others, d the distance of two vectors.

    Args:
        ref_BCHW: (B, C, H, W) vectors of ref.
        src_BCHW: (B, C, H, W) vectors of src.
        disparity_px_BHW: (B, H, W) matches, px of this map.
        valid: (B, H, W) bool each, where ref and src were photographed; other points do not count. None for all.
    """
    apart, counts = _distance(ref_BCHW, src_BCHW, disparity_px_BHW), _counts(disparity_px_BHW, valid)
    total = (0.5 * apart.square() * counts).sum()
    for offset_px in NEGATIVE_OFFSETS_PX:
        other_px = disparity_px_BHW + offset_px
        apart = _distance(ref_BCHW, src_BCHW, other_px)
        pushed = 0.5 * (MARGIN - apart).clamp(min=0).square() * _counts(other_px, valid)
        total = total + pushed.sum() / len(NEGATIVE_OFFSETS_PX)
    return Term(total, counts.sum().to(total.dtype))


def _counts(disparity_px_BHW: Tensor, valid: Valid | None) -> Tensor:
    """(B, H, W) bool, the pixels of ref whose point of src lies inside it and was photographed, as they were."""
    inside = is_inside_src(disparity_px_BHW)
    if valid is None:
        return inside
    ref_BHW, src_BHW = valid
    return inside & ref_BHW & (warp_to_ref(src_BHW[:, None].float(), disparity_px_BHW)[:, 0] > _WHOLLY)


def _distance(ref: Tensor, src: Tensor, disparity_px: Tensor) -> Tensor:
    # A square root has no slope at zero.
    return ((ref - warp_to_ref(src, disparity_px)).square().sum(dim=1) + 1e-8).sqrt()
