"""`iresnet` and `iresnet-s`: matching by 2-D convolutions alone, then refinement by the error of reconstruction.

Structure: Liang et al., *Learning for Disparity Estimation through Feature Constancy*, 2018, in the layout of the
authors' code, whose names the layers have where those are more than Caffe's numbers: `iresnet` at its widths (43 M
parameters), `iresnet-s` at an eighth of them, as large as `psmnet-s`. Weights of the authors are for Caffe, so none are
read. Apart from their code: disparities are ``x_ref - x_src``; the last layer of Phi_F, which they have twice, serves
both views; a window that the correlation does not reach is searched around its middle; refined outputs are kept within
the window; a volume is made of the result, from which confidence and the left-right check are read; and layers may tell
disparities in units of several px, which a short training needs: a step moves every weight by as much.
Letters: B batch, C channels, D planes, H W grid at hand.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.sampling import at_least_float32, warp_to_ref
from telewide.matching.volume import plane_disparities_px, shifted_views
from telewide.matching.window import VOLUME_STEP_PX, Window, check_window

SLOPE = 0.1
"""Of the leaky ReLU behind every hidden layer but the ``concat`` and ``zoom_fused`` ones, as published."""
REACH, MINI_REACH = 40, 20
"""The correlations look so many cells to both sides: of 4 px, and of 2 px in the refinement."""
REFINEMENTS = 2
CELL_PX, MINI_CELL_PX = 4, 2
CORRELATION_SHARPNESS = 4.0


def _conv(c_in: int, c_out: int, *, kernel: int = 3, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, kernel, stride=stride, padding=kernel // 2)


def _deconv(c_in: int, c_out: int, *, factor: int = 2) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(c_in, c_out, 2 * factor, stride=factor, padding=factor // 2)


def _leaky(x: Tensor) -> Tensor:
    return functional.leaky_relu(x, SLOPE)


def _width(published: int, divisor: int) -> int:
    return max(8, published // divisor)


class IresnetFeatures(nn.Module):
    """Phi_F: a view to (features at 1/4, at 1/2, at 1/1); the last is the space that the feature-metric loss takes.

    Args:
        divisor: of the published widths.
    """

    feature_space = 2
    """Position of the map in which views are compared."""

    def __init__(self, *, divisor: int = 1) -> None:
        super().__init__()
        half, quarter, full = (_width(n, divisor) for n in (64, 128, 32))
        self.conv1 = _conv(3, half, kernel=7, stride=2)
        self.conv2 = _conv(half, quarter, kernel=5, stride=2)
        self.up_conv1ab = _deconv(half, full)
        self.up_conv2ab = _deconv(quarter, full, factor=4)
        self.up_conv1a2a = nn.Conv2d(2 * full, full, 1)

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, 3, H, W), sides multiples of 4, to (B, 128, H/4, W/4), (B, 64, H/2, W/2) and (B, 32, H, W)."""
        half = _leaky(self.conv1(image_BCHW))
        quarter = _leaky(self.conv2(half))
        full = torch.cat((_leaky(self.up_conv1ab(half)), _leaky(self.up_conv2ab(quarter))), dim=1)
        return quarter, half, _leaky(self.up_conv1a2a(full))


class _Up(nn.Module):
    """One level of the decoder: deeper features and disparity enlarged, joined to the skip, one disparity out."""

    def __init__(self, c_in: int, c_skip: int, c_out: int) -> None:
        super().__init__()
        self.deconv = _deconv(c_in, c_out)
        self.upsample_flow = _deconv(1, 1)
        self.concat = _conv(c_skip + c_out + 1, c_out)
        self.predict_flow = _conv(c_out, 1)

    def forward(self, deep: Tensor, disparity: Tensor, skip: Tensor) -> tuple[Tensor, Tensor]:
        risen = _crop_like(_leaky(self.deconv(deep)), skip)
        enlarged = _crop_like(self.upsample_flow(disparity), skip)
        joined = self.concat(torch.cat((skip, risen, enlarged), dim=1))
        return joined, self.predict_flow(joined)


