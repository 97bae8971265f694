"""`lite`: a network made for two cores and for phones' photos.

    image ─ features (1/4, guide at 1/2) ─┬─ unit-length group correlation ─┐
                                          └─ thin concatenation ────────────┴─ hourglass ─ mode expectation (1/4)
    ─ convex upsampling (1/2) ─ one refinement against the warped guide ─ convex upsampling (1/1)

Widths are multiples of 16, which processors and GPUs compute in. There is no normalisation layer: a network this
shallow trains without, each convolution costs half, a tile sees what the whole image would, and gradients do not depend
on how a batch is split. Residual branches start at zero.
Letters: B batch, C channels, G groups, D planes, H W grid at hand.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.conv3d import Conv3d
from telewide.matching.sampling import upsample_convex, warp_to_ref
from telewide.matching.volume import concatenate_views, correlate_groups, expect_disparity_at_mode
from telewide.matching.window import VOLUME_STEP_PX, Window, planes_of, widened_window

GUIDE_CHANNELS = 16
MATCH_CHANNELS = 32
CORRELATION_GROUPS = 8
THIN_CHANNELS = 4
VOLUME_CHANNELS = 16
REFINE_CHANNELS = 16
HALVED_PLANES = 4
"""The hourglass halves the volume twice."""
DISPARITY_SCALE_PX = 16.0
"""Disparities enter the refinement as fractions of this, so that they have the size of the features."""
SURROUNDINGS_PX = 17
"""Side of the square whose mean disparity they are taken against, px of the half-size grid."""


def _conv2d(c_in: int, c_out: int, *, stride: int = 1, dilation: int = 1) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, 3, stride=stride, padding=dilation, dilation=dilation)


class _Residual2d(nn.Module):
    def __init__(self, channels: int, *, dilation: int = 1) -> None:
        super().__init__()
        self.first = _conv2d(channels, channels, dilation=dilation)
        self.last = _conv2d(channels, channels, dilation=dilation)
        nn.init.zeros_(self.last.weight)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.last(functional.relu(self.first(x))))


class LiteFeatures(nn.Module):
    """Phi_F: a standardised view to (matching features at 1/4, guide at 1/2)."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            _conv2d(3, GUIDE_CHANNELS, stride=2), nn.ReLU(inplace=True), _Residual2d(GUIDE_CHANNELS)
        )
        self.quarter = nn.Sequential(
            _conv2d(GUIDE_CHANNELS, 32, stride=2), nn.ReLU(inplace=True), _Residual2d(32), _Residual2d(32)
        )
        self.eighth = nn.Sequential(_conv2d(32, 48, stride=2), nn.ReLU(inplace=True), _Residual2d(48), _Residual2d(48))
        self.sixteenth = nn.Sequential(
            _conv2d(48, 64, stride=2), nn.ReLU(inplace=True), _Residual2d(64), _Residual2d(64)
        )
        self.eighth_from_sixteenth = nn.Conv2d(64, 48, 1)
        self.quarter_from_eighth = nn.Conv2d(48, 32, 1)
        self.fuse_eighth = _Residual2d(48)
        self.fuse_quarter = _Residual2d(32)
        self.head = nn.Conv2d(32, MATCH_CHANNELS, 1)

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3, H, W) to (B, 32, H/4, W/4) and (B, 16, H/2, W/2)."""
        guide = self.stem(image_BCHW)
        quarter = self.quarter(guide)
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        eighth = self.fuse_eighth(eighth + _double(self.eighth_from_sixteenth(sixteenth)))
        quarter = self.fuse_quarter(quarter + _double(self.quarter_from_eighth(eighth)))
        return self.head(quarter), guide


def _double(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


class _Hourglass(nn.Module):
    """3-D encoder and decoder over two levels, with skips."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.down1 = nn.Sequential(
            Conv3d(channels, 32, stride=2), nn.ReLU(inplace=True), Conv3d(32, 32), nn.ReLU(inplace=True)
        )
        self.down2 = nn.Sequential(
            Conv3d(32, 48, stride=2),
            nn.ReLU(inplace=True),
            Conv3d(48, 48),
            nn.ReLU(inplace=True),
            Conv3d(48, 48),
            nn.ReLU(inplace=True),
        )
        self.lift2 = Conv3d(48, 32, kernel=1)
        self.mix1 = nn.Sequential(Conv3d(32, 32), nn.ReLU(inplace=True))
        self.lift1 = Conv3d(32, channels, kernel=1)
        self.mix0 = nn.Sequential(Conv3d(channels, channels), nn.ReLU(inplace=True))

    def forward(self, x: Tensor) -> Tensor:
        half = self.down1(x)
        quarter = self.down2(half)
        # Added in place: a fresh volume takes longer to lay out than to fill.
        half = self.mix1(_resize_volume(self.lift2(quarter), half).add_(half))
        mixed: Tensor = self.mix0(_resize_volume(self.lift1(half), x).add_(x))
        return mixed


