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


def auto_encoder_terms(
    space: nn.Module,
    ref_BCHW: Tensor,
    src_BCHW: Tensor,
    *,
    disparity_px_BHW: Tensor,
    valid: tuple[Tensor, Tensor] | None = None,
) -> NamedTerms:
    """Rebuild both views, with features that lead somewhere.

    Args:
        space: an :class:`AutoEncoder`.
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        disparity_px_BHW: not looked at.
        valid: (B, H, W) bool each, where ref and src were photographed; other pixels do not count. None for all.

    Raises:
        TypeError: for another module.
    """
    if not isinstance(space, AutoEncoder):
        raise TypeError("the losses of an auto-encoder need one")
    image = torch.cat((ref_BCHW, src_BCHW))
    if not len(image):  # this process has no real crop of the joint batch
        nothing = Term(disparity_px_BHW.sum(), disparity_px_BHW.sum())
        n_slopes = 2 * len(ENCODER_WIDTHS)
        names = ["rebuilt"] * 2 * SCALES + ["discriminative"] * n_slopes + ["convergent"] * n_slopes
        return [(name, nothing) for name in names]
    mask = torch.ones_like(image[:, 0], dtype=torch.bool) if valid is None else torch.cat(valid)
    maps = space(image)
    terms: NamedTerms = []
    for picture in space.decode(maps[-1]):
        parts = _reconstruction(picture, _resized(image, picture), mask_BHW=_within_cells(mask, picture))
        terms += [("rebuilt", _weighed(1 / SCALES, part)) for part in parts]
    for order, name, weight in ((1, "discriminative", -DISCRIMINATIVE), (2, "convergent", CONVERGENT)):
        for level, features in enumerate(maps):
            share = weight * 2.0**-level / len(maps)
            steps = differences(
                features, _resized(image, features), order=order, mask_BHW=_within_cells(mask, features)
            )
            terms += [(name, _weighed(share, step)) for step in steps]
    return terms


def _weighed(weight: float, term: Term) -> Term:
    return Term(weight * term.total, term.count)


def _reconstruction(picture: Tensor, target: Tensor, *, mask_BHW: Tensor) -> tuple[Term, Term]:
    """``0.85 (1 - SSIM) / 2``, and ``0.15 sqrt(e^2 + 1e-6)``: means over channels, sums over the pixels of a mask."""
    picture = at_least_float32(picture)
    robust = ((picture - target).square() + ROOT_FLOOR).sqrt().mean(dim=1)
    unlike = (1 - ssim(picture, target)).mean(dim=1) / 2
    windows = _windows_within(mask_BHW)
    return _masked(SSIM_SHARE * unlike, windows), _masked((1 - SSIM_SHARE) * robust, mask_BHW)


def differences(
    features_BCHW: Tensor, image_BCHW: Tensor, *, order: int, mask_BHW: Tensor | None = None
) -> tuple[Term, Term]:
    """First or second differences of features along x and along y, each less where those of the picture are large.

    ``|dF| exp(-|dI|)`` and ``|ddF| exp(-|ddI|)``, means over the channels (FeatDepth, eq. 5 and 6).

    Args:
        features_BCHW: (B, C, H, W).
        image_BCHW: (B, 3, H, W) of the same size; differences are means over its channels.
        order: 1 or 2.
        mask_BHW: (B, H, W) bool, the pixels between which differences count; None for all.
    """
    features, image = at_least_float32(features_BCHW), at_least_float32(image_BCHW)
    mask = torch.ones_like(image[:, 0], dtype=torch.bool) if mask_BHW is None else mask_BHW
    along_x, along_y = (
        _masked(
            torch.diff(features, n=order, dim=axis).abs().mean(dim=1)
            * torch.exp(-torch.diff(image, n=order, dim=axis).abs().mean(dim=1)),
            mask.unfold(axis, order + 1, 1).all(dim=-1) if mask.shape[axis] > order else mask.narrow(axis, 0, 0),
        )
        for axis in (-1, -2)
    )
    return along_x, along_y


def _masked(difference_BHW: Tensor, mask_BHW: Tensor) -> Term:
    return Term((difference_BHW * mask_BHW).sum(), mask_BHW.sum().to(difference_BHW.dtype))


def _within_cells(mask_BHW: Tensor, like: Tensor) -> Tensor:
    """(B, h, w) bool, the cells of a smaller map all of whose pixels are in the mask."""
    outside = functional.adaptive_max_pool2d((~mask_BHW)[:, None].float(), like.shape[-2:])
    return outside[:, 0] == 0


def _windows_within(mask_BHW: Tensor) -> Tensor:
    """(B, H - 2, W - 2) bool, the windows of 3x3 pixels that are wholly in the mask."""
    outside = functional.max_pool2d((~mask_BHW)[:, None].float(), 3, stride=1)
    return outside[:, 0] == 0


def _resized(image: Tensor, like: Tensor) -> Tensor:
    if image.shape[-2:] == like.shape[-2:]:
        return image
    return functional.interpolate(image, size=like.shape[-2:], mode="area")
