"""`guided`: a regularised volume, then recurrent updates, both guided by the sharp view.

    image ─ features: guide (1/2), pyramid to 1/32 and back ─ matching features, trunk (1/4)
    matching features ─ unit-length group correlation ─ hourglass gated by ref's trunk ─ mode expectation (1/4)
    ─ two gated recurrent updates that see the volume around the present guess (1/4) ─ convex upsampling (1/2)
    ─ one update against the warped guide (1/2) ─ convex upsampling (1/1)

Little is spent on 3-D convolution: features and updates carry over to unseen pictures better than filtered volumes.
What the updates know of a disparity is its difference from its neighbourhood, so that a moved window moves the result.
No normalisation layer: a tile sees what the whole image would. Widths are multiples of 16.
Letters: B batch, C channels, G groups, D planes, H W grid at hand.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.conv3d import Conv3d
from telewide.matching.overwriting import add_enlarged, is_overwriting_allowed, planar_conv1x1
from telewide.matching.sampling import upsample_convex, warp_to_ref
from telewide.matching.volume import correlate_at, correlate_groups, expect_disparity_at_mode, peak_share
from telewide.matching.window import VOLUME_STEP_PX, Window, planes_of, widened_window

GUIDE, QUARTER, EIGHTH, SIXTEENTH, THIRTYSECOND = 32, 48, 80, 112, 144
GROUPS = 8
HIDDEN = 48
UPDATES = 2
REACH = 3
"""Planes on each side of the guess that an update sees."""
HALF_GROUPS, HALF_CHANNELS, HALF_REACH = 4, 16, 2
HALVED_PLANES = 4
"""The hourglass halves the planes twice."""
LEAST_PLANES = 12
"""Fewer are padded to this: the coarsest level has a quarter of them, and no less than three (oneDNN's bf16 gradient of
a 3-D convolution over two planes reads memory that nobody has written)."""
DISPARITY_SCALE_PX = 8.0
UNSURE, NO_LESS_BY, APART_PX = 0.85, 0.2, 3.0
"""A coarser match is the guess where the likeliest planes hold less of the probability than the first, its confidence
is no less by the second, and both lie apart by the third. Chosen on eight scenes of Middlebury 2006."""


class Coarser(NamedTuple):
    """A match of the same views at a smaller size, on cells of 4x4 px; (B, H/4, W/4) each."""

    disparity_px: Tensor
    confidence: Tensor


def _conv(c_in: int, c_out: int, *, stride: int = 1, dilation: int = 1) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, 3, stride=stride, padding=dilation, dilation=dilation)


class _Residual(nn.Module):
    def __init__(self, channels: int, *, dilation: int = 1) -> None:
        super().__init__()
        self.first = _conv(channels, channels, dilation=dilation)
        self.last = _conv(channels, channels, dilation=dilation)
        nn.init.zeros_(self.last.weight)

    def forward(self, x: Tensor) -> Tensor:
        # In place throughout: a fresh map takes longer to lay out than to fill.
        inner = self.last(functional.relu_(self.first(x)))
        return functional.relu_(inner.add_(x))


def _down(c_in: int, c_out: int, *blocks: nn.Module) -> nn.Sequential:
    return nn.Sequential(_conv(c_in, c_out, stride=2), nn.ReLU(inplace=True), *blocks)


class _Up(nn.Module):
    """Bring a coarse level up to a finer one and mix."""

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.lift = nn.Conv2d(coarse, fine, 1)
        self.mix = _Residual(fine)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        lifted = functional.interpolate(self.lift(coarse), size=fine.shape[-2:], mode="bilinear", align_corners=False)
        mixed: Tensor = self.mix(lifted.add_(fine))
        return mixed


class GuidedFeatures(nn.Module):
    """Phi_F: a standardised view to (matching features at 1/4, guide at 1/2, trunk at 1/4)."""

    def __init__(self) -> None:
        super().__init__()
        self.guide = nn.Sequential(
            nn.PixelUnshuffle(2), _conv(12, GUIDE), nn.ReLU(inplace=True), _conv(GUIDE, GUIDE), nn.ReLU(inplace=True)
        )
        self.quarter = _down(GUIDE, QUARTER, _Residual(QUARTER))
        self.eighth = _down(QUARTER, EIGHTH, _Residual(EIGHTH), _Residual(EIGHTH))
        self.sixteenth = _down(EIGHTH, SIXTEENTH, _Residual(SIXTEENTH), _Residual(SIXTEENTH, dilation=2))
        self.thirtysecond = _down(SIXTEENTH, THIRTYSECOND, _Residual(THIRTYSECOND), _Residual(THIRTYSECOND, dilation=2))
        self.to_sixteenth = _Up(THIRTYSECOND, SIXTEENTH)
        self.to_eighth = _Up(SIXTEENTH, EIGHTH)
        self.to_quarter = _Up(EIGHTH, QUARTER)
        self.head = nn.Conv2d(QUARTER, QUARTER, 1)

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, 3, H, W) to (B, 48, H/4, W/4), (B, 32, H/2, W/2) and (B, 48, H/4, W/4)."""
        guide = self.guide(image_BCHW)
        quarter = self.quarter(guide)
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        deep = self.to_sixteenth(self.thirtysecond(sixteenth), sixteenth)
        trunk = self.to_quarter(self.to_eighth(deep, eighth), quarter)
        return planar_conv1x1(self.head, trunk), guide, trunk


