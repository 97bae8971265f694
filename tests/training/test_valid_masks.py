"""What no photo shows teaches nothing: a step is the same whatever is painted there."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from training.small import CROP_HW, WINDOW, rendered, source_of, stage_of

from telewide.capture.images import write_image
from telewide.capture.pair import Capture, read_pair
from telewide.geometry.arrays import BoolMap
from telewide.matching.networks import NetworkOutput, build_network
from telewide.training.checkpoint import frozen_extractor
from telewide.training.contrastive import contrastive_loss
from telewide.training.data import StepBatches, collate
from telewide.training.objective import Batch, objective
from telewide.training.samples import SampleSource, SeenPhotos, crop_capture, generator_for, inner_rectangle
from telewide.training.spaces import SPACES, build_space, space_objective
from telewide.training.stages import Stage

HW = (96, 144)
PAINTS = ((1.0, 0.0, 1.0), (0.0, 1.0, 0.0))


def masks() -> tuple[BoolMap, BoolMap]:
    """Of a tele photo that is turned, and of a wide photo that ends."""
    rows, columns = np.mgrid[: HW[0], : HW[1]]
    return columns + rows // 3 > 40, (columns < 120) & (rows > 6)


def source_with(folder: Path, paint: tuple[float, float, float], *, has_masks: bool = True) -> SampleSource:
    pair = rendered(0, hw=HW)
    paths = [folder / f"{name}.png" for name in ("tele", "wide", "tele_valid", "wide_valid")]
    for path, view, mask in zip(paths, (pair.ref, pair.src), masks(), strict=False):
        write_image(path, np.where(mask[..., None], view, np.float32(paint)).astype(np.float32))
    for path, mask in zip(paths[2:], masks(), strict=True):
        write_image(path, mask.astype(np.float32))
    valid_paths = (paths[2], paths[3]) if has_masks else None
    return source_of([Capture("000", paths[0], paths[1], valid_paths=valid_paths)])


def test_the_masks_are_read_with_the_pair(tmp_path: Path) -> None:
    (capture,) = source_with(tmp_path, PAINTS[0]).captures
    valid = read_pair(capture).valid
    assert valid is not None
    for found, expected in zip((valid.ref, valid.src), masks(), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_crop_shows_no_paint_where_it_is_valid(tmp_path: Path) -> None:
    sources = [source_with(tmp_path / str(n), paint) for n, paint in enumerate(PAINTS)]
    shares = []
    for index in range(40):
        one, other = (crop_capture(source, rng=generator_for(1, index), may_swap=True) for source in sources)
        assert one.valid is not None
        for view in ("ref", "src"):
            valid = getattr(one.valid, view)
            assert valid.shape == CROP_HW
            np.testing.assert_allclose(getattr(one, view)[valid], getattr(other, view)[valid], atol=2e-3)
            shares.append(valid.mean())
    assert 0.4 < np.mean(shares) < 0.95
    assert min(shares) < 0.9


def test_masks_change_no_crop(tmp_path: Path) -> None:
    """The same draws, the same pixels: a training on photos that fill their views goes on as before."""
    masked, plain = (source_with(tmp_path / str(has), PAINTS[0], has_masks=has) for has in (True, False))
    for index in range(6):
        one, other = (crop_capture(source, rng=generator_for(2, index), may_swap=True) for source in (masked, plain))
        np.testing.assert_array_equal(one.ref, other.ref)
        np.testing.assert_array_equal(one.src, other.src)
        assert other.valid is None
    assert StepBatches(plain, stage_of(steps=1, rehearsed=1, captured=2), seed=0)[0].valid is None


def test_rehearsals_are_not_painted_with_continued_borders(tmp_path: Path) -> None:
    sources = [source_with(tmp_path / str(n), paint) for n, paint in enumerate(PAINTS)]
    one, other = (SeenPhotos(source)[0] for source in sources)
    assert one.shape[0] * one.shape[1] > 0.4 * HW[0] * HW[1]
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("turned_deg", [0, 4, -9])
def test_the_inner_rectangle_is_valid_and_large(turned_deg: float) -> None:
    turn = cv2.getRotationMatrix2D((100, 75), turned_deg, 1.0)
    valid = cv2.warpAffine(np.ones((150, 200), np.uint8), turn, (200, 150)) > 0
    inner = valid[inner_rectangle(valid)]
    assert inner.all()
    assert inner.size > 0.6 * valid.sum()


def batch_of(paint: tuple[float, float, float], *, has_masks: bool) -> Batch:
    pair = rendered(0, hw=HW)
    views = [
        np.where(mask[..., None], view, np.float32(paint)).astype(np.float32)
        for view, mask in zip((pair.ref, pair.src), masks(), strict=True)
    ]
    valid = tuple(torch.from_numpy(mask)[None] for mask in masks())
    ref, src = (torch.from_numpy(view.transpose(2, 0, 1).copy())[None] for view in views)
    unlabelled = torch.full((1, *HW), torch.nan)
    return Batch(ref, src, unlabelled, 0, valid=(valid[0], valid[1]) if has_masks else None)


def step(batch: Batch, *, loss: str) -> tuple[float, torch.Tensor]:
    """The objective at the true disparity, and its gradient there."""
    stage = stage_of(steps=1, captured=1, captured_loss=loss, occlusion_masks=False, smoothness=0.1, alpha=1.0)
    teacher = frozen_extractor(build_network("lite", seed=2)) if stage.needs_teacher else None
    disparity_px = torch.from_numpy(rendered(0, hw=HW).disparity_px)[None].requires_grad_()
    logits = torch.zeros(1, (WINDOW[1] - WINDOW[0]) // 4, HW[0] // 4, HW[1] // 4)
    output = NetworkOutput([disparity_px], logits)
    total, _ = objective(output, batch, stage, window=WINDOW, teacher=teacher, global_sum=lambda x: x)
    (gradient,) = torch.autograd.grad(total, disparity_px)
    return float(total.detach()), gradient[0]


def test_the_photometric_step_is_the_same_whatever_is_painted() -> None:
    values, gradients = zip(
        *(step(batch_of(paint, has_masks=True), loss="photometric") for paint in PAINTS), strict=True
    )
    assert values[0] == pytest.approx(values[1], rel=1e-6)
    torch.testing.assert_close(gradients[0], gradients[1])
    without = [step(batch_of(paint, has_masks=False), loss="photometric")[0] for paint in PAINTS]
    assert without[0] != pytest.approx(without[1], rel=1e-2)


@pytest.mark.parametrize("loss", ["photometric", "feature"])
def test_pixels_without_a_photo_pull_at_no_disparity(loss: str) -> None:
    valid_ref, valid_src = masks()
    x_src = np.clip(np.round(np.arange(HW[1]) - rendered(0, hw=HW).disparity_px), 0, HW[1] - 1).astype(int)
    unknown = ~(valid_ref & np.take_along_axis(valid_src, x_src, axis=1))
    # SSIM looks at pixels beside; what lies deep in the unknown is out of its reach.
    deep = cv2.erode(unknown.astype(np.uint8), np.ones((9, 9))) > 0
    assert deep.sum() > 500
    smooth = cv2.erode((~valid_ref).astype(np.uint8), np.ones((3, 3))) > 0
    _, gradient = step(batch_of(PAINTS[0], has_masks=True), loss=loss)
    pull = gradient[torch.from_numpy(smooth & deep)].abs().mean()
    _, without = step(batch_of(PAINTS[0], has_masks=False), loss=loss)
    assert without[torch.from_numpy(smooth & deep)].any()
    # A feature sees far around itself: those that count, beside the unknown, also depend on what was warped there.
    assert pull <= (0.0 if loss == "photometric" else 0.2 * gradient[torch.from_numpy(~unknown)].abs().mean())


def test_a_whole_crop_beside_a_masked_one_counts_everywhere(tmp_path: Path) -> None:
    masked, plain = (source_with(tmp_path / str(has), PAINTS[0], has_masks=has) for has in (True, False))
    cut = [crop_capture(masked, rng=generator_for(4, index), may_swap=False) for index in range(20)]
    beside = next(sample for sample in cut if sample.valid is not None and not sample.valid.ref.all())
    whole = crop_capture(plain, rng=generator_for(4, 0), may_swap=False)
    valid = collate([beside, whole], n_rehearsed=0).valid
    assert valid is not None
    assert not valid[0][0].all()
    assert valid[0][1].all()
    assert valid[1][1].all()


def space_step(name: str, batch: Batch) -> tuple[float, dict[str, torch.Tensor]]:
    """What teaches a feature space, and its gradient at every weight."""
    batch = Batch(
        *(view[..., :64, :128] for view in (batch.ref_BCHW, batch.src_BCHW)),
        batch.truth_px_BHW[:, :64, :128],
        0,
        valid=batch.valid and (batch.valid[0][:, :64, :128], batch.valid[1][:, :64, :128]),
    )
    space = build_space(name, seed=3).train()
    stage = Stage("space", 0, stage_of(steps=1, captured=1).options, name)  # type: ignore[arg-type]
    network = build_network("lite", seed=2)
    loss, _ = space_objective(space, batch, stage, network=network, window=WINDOW, global_sum=lambda x: x)
    torch.autograd.backward(loss)
    return float(loss.detach()), {key: p.grad for key, p in space.named_parameters() if p.grad is not None}


@pytest.mark.parametrize("name", SPACES)
def test_a_feature_space_learns_the_same_whatever_is_painted(name: str) -> None:
    losses, gradients = zip(*(space_step(name, batch_of(paint, has_masks=True)) for paint in PAINTS), strict=True)
    assert losses[0] == losses[1]
    assert gradients[0].keys() == gradients[1].keys()
    assert all(torch.equal(gradients[0][key], gradients[1][key]) for key in gradients[0])
    without = [space_step(name, batch_of(paint, has_masks=False))[0] for paint in PAINTS]
    assert without[0] != pytest.approx(without[1], rel=1e-3)


@pytest.mark.parametrize("name", SPACES)
def test_masks_of_whole_crops_teach_a_feature_space_nothing_else(name: str) -> None:
    plain = batch_of(PAINTS[0], has_masks=False)
    everywhere = torch.ones(1, *HW, dtype=torch.bool)
    whole = Batch(plain.ref_BCHW, plain.src_BCHW, plain.truth_px_BHW, 0, valid=(everywhere, everywhere))
    assert space_step(name, whole)[0] == pytest.approx(space_step(name, plain)[0], rel=1e-6)


def test_what_lies_outside_a_mask_pulls_at_no_feature() -> None:
    """The contrastive loss at the features themselves: no gradient where ref was not photographed, or its partner."""
    valid_ref, valid_src = (torch.from_numpy(mask)[None] for mask in masks())
    ref, src = (torch.rand(1, 3, *HW, generator=torch.Generator().manual_seed(n)).requires_grad_() for n in (1, 2))
    disparity_px = torch.from_numpy(rendered(0, hw=HW).disparity_px)[None]
    term = contrastive_loss(ref, src, disparity_px, valid=(valid_ref, valid_src))
    for gradient, valid in zip(torch.autograd.grad(term.total, (ref, src)), (valid_ref, valid_src), strict=True):
        pull = gradient.abs().sum(dim=1)
        pulled = pull > 2e-3 * pull.max()  # a partner is taken that lies between pixels by up to a thousandth
        assert not pulled[~valid].any()
        assert pulled[valid].float().mean() > 0.7
    assert 0 < float(term.count) < float(contrastive_loss(ref, src, disparity_px).count)
