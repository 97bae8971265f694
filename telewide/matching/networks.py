"""The networks by name. A new one is a file with its Phi_F and Phi_M, and a line in ``NETWORKS``.

A network is a :class:`StereoNetwork`: a feature extractor and a matching module that can be used apart, since the
feature-metric loss needs the first alone. Letters: B batch, C channels, D planes, H W image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from telewide.errors import UsageError
from telewide.matching.guided import Coarser, GuidedFeatures, GuidedMatching
from telewide.matching.iresnet import IresnetFeatures, IresnetMatching, initialise_iresnet
from telewide.matching.lite import LiteFeatures, LiteMatching
from telewide.matching.psmnet import PsmnetFeatures, PsmnetMatching, initialise_psmnet
from telewide.matching.psmnet_full import (
    PsmnetFullFeatures,
    PsmnetFullMatching,
    PublishedPsmnetFeatures,
    load_published_psmnet,
)
from telewide.matching.window import VOLUME_STEP_PX, Window, scaled_window

SIZE_MULTIPLE_PX = 16
"""Both sides of a network's input are multiples of this; inference pads."""
SCALES = 3
"""In which a network that can matches: full size, half and a quarter."""
CELLS_PX = 64
"""Tiles begin at multiples of this: psmnet-s pools over cells of this size."""
PSMNET_CELLS_PX = 256
"""The largest that psmnet pools over."""
WIDEST_CONTEXT_PX = 320
"""Of psmnet-s, whose convolutions, hourglass and pools over cells of 64 px reach 306 px: rounded up to the cells."""
PSMNET_CONTEXT_PX = 768
"""Of psmnet: 46 convolutions at 1/4, cells of 256 px and three hourglasses."""
IRESNET_CONTEXT_PX = 512
"""Of both: seven levels of convolutions, the deepest of them over cells of 64 px, and their correlation."""
COMPACT_DIVISOR = 8
"""Widths of iresnet over those of iresnet-s, which is then as large as psmnet-s."""
COMPACT_UNIT_PX = 20.0
"""Of the disparities that layers of iresnet-s compute."""
LITE_CONTEXT_PX = 128
"""Trained on phones' photos: at this overlap no pixel differs by 0.01 px from the whole image, at 64 px one in 700."""


@dataclass(frozen=True)
class NetworkOutput:
    """Output of a network for ref.

    Attributes:
        disparities_px: (B, H, W) each, coarse to fine; the last is the result.
        logits_BDHW: (B, D, H/4, W/4) regularised volume, from which confidence and the left-right check are read.
        heads_BCHW: (B, 2, H, W) logits, where a network has them: that the error is below 1 px, that the pixel is
            hidden from src.
    """

    disparities_px: list[Tensor]
    logits_BDHW: Tensor
    heads_BCHW: Tensor | None = None

    @property
    def disparity_px(self) -> Tensor:
        """(B, H, W) the result."""
        return self.disparities_px[-1]


