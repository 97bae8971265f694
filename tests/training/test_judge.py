"""Judges: every known pixel of a rehearsal counts, and of two judges rehearsals decide."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor, nn
from training.small import CPU

from telewide.matching.networks import NetworkOutput, StereoNetwork
from telewide.matching.window import Window
from telewide.training.judge import crops_judge, joined_judge, judge_stage
from telewide.training.world_samples import WorldBatches, WorldSource


class Answering(StereoNetwork):
    """Answers with the true disparities of some batches, in their order, moved by an error."""

    def __init__(self, batches: WorldBatches, *, error_px: float) -> None:
        super().__init__(nn.Conv2d(3, 1, 1), nn.Identity())
        self._truths = [batches[step].truth_px_BHW for step in range(len(batches))]
        self._error_px = error_px

    def forward(self, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window) -> NetworkOutput:
        truth_px = self._truths.pop(0)
        assert ref_BCHW.shape[-2:] == truth_px.shape[-2:]
        return NetworkOutput([truth_px + self._error_px], torch.zeros(1, 1, 1, 1), None)


@pytest.mark.parametrize(("error_px", "clipped_px"), [(0.0, 0.0), (0.5, 0.5), (40.0, 3.0)])
def test_every_pixel_of_a_rehearsal_counts(error_px: float, clipped_px: float) -> None:
    batches = WorldBatches(WorldSource(seed=3, crop_hw=(64, 96)), judge_stage(steps=1))
    network = Answering(batches, error_px=error_px).to(CPU)
    judgement = crops_judge(batches, window=(0, 96))(network)
    assert judgement["clipped_px"] == pytest.approx(clipped_px, abs=1e-4)
    assert judgement["off_1px"] == (error_px > 1)
    assert judgement["matches"] > 0.5 * 4 * 64 * 96


def test_all_sources_of_crops_are_asked_and_every_pixel_counts_the_same() -> None:
    """Exact on the first, 2 px off on the second, whose crops have twice as many pixels."""
    small, large = (WorldBatches(WorldSource(seed=3, crop_hw=hw), judge_stage(steps=1)) for hw in ((64, 96), (64, 192)))
    answers = {96: small[0].truth_px_BHW, 192: large[0].truth_px_BHW + 2}

    class Both(StereoNetwork):
        def forward(self, ref_BCHW: Tensor, src_BCHW: Tensor, window: Window) -> NetworkOutput:
            return NetworkOutput([answers[ref_BCHW.shape[-1]]], torch.zeros(1, 1, 1, 1), None)

    judgement = crops_judge(small, large, window=(0, 96))(Both(nn.Conv2d(3, 1, 1), nn.Identity()).to(CPU))
    counts = []
    for batches in (small, large):
        batch = batches[0]
        low_px, end_px = batch.window or (0, 96)
        counts.append(int(((batch.truth_px_BHW >= low_px) & (batch.truth_px_BHW < end_px)).sum()))
    assert judgement["clipped_px"] == pytest.approx(2 * counts[1] / sum(counts), abs=1e-4)


@pytest.mark.parametrize(
    ("matches_px", "rehearsed_px", "decisive_px"), [(0.5, 0.3, 0.3), (math.nan, 0.3, 0.3), (0.5, math.nan, 0.5)]
)
def test_rehearsals_decide_and_matches_where_there_are_none(
    matches_px: float, rehearsed_px: float, decisive_px: float
) -> None:
    network = StereoNetwork(nn.Identity(), nn.Identity())
    judge = joined_judge(
        lambda _: {"clipped_px": matches_px, "off_1px": 0.1}, lambda _: {"clipped_px": rehearsed_px, "off_1px": 0.9}
    )
    assert judge(network) == {"clipped_px": pytest.approx(decisive_px), "off_1px": 0.1}


def test_judges_without_an_answer_have_none_together() -> None:
    judge = joined_judge(*(lambda _: {"clipped_px": math.nan} for _ in range(2)))
    assert math.isnan(judge(StereoNetwork(nn.Identity(), nn.Identity()))["clipped_px"])
