"""What a step minimises: values written out by hand, the truth of rendered pairs, and batches split over processes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter
from training.small import WINDOW, rendered, stage_of, tensor_of

from telewide.geometry.arrays import FloatArray
from telewide.matching.networks import NetworkOutput, build_network, standardise
from telewide.matching.volume import plane_disparities_px
from telewide.training.checkpoint import frozen_extractor
from telewide.training.objective import Batch, objective
from telewide.training.options import StageOptions
from telewide.training.stages import Stage


def a_batch(n_rehearsed: int, n_captured: int, *, has_truth: bool = False) -> Batch:
    pairs = [rendered(seed, hw=(64, 96)) for seed in range(n_rehearsed + n_captured)]
    truth = torch.stack([torch.from_numpy(pair.disparity_px) for pair in pairs])
    if not has_truth:
        truth[n_rehearsed:] = torch.nan
    ref, src = (torch.cat([tensor_of(getattr(pair, view)) for pair in pairs]) for view in ("ref", "src"))
    return Batch(ref, src, truth, n_rehearsed)


def part_of(batch: Batch, crops: list[int]) -> Batch:
    n = sum(crop < batch.n_rehearsed for crop in crops)
    return Batch(batch.ref_BCHW[crops], batch.src_BCHW[crops], batch.truth_px_BHW[crops], n)


def output_of(batch: Batch) -> NetworkOutput:
    network = build_network("lite", seed=1)
    output: NetworkOutput = network(standardise(batch.ref_BCHW), standardise(batch.src_BCHW), WINDOW)
    return output


STAGES = {
    "exact crops of both kinds": stage_of(steps=1, rehearsed=1, retaken=1, captured=2, captured_loss="photometric"),
    "supervised": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="supervised"),
    "photometric": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="photometric"),
    "photometric without masks": stage_of(
        steps=1, rehearsed=2, captured=2, captured_loss="photometric", occlusion_masks=False
    ),
    "feature": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="feature"),
}


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_shares_of_processes_add_up_to_the_joint_loss(stage: Stage) -> None:
    """Counts are of the joint batch: whoever has which crops, none of a kind included, sums and gradients agree."""
    batch = a_batch(2, 2, has_truth=True)
    teacher = frozen_extractor(build_network("lite", seed=2)) if stage.needs_teacher else None
    counts: list[torch.Tensor] = []

    def remember(value: torch.Tensor) -> torch.Tensor:
        counts.append(value)
        return value

    def loss_of(part: Batch, reduce: object) -> torch.Tensor:
        assert callable(reduce)
        loss, _ = objective(output_of(part), part, stage, window=WINDOW, teacher=teacher, global_sum=reduce)
        return loss

    with torch.no_grad():
        joint = loss_of(batch, remember)
        joint_counts = counts[0]
        for crops in ([[0, 2], [1, 3]], [[0], [1, 2, 3]], [[0, 1], [2, 3]]):
            counts.clear()
            for part in crops:
                loss_of(part_of(batch, part), remember)
            torch.testing.assert_close(sum(counts[::2]), joint_counts, rtol=1e-3, atol=0.5)
            shares = [loss_of(part_of(batch, part), lambda _: joint_counts) for part in crops]
            # In bf16 a crop's result depends a little on its batch mates' memory layout.
            assert float(sum(shares)) == pytest.approx(float(joint), rel=2e-2)


def test_every_process_adds_up_the_same_terms() -> None:
    """One with no real crop, or with no rehearsed one, must not fall out of step with the others."""
    for stage in STAGES.values():
        teacher = frozen_extractor(build_network("lite")) if stage.needs_teacher else None
        batch = a_batch(2, 2, has_truth=True)
        sizes = set()
        for crops in ([0, 1], [2, 3], [0, 2]):
            part = part_of(batch, crops)
            asked: list[torch.Size] = []

            def note(value: torch.Tensor, asked: list[torch.Size] = asked) -> torch.Tensor:
                asked.append(value.shape)
                return value

            loss, _ = objective(output_of(part), part, stage, window=WINDOW, teacher=teacher, global_sum=note)
            loss.backward()
            sizes.add(tuple(asked))
        assert len(sizes) == 1


def test_parts_are_named_and_sum_to_the_loss() -> None:
    batch = a_batch(1, 1)
    stage = stage_of(steps=1, rehearsed=1, captured=1, captured_loss="photometric", smoothness=0.1)
    loss, parts = objective(output_of(batch), batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)
    assert set(parts) == {"rehearsal", "photometric", "smoothness"}
    assert float(loss.detach()) == pytest.approx(sum(parts.values()), rel=1e-5)


def test_weights_scale_their_parts() -> None:
    batch = a_batch(1, 1)
    output = output_of(batch)
    parts = []
    for weight, smoothness in ((1.0, 0.1), (0.5, 0.4)):
        stage = stage_of(
            steps=1, rehearsed=1, captured=1, captured_loss="photometric", captured_weight=weight, smoothness=smoothness
        )
        parts.append(objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)[1])
    assert parts[1]["rehearsal"] == pytest.approx(parts[0]["rehearsal"])
    assert parts[1]["photometric"] == pytest.approx(0.5 * parts[0]["photometric"])
    assert parts[1]["smoothness"] == pytest.approx(2 * parts[0]["smoothness"])


def test_the_truth_costs_less_than_anything_beside_it() -> None:
    batch = a_batch(2, 0)
    stage = stage_of(steps=1, rehearsed=2)
    logits = output_of(batch).logits_BDHW

    def beside(offset_px: float) -> float:
        output = NetworkOutput([batch.truth_px_BHW + offset_px], logits)
        return float(objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)[0].detach())

    assert beside(0) < min(beside(-1), beside(1)) < beside(4)


def test_the_extractor_of_the_stage_before_stays_as_it_is() -> None:
    batch = a_batch(0, 1)
    network = build_network("lite", seed=1)
    teacher = frozen_extractor(network)
    stage = stage_of(steps=1, captured=1, captured_loss="feature", smoothness=0.0)
    output = network(standardise(batch.ref_BCHW), standardise(batch.src_BCHW), WINDOW)
    loss, _ = objective(output, batch, stage, window=WINDOW, teacher=teacher, global_sum=lambda x: x)
    loss.backward()
    assert all(parameter.grad is None for parameter in teacher.parameters())
    assert not teacher.training
    assert any(p.grad is not None and bool(p.grad.any()) for p in network.parameters())
    with pytest.raises(ValueError, match="no extractor"):
        objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)


def test_a_truth_outside_the_window_is_no_lesson() -> None:
    batch = a_batch(1, 0)
    far = Batch(batch.ref_BCHW, batch.src_BCHW, batch.truth_px_BHW + 1000, 1)
    stage = stage_of(steps=1, rehearsed=1)
    loss, _ = objective(output_of(batch), far, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)
    assert float(loss.detach()) == 0


# What the real crops are compared by, against a value written out by hand


class _Extractor(torch.nn.Module):
    """Frozen features at a quarter of the size that are neither linear nor blind to gain and offset."""

    def __init__(self) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(3)
            self.conv = torch.nn.Conv2d(3, 5, 5, stride=4, padding=2).double()
        self.requires_grad_(False)
        self.seen: list[torch.Tensor] = []

    def forward(self, image_BCHW: torch.Tensor) -> tuple[torch.Tensor]:
        self.seen.append(image_BCHW.detach())
        features: torch.Tensor = self.conv(image_BCHW.double())
        return (features.square() + features,)


def real_crop(seed: int = 3) -> tuple[Batch, torch.Tensor, torch.Tensor]:
    """A rendered pair taken for a real one, its truth, and logits that hold the truth; float64."""
    pair = rendered(seed, hw=(64, 96))
    ref, src = (tensor_of(view).double() for view in (pair.ref, pair.src))
    truth_px = torch.from_numpy(pair.disparity_px)[None].double()
    planes = plane_disparities_px(WINDOW)[:, None, None]
    logits = -(((truth_px[:, None, 2::4, 2::4] - planes) / 3) ** 2)
    return Batch(ref, src, torch.full_like(truth_px, torch.nan), 0), truth_px, logits


def loss_at(
    disparities_px: list[torch.Tensor], logits: torch.Tensor, batch: Batch, stage: Stage, teacher: torch.nn.Module
) -> torch.Tensor:
    """The objective of a network that answers with these disparities."""
    output = NetworkOutput(disparities_px, logits)
    return objective(output, batch, stage, window=WINDOW, teacher=teacher, global_sum=lambda x: x)[0]


def standard_by_hand(view: FloatArray) -> FloatArray:
    """(3, H, W) each channel at mean 0 and deviation 1, less where it is flat."""
    centred = view - view.mean(axis=(1, 2), keepdims=True)
    return centred / (centred.std(axis=(1, 2), keepdims=True) + 0.02)


def warp_by_hand(view: FloatArray, disparity_px: FloatArray) -> FloatArray:
    """(C, H, W) linear between ``view[x - d]``, zero outside."""
    x_px = np.arange(view.shape[2]) - disparity_px
    left = np.floor(x_px).astype(int)
    padded = np.pad(view, ((0, 0), (0, 0), (64, 64)))
    rows = np.arange(view.shape[1])[:, None]
    return padded[:, rows, left + 64] * (1 - x_px + left) + padded[:, rows, left + 65] * (x_px - left)


def difference_by_hand(a: FloatArray, b: FloatArray, *, alpha: float) -> FloatArray:
    """(H - 2, W - 2) of two (C, H, W): eq. 3, SSIM over 3x3 with the constants of its authors."""

    def box(x: FloatArray) -> FloatArray:
        return uniform_filter(x, (1, 3, 3))

    mu_a, mu_b = box(a), box(b)
    var_a, var_b, cov = box(a * a) - mu_a**2, box(b * b) - mu_b**2, box(a * b) - mu_a * mu_b
    ssim = (2 * mu_a * mu_b + 0.0001) * (2 * cov + 0.0009) / ((mu_a**2 + mu_b**2 + 0.0001) * (var_a + var_b + 0.0009))
    return (np.abs(a - b) + alpha * (1 - ssim)).mean(axis=0)[1:-1, 1:-1]


def smoothness_by_hand(disparity_px: FloatArray, ref: FloatArray) -> float:
    """Eq. 6 over the sum of its weights, halved: two directions."""
    total, weights = 0.0, 0.0
    for axis in (0, 1):
        weight = np.exp(-np.abs(np.diff(ref, axis=axis + 1)).mean(axis=0))
        total += float((weight * np.abs(np.diff(disparity_px, axis=axis))).sum())
        weights += float(weight.sum())
    return 2 * total / weights


@pytest.mark.parametrize("kind", ["photometric", "feature"])
def test_the_objective_of_a_real_crop_is_warp_then_extract(kind: str) -> None:
    """Two outputs, the coarse one at 0.4: the source image is warped, then seen by the extractor, both standardised."""
    batch, truth_px, logits = real_crop()
    stage = stage_of(
        steps=1,
        captured=1,
        captured_loss=kind,
        captured_weight=0.7,
        alpha=1.5,
        smoothness=0.3,
        occlusion_masks=False,
    )
    teacher = _Extractor()
    answers = [truth_px + 1.25, truth_px - 0.4]
    found = float(loss_at(answers, logits, batch, stage, teacher))
    ref, src = batch.ref_BCHW[0].numpy(), batch.src_BCHW[0].numpy()
    expected = 0.0
    for weight, answer in zip((0.4, 1.0), answers, strict=True):
        disparity_px = answer[0].numpy()
        x_src_px = np.arange(96) - disparity_px
        inside = (x_src_px >= 0) & (x_src_px <= 95)
        if kind == "photometric":
            difference = difference_by_hand(ref, warp_by_hand(src, disparity_px), alpha=1.5)
        else:
            warped = warp_by_hand(standard_by_hand(src), disparity_px)
            seen = (teacher(torch.from_numpy(view)[None])[0][0].numpy() for view in (standard_by_hand(ref), warped))
            unit = (features / np.sqrt((features**2).sum(axis=0)) for features in seen)
            difference = difference_by_hand(*unit, alpha=1.5)
            inside = inside.reshape(16, 4, 24, 4).all(axis=(1, 3))
        counted = inside[1:-1, 1:-1]
        assert 0 < counted.sum() < counted.size
        expected += weight * 0.7 * float(difference[counted].mean())
        expected += weight * 0.7 * 0.3 * smoothness_by_hand(disparity_px, ref)
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("has_masks", [True, False])
@pytest.mark.parametrize("kind", ["photometric", "feature"])
@pytest.mark.parametrize("seed", [3, 5])
def test_the_objective_of_a_real_crop_is_least_at_the_truth(kind: str, has_masks: bool, seed: int) -> None:
    batch, truth_px, logits = real_crop(seed)
    stage = stage_of(steps=1, captured=1, captured_loss=kind, smoothness=0.0, occlusion_masks=has_masks)
    losses = {
        offset_px: float(loss_at([truth_px + offset_px], logits, batch, stage, _Extractor()))
        for offset_px in (-4.0, -2.0, 0.0, 2.0, 4.0)
    }
    assert min(losses, key=lambda key: losses[key]) == 0.0
    assert losses[0.0] < 0.75 * min(losses[-2.0], losses[2.0])
    assert losses[0.0] < 0.5 * float(loss_at([-truth_px], logits, batch, stage, _Extractor()))


@pytest.mark.parametrize("kind", ["photometric", "feature", "smoothness"])
def test_each_term_alone_passes_its_gradient_to_the_disparity(kind: str) -> None:
    """Against finite differences along a random direction, everything else switched off."""
    batch, truth_px, logits = real_crop()
    options = {"captured_loss": "photometric", "alpha": 0.0, "captured_weight": 1e-9, "smoothness": 1e9}
    if kind != "smoothness":
        options = {"captured_loss": kind, "alpha": 3.0, "smoothness": 0.0}
    stage = stage_of(steps=1, captured=1, **options)
    teacher = _Extractor()
    # Away from whole pixels and from equal neighbours, where a bilinear look-up and a magnitude have kinks.
    generator = torch.Generator().manual_seed(0)
    away_px = 0.3 + 0.3 * torch.rand(truth_px.shape, generator=generator, dtype=torch.float64)
    disparity_px = (truth_px.floor() + away_px).requires_grad_()
    direction = torch.randn(truth_px.shape, generator=generator, dtype=torch.float64)
    (gradient,) = torch.autograd.grad(loss_at([disparity_px], logits, batch, stage, teacher), disparity_px)
    assert (gradient != 0).float().mean() > 0.5
    step = 1e-5
    ahead, behind = (
        float(loss_at([disparity_px.detach() + s * direction], logits, batch, stage, teacher)) for s in (step, -step)
    )
    assert float((gradient * direction).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-3)
    if kind != "smoothness":  # so that descending moves towards the truth
        beside_px = (truth_px + 0.8).requires_grad_()
        (slope,) = torch.autograd.grad(loss_at([beside_px], logits, batch, stage, teacher), beside_px)
        assert float(slope.sum()) > 0


def test_the_frozen_extractor_sees_standardised_views_and_learns_nothing() -> None:
    batch, truth_px, logits = real_crop()
    teacher = _Extractor()
    stage = stage_of(steps=1, captured=1, captured_loss="feature")
    dark = Batch(0.3 * batch.ref_BCHW + 0.1, 0.5 * batch.src_BCHW, batch.truth_px_BHW, 0)
    loss_at([truth_px], logits, dark, stage, teacher)
    of_ref, of_src = teacher.seen
    np.testing.assert_allclose(of_ref[0], standard_by_hand(dark.ref_BCHW[0].numpy()), atol=1e-5)
    warped = warp_by_hand(standard_by_hand(dark.src_BCHW[0].numpy()), truth_px[0].numpy())
    np.testing.assert_allclose(of_src[0], warped, atol=1e-4)
    assert all(parameter.grad is None for parameter in teacher.parameters())


def test_smoothness_follows_the_edges_of_ref() -> None:
    """A step of the disparity is cheap where ref has an edge, whatever src shows."""
    step_px = torch.zeros(1, 64, 96)
    step_px[..., 48:] = 8.0
    edge, plain = torch.zeros(1, 3, 64, 96), torch.full((1, 3, 64, 96), 0.5)
    edge[..., 48:] = 1.0
    stage = stage_of(steps=1, captured=1, captured_loss="photometric", smoothness=0.1)
    logits = torch.zeros(1, 8, 16, 24)
    parts = [
        objective(
            NetworkOutput([step_px], logits),
            Batch(ref, src, torch.full((1, 64, 96), torch.nan), 0),
            stage,
            window=WINDOW,
            teacher=None,
            global_sum=lambda x: x,
        )[1]["smoothness"]
        for ref, src in ((edge, plain), (plain, edge))
    ]
    # By hand: 64 steps of 8 px, over half of all 64 * 95 + 63 * 96 neighbours.
    assert parts[1] == pytest.approx(0.1 * 64 * 8 / (12128 / 2), rel=1e-4)
    assert parts[0] == pytest.approx(0.1 * 64 * 8 * 0.367879 / ((12128 - 64 * 0.632121) / 2), rel=1e-4)


@pytest.mark.parametrize("has_masks", [True, False])
@pytest.mark.parametrize("kind", ["photometric", "feature"])
def test_what_src_does_not_show_is_left_out(kind: str, has_masks: bool) -> None:
    """A wall at 8 px, a bar at 24 px before it: counted by hand, columns outside src and, with masks, the hidden ones.

    The bar covers columns 48 to 71; left of it, from 32, src sees the bar and not the wall. Outside src lie the columns
    up to 7. A window of 3x3 that has no whole pixel beside it is no pixel of the loss: the border is left out.
    """
    disparity_px = torch.full((1, 64, 96), 8.0)
    disparity_px[..., 48:72] = 24.0
    logits = torch.full((1, 8, 16, 24), -20.0)
    logits[:, 2], logits[:, 6] = 20.0, -20.0
    logits[:, 2, :, 12:18], logits[:, 6, :, 12:18] = -20.0, 20.0
    batch = Batch(torch.rand(1, 3, 64, 96), torch.rand(1, 3, 64, 96), torch.full((1, 64, 96), torch.nan), 0)
    stage = stage_of(steps=1, captured=1, captured_loss=kind, occlusion_masks=has_masks)
    counts: list[torch.Tensor] = []

    def note(value: torch.Tensor) -> torch.Tensor:
        counts.append(value)
        return value

    output = NetworkOutput([disparity_px], logits)
    objective(output, batch, stage, window=WINDOW, teacher=_Extractor(), global_sum=note)
    columns, rows = (94 - 7, 62) if kind == "photometric" else (22 - 1, 14)
    hidden = (16 if kind == "photometric" else 4) if has_masks else 0
    assert float(counts[0][0]) == rows * (columns - hidden)


def test_heads_are_taught_what_is_sure_and_what_is_hidden() -> None:
    truth_px = torch.full((1, 8, 8), 4.0)
    disparity_px = truth_px.clone()
    disparity_px[:, :, 4:] += 1.5
    occluded = torch.zeros(1, 8, 8, dtype=torch.bool)
    occluded[:, :2] = True
    right = torch.where(torch.stack(((disparity_px - truth_px) < 1, occluded), dim=1), 8.0, -8.0)
    losses = [_head_losses(heads, disparity_px, truth_px, occluded) for heads in (right, -right, right.flip(1))]
    assert max(losses[0].values()) < 1e-3
    assert min(losses[1].values()) > 1
    assert min(losses[2].values()) > 0.2


def test_what_the_window_does_not_hold_teaches_the_heads_nothing() -> None:
    truth_px = torch.full((1, 8, 8), 99.0)
    heads = torch.full((1, 2, 8, 8), 5.0)
    losses = _head_losses(heads, truth_px, truth_px, torch.zeros(1, 8, 8, dtype=torch.bool))
    assert set(losses.values()) == {0.0}


def _head_losses(
    heads_BCHW: torch.Tensor, disparity_px: torch.Tensor, truth_px: torch.Tensor, occluded: torch.Tensor
) -> dict[str, float]:
    image = torch.zeros(1, 3, 8, 8)
    output = NetworkOutput([disparity_px], torch.zeros(1, 4, 2, 2), heads_BCHW)
    batch = Batch(image, image, truth_px, 1, occluded)
    stage = Stage("rehearsal", 0, StageOptions(steps=1, rehearsed=1))
    _, parts = objective(output, batch, stage, window=(0, 16), teacher=None, global_sum=lambda x: x)
    return {name: parts[name] for name in ("sure", "hidden")}
