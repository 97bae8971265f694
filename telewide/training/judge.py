"""The judge between steps and stages: a network asked on held-out matches."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from telewide.capture.pair import PairReader
from telewide.matching.inference import low_precision, match_with_network
from telewide.matching.networks import StereoNetwork, standardise
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors
from telewide.training.options import StageOptions
from telewide.training.stages import Stage
from telewide.training.world_samples import WorldBatches, WorldSource

JUDGED_CROPS = 4
"""Crops of worlds in a batch of the judge."""


def world_judge(source: WorldSource, *, steps: int) -> Callable[[StereoNetwork], dict[str, float]]:
    """Bind the crops of some steps of worlds, which no training sees, into a judge; every pixel counts the same.

    Args:
        source: worlds of a seed of their own.
        steps: how many batches.

    Returns:
        A function from a network to the shares of `summarise_errors`, hidden pixels included.
    """
    stage = Stage("judge", 0, StageOptions(steps=steps, rehearsed=JUDGED_CROPS))
    batches = [WorldBatches(source, stage)[step] for step in range(steps)]

    @torch.inference_mode()
    def judge(network: StereoNetwork) -> dict[str, float]:
        network.eval()
        device = next(network.parameters()).device
        errors_px = []
        for batch in (batch.to(device) for batch in batches):
            window = batch.window or source.window_px
            with low_precision(device):
                output = network(standardise(batch.ref_BCHW), standardise(batch.src_BCHW), window)
            known = (batch.truth_px_BHW >= window[0]) & (batch.truth_px_BHW < window[1])
            errors_px.append((output.disparity_px.float() - batch.truth_px_BHW).abs()[known].cpu().numpy())
        return summarise_errors(np.concatenate(errors_px))

    return judge


def network_judge(
    held_out: Sequence[HeldOut], *, window: Window, reader: PairReader
) -> Callable[[StereoNetwork], dict[str, float]]:
    """Bind held-out captures into a judge for the training loop; every match counts the same.

    Args:
        held_out: captures with their matches.
        window: disparities to search, px.
        reader: of the corrected pairs.

    Returns:
        A function from a network to the shares of `summarise_errors`.
    """

    def judge(network: StereoNetwork) -> dict[str, float]:
        errors_px = [np.empty(0)]
        for item in held_out:
            pair = reader.read(item.capture)
            matched = match_with_network(pair.tele, pair.wide, network=network, window=window)
            errors_px.append(match_errors_px(matched.disparity_px, item))
        return summarise_errors(np.concatenate(errors_px))

    return judge
