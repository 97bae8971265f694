"""What a step minimises: which terms a stage has, and that the batch may be split over processes."""

from __future__ import annotations

import pytest
import torch
from training.small import WINDOW, rendered, stage_of, tensor_of

from telewide.matching.networks import NetworkOutput, build_network, standardise
from telewide.training.checkpoint import frozen_extractor
from telewide.training.objective import Batch, objective
from telewide.training.stages import Stage


def a_batch(n_rehearsed: int, n_captured: int, *, has_labels: bool = False) -> Batch:
    pairs = [rendered(seed, hw=(64, 96)) for seed in range(n_rehearsed + n_captured)]
    truth = torch.stack([torch.from_numpy(pair.disparity_px) for pair in pairs])
    if not has_labels:
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
    "labels": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="labels"),
    "photometric": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="photometric"),
    "photometric without masks": stage_of(
        steps=1, rehearsed=2, captured=2, captured_loss="photometric", occlusion_masks=False
    ),
    "feature": stage_of(steps=1, rehearsed=2, captured=2, captured_loss="feature", labels_weight=0.3),
}


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_shares_of_processes_add_up_to_the_joint_loss(stage: Stage) -> None:
    """Counts are of the joint batch: whoever has which crops, none of a kind included, sums and gradients agree."""
    batch = a_batch(2, 2, has_labels=True)
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
        batch = a_batch(2, 2, has_labels=True)
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

    def loss_at(offset_px: float) -> float:
        output = NetworkOutput([batch.truth_px_BHW + offset_px], logits)
        return float(objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)[0].detach())

    assert loss_at(0) < min(loss_at(-1), loss_at(1)) < loss_at(4)


def test_the_extractor_of_the_stage_before_stays_as_it_is() -> None:
    batch = a_batch(0, 1)
    network = build_network("lite", seed=1)
    teacher = frozen_extractor(network)
    stage = stage_of(steps=1, captured=1, captured_loss="feature")
    output = network(standardise(batch.ref_BCHW), standardise(batch.src_BCHW), WINDOW)
    loss, _ = objective(output, batch, stage, window=WINDOW, teacher=teacher, global_sum=lambda x: x)
    loss.backward()
    assert all(parameter.grad is None for parameter in teacher.parameters())
    assert not teacher.training
    assert any(p.grad is not None and bool(p.grad.any()) for p in network.parameters())
    with pytest.raises(ValueError, match="no extractor"):
        objective(output, batch, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)


def test_labels_outside_the_window_are_no_lesson() -> None:
    batch = a_batch(1, 0)
    far = Batch(batch.ref_BCHW, batch.src_BCHW, batch.truth_px_BHW + 1000, 1)
    stage = stage_of(steps=1, rehearsed=1)
    loss, _ = objective(output_of(batch), far, stage, window=WINDOW, teacher=None, global_sum=lambda x: x)
    assert float(loss.detach()) == 0
