"""Feature spaces that are taught apart from the network, by name: what eq. 5 may compare in.

A space is a module like a Phi_F and a loss that teaches it; it is then frozen. A new one is a file with both, and a
line in ``SPACES``. Both of today are as wide as the compact network they serve, and both are compared in by eq. 5 like
the network's own features; their papers compare by L1 alone and warp features. Letters: B batch, C channels, H W crop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from telewide.matching.networks import StereoNetwork, prepare_view
from telewide.matching.window import Window
from telewide.training.auto_encoder import AutoEncoder, auto_encoder_terms
from telewide.training.contrastive import ContrastiveFeatures, contrastive_terms
from telewide.training.losses import NamedTerms
from telewide.training.objective import Batch, Reduce, add_up
from telewide.training.stages import Stage


class SpaceLoss(Protocol):
    """Named losses that teach a space on views (B, 3, H, W), with the disparity (B, H, W) of ref where it is needed.

    Masks (B, H, W) of both views say what was photographed; None where all was.
    """

    def __call__(
        self,
        space: nn.Module,
        ref_BCHW: Tensor,
        src_BCHW: Tensor,
        *,
        disparity_px_BHW: Tensor,
        valid: tuple[Tensor, Tensor] | None = None,
    ) -> NamedTerms:
        """Compare the views of one step."""
        ...


@dataclass(frozen=True)
class Space:
    """One feature space.

    Attributes:
        build: a fresh module.
        terms: what teaches it.
        needs_matches: whether the disparity is looked at.
    """

    build: Callable[[], nn.Module]
    terms: SpaceLoss
    needs_matches: bool


SPACES: dict[str, Space] = {
    "contrastive": Space(ContrastiveFeatures, contrastive_terms, needs_matches=True),
    "auto-encoder": Space(AutoEncoder, auto_encoder_terms, needs_matches=False),
}


def build_space(name: str, *, seed: int = 0) -> nn.Module:
    """A feature space with weights drawn from ``seed``."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return SPACES[name].build()


def space_objective(
    space: nn.Module, batch: Batch, stage: Stage, *, network: StereoNetwork, window: Window, global_sum: Reduce
) -> tuple[Tensor, dict[str, float]]:
    """Add up what teaches a feature space on a batch.

    What no photo shows has no say: it is painted over with the mean of the rest, since features look around, and
    no loss counts it.

    Args:
        space: the module that learns.
        batch: real crops.
        stage: names the space.
        network: finds the matches, where the space needs them; it learns nothing.
        window: disparities of the volume, px.
        global_sum: adds a tensor up over all processes; the identity for one.

    Returns:
        The scalar to differentiate, and the parts for the log.
    """
    ref, src = _photographed(batch, is_symmetric=stage.options.symmetric_loss)
    disparity_px = torch.zeros_like(batch.truth_px_BHW)
    if SPACES[stage.space].needs_matches and len(ref):
        shown = _photographed(batch, is_symmetric=stage.options.symmetric_input)
        with torch.no_grad():
            prepared = (prepare_view(network.features, view) for view in shown)
            disparity_px = network.eval()(*prepared, window).disparity_px
    terms = SPACES[stage.space].terms(space, ref, src, disparity_px_BHW=disparity_px, valid=batch.valid)
    return add_up([(name, 1.0, term) for name, term in terms], global_sum=global_sum)


def _photographed(batch: Batch, *, is_symmetric: bool) -> tuple[Tensor, Tensor]:
    """Both views (B, 3, H, W), the mean of what was photographed wherever nothing was."""
    ref, src = batch.views(is_symmetric=is_symmetric)
    if batch.valid is None:
        return ref, src
    return _painted_over(ref, batch.valid[0]), _painted_over(src, batch.valid[1])


def _painted_over(view_BCHW: Tensor, valid_BHW: Tensor) -> Tensor:
    valid = valid_BHW[:, None]
    mean = torch.where(valid, view_BCHW, 0.0).sum(dim=(-2, -1), keepdim=True) / valid.sum(
        dim=(-2, -1), keepdim=True
    ).clamp(min=1)
    return torch.where(valid, view_BCHW, mean)
