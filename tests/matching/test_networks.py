"""Both networks: size, parts, any image size, negative windows, independence, and how one is added."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from telewide.errors import UsageError
from telewide.matching.inference import full_precision, match_with_network
from telewide.matching.lite import LiteFeatures, LiteMatching
from telewide.matching.networks import NETWORKS, SIZE_MULTIPLE_PX, StereoNetwork, build_network, standardise
from telewide.matching.volume import concatenate_views, expect_disparity

NAMES = ["lite", "psmnet-s"]


def randn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def count_parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_lite_has_the_stated_size() -> None:
    assert count_parameters(build_network("lite")) == 684_639


def test_unknown_networks_are_named_with_the_known_ones() -> None:
    with pytest.raises(UsageError) as raised:
        build_network("light")
    assert "light" in raised.value.message
    assert all(name in str(raised.value.hint) for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_features_and_matching_can_be_used_apart(name: str) -> None:
    network = build_network(name).eval()
    ref, src = (standardise(randn(1, 3, 64, 96, seed=seed)) for seed in (0, 1))
    with torch.inference_mode():
        maps = network.features(ref)
        assert maps[0].shape[-2:] == (16, 24)
        disparities, logits = network.matching(maps, network.features(src), (0, 32))
        whole = network(ref, src, (0, 32))
    assert all(disparity.shape == (1, 64, 96) for disparity in disparities)
    assert logits.shape == (1, 8, 16, 24)
    # Rounding alone: an untrained psmnet-s has logits in the hundreds.
    torch.testing.assert_close(disparities[-1], whole.disparity_px, atol=0.2, rtol=0)
    torch.testing.assert_close(logits, whole.logits_BDHW, atol=0.1, rtol=1e-4)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("window", [(0, 32), (-16, 16), (-40, -8), (4, 12)])
def test_disparities_lie_in_any_window(name: str, window: tuple[int, int]) -> None:
    network = build_network(name).eval()
    with torch.inference_mode():
        output = network(randn(1, 3, 64, 96), randn(1, 3, 64, 96, seed=1), window)
    assert output.disparity_px.shape == (1, 64, 96)
    assert output.logits_BDHW.shape == (1, (window[1] - window[0]) // 4, 16, 24)
    margin_px = 2 if name == "psmnet-s" else 4
    assert output.disparity_px.min() >= window[0] - margin_px
    assert output.disparity_px.max() <= window[1] + margin_px


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("hw", [(49, 83), (64, 96), (33, 35)])
def test_output_has_the_size_of_odd_images(name: str, hw: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    ref, src = (rng.random((*hw, 3), dtype=np.float32) for _ in range(2))
    matched = match_with_network(ref, src, network=build_network(name), window=(-16, 16))
    assert matched.disparity_px.shape == matched.confidence.shape == matched.valid.shape == hw
    assert np.isfinite(matched.disparity_px).all()


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_same_weights(name: str) -> None:
    state = torch.random.get_rng_state()
    first, again, other = (build_network(name, seed=seed) for seed in (3, 3, 4))
    assert torch.equal(torch.random.get_rng_state(), state), "building a network must not touch others' draws"
    for a, b in zip(first.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    assert any(not torch.equal(a, b) for a, b in zip(first.parameters(), other.parameters(), strict=True))


def test_lite_sees_no_batch_mates() -> None:
    network = build_network("lite").train()
    ref, src = randn(3, 3, 64, 96), randn(3, 3, 64, 96, seed=1)
    with torch.no_grad(), full_precision():
        together = network(ref, src, (0, 32))
        alone = network(ref[1:2], src[1:2], (0, 32))
    torch.testing.assert_close(together.disparity_px[1:2], alone.disparity_px, atol=1e-3, rtol=0)
    torch.testing.assert_close(together.logits_BDHW[1:2], alone.logits_BDHW, atol=1e-4, rtol=1e-4)


def test_psmnet_sees_no_batch_mates_once_trained() -> None:
    network = build_network("psmnet-s").eval()
    ref, src = randn(2, 3, 64, 96), randn(2, 3, 64, 96, seed=1)
    with torch.no_grad(), full_precision():
        together, alone = network(ref, src, (0, 32)), network(ref[:1], src[:1], (0, 32))
    torch.testing.assert_close(together.disparity_px[:1], alone.disparity_px, atol=0.05, rtol=0)


def test_untrained_lite_reads_the_correlation() -> None:
    """The mean correlation goes straight to the output: before any training a shifted picture is found."""
    world = torch.nn.functional.avg_pool2d(randn(1, 3, 66, 162), 3, stride=1)
    ref, src = standardise(world[..., :128]), standardise(world[..., 16:144])
    with torch.no_grad():
        output = build_network("lite")(ref, src, (0, 32))
    plane = output.logits_BDHW.argmax(dim=1)[..., 2:-2, 8:-2]
    assert (plane == 4).float().mean() > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_every_weight_gets_a_gradient(name: str) -> None:
    network = build_network(name).train()
    with torch.no_grad():  # branches that start at zero pass nothing on in the first step
        for parameter in network.parameters():
            if not parameter.any():
                parameter += 0.01 * torch.randn_like(parameter)
    output = network(randn(1, 3, 64, 96), randn(1, 3, 64, 96, seed=1), (0, 32))
    (sum(d.square().mean() for d in output.disparities_px) + output.logits_BDHW.square().mean()).backward()
    silent = [key for key, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert silent == []


def test_standardising_takes_out_gain_and_offset() -> None:
    image = torch.rand(2, 3, 32, 40)
    standard = standardise(image)
    torch.testing.assert_close(standard.mean(dim=(-2, -1)), torch.zeros(2, 3), atol=1e-5, rtol=0)
    assert (standard.std(dim=(-2, -1)) - 1).abs().max() < 0.1
    gain = torch.tensor([0.8, 1.1, 1.3])[None, :, None, None]
    assert (standardise(gain * image + 0.1) - standard).abs().max() < 0.1
    assert standardise(torch.zeros(1, 3, 8, 8)).isfinite().all()


class _OneLayer(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Conv2d(3, 8, 4, stride=4)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor]:
        return (self.layer(image),)


class _Plain(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.classify = nn.Conv3d(16, 1, 1)

    def forward(
        self, ref: tuple[torch.Tensor], src: tuple[torch.Tensor], window: tuple[int, int]
    ) -> tuple[list[torch.Tensor], torch.Tensor]:
        logits = self.classify(concatenate_views(ref[0], src[0], window=window))[:, 0].float()
        disparity = expect_disparity(logits, window=window)
        return [torch.nn.functional.interpolate(disparity[:, None], scale_factor=4)[:, 0]], logits


def test_a_network_is_added_with_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(NETWORKS, "plain", lambda: StereoNetwork(_OneLayer(), _Plain()))
    network = build_network("plain", seed=1)
    rng = np.random.default_rng(0)
    image = rng.random((SIZE_MULTIPLE_PX * 3 + 1, 50, 3), dtype=np.float32)
    matched = match_with_network(image, image, network=network, window=(-8, 8))
    assert matched.disparity_px.shape == image.shape[:2]


def test_parts_of_different_networks_fit_the_same_frame() -> None:
    """Phi_F and Phi_M are modules of their own: new matching on frozen features is one line."""
    features = LiteFeatures().requires_grad_(False)
    network = StereoNetwork(features, LiteMatching())
    network(randn(1, 3, 64, 64), randn(1, 3, 64, 64), (0, 16)).disparity_px.sum().backward()
    assert all(p.grad is None for p in network.features.parameters())
    assert any(p.grad is not None for p in network.matching.parameters())


def stirred(name: str) -> StereoNetwork:
    """A network whose branches that start at zero say something."""
    network = build_network(name, seed=1).eval()
    with torch.no_grad():
        for index, parameter in enumerate(network.parameters()):
            if not parameter.any():
                parameter += 0.05 * randn(*parameter.shape, seed=index)
    return network


@pytest.mark.parametrize("name", [*NAMES, "guided", "psmnet"])
@pytest.mark.parametrize("first_px", [-100, -40, 4])
def test_any_number_of_planes_gives_the_same_volume(name: str, first_px: int) -> None:
    """Windows of 4 to 40 planes against one a few planes wider: what is halved inside falls on the same planes."""
    network = stirred(name)
    with torch.no_grad(), full_precision():
        ref, src = (network.features(randn(1, 3, 32, 64, seed=seed)) for seed in (0, 1))
        for planes in range(4, 41, {"guided": 3, "psmnet": 9}.get(name, 1)):
            window = (first_px, first_px + 4 * planes)
            wider = (window[0] // 16 * 16, -(-window[1] // 16) * 16)
            volume, whole = (network.matching(ref, src, searched)[1] for searched in (window, wider))
            inside = whole[:, (window[0] - wider[0]) // 4 :][:, :planes]
            torch.testing.assert_close(volume, inside, atol=1e-4, rtol=1e-3, msg=f"{planes} planes")


@pytest.mark.parametrize("name", [*NAMES, "guided"])
def test_a_moved_window_moves_the_result(name: str) -> None:
    """A source view moved by 32 px, from no disparity, and a window moved as far give the same disparities, plus 32."""
    network = stirred(name)
    world = torch.nn.functional.avg_pool2d(randn(1, 3, 66, 450), 3, stride=1)
    with torch.no_grad(), full_precision():
        maps = network.features(standardise(world))  # of the whole world: the views have no borders of their own
        ref, far = ([m[..., m.shape[-1] * x // 448 :][..., : m.shape[-1] * 384 // 448] for m in maps] for x in (0, 32))
        plain, moved = network.matching(ref, ref, (-24, 24))[0][-1], network.matching(ref, far, (8, 56))[0][-1]
    middle = slice(176, 256)  # beside it the hourglasses see what src does not show
    assert plain.std() > 0.1
    torch.testing.assert_close(moved[..., middle], plain[..., middle] + 32, atol=1e-3, rtol=0)


def test_a_moved_centre_does_not_move_the_result() -> None:
    """The views alone say how a disparity is refined, not where it lies in the window."""
    network = stirred("lite")
    world = torch.nn.functional.avg_pool2d(randn(1, 3, 66, 290), 3, stride=1)
    ref, src = standardise(world[..., :256]), standardise(world[..., 20:276])
    with torch.no_grad(), full_precision():
        network.matching.leave.weight.zero_()  # the correlation alone decides: the same plane in every window
        network.matching.refine_residual.weight.mul_(4)
        narrow, wide = (network(ref, src, window) for window in ((0, 48), (0, 144)))
    assert (narrow.disparities_px[1] - wide.disparities_px[1])[..., 40:-8].abs().median() < 1e-3
    moved_px = (narrow.disparity_px - wide.disparity_px)[..., 40:-8].abs()
    assert (narrow.disparity_px - narrow.disparities_px[1])[..., 40:-8].abs().median() > 0.05, "nothing is refined"
    assert moved_px.median() < 1e-3


@pytest.mark.parametrize("width_px", [272, 288, 304])
def test_psmnet_pools_a_crop_on_the_grid_of_the_padded_image(width_px: int) -> None:
    """Training sees crops of any multiple of 16 px, inference pads to 64: the same features but at the cut."""
    network = build_network("psmnet-s", seed=1).eval()
    smooth = torch.nn.functional.interpolate(randn(1, 3, 9, 18), size=(192, 384), mode="bicubic", align_corners=False)
    crop = smooth[..., :width_px]
    padded = torch.nn.functional.pad(crop, (0, -width_px % 64, 0, 0), mode="replicate")
    with torch.no_grad(), full_precision():
        of_crop, of_padded = (network.features(view)[0] for view in (crop, padded))
    apart = (of_crop - of_padded[..., : width_px // 4])[..., :-24].abs() / of_padded.std()
    assert apart.mean() < 1e-3


def test_psmnet_takes_crops_smaller_than_its_pools() -> None:
    features = build_network("psmnet-s").eval().features(randn(1, 3, 32, 48))
    assert features[0].shape == (1, 16, 8, 12)
