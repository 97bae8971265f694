"""Crops of photos taken again: their truth warps one view onto the other and lies in the window; wide has no part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from training.small import CROP_HW, WINDOW, rendered, source_of, stage_of, write_pairs

from telewide.capture.images import read_image, write_image
from telewide.capture.pair import Capture
from telewide.capture.pfm import write_pfm
from telewide.geometry.arrays import FloatMap
from telewide.matching.sampling import warp_to_ref
from telewide.training.data import StepBatches
from telewide.training.retaken import retaken_crop
from telewide.training.samples import CropArea, SampleSource, disparity_path, generator_for
from telewide.training.world_samples import WorldCrop

MANY = range(24)


def surveyed(folder: Path, *, area: CropArea | None = None) -> SampleSource:
    """Two pairs with their true disparities."""
    captures = write_pairs(folder)
    for seed, capture in enumerate(captures):
        write_surface(folder, capture, rendered(seed).disparity_px)
    return source_of(captures, area=area, disparities=folder)


def write_surface(folder: Path, capture: Capture, disparity_px: FloatMap) -> None:
    write_pfm(disparity_path(folder / capture.name, window_px=WINDOW), disparity_px)


def crops_of(source: SampleSource, *, scale: float = 1.0) -> list[WorldCrop]:
    return [retaken_crop(source, rng=generator_for(0, index), scale=scale) for index in MANY]


def warp_error(crop: WorldCrop, *, off_px: float = 0.0) -> float:
    warped = warp_to_ref(crop.src[None], crop.truth_px[None] + off_px)[0]
    return float((warped - crop.ref).abs().mean(dim=0)[~crop.occluded].mean())


@pytest.mark.parametrize("scale", [1.0, 0.75])
def test_the_truth_warps_src_onto_ref(tmp_path: Path, scale: float) -> None:
    for crop in crops_of(surveyed(tmp_path), scale=scale):
        assert tuple(crop.ref.shape) == (3, *(round(scale * side) for side in CROP_HW))
        right = warp_error(crop)
        assert right < 0.01
        assert right < 0.2 * min(warp_error(crop, off_px=-3), warp_error(crop, off_px=3))


def test_the_truth_lies_in_the_window_and_is_known_everywhere(tmp_path: Path) -> None:
    for crop in crops_of(surveyed(tmp_path)):
        assert crop.truth_px.isfinite().all()
        inside = (crop.truth_px >= WINDOW[0]) & (crop.truth_px < WINDOW[1])
        assert float(inside.float().mean()) > 0.9


def test_the_wide_photo_has_no_part_in_it(tmp_path: Path) -> None:
    source = surveyed(tmp_path)
    before = crops_of(source)
    for capture in source.captures:
        write_image(capture.wide_path, np.zeros((96, 144, 3), np.float32))
    for one, other in zip(before, crops_of(replace(source, reader=source_of(source.captures).reader)), strict=True):
        assert torch.equal(one.src, other.src)


def test_what_is_held_out_is_never_shown(tmp_path: Path) -> None:
    """Black in the strip and grey before it, so that a pixel of the strip would show whatever its colours become."""
    source = surveyed(tmp_path, area=CropArea(end=0.75))
    for capture in source.captures:
        photo = np.full((96, 144, 3), 0.8, np.float32)
        photo[:, 108:] = 0
        write_image(capture.tele_path, photo)
    assert min(float(crop.ref.min()) for crop in crops_of(source)) > 0.3
    assert min(float(crop.ref.min()) for crop in crops_of(replace(source, area=CropArea()))) < 0.1


def test_what_no_photo_shows_is_never_shown(tmp_path: Path) -> None:
    source, masked = surveyed(tmp_path), []
    for capture in source.captures:
        photo, valid = np.full((96, 144, 3), 0.8, np.float32), np.ones((96, 144), np.float32)
        photo[:20], valid[:20] = 0, 0
        write_image(capture.tele_path, photo)
        write_image(tmp_path / "valid.png", valid)
        masked.append(replace(capture, valid_paths=(tmp_path / "valid.png", tmp_path / "valid.png")))
    assert min(float(crop.ref.min()) for crop in crops_of(replace(source, captures=tuple(masked)))) > 0.3
    assert min(float(crop.ref.min()) for crop in crops_of(source)) < 0.1


def test_a_step_has_worlds_photos_taken_again_and_real_crops_in_this_order(tmp_path: Path) -> None:
    source = surveyed(tmp_path)
    stage = stage_of(steps=3, rehearsed=1, retaken=2, captured=1)
    batch = StepBatches(source, stage, seed=3)[1]
    assert batch.n_rehearsed == 3
    assert len(batch.ref_BCHW) == 4
    assert batch.occluded_BHW is not None
    assert len(batch.occluded_BHW) == 3
    assert batch.truth_px_BHW[:3].isfinite().all()
    shares = [StepBatches(source, stage, seed=3, rank=rank, world=2)[1] for rank in range(2)]
    assert torch.equal(shares[0].ref_BCHW[1], batch.ref_BCHW[2])
    assert torch.equal(shares[1].ref_BCHW[0], batch.ref_BCHW[1])


def test_the_second_view_is_damaged_as_wide_is(tmp_path: Path) -> None:
    """Four times fewer pixels: hardly anything is left of the finest differences, which the sharp view keeps."""
    source = replace(surveyed(tmp_path), asymmetry=(4.0, 4.0))
    assert read_image(source.captures[0].tele_path).shape == (96, 144, 3)
    batch = StepBatches(source, stage_of(steps=6, retaken=4), seed=0)[0]
    fine = [float(view.diff(dim=-1).abs().mean()) for view in (batch.ref_BCHW, batch.src_BCHW)]
    assert fine[1] < 0.7 * fine[0]
