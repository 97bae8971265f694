"""The judges between steps and stages: a network asked on rehearsals it has not seen, and on held-out matches."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch

from telewide.capture.pair import PairReader
from telewide.matching.inference import low_precision, match_with_network
from telewide.matching.networks import StereoNetwork, prepare_view
from telewide.matching.window import Window
from telewide.points.held_out import HeldOut, match_errors_px, summarise_errors
from telewide.training.data import Batches
from telewide.training.objective import Batch
from telewide.training.options import StageOptions
from telewide.training.stages import Stage

Judge = Callable[[StereoNetwork], Mapping[str, float]]
"""Answers with figures by their names; :mod:`telewide.training.loop` says which one decides."""

JUDGE_SEED = 1_000_003
"""Added to a training's seed: rehearsals that no step of it has seen."""


def judge_stage(*, steps: int, retakes: bool = False) -> Stage:
    """A stage whose batches a judge asks.

    Args:
        steps: how many, of four crops each.
        retakes: whether the crops are photos taken again, and not cast worlds.
    """
    return Stage("judge", 0, StageOptions(steps=steps, rehearsed=0 if retakes else 4, retaken=4 if retakes else 0))


def crops_judge(*sources: Batches, window: Window) -> Judge:
    """Bind rehearsed crops, which no training sees, into a judge; every pixel counts the same, hidden ones too.

    Args:
        *sources: batches of a `judge_stage` each; made when they are first asked.
        window: disparities to search where a batch names none, px.

    Returns:
        A function from a network to the shares of `summarise_errors`.
    """
    made: list[Batch] = []

    @torch.inference_mode()
    def judge(network: StereoNetwork) -> dict[str, float]:
        network.eval()
        device = next(network.parameters()).device
        if not made:
            made.extend(batches[step] for batches in sources for step in range(len(batches)))
        errors_px = []
        for batch in (batch.to(device) for batch in made):
            searched = batch.window or window
            views = (prepare_view(network.features, view) for view in (batch.ref_BCHW, batch.src_BCHW))
            with low_precision(device):
                output = network(*views, searched)
            known = (batch.truth_px_BHW >= searched[0]) & (batch.truth_px_BHW < searched[1])
            errors_px.append((output.disparity_px.float() - batch.truth_px_BHW).abs()[known].cpu().numpy())
        return summarise_errors(np.concatenate(errors_px))

    return judge


def joined_judge(matches: Judge, rehearsals: Judge) -> Judge:
    """Join two judges: rehearsals decide, or matches where there are none; the rest is told of the matches.

    Rehearsals know plain walls, edges and what is hidden, and rank networks as the truth does. Sparse matches do not:
    they lie on sharp texture, and those at edges of depth are off themselves (docs/decisions.md, "What ranks
    networks").

    Args:
        matches: asks held-out matches.
        rehearsals: asks rehearsed crops.
    """

    def judge(network: StereoNetwork) -> dict[str, float]:
        of_matches, decisive_px = matches(network), rehearsals(network)["clipped_px"]
        return dict(of_matches) if math.isnan(decisive_px) else {**of_matches, "clipped_px": decisive_px}

    return judge


def network_judge(held_out: Sequence[HeldOut], *, window: Window, reader: PairReader) -> Judge:
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
            matched = match_with_network(pair.tele, pair.wide, network=network, window=window, valid=pair.valid)
            errors_px.append(match_errors_px(matched.disparity_px, item))
        return summarise_errors(np.concatenate(errors_px))

    return judge
