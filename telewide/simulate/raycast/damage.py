"""Damage by a second, worse camera to a view, in torch: moved, blurred, shrunken, noisy, compressed, tinted, enlarged.

On the device of the view. Moves, blur, shrinking and noise are those of `telewide.simulate.degrade`; the rest is not:

- corners darken after shrinking, in sRGB values and by the square of the distance from the middle; there before it, in
  linear light and by cos^4;
- gamma and gain come before JPEG; there after it, and channels may be mixed;
- rows may also move by the column, as a small turn moves them; there by the row alone.

The weights that come with the program were trained so. Letters: B views, H W view, h w as the worse camera saw it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

JPEG_BLOCK = 8
LEAST_BLUR = 0.2
"""Sigma, px, below which nothing is blurred."""


@dataclass(frozen=True)
class Damage:
    """One damage of a view.

    Attributes:
        factor: how many times fewer pixels along each axis, >= 1.
        blur_sigma_px: along the major and the minor axis, px before shrinking.
        blur_angle_rad: direction of the major axis.
        noise_std: white noise of the shrunken view.
        jpeg_quality: 1 to 100; None for no compression.
        gain: (R, G, B) factors.
        gamma: exponent.
        vignetting: share of their sRGB values that the corners lose.
        vertical_px: the content moves down by so many px,
        vertical_slope: by so many more per px below the centre,
        turn_rad: and by so many more per px to the right of it; columns stay.
    """

    factor: float = 1.0
    blur_sigma_px: tuple[float, float] = (0.0, 0.0)
    blur_angle_rad: float = 0.0
    noise_std: float = 0.0
    jpeg_quality: int | None = None
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    vignetting: float = 0.0
    vertical_px: float = 0.0
    vertical_slope: float = 0.0
    turn_rad: float = 0.0


def draw_damage(rng: np.random.Generator, *, factors: tuple[float, float], equal_share: float) -> Damage:
    """Draw what wide lenses do; now and then only colour differs, as between equal cameras.

    Args:
        rng: source of all draws.
        factors: smallest and largest loss of resolution.
        equal_share: share of the draws with equal cameras.
    """
    gain = np.exp(rng.normal(0, 0.22) + rng.normal(0, 0.1, 3))
    colour = {"gain": tuple(float(g) for g in gain), "gamma": math.exp(rng.normal(0, 0.15))}
    if rng.random() < 0.25:
        colour = {}
    if rng.random() < equal_share:
        return Damage(noise_std=rng.uniform(0, 0.01), **colour)  # type: ignore[arg-type]
    factor = math.exp(rng.uniform(math.log(factors[0]), math.log(factors[1])))
    major = factor * rng.uniform(0, 0.6)
    moves = rng.random() < 0.6
    return Damage(
        factor=factor,
        blur_sigma_px=(major, major * rng.uniform(0.4, 1.0)),
        blur_angle_rad=rng.uniform(0, math.pi),
        noise_std=rng.uniform(0, 0.025) * (rng.random() < 0.7),
        jpeg_quality=int(rng.integers(35, 97)) if rng.random() < 0.35 else None,
        vignetting=rng.uniform(0, 0.5) * (rng.random() < 0.4),
        vertical_px=moves * (rng.normal(0, 0.35) if rng.random() < 0.8 else rng.uniform(-2, 2)),
        vertical_slope=moves * rng.normal(0, 0.0015),
        turn_rad=moves * rng.normal(0, 0.0007),
        **colour,  # type: ignore[arg-type]
    )


def damage_view(view_CHW: Tensor, damage: Damage, *, generator: torch.Generator) -> Tensor:
    """Damage a view and enlarge it back to its own size.

    Args:
        view_CHW: (3, H, W) float32, sRGB in [0, 1].
        damage: what happens to it.
        generator: source of the noise, on the view's device.

    Returns:
        (3, H, W) float32, sRGB in [0, 1].
    """
    return damage_views([view_CHW], [damage], generators=[generator])[0]


def damage_views(
    views_CHW: Sequence[Tensor], damages: Sequence[Damage], *, generators: Sequence[torch.Generator]
) -> list[Tensor]:
    """Damage views of one size, many in each call, and enlarge them back to it.

    Args:
        views_CHW: (3, H, W) float32 each, sRGB in [0, 1].
        damages: what happens to each.
        generators: source of the noise of each, on the views' device; views that share one draw from it in turn.

    Returns:
        (3, H, W) float32 each, sRGB in [0, 1], to rounding what each would be alone.
    """
    x, hw = [*views_CHW], (views_CHW[0].shape[-2], views_CHW[0].shape[-1])
    _change(x, damages, _move, chosen=[k for k, damage in enumerate(damages) if _is_moved(damage)])
    _change(x, damages, _blur, chosen=[k for k, damage in enumerate(damages) if damage.blur_sigma_px[0] >= LEAST_BLUR])
    seen_hw = [_seen_hw(damage, hw) for damage in damages]
    noise = [
        damage.noise_std * torch.randn((3, *size), generator=generator, device=generator.device)
        if damage.noise_std
        else x[0].new_zeros((3, *size))
        for damage, size, generator in zip(damages, seen_hw, generators, strict=True)
    ]
    for size in dict.fromkeys(seen_hw):
        chosen = [k for k, seen in enumerate(seen_hw) if seen == size]
        noise_BChw = torch.stack([noise[k] for k in chosen])
        _change(x, damages, partial(_photographed, noise_BChw=noise_BChw), chosen=chosen)
    return x


def _change(
    x: list[Tensor], damages: Sequence[Damage], change: Callable[..., Tensor], *, chosen: Sequence[int]
) -> None:
    """Change the chosen ones of some views, in place, all in one call."""
    if chosen:
        changed = change(torch.stack([x[k] for k in chosen]), [damages[k] for k in chosen])
        for k, view in zip(chosen, changed, strict=True):
            x[k] = view


def _seen_hw(damage: Damage, hw: tuple[int, int]) -> tuple[int, int]:
    """Size of a view as the worse camera sees it."""
    if damage.factor <= 1:
        return hw
    return max(8, round(hw[0] / damage.factor)), max(8, round(hw[1] / damage.factor))


def _photographed(x_BCHW: Tensor, damages: Sequence[Damage], *, noise_BChw: Tensor) -> Tensor:
    """Shrink views to the size of their noise, and lose what the worse camera loses."""

    def each(values: Sequence[float | tuple[float, ...]]) -> Tensor:
        return torch.tensor(values, device=x_BCHW.device).reshape(len(values), -1, 1, 1)

    x = _resize(x_BCHW, (noise_BChw.shape[-2], noise_BChw.shape[-1]))
    if any(damage.vignetting for damage in damages):
        x = x * _falloff(x, each([damage.vignetting for damage in damages]))
    x = (x + noise_BChw).clamp(0, 1)
    # A tensor of exponents would round otherwise than one exponent at a time.
    x = torch.cat([view**damage.gamma for view, damage in zip(x.split(1), damages, strict=True)])
    x = (x * each([damage.gain for damage in damages])).clamp(0, 1)
    qualities = [damage.jpeg_quality for damage in damages]
    if any(quality is not None for quality in qualities):
        views = zip(x.split(1), qualities, strict=True)
        x = torch.cat([view if quality is None else compress_jpeg(view, quality=quality) for view, quality in views])
    return _resize(x, (x_BCHW.shape[-2], x_BCHW.shape[-1])).clamp(0, 1)


def _resize(x_BCHW: Tensor, hw: tuple[int, int]) -> Tensor:
    if tuple(x_BCHW.shape[-2:]) == hw:
        return x_BCHW
    return functional.interpolate(x_BCHW, size=hw, mode="bicubic", align_corners=False, antialias=True)


def _is_moved(damage: Damage) -> bool:
    return bool(damage.vertical_px or damage.vertical_slope or damage.turn_rad)


def _move(x_BCHW: Tensor, damages: Sequence[Damage]) -> Tensor:
    height, width = x_BCHW.shape[-2:]
    y = torch.arange(height, device=x_BCHW.device, dtype=torch.float32)[:, None] - (height - 1) / 2
    x = torch.arange(width, device=x_BCHW.device, dtype=torch.float32)[None, :] - (width - 1) / 2
    moves = [(damage.vertical_px, damage.vertical_slope, damage.turn_rad) for damage in damages]
    down, slope, turn = torch.tensor(moves, device=x_BCHW.device).T[..., None, None]
    # A small turn moves rows by the column; what it does along x is disparity, which the truth would have to follow.
    y_from = y - down - slope * y - turn * x
    grid_y = 2 * y_from / height
    grid = torch.stack(((2 * x / width).expand_as(grid_y), grid_y), dim=-1)
    return functional.grid_sample(x_BCHW, grid, mode="bicubic", padding_mode="reflection", align_corners=False)


def _blur(x_BCHW: Tensor, damages: Sequence[Damage]) -> Tensor:
    batch, channels, height, width = x_BCHW.shape
    kernels = [_kernel(damage) for damage in damages]
    reach = max(len(kernel) for kernel in kernels) // 2
    wide = torch.stack([functional.pad(kernel, (reach - len(kernel) // 2,) * 4) for kernel in kernels])
    weight = wide.repeat_interleave(channels, dim=0)[:, None].to(x_BCHW.device)
    reach = min(reach, min(height, width) - 1)
    padded = functional.pad(x_BCHW, (reach,) * 4, mode="reflect")
    # Each channel of each view is a group of its own.
    blurred = functional.conv2d(padded.flatten(0, 1)[None], weight, groups=batch * channels)
    return blurred.reshape(batch, channels, *blurred.shape[-2:])


def _kernel(damage: Damage) -> Tensor:
    """(k, k) weights of a blur, on the processor."""
    major, minor = damage.blur_sigma_px
    reach = math.ceil(2.6 * major)
    axis = torch.arange(-reach, reach + 1, dtype=torch.float32)
    cos, sin = math.cos(damage.blur_angle_rad), math.sin(damage.blur_angle_rad)
    along, across = cos * axis[None, :] + sin * axis[:, None], cos * axis[:, None] - sin * axis[None, :]
    kernel = torch.exp(-0.5 * ((along / major) ** 2 + (across / max(minor, LEAST_BLUR)) ** 2))
    return kernel / kernel.sum()


def _falloff(x_BCHW: Tensor, loss_B111: Tensor) -> Tensor:
    height, width = x_BCHW.shape[-2:]
    y = torch.linspace(-1, 1, height, device=x_BCHW.device)[:, None]
    x = torch.linspace(-1, 1, width, device=x_BCHW.device)[None, :]
    return 1 - loss_B111 * (x * x + y * y) / 2


def compress_jpeg(x_BCHW: Tensor, *, quality: int) -> Tensor:
    """Lose what baseline JPEG loses at a quality: rounded DCT coefficients, colour at half size (ITU-T T.81, annex K).

    Args:
        x_BCHW: (B, 3, H, W) sRGB in [0, 1].
        quality: 1 to 100, scaled as the Independent JPEG Group does.
    """
    height, width = x_BCHW.shape[-2:]
    padded = functional.pad(x_BCHW, (0, -width % 16, 0, -height % 16), mode="replicate") * 255
    r, g, b = padded.unbind(dim=1)
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    chroma = torch.stack((0.564 * (b - luma), 0.713 * (r - luma)), dim=1)
    scale = (5000 / quality if quality < 50 else 200 - 2 * quality) / 100
    luma = _round_blocks(luma[:, None] - 128, _steps(_LUMA_STEPS, scale, x_BCHW)) + 128
    small = _round_blocks(functional.avg_pool2d(chroma, 2), _steps(_CHROMA_STEPS, scale, x_BCHW))
    blue, red = functional.interpolate(small, scale_factor=2, mode="bilinear", align_corners=False).unbind(dim=1)
    luma = luma[:, 0]
    rgb = torch.stack((luma + 1.403 * red, luma - 0.344 * blue - 0.714 * red, luma + 1.773 * blue), dim=1)
    return (rgb / 255).clamp(0, 1)[..., :height, :width]


def _steps(table: tuple[int, ...], scale: float, like: Tensor) -> Tensor:
    steps = torch.tensor(table, device=like.device, dtype=torch.float32).reshape(JPEG_BLOCK, JPEG_BLOCK)
    return (steps * scale).round().clamp(1, 255)


def _round_blocks(x_BCHW: Tensor, steps: Tensor) -> Tensor:
    batch, channels, height, width = x_BCHW.shape
    n = JPEG_BLOCK
    k = torch.arange(n, device=x_BCHW.device, dtype=torch.float32)
    basis = torch.cos(math.pi * (2 * k[None, :] + 1) * k[:, None] / (2 * n)) * math.sqrt(2 / n)
    basis[0] /= math.sqrt(2)
    blocks = x_BCHW.reshape(batch, channels, height // n, n, width // n, n).transpose(3, 4)
    coefficients = basis @ blocks @ basis.T
    rounded = (coefficients / steps).round() * steps
    return (basis.T @ rounded @ basis).transpose(3, 4).reshape(batch, channels, height, width)


# Quantisation steps of annex K, row by row.
_LUMA_STEPS = (
    *(16, 11, 10, 16, 24, 40, 51, 61),
    *(12, 12, 14, 19, 26, 58, 60, 55),
    *(14, 13, 16, 24, 40, 57, 69, 56),
    *(14, 17, 22, 29, 51, 87, 80, 62),
    *(18, 22, 37, 56, 68, 109, 103, 77),
    *(24, 35, 55, 64, 81, 104, 113, 92),
    *(49, 64, 78, 87, 103, 121, 120, 101),
    *(72, 92, 95, 98, 112, 100, 103, 99),
)
_CHROMA_STEPS = (
    *(17, 18, 24, 47, 99, 99, 99, 99),
    *(18, 21, 26, 66, 99, 99, 99, 99),
    *(24, 26, 56, 99, 99, 99, 99, 99),
    *(47, 66, 99, 99, 99, 99, 99, 99),
    *((99,) * 32),
)