class _Hourglass(nn.Module):
    """3-D encoder and decoder over three levels; ref's trunk gates the channels of each level."""

    def __init__(self) -> None:
        super().__init__()
        relu = nn.ReLU(inplace=True)
        self.enter = nn.Sequential(Conv3d(GROUPS, 16), relu)
        self.down1 = nn.Sequential(Conv3d(16, 32, stride=2), relu, Conv3d(32, 32), relu)
        self.down2 = nn.Sequential(Conv3d(32, 48, stride=2), relu, Conv3d(48, 48), relu)
        self.down3 = nn.Sequential(Conv3d(48, 64, stride=(1, 2, 2)), relu, Conv3d(64, 64), relu)
        self.gates = nn.ModuleList([nn.Conv2d(QUARTER, c, 1) for c in (16, 32, 48)])
        self.lift3, self.lift2, self.lift1 = (
            Conv3d(64, 48, kernel=1),
            Conv3d(48, 32, kernel=1),
            Conv3d(32, 16, kernel=1),
        )
        self.mix2 = nn.Sequential(Conv3d(48, 48), relu)
        self.mix1 = nn.Sequential(Conv3d(32, 32), relu)
        self.mix0 = nn.Sequential(Conv3d(16, 16), relu)
        self.leave = Conv3d(16, 1, kernel=1)
        nn.init.zeros_(self.leave.weight)

    def forward(self, volume_BGDHW: Tensor, trunk: Tensor) -> Tensor:
        full = _gated(self.enter(volume_BGDHW), self.gates[0](trunk))
        half = _gated(self.down1(full), self.gates[1](_pooled(trunk, 2)))
        quarter = _gated(self.down2(half), self.gates[2](_pooled(trunk, 4)))
        eighth = self.down3(quarter)
        quarter = self.mix2(add_enlarged(self.lift3(eighth), quarter))
        half = self.mix1(add_enlarged(self.lift2(quarter), half))
        full = self.mix0(add_enlarged(self.lift1(half), full))
        left: Tensor = self.leave(full)[:, 0]
        return left


def _gated(volume_BCDHW: Tensor, gate_BCHW: Tensor) -> Tensor:
    gate = gate_BCHW.sigmoid()[:, :, None]
    return volume_BCDHW.mul_(gate) if is_overwriting_allowed() else volume_BCDHW * gate


def _pooled(x: Tensor, factor: int) -> Tensor:
    return functional.avg_pool2d(x, factor, ceil_mode=True)


