"""Samples: functions of the seed alone, the same in any process, and never of what is held out."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from training.small import CROP_HW, WINDOW, rendered, source_of, stage_of

from telewide.capture.images import write_image
from telewide.capture.pair import Capture
from telewide.capture.pfm import write_pfm
from telewide.errors import MissingPartError, UsageError
from telewide.simulate.raycast import patterns
from telewide.training import world_samples
from telewide.training.data import StepBatches, iterate_batches
from telewide.training.objective import Batch
from telewide.training.samples import (
    CropArea,
    Sample,
    SampleSource,
    crop_capture,
    disparity_path,
    fitting_crop,
    generator_for,
)

AS_SHIPPED = {name: getattr(world_samples, name) for name in ("PALETTE_SIZE", "KEPT_WORLDS")}


@pytest.fixture(scope="module", autouse=True)
def _few_textures() -> Iterator[None]:
    """Nothing here depends on how many there are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_samples, "PALETTE_SIZE", 12)
        patch.setattr(world_samples, "KEPT_WORLDS", 2)
        yield


def rehearsed(source: SampleSource, *, step: int = 0, crops: int = 1) -> list[Sample]:
    """The rehearsed crops of a step, and both views undamaged."""
    stage = stage_of(steps=99, rehearsed=crops, symmetric_loss=True)
    batch = StepBatches(source, stage, seed=1)[step]
    assert batch.undamaged is not None
    assert batch.occluded_BHW is not None
    parts = zip(
        *(pictures(views) for views in (batch.ref_BCHW, batch.src_BCHW, *batch.undamaged)),
        batch.truth_px_BHW.numpy(),
        batch.occluded_BHW.numpy(),
        strict=True,
    )
    return [Sample(ref, src, truth_px, hidden, crisp) for ref, src, *crisp, truth_px, hidden in parts]


def pictures(views_BCHW: torch.Tensor) -> np.ndarray:
    return views_BCHW.permute(0, 2, 3, 1).numpy()


def is_equal(a: Batch, b: Batch) -> bool:
    return (
        torch.equal(a.ref_BCHW, b.ref_BCHW)
        and torch.equal(a.src_BCHW, b.src_BCHW)
        and torch.equal(a.truth_px_BHW.nan_to_num(-99), b.truth_px_BHW.nan_to_num(-99))
        and a.n_rehearsed == b.n_rehearsed
    )


def warp_error(sample: Sample, disparity_px: np.ndarray, seen: np.ndarray) -> float:
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in CROP_HW[::-1]))
    warped = cv2.remap(sample.src, x - disparity_px, y, cv2.INTER_LINEAR)
    inside = seen & (x - disparity_px >= 0) & (x - disparity_px <= CROP_HW[1] - 1)
    return float(np.abs(warped - sample.ref)[inside].mean())


def test_a_batch_depends_on_seed_stage_and_step_only(source: SampleSource, captures: tuple[Capture, ...]) -> None:
    stage = stage_of(1, steps=9, rehearsed=1, captured=2, swaps_views=True)
    batches = StepBatches(source, stage, seed=3)
    first = batches[4]
    for other in (0, 7):
        batches[other]
    assert is_equal(batches[4], first)
    assert is_equal(StepBatches(source_of(captures), stage, seed=3)[4], first)
    assert not is_equal(batches[5], first)
    assert not is_equal(StepBatches(source, stage, seed=4)[4], first)
    assert not is_equal(StepBatches(source, replace(stage, index=2), seed=3)[4], first)
    captured = [StepBatches(source, stage_of(index, steps=9, captured=2), seed=3)[4] for index in (1, 2)]
    assert not is_equal(*captured), "crops of captures too"


def test_a_batch_does_not_touch_others_draws(source: SampleSource) -> None:
    state, torch_state = np.random.get_state()[1].copy(), torch.random.get_rng_state()  # noqa: NPY002
    StepBatches(source, stage_of(steps=1, rehearsed=1, captured=1), seed=0)[0]
    assert np.array_equal(state, np.random.get_state()[1])  # noqa: NPY002
    assert torch.equal(torch_state, torch.random.get_rng_state())


