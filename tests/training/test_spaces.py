"""Feature spaces of their own: losses written out by hand, shapes, and that each is learned in a few steps."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from training.small import CROP_HW, WINDOW, rendered, stage_of, tensor_of

from telewide.matching.networks import build_network, comparable_map, prepare_view
from telewide.training.auto_encoder import AutoEncoder, auto_encoder_terms, differences
from telewide.training.contrastive import NEGATIVE_OFFSETS_PX, contrastive_loss
from telewide.training.losses import Term
from telewide.training.objective import Batch
from telewide.training.spaces import SPACES, build_space, space_objective


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def mean_of(term: Term) -> float:
    return float(term.total / term.count)


def test_the_contrastive_loss_is_its_formula() -> None:
    """Pixel by pixel, at whole disparities: half the squared distance of matches, half the squared lack of others."""
    ref, src = (torch.nn.functional.normalize(rand(1, 3, 3, 64, seed=s) - 0.5, dim=1) for s in (1, 2))
    total, count = 0.0, 0
    for y in range(3):
        for x in range(64):
            matches = [(x - 5, None)] + [(x - 5 - offset, offset) for offset in NEGATIVE_OFFSETS_PX]
            for column, offset in matches:
                if not 0 <= column < 64:
                    continue
                apart = float((ref[0, :, y, x] - src[0, :, y, column]).norm())
                if offset is None:
                    total, count = total + apart**2 / 2, count + 1
                else:
                    total += max(0.0, 0.5 - apart) ** 2 / 2 / len(NEGATIVE_OFFSETS_PX)
    term = contrastive_loss(ref, src, torch.full((1, 3, 64), 5.0, dtype=torch.float64))
    assert float(term.count) == count
    assert float(term.total) == pytest.approx(total, rel=1e-4)
    assert len(NEGATIVE_OFFSETS_PX) == 10


def test_the_contrastive_gradient() -> None:
    ref, src = rand(1, 3, 2, 40).requires_grad_(), rand(1, 3, 2, 40, seed=1).requires_grad_()
    disparity_px = torch.full((1, 2, 40), 3.0, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda a, b: contrastive_loss(a, b, disparity_px).total, (ref, src), atol=1e-4)


def test_slopes_and_bends_are_differences_that_the_picture_excuses() -> None:
    """First and second differences times ``exp(-|that of the picture|)``: by hand, of a ramp, and of a parabola."""
    features, image = rand(2, 4, 6, 7), rand(2, 3, 6, 7, seed=1)
    f, i = features.numpy(), image.numpy()
    for order in (1, 2):
        for axis, found in zip((3, 2), differences(features, image, order=order), strict=True):
            weight = np.exp(-np.abs(np.diff(i, n=order, axis=axis)).mean(axis=1, keepdims=True))
            expected = (np.abs(np.diff(f, n=order, axis=axis)) * weight).mean()
            assert mean_of(found) == pytest.approx(expected)
    x = torch.arange(7, dtype=torch.float64).expand(1, 1, 6, 7)
    flat = torch.zeros(1, 3, 6, 7, dtype=torch.float64)
    assert [mean_of(step) for step in differences(2 * x, flat, order=1)] == pytest.approx([2.0, 0.0])
    assert [mean_of(bend) for bend in differences(x * x, flat, order=2)] == pytest.approx([2.0, 0.0])


def test_differences_across_the_border_of_a_mask_do_not_count() -> None:
    """Two plateaus and the step between them: the slope is 0 where only one of them was photographed."""
    features = torch.zeros(1, 1, 4, 8, dtype=torch.float64)
    features[..., 5:] = 3.0
    photographed = torch.arange(8).expand(1, 4, 8) < 5
    for order, counts in ((1, 4 * 4), (2, 4 * 3)):
        along_x, _ = differences(features, torch.zeros(1, 3, 4, 8), order=order, mask_BHW=photographed)
        assert (float(along_x.total), float(along_x.count)) == (0.0, counts)
        assert float(differences(features, torch.zeros(1, 3, 4, 8), order=order)[0].total) > 0


@pytest.mark.parametrize(("name", "shape"), [("contrastive", (2, 3, 64, 96)), ("auto-encoder", (2, 64, 32, 48))])
def test_a_space_has_one_map_to_compare_in(name: str, shape: tuple[int, ...]) -> None:
    space = build_space(name).eval()
    image = torch.rand(2, 3, 64, 96)
    with torch.no_grad():
        found = comparable_map(space, prepare_view(space, image))
    assert found.shape == shape
    if name == "contrastive":
        torch.testing.assert_close(found.norm(dim=1), torch.ones(2, 64, 96))
    state = torch.random.get_rng_state()
    again, other = build_space(name), build_space(name, seed=1)
    assert torch.equal(torch.random.get_rng_state(), state)
    weights = [next(s.parameters()) for s in (space, again, other)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_an_auto_encoder_rebuilds_four_sizes_from_its_deepest_map_alone() -> None:
    space = AutoEncoder().eval()
    with torch.no_grad():
        maps = space(torch.rand(1, 3, 64, 128))
        pictures = space.decode(maps[-1])
    assert [m.shape[-1] for m in maps] == [64, 32, 16, 8, 4]
    assert [tuple(p.shape) for p in pictures] == [(1, 3, 64 // n, 128 // n) for n in (8, 4, 2, 1)]
    assert all(p.min() >= 0 and p.max() <= 1 for p in pictures)


@pytest.mark.parametrize("name", SPACES)
def test_a_space_is_learned(name: str) -> None:
    """A few steps on one batch lower what teaches it, every weight takes part, and the network stays as it is."""
    pairs = [rendered(seed, hw=CROP_HW) for seed in (0, 1)]
    ref, src = (torch.cat([tensor_of(getattr(pair, view)) for pair in pairs]) for view in ("ref", "src"))
    batch = Batch(ref, src, torch.full((2, *CROP_HW), torch.nan), 0)
    stage, network, space = stage_of(steps=1, captured=2), build_network("lite"), build_space(name).train()
    stage = type(stage)("space", 0, stage.options, name)  # type: ignore[arg-type]
    before = [p.clone() for p in network.parameters()]
    optimiser = torch.optim.Adam(space.parameters(), lr=1e-3)
    losses = []
    for _ in range(12):
        loss, parts = space_objective(space, batch, stage, network=network, window=WINDOW, global_sum=lambda x: x)
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        assert [key for key, p in space.named_parameters() if p.grad is None] == []
        optimiser.step()
        losses.append(float(loss.detach()))
        assert sum(parts.values()) == pytest.approx(losses[-1], rel=1e-4)
    assert losses[-1] < losses[0] - 0.05 * abs(losses[0])
    assert all(torch.equal(a, b) for a, b in zip(before, network.parameters(), strict=True))


def test_an_auto_encoder_without_crops_has_the_terms_of_one_with_crops() -> None:
    """Processes add their terms up one by one; one of them may have no real crop of the joint batch."""
    space = AutoEncoder().eval()
    names = []
    for crops in (0, 1):
        view, disparity_px = torch.rand(crops, 3, 64, 64), torch.zeros(crops, 64, 64)
        names.append([name for name, _ in auto_encoder_terms(space, view, view, disparity_px_BHW=disparity_px)])
    assert names[0] == names[1]


@pytest.mark.parametrize("hw", [(96, 128), (96, 112), (80, 144)])
def test_whole_masks_change_nothing_at_any_size_of_crop(hw: tuple[int, int]) -> None:
    """Crops of small pictures are multiples of 16 px, which halving five times does not divide."""
    view = torch.rand(1, 3, *hw, generator=torch.Generator().manual_seed(0))
    whole = torch.ones(1, *hw, dtype=torch.bool)
    disparity_px = torch.zeros(1, *hw)
    torch.manual_seed(0)
    space = AutoEncoder()
    plain, masked = (
        auto_encoder_terms(space, view, view, disparity_px_BHW=disparity_px, valid=valid)
        for valid in (None, (whole, whole))
    )
    for (name, one), (_, other) in zip(plain, masked, strict=True):
        torch.testing.assert_close(one.total, other.total, msg=name)
        assert one.count == other.count > 0
