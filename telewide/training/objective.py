"""Objective of one step: the losses of a stage over one batch.

A batch holds rehearsed crops first, whose truth is exact and teaches, then real ones, compared by the stage's loss.
Letters: B batch, C channels, H W crop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from telewide.matching.networks import NetworkOutput
from telewide.matching.window import Window
from telewide.training.captured_losses import CAPTURED_LOSSES, Comparison
from telewide.training.losses import (
    Term,
    distribution_loss,
    smoothness_loss,
    state_loss,
    supervised_loss,
    visible_mask,
)
from telewide.training.stages import Stage

COARSE_WEIGHT = 0.4
"""Weight of each disparity before the last, as in networks with several outputs."""
COARSE_WEIGHT_OF_ALL = 0.8
"""Weight that they share at most."""
SURE_PX = 1.0
"""Error below which a network should be sure of a pixel."""
HEAD_WEIGHT = 0.15


@dataclass(frozen=True)
class Batch:
    """Crops of one step.

    Attributes:
        ref_BCHW: (B, 3, H, W) in [0, 1].
        src_BCHW: (B, 3, H, W) in [0, 1].
        truth_px_BHW: (B, H, W), NaN where unknown.
        n_rehearsed: how many of the first crops are rendered; the others are real.
        occluded_BHW: (n_rehearsed, H, W) bool, hidden from src; None where nobody knows.
        window: disparities to search in these crops, px; None for the training's.
        undamaged: both views as they were before any damage, (B, 3, H, W) in [0, 1]; None where nobody has them.
        valid: where ref and src were photographed, (B, H, W) bool each; None where all crops are whole.
    """

    ref_BCHW: Tensor
    src_BCHW: Tensor
    truth_px_BHW: Tensor
    n_rehearsed: int
    occluded_BHW: Tensor | None = None
    window: Window | None = None
    undamaged: tuple[Tensor, Tensor] | None = None
    valid: tuple[Tensor, Tensor] | None = None

    def views(self, *, is_symmetric: bool) -> tuple[Tensor, Tensor]:
        """Both views (B, 3, H, W), undamaged ones where symmetry is asked for.

        Raises:
            ValueError: nobody has them.
        """
        if not is_symmetric:
            return self.ref_BCHW, self.src_BCHW
        if self.undamaged is None:
            raise ValueError("undamaged views are asked for, and these crops have none")
        return self.undamaged

    def to(self, device: torch.device) -> Batch:
        """Move the tensors."""
        ref, src, truth_px = (t.to(device) for t in (self.ref_BCHW, self.src_BCHW, self.truth_px_BHW))
        occluded = None if self.occluded_BHW is None else self.occluded_BHW.to(device)
        undamaged, valid = (
            None if pair is None else (pair[0].to(device), pair[1].to(device)) for pair in (self.undamaged, self.valid)
        )
        return Batch(
            ref_BCHW=ref,
            src_BCHW=src,
            truth_px_BHW=truth_px,
            n_rehearsed=self.n_rehearsed,
            occluded_BHW=occluded,
            window=self.window,
            undamaged=undamaged,
            valid=valid,
        )


Reduce = Callable[[Tensor], Tensor]


def objective(
    output: NetworkOutput, batch: Batch, stage: Stage, *, window: Window, teacher: nn.Module | None, global_sum: Reduce
) -> tuple[Tensor, dict[str, float]]:
    """Add up the losses of a stage.

    Args:
        output: the network's, of this batch.
        batch: the crops.
        stage: which losses, with which weights.
        window: disparities of the volume, px.
        teacher: frozen extractor of the stage before, in eval mode, where the stage's loss is feature-metric.
        global_sum: adds a tensor up over all processes; the identity for one.

    Returns:
        The scalar to differentiate (this process' share of the sum), and the parts of all processes for the log.
    """
    weighted = _supervised_terms(output, batch, stage, window)
    if stage.options.captured:
        weighted += _captured_terms(output=output, batch=batch, stage=stage, window=window, teacher=teacher)
    return add_up(weighted, global_sum=global_sum)


Weighted = list[tuple[str, float, Term]]


def add_up(weighted: Weighted, *, global_sum: Reduce) -> tuple[Tensor, dict[str, float]]:
    """Weigh and add up losses, each a mean over all processes.

    Args:
        weighted: name, weight and this process' sum and count of each.
        global_sum: adds a tensor up over all processes; the identity for one.

    Returns:
        The scalar to differentiate (this process' share of the sum), and the parts of all processes for the log.
    """
    counts = global_sum(torch.stack([term.count.detach() for _, _, term in weighted])).clamp(min=1.0)
    shares = torch.stack([weight * term.total for _, weight, term in weighted]) / counts
    parts: dict[str, float] = {}
    for (name, _, _), value in zip(weighted, global_sum(shares.detach()).tolist(), strict=True):
        parts[name] = parts.get(name, 0.0) + value
    return shares.sum(), parts


def _supervised_terms(output: NetworkOutput, batch: Batch, stage: Stage, window: Window) -> Weighted:
    # Decided by the stage and not by the batch: every process has the same terms, some of them without crops.
    if not stage.options.exact:
        return []
    part = slice(0, batch.n_rehearsed)
    truth_px = _within(batch.truth_px_BHW[part], window)
    terms: Weighted = [
        ("rehearsal", 1.0, distribution_loss(output.logits_BDHW[part], truth_px, window=window)),
        *(
            ("rehearsal", factor, supervised_loss(disparity_px[part], truth_px))
            for disparity_px, factor in _weighted_outputs(output)
        ),
    ]
    return terms + _head_terms(output, batch, window)


def _head_terms(output: NetworkOutput, batch: Batch, window: Window) -> Weighted:
    """Terms of what a network says of its own result, in rehearsed crops: they say whether it is so."""
    if output.heads_BCHW is None:
        return []
    truth_px = batch.truth_px_BHW[: batch.n_rehearsed]
    known = (truth_px >= window[0]) & (truth_px < window[1])
    is_sure = (output.disparity_px[: batch.n_rehearsed].detach() - truth_px).abs() < SURE_PX
    sure, hidden = output.heads_BCHW[: batch.n_rehearsed].unbind(dim=1)
    occluded = batch.occluded_BHW
    is_told = known if occluded is not None else torch.zeros_like(known)
    is_hidden = torch.zeros_like(known) if occluded is None else occluded
    return [
        ("sure", HEAD_WEIGHT, state_loss(sure, is_sure, known_BHW=known)),
        ("hidden", HEAD_WEIGHT, state_loss(hidden, is_hidden, known_BHW=is_told)),
    ]


def _captured_terms(
    output: NetworkOutput, batch: Batch, stage: Stage, window: Window, teacher: nn.Module | None
) -> Weighted:
    options, part = stage.options, slice(batch.n_rehearsed, None)
    ref, src = (view[part] for view in batch.views(is_symmetric=options.symmetric_loss))
    visible = visible_mask(output.logits_BDHW[part], window=window) if options.occlusion_masks else None
    truth_px = _within(batch.truth_px_BHW[part], window)
    valid = None if batch.valid is None else (batch.valid[0][part], batch.valid[1][part])
    terms: Weighted = []
    for disparity_px, factor in _weighted_outputs(output):
        disparity, weight = disparity_px[part], factor * options.captured_weight
        crops = Comparison(
            ref_BCHW=ref,
            src_BCHW=src,
            truth_px_BHW=truth_px,
            disparity_px_BHW=disparity,
            visible_Bhw=visible,
            space=teacher,
            alpha=options.alpha,
            halvings=options.halvings,
            has_unit_features=options.unit_features,
            valid=valid,
        )
        terms.append((options.captured_loss, weight, CAPTURED_LOSSES[options.captured_loss](crops)))
        terms.append(
            ("smoothness", weight * options.smoothness, smoothness_loss(disparity, ref, mask_BHW=valid and valid[0]))
        )
    return terms


def _within(truth_px: Tensor, window: Window) -> Tensor:
    """Leave out what the volume cannot hold: it is no lesson."""
    return torch.where((truth_px >= window[0]) & (truth_px < window[1]), truth_px, torch.nan)


def _weighted_outputs(output: NetworkOutput) -> list[tuple[Tensor, float]]:
    *coarse, last = output.disparities_px
    weight = min(COARSE_WEIGHT, COARSE_WEIGHT_OF_ALL / max(1, len(coarse)))
    return [*((disparity_px, weight) for disparity_px in coarse), (last, 1.0)]