class _Refinement(nn.Module):
    """A residual to a disparity from how well it rebuilds ref's features; its weights serve every iteration."""

    def __init__(self, full: int, divisor: int, *, unit_px: float) -> None:
        super().__init__()
        self.unit_px = unit_px
        c0, c1, c2 = (_width(n, divisor) for n in (32, 64, 128))
        self.zoom_conv0 = _conv(2 * full + 1, c0)
        self.zoom_conv1 = _conv(c0, c1, stride=2)
        self.zoom_conv1b = _conv(2 * MINI_REACH + 1 + c1, c1)
        self.zoom_conv2 = _conv(c1, c2, stride=2)
        self.zoom_conv2b = _conv(c2, c2)
        self.zoom_predict2 = _conv(c2, 1)
        self.zoom_deconv2, self.zoom_upsample2 = _deconv(c2, c1), _deconv(1, 1)
        self.zoom_fused1, self.zoom_predict1 = _conv(2 * c1 + 1, c1), _conv(c1, 1)
        self.zoom_deconv1, self.zoom_upsample1 = _deconv(c1, c0), _deconv(1, 1)
        self.zoom_fused0, self.zoom_predict0 = _conv(2 * c0 + 1, c0), _conv(c0, 1)

    def forward(self, ref: Tensor, src: Tensor, disparity: Tensor, correlation: Tensor) -> Tensor:
        """All (B, C, H, W) at full size but the correlation, at half; disparity and residual in px."""
        error = (warp_to_ref(src, disparity[:, 0]).to(ref.dtype) - ref).abs()
        told = (disparity / self.unit_px).to(ref.dtype)
        full = _leaky(self.zoom_conv0(torch.cat((ref, told, error), dim=1)))
        half = torch.cat((correlation, _leaky(self.zoom_conv1(full))), dim=1)
        half = _leaky(self.zoom_conv1b(half))
        quarter = _leaky(self.zoom_conv2b(_leaky(self.zoom_conv2(half))))
        risen = _leaky(self.zoom_deconv2(quarter)), self.zoom_upsample2(self.zoom_predict2(quarter))
        half = self.zoom_fused1(torch.cat((half, *(_crop_like(x, half) for x in risen)), dim=1))
        risen = _leaky(self.zoom_deconv1(half)), self.zoom_upsample1(self.zoom_predict1(half))
        residual: Tensor = at_least_float32(self.zoom_predict0(self.zoom_fused0(torch.cat((full, *risen), dim=1))))
        return self.unit_px * residual


