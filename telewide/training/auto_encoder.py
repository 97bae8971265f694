"""The auto-encoder feature space of FeatDepth (Shu et al., 2020), narrowed, with both of its regularisers.

An encoder that halves five times, a decoder from its deepest level alone. The first regulariser asks features for
slopes, so that neighbours differ; the second for slopes that do not change, so that a descent along them ends.
Letters: B batch, C channels, H W crop.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.matching.sampling import at_least_float32
from telewide.training.losses import NamedTerms, Term, ssim

ENCODER_WIDTHS = (64, 64, 96, 128, 160)
"""At 1/2, 1/4, ... 1/32; the first is the space."""
DECODER_WIDTHS = (128, 96, 64, 32, 16)
SCALES = 4
"""The picture is rebuilt at 1/1, 1/2, 1/4 and 1/8."""
SSIM_SHARE = 0.85
ROOT_FLOOR = 1e-6
DISCRIMINATIVE, CONVERGENT = 1e-3, 1e-3


def _halving(c_in: int, c_out: int, *, kernel: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(c_in, c_out, kernel, stride=2, padding=kernel // 2), nn.ELU(), nn.Conv2d(c_out, c_out, 3, padding=1)
    )


def _reflecting(c_in: int, c_out: int) -> nn.Conv2d:
    return nn.Conv2d(c_in, c_out, 3, padding=1, padding_mode="reflect")


class AutoEncoder(nn.Module):
    """A view in [0, 1] to maps at 1/2, 1/4, ... 1/32; sides are multiples of 64."""

    def __init__(self) -> None:
        super().__init__()
        widths = (3, *ENCODER_WIDTHS)
        self.encoder = nn.ModuleList(
            _halving(c_in, c_out, kernel=7 if c_in == 3 else 3)
            for c_in, c_out in zip(widths, ENCODER_WIDTHS, strict=False)
        )
        self.decoder = nn.ModuleList(
            nn.ModuleList((_reflecting(c_in, c_out), _reflecting(c_out, c_out)))
            for c_in, c_out in zip((ENCODER_WIDTHS[-1], *DECODER_WIDTHS), DECODER_WIDTHS, strict=False)
        )
        self.pictures = nn.ModuleList(_reflecting(width, 3) for width in DECODER_WIDTHS[-SCALES:])

    def prepare(self, image_BCHW: Tensor) -> Tensor:
        """Views are seen as they are."""
        return image_BCHW

    def forward(self, image_BCHW: Tensor) -> tuple[Tensor, ...]:
        """(B, 3, H, W) to (B, 64, H/2, W/2) and four smaller maps."""
        maps = [image_BCHW]
        for level in self.encoder:
            maps.append(functional.elu(level(maps[-1])))
        return tuple(maps[1:])

    def decode(self, deepest_BCHW: Tensor) -> list[Tensor]:
        """The deepest map to pictures (B, 3, H, W), small to large."""
        x, pictures = deepest_BCHW, []
        for index, level in enumerate(self.decoder):
            before, after = level.children()
            x = functional.interpolate(functional.elu(before(x)), scale_factor=2, mode="nearest")
            x = functional.elu(after(x))
            scale = index - (len(self.decoder) - SCALES)
            if scale >= 0:
                pictures.append(self.pictures[scale](x).sigmoid())
        return pictures


def auto_encoder_terms(space: nn.Module, ref_BCHW: Tensor, src_BCHW: Tensor, *, disparity_px_BHW: Tensor) -> NamedTerms:
    """Rebuild both views, with features that lead somewhere.

    Args:
        space: an :class:`AutoEncoder`.
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        disparity_px_BHW: not looked at.

    Raises:
        TypeError: for another module.
    """
    if not isinstance(space, AutoEncoder):
        raise TypeError("the losses of an auto-encoder need one")
    image = torch.cat((ref_BCHW, src_BCHW))
    if not len(image):  # this process has no real crop of the joint batch
        nothing = disparity_px_BHW.sum()
        return [(name, Term(nothing, nothing)) for name in ("rebuilt", "discriminative", "convergent")]
    maps = space(image)
    count = torch.tensor(float(len(image)), device=image.device)
    rebuilt = torch.stack([_reconstruction(picture, image) for picture in space.decode(maps[-1])]).mean()
    slopes, bends = zip(*(slope_and_bend(level, _resized(image, level)) for level in maps), strict=True)
    levels = len(maps)
    slope = sum((s * 2.0**-i / levels for i, s in enumerate(slopes)), start=rebuilt.new_zeros(()))
    bend = sum((b * 2.0**-i / levels for i, b in enumerate(bends)), start=rebuilt.new_zeros(()))
    return [
        ("rebuilt", Term(count * rebuilt, count)),
        ("discriminative", Term(-DISCRIMINATIVE * count * slope, count)),
        ("convergent", Term(CONVERGENT * count * bend, count)),
    ]


def _reconstruction(picture: Tensor, image: Tensor) -> Tensor:
    """``0.85 (1 - SSIM) / 2 + 0.15 sqrt(e^2 + 1e-6)``, mean over all."""
    picture = at_least_float32(picture)
    target = _resized(image, picture)
    robust = ((picture - target).square() + ROOT_FLOOR).sqrt().mean()
    if min(picture.shape[-2:]) < 3:  # no whole window
        return robust
    return SSIM_SHARE * (1 - ssim(picture, target)).mean() / 2 + (1 - SSIM_SHARE) * robust


def slope_and_bend(features_BCHW: Tensor, image_BCHW: Tensor) -> tuple[Tensor, Tensor]:
    """Mean first and second differences of features, each less where those of the picture are large.

    ``|dF| exp(-|dI|)`` and ``|ddF| exp(-|ddI|)``, along x plus along y (FeatDepth, eq. 5 and 6).

    Args:
        features_BCHW: (B, C, H, W).
        image_BCHW: (B, 3, H, W) of the same size; differences are means over its channels.
    """
    features, image = at_least_float32(features_BCHW), at_least_float32(image_BCHW)
    sums = []
    for order in (1, 2):
        parts = []
        for axis in (-1, -2):
            of_features, of_image = torch.diff(features, n=order, dim=axis), torch.diff(image, n=order, dim=axis)
            weight = torch.exp(-of_image.abs().mean(dim=1, keepdim=True))
            parts.append((of_features.abs() * weight).mean() if weight.numel() else features.new_zeros(()))
        sums.append(parts[0] + parts[1])
    return sums[0], sums[1]


def _resized(image: Tensor, like: Tensor) -> Tensor:
    if image.shape[-2:] == like.shape[-2:]:
        return image
    return functional.interpolate(image, size=like.shape[-2:], mode="area")