@pytest.mark.slow
def test_worker_processes_make_the_same_batches(source: SampleSource, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in AS_SHIPPED.items():  # what is patched here is not in other processes
        monkeypatch.setattr(world_samples, name, value)
    batches = StepBatches(source, stage_of(steps=6, rehearsed=1, captured=1), seed=1)
    made = list(iterate_batches(batches, first_step=2, workers=2))
    assert len(made) == 4
    assert all(is_equal(batch, batches[step]) for step, batch in enumerate(made, start=2))


@pytest.mark.slow
def test_a_worker_process_that_the_system_ends_is_told(source: SampleSource) -> None:
    """As it does where memory runs out."""
    batches = iterate_batches(StepBatches(source, stage_of(steps=500, captured=1), seed=1), first_step=0, workers=1)
    next(batches)
    (worker,) = multiprocessing.active_children()
    worker.kill()
    with pytest.raises(MissingPartError, match="ended by the system"):
        list(batches)


@pytest.mark.slow
def test_worker_processes_end_with_the_batches(source: SampleSource, capfd: pytest.CaptureFixture[str]) -> None:
    """Without a traceback, whatever they were doing."""
    for _ in range(3):
        batches = iterate_batches(StepBatches(source, stage_of(steps=500, captured=1), seed=1), first_step=0, workers=1)
        next(batches)
        batches.close()
        assert multiprocessing.active_children() == []
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.slow
def test_what_a_user_did_arrives_as_it_was_said(source: SampleSource) -> None:
    gone = tuple(replace(capture, tele_path=Path("gone.png")) for capture in source.captures)
    batches = StepBatches(replace(source, captures=gone), stage_of(steps=9, captured=1), seed=1)
    said = []
    for workers in (0, 1):
        with pytest.raises(UsageError) as caught:
            list(iterate_batches(batches, first_step=0, workers=workers))
        said.append((caught.value.message, caught.value.hint))
    assert said[0] == said[1]


def test_batches_go_on_where_they_were_left(source: SampleSource) -> None:
    batches = StepBatches(source, stage_of(steps=5, captured=1), seed=1)
    whole = list(iterate_batches(batches, first_step=0, workers=0))
    again = list(iterate_batches(batches, first_step=3, workers=0))
    assert all(is_equal(a, b) for a, b in zip(again, whole[3:], strict=True))
    assert not is_equal(again[0], whole[0])
    assert list(iterate_batches(batches, first_step=5, workers=0)) == []


@pytest.mark.parametrize("world", [2, 3])
def test_every_process_gets_its_share_of_the_joint_batch(source: SampleSource, world: int) -> None:
    """Rank r makes crops r, r + N, ... of rehearsed crops followed by real ones; together they are the joint batch."""
    stage = stage_of(steps=2, rehearsed=2, captured=3, swaps_views=True)
    joint = StepBatches(source, stage, seed=2)[1]
    for rank in range(world):
        mine = StepBatches(source, stage, seed=2, rank=rank, world=world)[1]
        crops = range(rank, 5, world)
        assert torch.equal(mine.ref_BCHW, joint.ref_BCHW[crops])
        assert torch.equal(mine.src_BCHW, joint.src_BCHW[crops])
        assert torch.equal(mine.truth_px_BHW.nan_to_num(-99), joint.truth_px_BHW[crops].nan_to_num(-99))
        assert mine.n_rehearsed == sum(crop < 2 for crop in crops)


def test_samples_have_the_shape_and_range_of_pictures(source: SampleSource) -> None:
    for index, made in enumerate(rehearsed(source, crops=12)):
        cut = crop_capture(source, rng=generator_for(0, index), may_swap=True)
        for sample in (made, cut):
            for view in (sample.ref, sample.src):
                assert view.shape == (*CROP_HW, 3)
                assert view.dtype == np.float32
                assert view.min() >= 0
                assert view.max() <= 1
            assert sample.truth_px.shape == CROP_HW
        assert np.isfinite(made.truth_px).all()
        assert np.isnan(cut.truth_px).all()


@pytest.mark.parametrize("enlargement", [1.0, 1.5])
def test_rehearsed_truth_fills_the_window_and_explains_the_pair(source: SampleSource, enlargement: float) -> None:
    """Without damage the source view is the reference view moved by the truth: a pixel aside is worse."""
    enlarged = replace(source, enlargement=enlargement)
    low, high = enlarged.volume_px
    assert (high - low) / (WINDOW[1] - WINDOW[0]) == pytest.approx(enlargement, abs=0.3)
    samples = rehearsed(enlarged, crops=24)
    truth_px = np.stack([sample.truth_px for sample in samples])
    assert np.mean((truth_px >= low) & (truth_px < high)) > 0.75
    low_px, high_px = np.percentile(truth_px, (10, 90))
    assert high_px - low_px > 0.4 * (high - low)
    fitting = 0
    for sample in samples:
        assert sample.occluded is not None
        assert sample.undamaged is not None
        crisp = replace(sample, ref=sample.undamaged[0], src=sample.undamaged[1])
        seen = ~sample.occluded
        errors = {off: warp_error(crisp, sample.truth_px + np.float32(off), seen) for off in (-3, -1, 0, 1, 3)}
        fitting += min(errors, key=lambda off: errors[off]) == 0
    assert fitting >= 22, "all but worlds that are plain"


def test_rehearsed_sources_are_damaged_and_references_hardly(source: SampleSource) -> None:
    """Six times fewer pixels cost src its fine detail; of ref most is left."""

    def detail(view: np.ndarray) -> float:
        return float(np.abs(view - cv2.GaussianBlur(view, (0, 0), 1.5)).mean())

    for sample in rehearsed(replace(source, asymmetry=(6.0, 6.0)), crops=8):
        assert sample.undamaged is not None
        ref, src = sample.undamaged
        smooth = [cv2.GaussianBlur(view, (0, 0), 1.0) for view in (sample.src, src)]
        assert detail(smooth[0]) < 0.8 * detail(smooth[1])
        assert detail(sample.ref) > 0.6 * detail(ref)


# What is held out


def _painted(folder: Path, *, first_held_out: int, hw: tuple[int, int] = (96, 160)) -> Capture:
    """A capture whose held-out columns are pure red and whose others have no red at all."""
    rng = np.random.default_rng(0)
    views = []
    for _ in range(2):
        view = rng.uniform(0.2, 0.9, (*hw, 3)).astype(np.float32)
        view[:, :, 0] = 0.0
        view[:, first_held_out:] = (1.0, 0.0, 0.0)
        views.append(view)
    capture = Capture("painted", folder / "tele.png", folder / "wide.png")
    write_image(capture.tele_path, views[0])
    write_image(capture.wide_path, views[1])
    return capture


@pytest.mark.parametrize("share", [0.8, 0.55])
def test_the_held_out_strip_is_never_shown(tmp_path: Path, share: float) -> None:
    capture = _painted(tmp_path, first_held_out=round(share * 160))
    shown, open_source = (source_of([capture], area=CropArea(end=end)) for end in (share, 1.0))
    red, red_if_open = 0.0, 0.0
    for index in range(40):
        whole = crop_capture(open_source, rng=generator_for(0, index), may_swap=True)
        red_if_open = max(red_if_open, float((whole.ref[..., 0] > 0.5).mean()))
        kept = crop_capture(shown, rng=generator_for(0, index), may_swap=True)
        red = max(red, float(kept.ref[..., 0].max()), float(kept.src[..., 0].max()))
    assert red_if_open > 0.2, "the paint would be seen"
    assert red < 0.05


def test_the_held_out_strip_is_no_texture_either(tmp_path: Path) -> None:
    capture = _painted(tmp_path, first_held_out=120)
    shown = source_of([capture], area=CropArea(end=0.75))
    photo = shown.reader.read(capture).tele
    before = rehearsed(shown, crops=4)
    # Other pictures in the strip, the same rehearsal.
    write_image(capture.tele_path, np.where(np.arange(160)[None, :, None] >= 120, 0.3, photo).astype(np.float32))
    after = rehearsed(source_of([capture], area=CropArea(end=0.75)), crops=4)
    for one, other in zip(before, after, strict=True):
        assert np.array_equal(one.ref, other.ref)
        assert np.array_equal(one.src, other.src)


def test_worlds_are_painted_with_the_photos(tmp_path: Path) -> None:
    """Green, blue and no red at all: what is drawn besides has all three."""
    capture = _painted(tmp_path, first_held_out=160)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(patterns, "PHOTO_SHARE", 1.0)
        painted = rehearsed(source_of([capture]), crops=6)
    assert np.mean([sample.ref.min(axis=-1).mean() < 0.12 for sample in painted]) > 0.6


def test_crops_reach_every_part_that_may_be_seen(tmp_path: Path) -> None:
    """A coordinate painted as colour shows where crops come from."""
    ramp = np.linspace(0, 1, 320, dtype=np.float32)[None, :, None]
    capture = Capture("ramp", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(capture.tele_path, np.broadcast_to(ramp, (128, 320, 3)).astype(np.float32))
    write_image(capture.wide_path, np.broadcast_to(ramp * 0.99, (128, 320, 3)).astype(np.float32))
    source = source_of([capture], area=CropArea(end=0.75))
    ends = []
    for index in range(60):
        sample = crop_capture(source, rng=generator_for(0, index), may_swap=False)
        ends.append((float(sample.ref[..., 1].min()), float(sample.ref[..., 1].max())))
    assert min(first for first, _ in ends) < 0.05
    assert 0.68 < max(end for _, end in ends) < 0.95  # 0.75, brightened by up to a quarter


# Views and disparities


def test_exchanged_views_keep_the_sign_of_the_disparity(tmp_path: Path) -> None:
    """A plane at 12 px: whichever view is the reference, and mirrored, src lies 12 px (of the crop) to the left."""
    rng = np.random.default_rng(0)
    world = cv2.GaussianBlur(rng.random((96, 172, 3), dtype=np.float32), (0, 0), 1.2)
    capture = Capture("plane", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(capture.tele_path, np.ascontiguousarray(world[:, :160]))
    write_image(capture.wide_path, np.ascontiguousarray(world[:, 12:]))
    source = source_of([capture])
    n_swapped = 0
    for index in range(20):
        plain = crop_capture(source, rng=generator_for(0, index), may_swap=False)
        sample = crop_capture(source, rng=generator_for(0, index), may_swap=True)
        n_swapped += not np.array_equal(plain.ref, sample.ref)
        seen = np.ones(CROP_HW, np.bool_)
        errors = [warp_error(sample, np.full(CROP_HW, d, np.float32), seen) for d in range(-20, 21)]
        found_px = int(np.argmin(errors)) - 20
        assert 12 * 0.7 <= found_px <= 12 * 1.25  # the crop is zoomed by 0.75 to 1.2
    assert 0 < n_swapped < 20


def test_an_exchange_mirrors_both_views(source: SampleSource) -> None:
    """Drawn alike, with and without: the former source view, mirrored, is the reference, and the other way round."""
    n_exchanged = 0
    for index in range(20):
        plain = crop_capture(source, rng=generator_for(0, index), may_swap=False)
        sample = crop_capture(source, rng=generator_for(0, index), may_swap=True)
        if not np.array_equal(sample.ref, plain.ref):
            n_exchanged += 1
            np.testing.assert_array_equal(sample.ref, plain.src[:, ::-1])
            np.testing.assert_array_equal(sample.src, plain.ref[:, ::-1])
    assert 4 <= n_exchanged <= 16


def test_colour_is_jittered_alike_in_both_views(tmp_path: Path) -> None:
    """Of one plain picture as both views every crop has equal colours; about half of the crops differ from it."""
    picture = np.full((96, 160, 3), (0.3, 0.5, 0.6), np.float32)
    capture = Capture("twin", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(capture.tele_path, picture)
    picture[0, 0] = 0.0  # the same picture twice would be refused
    write_image(capture.wide_path, picture)
    source = source_of([capture])
    tints = []
    for index in range(60):
        sample = crop_capture(source, rng=generator_for(0, index), may_swap=True)
        of_ref, of_src = (np.median(view, axis=(0, 1)) for view in (sample.ref, sample.src))
        np.testing.assert_array_equal(of_ref, of_src)
        tints.append(of_ref / source.reader.read(capture).tele[0, 0])
    gains = np.array(tints)
    is_changed = np.abs(gains - 1).max(axis=1) > 1e-3
    assert 15 <= is_changed.sum() <= 45
    changed = gains[is_changed]
    # Gamma of 0.8 to 1.2 on 0.3, brightness within a fifth, colours within 5 %: nothing beyond, and most of it used.
    assert 0.6 < changed.min() < 0.8
    assert 1.2 < changed.max() < 1.6
    assert np.ptp(changed[:, 1:] / changed[:, :1]) > 0.05


def test_exchanged_views_of_a_rendered_pair_follow_the_truth_of_src(tmp_path: Path) -> None:
    """The mirrored pair's own truth is what the renderer says of the source view's surfaces."""
    pair = rendered(2, hw=CROP_HW)
    mirrored = Sample(
        np.ascontiguousarray(pair.src[:, ::-1]),
        np.ascontiguousarray(pair.ref[:, ::-1]),
        np.full(CROP_HW, np.nan, np.float32),
    )
    height, width = CROP_HW
    src_truth = np.full(CROP_HW, np.nan, np.float32)
    for y in range(height):  # nearer surfaces last: they hide the others
        order = np.argsort(pair.disparity_px[y], kind="stable")
        x_src = np.rint(order - pair.disparity_px[y, order]).astype(int)
        inside = (x_src >= 0) & (x_src < width)
        src_truth[y, x_src[inside]] = pair.disparity_px[y, order[inside]]
    truth = np.ascontiguousarray(src_truth[:, ::-1])
    seen = np.isfinite(truth)
    filled = np.nan_to_num(truth)
    right = warp_error(mirrored, filled, seen)
    assert right < 0.5 * warp_error(mirrored, -filled, seen)
    assert right < 0.5 * warp_error(mirrored, filled + 4, seen)


def test_disparities_are_cut_and_scaled_with_the_crop(tmp_path: Path, captures: tuple[Capture, ...]) -> None:
    """Disparities that state each pixel's own column: in a crop they differ by the zoom from pixel to pixel."""
    for capture in captures:
        columns = np.broadcast_to(np.arange(144, dtype=np.float32), (96, 144)).copy()
        columns[:10] = np.nan
        write_pfm(disparity_path(tmp_path / capture.name, window_px=source_of(captures).window_px), columns)
    source = source_of(captures, disparities=tmp_path)
    for index in range(8):
        truth = crop_capture(source, rng=generator_for(0, index), may_swap=False).truth_px
        row = truth[-1]
        assert np.isfinite(row).all()
        # From one end to the other the photo's columns, times the enlargement, are the crop's columns.
        assert (row[-1] - row[0]) / (CROP_HW[1] - 1) == pytest.approx(1.0, abs=0.03)
    swapped = [crop_capture(source, rng=generator_for(0, i), may_swap=True).truth_px for i in range(20)]
    assert any(np.isnan(truth).all() for truth in swapped), "disparities are of ref: none after an exchange"


def test_pictures_smaller_than_a_crop_are_enlarged(tmp_path: Path) -> None:
    pair = rendered(1, hw=(40, 48))
    capture = Capture("small", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(capture.tele_path, pair.ref)
    write_image(capture.wide_path, pair.src)
    sample = crop_capture(source_of([capture]), rng=generator_for(0), may_swap=False)
    assert sample.ref.shape == (*CROP_HW, 3)


@pytest.mark.parametrize("enlargement", [1.0, 1.5])
@pytest.mark.parametrize(
    ("disparity_px", "window"), [((100, 120), (96, 128)), ((-60, -40), (-64, -32)), ((4, 24), (0, 32))]
)
def test_zoomed_crops_stay_in_a_window_far_from_zero(
    tmp_path: Path, disparity_px: tuple[int, int], window: tuple[int, int], enlargement: float
) -> None:
    """A slanted wall: disparities of every crop lie in the window, and tell where src shows what ref shows."""
    rng = np.random.default_rng(0)
    hw = (96, 400)
    slant_px = np.broadcast_to(np.linspace(*disparity_px, hw[1], dtype=np.float32), hw).copy()
    src = cv2.GaussianBlur(rng.random((*hw, 3), dtype=np.float32), (0, 0), 2.0)
    columns = np.arange(hw[1], dtype=np.float32) - slant_px
    rows = np.broadcast_to(np.arange(hw[0], dtype=np.float32)[:, None], hw)
    ref = cv2.remap(src, columns, np.ascontiguousarray(rows), cv2.INTER_LINEAR)
    capture = Capture("wall", tmp_path / "tele.png", tmp_path / "wide.png")
    write_image(capture.tele_path, ref)
    write_image(capture.wide_path, src)
    write_pfm(disparity_path(tmp_path / "wall", window_px=window), slant_px)
    source = SampleSource(
        (capture,), crop_hw=CROP_HW, window_px=window, enlargement=enlargement, disparities_folder=tmp_path
    )
    for index in range(40):
        sample = crop_capture(source, rng=generator_for(0, index), may_swap=False)
        assert source.volume_px[0] <= sample.truth_px.min()
        assert sample.truth_px.max() < source.volume_px[1]
        x_src_px = np.arange(CROP_HW[1]) - sample.truth_px
        seen = (x_src_px > 1) & (x_src_px < CROP_HW[1] - 2)
        if seen.sum() > 200:
            assert warp_error(sample, sample.truth_px, seen) < 0.02


def test_crops_without_room_beside_them_keep_their_window(tmp_path: Path) -> None:
    """A window so far from zero that a zoomed crop would leave src: disparities are still those of its enlargement."""
    hw, window = (96, 130), (190, 200)
    capture = Capture("far", tmp_path / "tele.png", tmp_path / "wide.png")
    for seed, path in enumerate((capture.tele_path, capture.wide_path)):
        write_image(path, np.random.default_rng(seed).random((*hw, 3), dtype=np.float32))
    write_pfm(disparity_path(tmp_path / "far", window_px=window), np.full(hw, 195, dtype=np.float32))
    source = SampleSource((capture,), crop_hw=CROP_HW, window_px=window, enlargement=1.5, disparities_folder=tmp_path)
    for index in range(8):
        truth_px = crop_capture(source, rng=generator_for(0, index), may_swap=False).truth_px
        assert source.volume_px[0] <= truth_px.min() <= truth_px.max() < source.volume_px[1]


@pytest.mark.parametrize(
    ("sizes_hw", "expected"),
    [([(900, 1200)], (256, 384)), ([(900, 1200), (250, 300)], (240, 288)), ([(40, 50)], (64, 64))],
)
def test_a_crop_is_no_larger_than_the_smallest_picture(
    sizes_hw: list[tuple[int, int]], expected: tuple[int, int]
) -> None:
    assert fitting_crop((256, 384), sizes_hw) == expected