class StereoNetwork(nn.Module):
    """Phi = (Phi_F, Phi_M), over views already passed through :func:`standardise`.

    Args:
        features: a view (B, 3, H, W) to a tuple of maps, the first of them the matching features at 1/4.
        matching: ``(ref, src, window)`` to ``(disparities, logits)``.
        context_px: how far around a pixel its result depends on the views, beyond the disparities' reach; tiles overlap
            by so much.
        cells_px: side of the largest cells that the features are means over; tiles begin at multiples of it.
    """

    def __init__(
        self,
        features: nn.Module,
        matching: nn.Module,
        *,
        context_px: int = WIDEST_CONTEXT_PX,
        cells_px: int = CELLS_PX,
    ) -> None:
        super().__init__()
        self.features = features
        self.matching = matching
        self.context_px = context_px
        self.cells_px = cells_px

    @property
    def has_confidence(self) -> bool:
        """Whether it has learned how likely its error is below 1 px."""
        return isinstance(self.matching, GuidedMatching)

    def forward(
        self, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window, *, coarser: Coarser | None = None
    ) -> NetworkOutput:
        """Match two standardised views (B, 3, H, W) whose sides are multiples of ``SIZE_MULTIPLE_PX``."""
        # One pass over both views: half the launches, and batch statistics over both.
        maps = self.features(torch.cat((ref_BCHW, src_BCHW)).contiguous(memory_format=torch.channels_last))
        batch = ref_BCHW.shape[0]
        ref = tuple(m[:batch] for m in maps)
        src = tuple(m[batch:] for m in maps)
        aid = {} if coarser is None else {"coarser": coarser}
        disparities_px, logits, *heads = self.matching(ref, src, window, **aid)
        return NetworkOutput(disparities_px, logits, heads[0] if heads else None)

    def match_in_scales(
        self, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window, *, scales: int = SCALES
    ) -> NetworkOutput:
        """Match two standardised views, first at a smaller size, where what is plain is seen as a whole.

        Networks that cannot take up another match do it at once.

        Args:
            ref_BCHW: (B, 3, H, W), whose sides are multiples of ``SIZE_MULTIPLE_PX`` times 2 for each further scale.
            src_BCHW: likewise.
            window: disparities ``[d_min, d_max)``, px.
            scales: how many, each half as large as the one before.
        """
        if scales == 1 or not self.has_confidence:
            return cast(NetworkOutput, self(ref_BCHW, src_BCHW, window))
        ref_half, src_half = (functional.avg_pool2d(view, 2) for view in (ref_BCHW, src_BCHW))
        half = self.match_in_scales(ref_half, src_half, scaled_window(window, 0.5), scales=scales - 1)
        heads = cast(Tensor, half.heads_BCHW)
        maps = 2 * half.disparity_px.float(), heads[:, 0].sigmoid()
        on_cells = (functional.avg_pool2d(map_[:, None], VOLUME_STEP_PX // 2)[:, 0] for map_ in maps)
        return cast(NetworkOutput, self(ref_BCHW, src_BCHW, window, coarser=Coarser(*on_cells)))


def standardise(image_BCHW: Tensor) -> Tensor:
    """Shift and scale each channel of each image to mean 0 and deviation 1.

    Exposure and white balance differ between two lenses; this takes both out, as far as a gain and an offset can.
    """
    centred = image_BCHW - image_BCHW.mean(dim=(-2, -1), keepdim=True)
    # Not Tensor.std: it takes ten times as long.
    deviation = centred.square().mean(dim=(-2, -1), keepdim=True).sqrt()
    return centred / (deviation + 0.02)


def prepare_view(features: nn.Module, image_BCHW: Tensor) -> Tensor:
    """Bring a view (B, 3, H, W) in [0, 1] to what a Phi_F expects: its own ``prepare``, or :func:`standardise`."""
    prepare = cast(Callable[[Tensor], Tensor], getattr(features, "prepare", standardise))
    return prepare(image_BCHW)


def comparable_map(features: nn.Module, prepared_BCHW: Tensor) -> Tensor:
    """The map of a Phi_F in which two prepared views (B, 3, H, W) are compared: (B, C, h, w).

    It is the first, unless the module names another by its ``feature_space``.
    """
    maps: tuple[Tensor, ...] = features(prepared_BCHW)
    return maps[cast(int, getattr(features, "feature_space", 0))]


def _build_lite() -> StereoNetwork:
    return StereoNetwork(LiteFeatures(), LiteMatching(), context_px=LITE_CONTEXT_PX)


def _build_psmnet_s() -> StereoNetwork:
    network = StereoNetwork(PsmnetFeatures(), PsmnetMatching())
    initialise_psmnet(network)
    return network


def _build_psmnet() -> StereoNetwork:
    parts = PsmnetFullFeatures(), PsmnetFullMatching()
    network = StereoNetwork(*parts, context_px=PSMNET_CONTEXT_PX, cells_px=PSMNET_CELLS_PX)
    initialise_psmnet(network)
    return network


def _build_iresnet(divisor: int, *, unit_px: float = 1.0) -> StereoNetwork:
    parts = IresnetFeatures(divisor=divisor), IresnetMatching(divisor=divisor, unit_px=unit_px)
    network = StereoNetwork(*parts, context_px=IRESNET_CONTEXT_PX)
    initialise_iresnet(network)
    return network


def published_psmnet(path: Path) -> StereoNetwork:
    """PSMNet with the weights of a checkpoint of its authors, prepared, enlarged and read as they did.

    Args:
        path: their ``.tar``, or the same tensors as safetensors.

    Raises:
        UsageError: there is no such file.
        InputError: it is corrupt, or holds something else.
    """
    features, matching = PublishedPsmnetFeatures(), PsmnetFullMatching(is_published=True)
    load_published_psmnet(features, matching, path)
    return StereoNetwork(features, matching, context_px=PSMNET_CONTEXT_PX).eval()


NETWORKS: dict[str, Callable[[], StereoNetwork]] = {
    "guided": lambda: StereoNetwork(GuidedFeatures(), GuidedMatching()),
    "iresnet": lambda: _build_iresnet(1),
    "iresnet-s": lambda: _build_iresnet(COMPACT_DIVISOR, unit_px=COMPACT_UNIT_PX),
    "lite": _build_lite,
    "psmnet": _build_psmnet,
    "psmnet-s": _build_psmnet_s,
}


def build_network(name: str, *, seed: int = 0) -> StereoNetwork:
    """Build a network by name with weights drawn from ``seed``, in the memory order that is fast.

    Raises:
        UsageError: unknown name.
    """
    if name not in NETWORKS:
        raise UsageError(f"unknown network {name!r}", hint=f"known networks: {', '.join(NETWORKS)}")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = NETWORKS[name]()
    for layer in network.modules():
        if isinstance(layer, nn.Conv3d | nn.ConvTranspose3d):
            layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last_3d)
        elif isinstance(layer, nn.Conv2d):
            layer.weight.data = layer.weight.data.contiguous(memory_format=torch.channels_last)
    return network
