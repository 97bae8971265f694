"""Crops of worlds: a step is a function of seed and number, and the truth of a crop is that of its pixels."""

from __future__ import annotations

import pytest
import torch

from telewide.matching.sampling import warp_to_ref
from telewide.training import world_samples
from telewide.training.world_samples import WorldBatch, WorldSamples


@pytest.fixture(scope="module", autouse=True)
def _few_small_worlds() -> None:
    """Nothing here depends on how large a world is or how long it is kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_samples, "KEPT_WORLDS", 3)
        patch.setattr(world_samples, "WORLD_HW", (112, 192))
        patch.setattr(world_samples, "PALETTE_SIZE", 12)
        yield


def samples() -> WorldSamples:
    return WorldSamples(seed=3, crop_hw=(96, 128), crops=3)


@pytest.fixture(scope="module")
def batches() -> list[WorldBatch]:
    stream = samples()
    return [stream.batch(step) for step in range(6)]


def test_a_step_taken_up_later_is_the_same_step(batches: list[WorldBatch]) -> None:
    resumed = samples().batch(4)
    for name in ("ref_BCHW", "src_BCHW", "truth_px_BHW", "occluded_BHW"):
        assert torch.equal(getattr(resumed, name), getattr(batches[4], name))
    assert resumed.window == batches[4].window


def test_crops_are_pictures_with_their_truth(batches: list[WorldBatch]) -> None:
    for batch in batches:
        assert batch.ref_BCHW.shape == batch.src_BCHW.shape == (3, 3, 96, 128)
        assert batch.truth_px_BHW.shape == batch.occluded_BHW.shape == (3, 96, 128)
        assert float(batch.ref_BCHW.min()) >= 0
        assert float(batch.ref_BCHW.max()) <= 1


def test_most_of_the_truth_lies_in_the_window(batches: list[WorldBatch]) -> None:
    shares = [
        ((batch.truth_px_BHW >= batch.window[0]) & (batch.truth_px_BHW < batch.window[1])).float().mean()
        for batch in batches
    ]
    assert float(torch.stack(shares).mean()) > 0.75


def test_the_truth_warps_src_onto_ref_better_than_a_wrong_one(batches: list[WorldBatch]) -> None:
    better = 0
    for batch in batches:
        seen = ~batch.occluded_BHW
        errors = [_difference(batch, offset_px, seen) for offset_px in (0.0, 6.0)]
        better += int((errors[0] < errors[1]).sum())
    assert better >= 0.8 * 3 * len(batches)


def _difference(batch: WorldBatch, offset_px: float, seen: torch.Tensor) -> torch.Tensor:
    """(B,) mean difference of the views' structure, free of gain and offset."""
    warped = warp_to_ref(batch.src_BCHW, batch.truth_px_BHW + offset_px).mean(dim=1)
    ref = batch.ref_BCHW.mean(dim=1)
    results = []
    for a, b, mask in zip(ref, warped, seen, strict=True):
        a, b = a[mask] - a[mask].mean(), b[mask] - b[mask].mean()
        results.append(1 - (a @ b) / (a.norm() * b.norm() + 1e-6))
    return torch.stack(results)
