"""Crops of worlds: a step is a function of seed and number, and the truth of a crop is that of its pixels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from telewide.matching.sampling import warp_to_ref
from telewide.training import world_samples
from telewide.training.objective import Batch
from telewide.training.options import StageOptions
from telewide.training.stages import Stage
from telewide.training.world_samples import WorldBatches, WorldCrop, WorldSource, enlarged_crop


@pytest.fixture(scope="module", autouse=True)
def _few_small_worlds() -> None:
    """Nothing here depends on how large a world is or how long it is kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_samples, "KEPT_WORLDS", 3)
        patch.setattr(world_samples, "SIZE_OF_CROPS", 1.25)
        patch.setattr(world_samples, "PALETTE_SIZE", 12)
        yield


def dataset(*, rank: int = 0, world: int = 1) -> WorldBatches:
    stage = Stage("rehearsal", 0, StageOptions(steps=10, rehearsed=3))
    return WorldBatches(WorldSource(seed=3, crop_hw=(96, 128)), stage, rank=rank, world=world)


@pytest.fixture(scope="module")
def batches() -> list[Batch]:
    stream = dataset()
    return [stream[step] for step in range(6)]


def test_a_step_taken_up_later_is_the_same_step(batches: list[Batch]) -> None:
    resumed = dataset()[4]
    for name in ("ref_BCHW", "src_BCHW", "truth_px_BHW", "occluded_BHW"):
        assert torch.equal(getattr(resumed, name), getattr(batches[4], name))
    assert resumed.window == batches[4].window


def test_two_processes_make_the_crops_of_one(batches: list[Batch]) -> None:
    shares = [dataset(rank=rank, world=2)[2] for rank in range(2)]
    assert [share.n_rehearsed for share in shares] == [2, 1]
    assert torch.equal(shares[0].ref_BCHW, batches[2].ref_BCHW[::2])
    assert torch.equal(shares[1].truth_px_BHW, batches[2].truth_px_BHW[1::2])


def test_crops_are_pictures_with_their_truth(batches: list[Batch]) -> None:
    for batch in batches:
        assert batch.ref_BCHW.shape == batch.src_BCHW.shape == (3, 3, 96, 128)
        assert batch.truth_px_BHW.shape == batch.occluded_BHW.shape == (3, 96, 128)
        assert float(batch.ref_BCHW.min()) >= 0
        assert float(batch.ref_BCHW.max()) <= 1


def test_most_of_the_truth_lies_in_the_window(batches: list[Batch]) -> None:
    shares = [
        ((batch.truth_px_BHW >= batch.window[0]) & (batch.truth_px_BHW < batch.window[1])).float().mean()
        for batch in batches
    ]
    assert float(torch.stack(shares).mean()) > 0.75


def test_the_truth_warps_src_onto_ref_better_than_a_wrong_one(batches: list[Batch]) -> None:
    better = 0
    for batch in batches:
        seen = ~batch.occluded_BHW
        errors = [_difference(batch, offset_px, seen) for offset_px in (0.0, 6.0)]
        better += int((errors[0] < errors[1]).sum())
    assert better >= 0.8 * 3 * len(batches)


def _difference(batch: Batch, offset_px: float, seen: torch.Tensor) -> torch.Tensor:
    """(B,) mean difference of the views' structure, free of gain and offset."""
    warped = warp_to_ref(batch.src_BCHW, batch.truth_px_BHW + offset_px).mean(dim=1)
    ref = batch.ref_BCHW.mean(dim=1)
    results = []
    for a, b, mask in zip(ref, warped, seen, strict=True):
        a, b = a[mask] - a[mask].mean(), b[mask] - b[mask].mean()
        results.append(1 - (a @ b) / (a.norm() * b.norm() + 1e-6))
    return torch.stack(results)


def test_a_plane_that_is_enlarged_is_a_plane_and_a_step_stays_a_step() -> None:
    """At pixel x' of a picture s times as large lies x = (x' + 0.5) / s - 0.5, with s times the disparity."""
    x_px = torch.arange(64.0).expand(48, 64)
    views = torch.zeros(3, 48, 64)
    behind_px, before_px = 0.1 * x_px, torch.full((48, 64), 30.0)
    is_before = x_px >= 32
    crop = WorldCrop(views, views, torch.where(is_before, before_px, behind_px), is_before)
    larger = enlarged_crop(crop, hw=(72, 96))
    x_px = ((torch.arange(96.0) + 0.5) / 1.5 - 0.5).expand(72, 96)
    assert torch.equal(larger.occluded, x_px > 31.5)
    torch.testing.assert_close(larger.truth_px[:, 48:], torch.full((72, 48), 45.0))
    off_px = (larger.truth_px - 0.15 * x_px)[:, 1:48].abs()
    assert float(off_px.max()) <= 0.1, "half a small pixel beside the step, and nothing between both surfaces"
    assert float(off_px[:, :-2].max()) < 1e-4


def test_enlarged_crops_are_warped_onto_each_other_by_their_truth() -> None:
    worlds = world_samples.worlds_for((5,), crop_hw=(96, 128), crops=2, mine=2)
    for number in range(4):
        crop = worlds.crop(number, 0, rng=np.random.default_rng(number), window=(0, 64), scale=0.6)
        assert crop.truth_px.shape == (58, 77)
        larger = enlarged_crop(crop, hw=(96, 128))
        errors = [_difference(_as_batch(larger), offset_px, ~larger.occluded[None]) for offset_px in (0.0, 6.0)]
        assert float(errors[0]) < float(errors[1])


def _as_batch(crop: WorldCrop) -> Batch:
    return Batch(crop.ref[None], crop.src[None], crop.truth_px[None], n_rehearsed=1, occluded_BHW=crop.occluded[None])


def test_a_gpu_makes_its_crops_itself_and_the_same_ones_again(batches: list[Batch], gpu: str) -> None:
    source = WorldSource(seed=3, crop_hw=(96, 128), device=torch.device(gpu))
    stage = Stage("rehearsal", 0, StageOptions(steps=10, rehearsed=3))
    made, again = (WorldBatches(source, stage)[4] for _ in range(2))
    here = batches[4]
    assert made.ref_BCHW.device.type == made.occluded_BHW.device.type == gpu
    assert torch.equal(made.src_BCHW, again.src_BCHW)
    assert made.window == here.window
    off_px = (made.truth_px_BHW.cpu() - here.truth_px_BHW).abs()
    assert float((off_px > 0.01).float().mean()) < 0.02