class IresnetMatching(nn.Module):
    """Phi_M: features of both views to the disparities of ref.

    Args:
        divisor: of the published widths.
        unit_px: of the disparities that layers compute; published: 1.
    """

    def __init__(self, *, divisor: int = 1, unit_px: float = 1.0) -> None:
        super().__init__()
        self.unit_px = unit_px
        half, quarter, full, c3, c4, c6 = (_width(n, divisor) for n in (64, 128, 32, 256, 512, 1024))
        self.conv_redir = nn.Conv2d(quarter, _width(64, divisor), 1)
        self.conv3 = _conv(2 * REACH + 1 + _width(64, divisor), c3, kernel=5, stride=2)
        self.conv3_1 = _conv(c3, c3)
        self.conv4, self.conv4_1 = _conv(c3, c4, stride=2), _conv(c4, c4)
        self.conv5, self.conv5_1 = _conv(c4, c4, stride=2), _conv(c4, c4)
        self.conv6, self.conv6_1 = _conv(c4, c6, stride=2), _conv(c6, c6)
        self.predict_flow6 = _conv(c6, 1)
        widths = [_width(n, divisor) for n in (512, 256, 128, 64, 32, 32)]
        skips = (c4, c4, c3, quarter, half, full)
        self.ups = nn.ModuleList(
            _Up(deep, skip, wide) for deep, skip, wide in zip((c6, *widths), skips, widths, strict=False)
        )
        self.conv1_mini = _conv(half, _width(16, divisor))
        self.refinement = _Refinement(full, divisor, unit_px=unit_px)

    def forward(
        self, ref: tuple[Tensor, Tensor, Tensor], src: tuple[Tensor, Tensor, Tensor], window: Window
    ) -> tuple[list[Tensor], Tensor]:
        """Disparities (B, H, W), px, before and after each refinement, and a volume (B, D, H/4, W/4) around them."""
        centre_px = search_centre_px(window)
        seen_quarter, seen_half, seen_full = (
            _moved(m, centre_px // cell_px) for m, cell_px in zip(src, (CELL_PX, MINI_CELL_PX, 1), strict=True)
        )
        correlation = correlate_rows(ref[0], seen_quarter, reach=REACH)
        disparity = self.unit_px * at_least_float32(self._estimate(ref, correlation))
        results = [disparity]
        minis = (_leaky(self.conv1_mini(m)) for m in (ref[1], seen_half))
        mini = correlate_rows(*minis, reach=MINI_REACH)
        for _ in range(REFINEMENTS):
            residual = self.refinement(ref[2], seen_full, disparity, mini)
            disparity = _kept_within(disparity + residual, window, centre_px)
            results.append(disparity)
        results = [result[:, 0] + centre_px for result in results]
        return results, _volume_around(results[-1], ref[0], src[0], window)

    def _estimate(self, ref: tuple[Tensor, Tensor, Tensor], correlation: Tensor) -> Tensor:
        redirected = _leaky(self.conv_redir(ref[0]))
        level3 = _leaky(self.conv3_1(_leaky(self.conv3(torch.cat((correlation, redirected), dim=1)))))
        level4 = _leaky(self.conv4_1(_leaky(self.conv4(level3))))
        level5 = _leaky(self.conv5_1(_leaky(self.conv5(level4))))
        deep = _leaky(self.conv6_1(_leaky(self.conv6(level5))))
        disparity: Tensor = self.predict_flow6(deep)
        for up, skip in zip(self.ups, (level5, level4, level3, *ref), strict=True):
            deep, disparity = up(deep, disparity, skip)
        return disparity


def search_centre_px(window: Window) -> int:
    """Disparity around which the correlations look: zero, or the middle of a window that reaches beyond them."""
    check_window(window)
    if window[0] >= -REACH * CELL_PX and window[1] <= (REACH + 1) * CELL_PX:
        return 0
    return (window[0] + window[1]) // (2 * CELL_PX) * CELL_PX


def correlate_rows(ref_BCHW: Tensor, src_BCHW: Tensor, *, reach: int) -> Tensor:
    """Mean product over the channels of ref(x) and src(x + k), k from -reach to reach: (B, 2 reach + 1, H, W)."""
    width = ref_BCHW.shape[-1]
    padded = functional.pad(src_BCHW, (reach, reach))
    products = [(ref_BCHW * padded[..., first : first + width]).mean(dim=1) for first in range(2 * reach + 1)]
    return torch.stack(products, dim=1)


def _moved(x: Tensor, cells: int) -> Tensor:
    """``x(column - cells)``, zero outside."""
    if not cells:
        return x
    width = x.shape[-1]
    padded = functional.pad(x, (max(cells, 0), max(-cells, 0)))
    return padded[..., max(-cells, 0) : max(-cells, 0) + width]


def _kept_within(disparity: Tensor, window: Window, centre_px: int) -> Tensor:
    kept = disparity.clamp(window[0] - centre_px, window[1] - 1 - centre_px)
    # The gradient passes: otherwise what lies outside the window could not return.
    return kept.detach() + (disparity - disparity.detach())


def _volume_around(disparity_px_BHW: Tensor, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window) -> Tensor:
    """(B, D, h, w) logits: planes near the result are likely, and where several claim a pixel of src the most alike."""
    coarse_px = functional.avg_pool2d(disparity_px_BHW[:, None], VOLUME_STEP_PX)
    planes_px = plane_disparities_px(window, device=coarse_px.device)[:, None, None]
    ref, src = (functional.normalize(at_least_float32(m), dim=1, eps=1e-4) for m in (ref_BCHW, src_BCHW))
    likeness = torch.stack([(ref * shifted).sum(dim=1) for shifted in shifted_views(src, window)], dim=1)
    return CORRELATION_SHARPNESS * likeness - (planes_px - coarse_px).abs()


def _crop_like(x: Tensor, like: Tensor) -> Tensor:
    """Drop what a doubled odd side has too much."""
    return x[..., : like.shape[-2], : like.shape[-1]]


def initialise_iresnet(module: nn.Module) -> None:
    """He-normal over the fan-in, biases zero, as published; disparities begin near zero."""
    for layer in module.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            nn.init.kaiming_normal_(layer.weight, a=SLOPE)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)
