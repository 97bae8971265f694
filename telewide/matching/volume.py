"""Matching volumes and what is read out of them.

A volume has one plane every ``VOLUME_STEP_PX`` full-size pixels of the window ``[d_min, d_max)``, on the grid of the
features (a quarter of the image). Plane k holds the disparity ``d_min + k VOLUME_STEP_PX``; windows may be negative.
Letters: B batch, C channels, G groups, D planes, H W feature grid.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn import functional

from telewide.matching.window import VOLUME_STEP_PX, Window, check_window


def plane_disparities_px(window: Window, *, device: torch.device | None = None) -> Tensor:
    """(D,) float32 disparity of each plane, full-size px."""
    return torch.arange(window[0], window[1], VOLUME_STEP_PX, dtype=torch.float32, device=device)


def shifted_views(src_BCHW: Tensor, window: Window) -> list[Tensor]:
    """One view of src a plane, ``src(x - k)`` at ref's pixel x, zero outside; D tensors (B, C, H, W)."""
    check_window(window)
    width, shifts = src_BCHW.shape[-1], _shifts(window)
    padded = functional.pad(src_BCHW, (max(shifts[-1], 0), max(-shifts[0], 0)))
    return [padded[..., first : first + width] for first in _first_columns(shifts)]


def correlate_groups(ref_BCHW: Tensor, src_BCHW: Tensor, *, window: Window, groups: int) -> Tensor:
    """Group-wise correlation of unit-length features (after Guo et al., GwcNet, 2019), each value in [-1, 1].

    Args:
        ref_BCHW: (B, C, H, W) features of ref.
        src_BCHW: (B, C, H, W) features of src.
        window: disparities ``[d_min, d_max)``, full-size px.
        groups: G, a divisor of C; each group is scaled to unit length by itself.

    Returns:
        (B, G, D, H, W) volume.
    """
    check_window(window)
    ref, src = _unit_groups(ref_BCHW, groups), _unit_groups(src_BCHW, groups)
    shifts = _shifts(window)
    padded = functional.pad(src, (max(shifts[-1], 0), max(-shifts[0], 0)))
    return correlate_at(ref, padded, _first_columns(shifts)).to(ref_BCHW.dtype)


def correlate_at(ref_groups: Tensor, padded_groups: Tensor, columns: Sequence[int]) -> Tensor:
    """Inner products over K channels of ref with as wide a part of src, at several places.

    Args:
        ref_groups: (B, G, K, H, W).
        padded_groups: (B, G, K, H, W + P) src.
        columns: D columns of src, at most P, each of which comes to lie under ref's column 0.

    Returns:
        (B, G, D, H, W).
    """
    if torch.compiler.is_compiling():  # for export: ONNX would scatter each sum in place into a whole volume
        width = ref_groups.shape[-1]
        seen = (padded_groups[..., first : first + width] for first in columns)
        return torch.stack([(ref_groups * part).sum(dim=2) for part in seen], dim=2)
    volume_BGDHW: Tensor = _Correlation.apply(ref_groups, padded_groups, columns)  # type: ignore[no-untyped-call]
    return volume_BGDHW