def _resize_volume(x: Tensor, like: Tensor) -> Tensor:
    return functional.interpolate(x, size=like.shape[2:], mode="nearest")


class LiteMatching(nn.Module):
    """Phi_M: features of both views to the disparities of ref."""

    def __init__(self) -> None:
        super().__init__()
        self.thin = nn.Conv2d(MATCH_CHANNELS, THIN_CHANNELS, 1)
        self.enter = nn.Sequential(
            Conv3d(CORRELATION_GROUPS + 2 * THIN_CHANNELS, VOLUME_CHANNELS), nn.ReLU(inplace=True)
        )
        self.hourglass = _Hourglass(VOLUME_CHANNELS)
        self.leave = Conv3d(VOLUME_CHANNELS, 1, kernel=1)
        # The mean correlation goes straight to the output: training starts at once instead of after a plateau.
        self.correlation_scale = nn.Parameter(torch.tensor(8.0))
        self.up_weights = nn.Sequential(
            _conv2d(MATCH_CHANNELS + 4 * GUIDE_CHANNELS, 32), nn.ReLU(inplace=True), nn.Conv2d(32, 9 * 4, 1)
        )
        self.refine_views = _conv2d(2 * GUIDE_CHANNELS, REFINE_CHANNELS)
        self.refine_disparity = _conv2d(1, REFINE_CHANNELS)
        self.refine = nn.Sequential(*(_Residual2d(REFINE_CHANNELS, dilation=dilation) for dilation in (1, 2, 4)))
        self.refine_residual = _conv2d(REFINE_CHANNELS, 1)
        self.refine_weights = nn.Conv2d(REFINE_CHANNELS, 9 * 4, 1)
        nn.init.zeros_(self.refine_residual.weight)
        nn.init.zeros_(self.leave.weight)

    def forward(
        self, ref: tuple[Tensor, Tensor], src: tuple[Tensor, Tensor], window: Window
    ) -> tuple[list[Tensor], Tensor]:
        """Disparities (B, H, W), coarse to fine, px, and the volume (B, D, H/4, W/4) they were read from."""
        logits = self._logits(ref[0], src[0], window)
        coarse_px = expect_disparity_at_mode(logits, window=window)
        half_px = upsample_convex(coarse_px, self._up_weights(ref), factor=2)
        refined_px, weights = self._refine(half_px, ref[1], src[1])
        fine_px = upsample_convex(refined_px, weights, factor=2)
        return [_nearest(coarse_px, 4), _nearest(half_px, 2), fine_px], logits

    def _logits(self, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window) -> Tensor:
        whole = widened_window(window, planes=HALVED_PLANES)
        correlation = correlate_groups(ref_BCHW, src_BCHW, window=whole, groups=CORRELATION_GROUPS)
        thin = concatenate_views(self.thin(ref_BCHW), self.thin(src_BCHW), window=whole)
        volume = torch.cat((correlation, thin), dim=1).contiguous(memory_format=torch.channels_last_3d)
        regularised = self.leave(self.hourglass(self.enter(volume)))[:, 0]
        logits: Tensor = regularised.float() + self.correlation_scale * correlation.float().mean(dim=1)
        return logits[:, planes_of(window, within=whole)]

    def _up_weights(self, ref: tuple[Tensor, Tensor]) -> Tensor:
        weights: Tensor = self.up_weights(torch.cat((ref[0], functional.pixel_unshuffle(ref[1], 2)), dim=1))
        return weights

    def _refine(self, half_px: Tensor, ref_guide: Tensor, src_guide: Tensor) -> tuple[Tensor, Tensor]:
        start_px = half_px.detach()
        warped = warp_to_ref(src_guide, start_px / 2).to(ref_guide.dtype)
        scaled = (_against_surroundings(start_px) / DISPARITY_SCALE_PX)[:, None].to(ref_guide.dtype)
        entered = self.refine_views(torch.cat((ref_guide, warped), dim=1)) + self.refine_disparity(scaled)
        hidden = self.refine(functional.relu(entered))
        residual_px = self.refine_residual(hidden)[:, 0].float() * VOLUME_STEP_PX
        return half_px + residual_px, self.refine_weights(hidden)


def _nearest(values_BHW: Tensor, factor: int) -> Tensor:
    return functional.interpolate(values_BHW[:, None], scale_factor=factor, mode="nearest")[:, 0]


def _against_surroundings(values_BHW: Tensor) -> Tensor:
    """Difference from the mean around each pixel: the same wherever the window lies and whatever is far away."""
    mean = functional.avg_pool2d(
        values_BHW, SURROUNDINGS_PX, stride=1, padding=SURROUNDINGS_PX // 2, count_include_pad=False
    )
    return values_BHW - mean