class _Update(nn.Module):
    """One gated recurrent step (after ConvGRU in RAFT, Teed and Deng, 2020); the context enters its gates once."""

    def __init__(self) -> None:
        super().__init__()
        seen = 2 * (2 * REACH + 1) + 2
        self.encode = nn.Sequential(nn.Conv2d(seen, 48, 1), nn.ReLU(inplace=True), _conv(48, 32), nn.ReLU(inplace=True))
        self.context = _conv(HIDDEN, 3 * HIDDEN)
        self.gates = _conv(HIDDEN + 32, 2 * HIDDEN)
        self.candidate = _conv(HIDDEN + 32, HIDDEN)
        last = _conv(32, 1)
        self.residual = nn.Sequential(_conv(HIDDEN, 32), nn.ReLU(inplace=True), last)
        nn.init.zeros_(last.weight)

    def forward(self, hidden: Tensor, context: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        x = self.encode(seen)
        of_gates, of_candidate = context.split((2 * HIDDEN, HIDDEN), dim=1)
        gates = self.gates(torch.cat((hidden, x), dim=1)).add_(of_gates).sigmoid_()
        keep, reset = gates.chunk(2, dim=1)
        candidate = self.candidate(torch.cat((reset * hidden, x), dim=1)).add_(of_candidate).tanh_()
        hidden = torch.addcmul(hidden, keep, candidate - hidden)
        return hidden, self.residual(hidden)[:, 0].float() * VOLUME_STEP_PX


class GuidedMatching(nn.Module):
    """Phi_M: features of both views to the disparities of ref."""

    def __init__(self) -> None:
        super().__init__()
        self.hourglass = _Hourglass()
        # The mean correlation goes straight to the output: training starts at once instead of after a plateau.
        self.correlation_scale = nn.Parameter(torch.tensor(8.0))
        self.context = nn.Sequential(
            _conv(QUARTER, 2 * HIDDEN), nn.ReLU(inplace=True), nn.Conv2d(2 * HIDDEN, 2 * HIDDEN, 1)
        )
        self.update = _Update()
        self.up_weights = nn.Sequential(_conv(HIDDEN, 48), nn.ReLU(inplace=True), nn.Conv2d(48, 9 * 4, 1))
        self.half_features = nn.Conv2d(GUIDE, HALF_CHANNELS, 1)
        self.half_hidden = nn.Conv2d(HIDDEN, GUIDE, 1)
        seen = HALF_GROUPS * (2 * HALF_REACH + 1) + GUIDE + 1
        self.half_enter = nn.Sequential(
            _conv(seen, 32), nn.ReLU(inplace=True), _Residual(32), _Residual(32, dilation=2)
        )
        self.half_residual = _conv(32, 1)
        self.half_weights = nn.Conv2d(32, 9 * 4, 1)
        self.half_heads = _conv(32, 2)
        nn.init.zeros_(self.half_residual.weight)

    def forward(
        self, ref: tuple[Tensor, ...], src: tuple[Tensor, ...], window: Window, *, coarser: Coarser | None = None
    ) -> tuple[list[Tensor], Tensor, Tensor]:
        """Disparities (B, H, W), px, coarse to fine in training, else the last; the volume (B, D, H/4, W/4); heads.

        The heads (B, 2, H, W) are logits: that the error is below 1 px, and that src does not see the pixel. Where the
        volume is unsure, the updates begin from a coarser match.
        """
        whole = widened_window(window, planes=HALVED_PLANES)
        correlation = correlate_groups(ref[0], src[0], window=whole, groups=GROUPS)
        asked = planes_of(window, within=whole)
        mean = correlation.float().mean(dim=1)[:, asked]
        logits = self._regularised(correlation, ref[2])[:, asked] + self.correlation_scale * mean
        coarse_px = expect_disparity_at_mode(logits, window=window)
        if coarser is not None:
            coarse_px = _better_guess_px(coarse_px, logits, coarser)
        guesses, hidden = self._updated(coarse_px, logits, mean, trunk=ref[2], window=window)
        half_px = upsample_convex(guesses[-1], self._up_weights(hidden), factor=2)
        refined_px, fine, heads = self._at_half(half_px, hidden, ref[1], src[1])
        full_px = upsample_convex(refined_px, planar_conv1x1(self.half_weights, fine), factor=2)
        coarse = [*(_nearest(d, 4) for d in (coarse_px, *guesses)), _nearest(half_px, 2)] if self.training else []
        return [*coarse, full_px], logits, _doubled(heads)

    def _regularised(self, correlation: Tensor, trunk: Tensor) -> Tensor:
        planes = correlation.shape[2]
        missing = max(0, LEAST_PLANES - planes)
        padded = functional.pad(correlation, (0, 0, 0, 0, 0, missing)) if missing else correlation
        volume = padded.contiguous(memory_format=torch.channels_last_3d)
        regularised: Tensor = self.hourglass(volume, trunk)[:, :planes]
        return regularised.float()

    def _updated(
        self, coarse_px: Tensor, logits: Tensor, mean: Tensor, *, trunk: Tensor, window: Window
    ) -> tuple[list[Tensor], Tensor]:
        first, context = self.context(trunk).chunk(2, dim=1)
        hidden = torch.tanh(first)
        terms = self.update.context(functional.relu(context))
        likely = logits.log_softmax(dim=1)
        peak = likely.amax(dim=1, keepdim=True)
        guess_px, guesses = coarse_px, []
        for _ in range(UPDATES):
            guess_px = guess_px.detach()
            position = (guess_px - window[0]) / VOLUME_STEP_PX
            around = [_around(likely, position).clamp(min=-12) / 4, _around(mean, position) * 2]
            seen = torch.cat((*around, _relief(guess_px)[:, None] / DISPARITY_SCALE_PX, peak.clamp(min=-6)), dim=1)
            hidden, step_px = self.update(hidden, terms, seen.to(hidden.dtype))
            guess_px = guess_px + step_px
            guesses.append(guess_px)
        return guesses, hidden

    def _up_weights(self, hidden: Tensor) -> Tensor:
        return planar_conv1x1(cast(nn.Conv2d, self.up_weights[-1]), self.up_weights[:-1](hidden))

    def _at_half(self, half_px: Tensor, hidden: Tensor, ref_guide: Tensor, src_guide: Tensor) -> tuple[Tensor, ...]:
        """Refined disparity (B, h, w), px; what it was read from; heads (B, 2, h, w)."""
        start_px = half_px.detach()
        ref, src = (planar_conv1x1(self.half_features, guide) for guide in (ref_guide, src_guide))
        warped = warp_to_ref(src, start_px / 2)
        near = _near_correlation(ref.float(), warped.float()).to(ref_guide.dtype)
        relief = (_relief(start_px)[:, None] / DISPARITY_SCALE_PX).to(ref_guide.dtype)
        fine = self._entered(near, _doubled(self.half_hidden(hidden)).add_(ref_guide), relief)
        # One convolution for three channels: a processor computes sixteen at a time.
        heads = (self.half_residual, self.half_heads)
        weight, bias = (torch.cat([getattr(head, name) for head in heads]) for name in ("weight", "bias"))
        read = functional.conv2d(fine, weight, bias, padding=1).float().contiguous()
        return half_px + read[:, 0] * VOLUME_STEP_PX / 2, fine, read[:, 1:]

    def _entered(self, near: Tensor, guide: Tensor, relief: Tensor) -> Tensor:
        if not is_overwriting_allowed():
            entered: Tensor = self.half_enter(torch.cat((near, guide, relief), dim=1))
            return entered
        # In two parts: laying 53 channels out side by side takes longer than convolving them.
        first = cast(nn.Conv2d, self.half_enter[0])
        of_near, of_guide, of_relief = first.weight.split((near.shape[1], GUIDE, 1), dim=1)
        by_guide = functional.conv2d(guide, of_guide, first.bias, padding=1)
        rest, of_rest = torch.cat((near, relief), dim=1), torch.cat((of_near, of_relief), dim=1)
        entered = self.half_enter[1:](by_guide.add_(functional.conv2d(rest, of_rest, padding=1)))
        return entered


def _better_guess_px(likeliest_px_BHW: Tensor, logits_BDHW: Tensor, coarser: Coarser) -> Tensor:
    sureness = peak_share(logits_BDHW)
    is_unsure = (sureness < UNSURE) & (coarser.confidence > sureness - NO_LESS_BY)
    is_apart = (coarser.disparity_px - likeliest_px_BHW).abs() > APART_PX
    return torch.where(is_unsure & is_apart, coarser.disparity_px, likeliest_px_BHW)


def _around(volume_BDHW: Tensor, position_BHW: Tensor) -> Tensor:
    """Values of a volume at -REACH to REACH planes about a fractional one, (B, 2 REACH + 1, H, W); its ends repeat."""
    planes = volume_BDHW.shape[1]
    low = position_BHW.floor()
    fraction = (position_BHW - low)[:, None]
    offsets = torch.arange(-REACH, REACH + 2, device=volume_BDHW.device)[:, None, None]
    index = (low[:, None].long() + offsets).clamp(0, planes - 1)
    values = volume_BDHW.gather(1, index)
    return values[:, :-1] + fraction * (values[:, 1:] - values[:, :-1])


def _relief(disparity_px_BHW: Tensor) -> Tensor:
    """Difference of a disparity from the mean around it, px, kept within what is plausible."""
    mean = functional.avg_pool2d(disparity_px_BHW[:, None], 9, stride=1, padding=4, count_include_pad=False)[:, 0]
    return (disparity_px_BHW - mean).clamp(-16, 16)


def _near_correlation(ref_BCHW: Tensor, warped_BCHW: Tensor) -> Tensor:
    """Group correlation of ref with the warped src at -HALF_REACH to HALF_REACH px beside the guess."""
    batch, _, height, width = ref_BCHW.shape
    grouped = (x.reshape(batch, HALF_GROUPS, -1, height, width) for x in (ref_BCHW, warped_BCHW))
    ref, warped = (x * (x * x).sum(dim=2, keepdim=True).add(1e-6).rsqrt() for x in grouped)
    padded = functional.pad(warped, (HALF_REACH, HALF_REACH))
    near_BGDHW = correlate_at(ref, padded, range(2 * HALF_REACH + 1))
    return near_BGDHW.transpose(1, 2).flatten(1, 2)


def _doubled(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def _nearest(values_BHW: Tensor, factor: int) -> Tensor:
    return functional.interpolate(values_BHW[:, None], scale_factor=factor, mode="nearest")[:, 0]
