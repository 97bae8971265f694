"""Reading a network's output: how sure each disparity of ref is, and whether src sees the pixel.

Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from telewide.matching.networks import NetworkOutput
from telewide.matching.sampling import warp_to_ref
from telewide.matching.volume import expect_disparity_at_mode, peak_share, shear_to_src
from telewide.matching.window import VOLUME_STEP_PX, Window

AGREEMENT_PX = 3.0
"""Difference of the two views' disparities at which agreement has fallen to nothing."""


def left_right_gap_px(output: NetworkOutput, window: Window) -> Tensor:
    """(B, H, W) difference of ref's disparity from that of the pixel of src it leads to."""
    disparity_px = output.disparity_px.float()
    src_px = expect_disparity_at_mode(shear_to_src(output.logits_BDHW, window=window), window=window)
    seen_px = warp_to_ref(_enlarge(src_px, mode="nearest"), disparity_px)[:, 0]
    return (disparity_px - seen_px).abs()


def learned_confidence(heads_BCHW: Tensor) -> tuple[Tensor, Tensor]:
    """(B, H, W) confidence and probability that the pixel is hidden from src, as a network has learned them."""
    sure, hidden = heads_BCHW.float().sigmoid().unbind(dim=1)
    return sure, hidden


def measured_confidence(output: NetworkOutput, gap_px: Tensor) -> tuple[Tensor, Tensor]:
    """(B, H, W) confidence and probability of being hidden, by the peak of the volume and by how the views agree.

    The probability is one half where the views differ by ``AGREEMENT_PX``.
    """
    sharpness = _enlarge(peak_share(output.logits_BDHW), mode="bilinear")[:, 0]
    return sharpness * (1 - gap_px / AGREEMENT_PX).clamp(min=0), (gap_px / (2 * AGREEMENT_PX)).clamp(max=1)


def _enlarge(map_Bhw: Tensor, *, mode: str) -> Tensor:
    if mode == "nearest":
        return functional.interpolate(map_Bhw[:, None], scale_factor=VOLUME_STEP_PX, mode="nearest")
    return functional.interpolate(map_Bhw[:, None], scale_factor=VOLUME_STEP_PX, mode=mode, align_corners=False)