def _shifts(window: Window) -> range:
    """Shift of each plane, px of the feature grid."""
    return range(window[0] // VOLUME_STEP_PX, window[1] // VOLUME_STEP_PX)


class _Correlation(torch.autograd.Function):
    """:func:`correlate_at`, added up in place: several times faster than product and sum."""

    @staticmethod
    def forward(ctx: FunctionCtx, ref: Tensor, padded: Tensor, columns: Sequence[int]) -> Tensor:
        ctx.save_for_backward(ref, padded)
        ctx.columns = columns  # type: ignore[attr-defined]
        batch, groups, channels, height, width = ref.shape
        volume = ref.new_zeros((batch, len(columns), groups, height, width))
        for plane, first in enumerate(columns):
            for channel in range(channels):
                volume[:, plane].addcmul_(ref[:, :, channel], padded[:, :, channel, :, first : first + width])
        return volume.transpose(1, 2)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        ref, padded = ctx.saved_tensors  # type: ignore[attr-defined]
        grad_ref, grad_padded = torch.zeros_like(ref), torch.zeros_like(padded)
        width = ref.shape[-1]
        for plane, first in enumerate(ctx.columns):  # type: ignore[attr-defined]
            grad = grads[0][:, :, plane, None]
            seen = slice(first, first + width)
            grad_ref.addcmul_(grad, padded[..., seen])
            grad_padded[..., seen].addcmul_(grad, ref)
        return grad_ref, grad_padded, None


def _first_columns(shifts: range) -> list[int]:
    """Column of the padded src under ref's column 0, at each shift."""
    return [max(shifts[-1], 0) - shift for shift in shifts]


def _unit_groups(features_BCHW: Tensor, groups: int) -> Tensor:
    """(B, G, K, H, W), each group of K channels of length 1; float32 at least."""
    batch, channels, height, width = features_BCHW.shape
    grouped = features_BCHW.reshape(batch, groups, channels // groups, height, width)
    precise = grouped if grouped.dtype == torch.float64 else grouped.float()
    return functional.normalize(precise, dim=2, eps=1e-4).contiguous()


def concatenate_views(ref_BCHW: Tensor, src_BCHW: Tensor, *, window: Window) -> Tensor:
    """Features of both views stacked at every plane: (B, C_ref + C_src, D, H, W)."""
    shifted = torch.stack(shifted_views(src_BCHW, window), dim=2)
    ref = ref_BCHW[:, :, None].expand(-1, -1, shifted.shape[2], -1, -1)
    return torch.cat((ref, shifted), dim=1)


def expect_disparity(logits_BDHW: Tensor, *, window: Window) -> Tensor:
    """Expectation over all planes (soft argmin; Kendall et al., 2017): (B, H, W) float32, full-size px."""
    planes = plane_disparities_px(window, device=logits_BDHW.device)
    # No einsum: autocast computes it in bf16, which knows 100 px to half a pixel.
    return (logits_BDHW.float().softmax(dim=1) * planes[:, None, None]).sum(dim=1)


def expect_full_size(logits_BDHW: Tensor, *, window: Window) -> Tensor:
    """Enlarge linearly to one level a pixel, softmax, expectation over all levels (PSMNet, section 3.5).

    Enlarged levels lie at half-pixel centres, so level j stands for ``d_min + j - (step - 1) / 2``. Products with
    matrices of weights take a third of the time of torch's trilinear interpolation and its gradient on a processor.

    Args:
        logits_BDHW: (B, D, h, w).
        window: disparities ``[d_min, d_max)``, full-size px.

    Returns:
        (B, h step, w step) of the logits' dtype, full-size px.
    """
    planes, height, width = logits_BDHW.shape[1:]
    # Autocast would multiply in bf16, which knows 100 px to half a pixel.
    with torch.autocast(logits_BDHW.device.type, enabled=False):
        by_plane, by_row, by_column = (_enlarging(n, like=logits_BDHW) for n in (planes, height, width))
        wide = by_row @ (logits_BDHW @ by_column.T)
        full = wide.flatten(2).transpose(1, 2) @ by_plane.T
        levels_px = torch.arange(full.shape[-1], dtype=full.dtype, device=full.device)
        expected = full.softmax(dim=-1) @ (window[0] + levels_px - (VOLUME_STEP_PX - 1) / 2)
        return expected.reshape(-1, *wide.shape[2:])


def _enlarging(n: int, *, like: Tensor) -> Tensor:
    """(n step, n) weights of linear interpolation between half-pixel centres."""
    unit = torch.eye(n, dtype=like.dtype, device=like.device)[None]
    by_point: Tensor = functional.interpolate(unit, scale_factor=VOLUME_STEP_PX, mode="linear", align_corners=False)
    return by_point[0].T


def expect_disparity_at_mode(logits_BDHW: Tensor, *, window: Window, reach: int = 2) -> Tensor:
    """Expectation over the planes around the likeliest one, so that no value lies between two surfaces.

    Args:
        logits_BDHW: (B, D, H, W).
        window: disparities ``[d_min, d_max)``, full-size px.
        reach: planes on each side of the mode that take part.

    Returns:
        (B, H, W) float32, full-size px.
    """
    logits = logits_BDHW.float()
    planes = torch.arange(logits.shape[1], device=logits.device)[None, :, None, None]
    mode = logits.detach().argmax(dim=1, keepdim=True)
    near_mode = (planes - mode).abs() <= reach
    return expect_disparity(logits.masked_fill(~near_mode, -torch.inf), window=window)


def peak_share(logits_BDHW: Tensor, *, reach: int = 1) -> Tensor:
    """Share of the probability within ``reach`` planes of the likeliest one: (B, H, W) in [0, 1]."""
    planes = logits_BDHW.shape[1]
    probability = functional.pad(logits_BDHW.float().softmax(dim=1), (0, 0, 0, 0, reach, reach))
    # Slices, and not a pooling along the planes: that would lay the volume out anew.
    near = probability[:, :planes]
    for shift in range(1, 2 * reach + 1):
        near = near + probability[:, shift : shift + planes]
    return near.amax(dim=1).clamp(max=1)


def shear_to_src(logits_BDHW: Tensor, *, window: Window) -> Tensor:
    """The volume as seen from src: ``sheared(x_src, d) = volume(x_src + d, d)``, very unlikely outside.

    It gives the source view's disparity, and so the left-right check, without a second pass of the network.
    """
    width = logits_BDHW.shape[-1]
    shifts = _shifts(window)
    pad_left, pad_right = max(-shifts[0], 0), max(shifts[-1], 0)
    padded = functional.pad(logits_BDHW.float(), (pad_left, pad_right), value=-1e4)
    return torch.stack(
        [padded[:, k, :, pad_left + s : pad_left + s + width] for k, s in enumerate(shifts)],
        dim=1,
    )
