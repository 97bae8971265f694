"""A network as a matcher: tiles against the whole image, confidence, and what src does not see."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from training.small import stage_of, training_in

from telewide.assets import BOX_WEIGHTS
from telewide.capture.images import resize_bicubic
from telewide.capture.pair import find_captures, read_pair
from telewide.errors import MissingPartError
from telewide.geometry.stereo import DisparityMap, ValidMasks
from telewide.matching import inference, other_view
from telewide.matching.inference import (
    GRID_PX,
    choose_device,
    full_precision,
    has_fast_bf16,
    low_precision,
    match_with_network,
)
from telewide.matching.networks import StereoNetwork, build_network, standardise
from telewide.matching.refinement import refine
from telewide.matching.volume import correlate_groups, expect_disparity
from telewide.simulate.layers import render_pair
from telewide.simulate.scene import random_scene
from telewide.training.checkpoint import load_weights, new_state
from telewide.training.data import StepBatches
from telewide.training.loop import take_step
from telewide.training.samples import SampleSource

CPU = torch.device("cpu")
STEPS = 60
Views = tuple[NDArray[np.float32], NDArray[np.float32]]


def noise(*hw: int, seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random((*hw, 3), dtype=np.float32)


@pytest.fixture(scope="session")
def taught(repo: Path, tmp_path_factory: pytest.TempPathFactory) -> StereoNetwork:
    """`lite` after a minute's lesson on the example captures: its answers are rough, and no noise."""
    captures = find_captures(repo / "examples" / "captures").captures
    source = SampleSource(captures[1:], crop_hw=(64, 96), window_px=(0, 48))
    stage = stage_of(steps=STEPS, rehearsed=2, learning_rate=2e-3)
    training = training_in(tmp_path_factory.mktemp("taught"), source)
    state = new_state("lite", seed=1, device=CPU)
    batches = StepBatches(source, stage, seed=0)
    for step in range(STEPS):
        take_step(state, batches[step], stage, training=training)
        state.step += 1
    return state.average


@pytest.fixture(scope="session")
def example(repo: Path) -> Views:
    """An example capture at twice its size, cut to 390x650, no multiple of the tiles."""
    pair = read_pair(find_captures(repo / "examples" / "captures").captures[0])
    ref, src = (resize_bicubic(view, wh=(768, 512))[:390, :650] for view in (pair.tele, pair.wide))
    return ref, src


@pytest.mark.slow
def test_tiles_give_what_the_whole_image_gives(taught: StereoNetwork, example: Views) -> None:
    """The context that is thrown away is all that reaches a pixel: in float32 tiles are the whole, but for rounding."""
    ref, src = example
    with full_precision():
        whole = match_with_network(ref, src, network=taught, window=(0, 96))
        tiled = match_with_network(ref, src, network=taught, window=(0, 96), max_tile_pixels=100_000)
    error_px = np.abs(tiled.disparity_px - whole.disparity_px)
    assert (error_px <= 0.1).mean() >= 0.99
    assert np.abs(tiled.confidence - whole.confidence).mean() < 1e-3
    assert (tiled.valid == whole.valid).mean() >= 0.99


@pytest.mark.slow
def test_tiles_of_negative_windows_look_to_the_other_side(taught: StereoNetwork, example: Views) -> None:
    """Views exchanged: disparities are negative, and src is to be found to the right."""
    ref, src = example
    with full_precision():
        whole = match_with_network(src[:200], ref[:200], network=taught, window=(-96, 0))
        tiled = match_with_network(src[:200], ref[:200], network=taught, window=(-96, 0), max_tile_pixels=60_000)
    assert (np.abs(tiled.disparity_px - whole.disparity_px) <= 0.1).mean() >= 0.99


class _Blur(torch.nn.Module):
    """Features that look ``reach`` cells of the quarter grid around them."""

    def __init__(self, reach: int) -> None:
        super().__init__()
        self.reach = reach

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor]:
        quarter = torch.nn.functional.avg_pool2d(image, 4)
        return (torch.nn.functional.avg_pool2d(quarter, 2 * self.reach + 1, stride=1, padding=self.reach),)


class _Correlate(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.tensor(50.0))

    def forward(
        self, ref: tuple[torch.Tensor], src: tuple[torch.Tensor], window: tuple[int, int]
    ) -> tuple[list[torch.Tensor], torch.Tensor]:
        logits = self.scale * correlate_groups(ref[0], src[0], window=window, groups=1)[:, 0]
        coarse = expect_disparity(logits, window=window)[:, None]
        return [torch.nn.functional.interpolate(coarse, scale_factor=4)[:, 0]], logits


@pytest.mark.parametrize(("reach_px", "is_same"), [(64, True), (160, False)])
def test_tiles_overlap_by_what_the_network_sees(reach_px: int, is_same: bool) -> None:
    """A network that says 64 px: tiles are the whole exactly where that is true, and only there."""
    ref, src = noise(210, 900), noise(210, 900, seed=1)
    network = StereoNetwork(_Blur(reach_px // 4), _Correlate(), context_px=64)
    with full_precision():
        whole = match_with_network(ref, src, network=network, window=(0, 32))
        tiled = match_with_network(ref, src, network=network, window=(0, 32), max_tile_pixels=90_000)
    error_px = np.abs(tiled.disparity_px - whole.disparity_px)
    assert (float(error_px.max()) < 1e-3) == is_same


@pytest.mark.parametrize("view", [0, 1])
def test_psmnet_sees_no_farther_than_it_says(view: int) -> None:
    """What is no number spreads to every cell of the volume that depends on it, and not beyond the stated context.

    Enlarged, a cell of four pixels reaches two further.
    """
    network = build_network("psmnet-s").eval()
    for edge_px, is_left in ((392, True), (436, False)):  # where among the pooled cells of 64 px the reach is longest
        views = [torch.rand(1, 3, 64, 768) for _ in range(2)]
        views[view][..., slice(edge_px) if is_left else slice(edge_px, None)] = torch.nan
        with torch.no_grad():
            reached = network(views[0], views[1], (0, 4)).logits_BDHW[0].isnan().any(dim=0).any(dim=0).nonzero()
        reach_px = 2 + (4 * (int(reached[-1]) + 1) - edge_px if is_left else edge_px - 4 * int(reached[0]))
        assert 256 < reach_px <= network.context_px


@pytest.mark.parametrize("name", ["lite", "psmnet-s"])
def test_confidence_lies_in_zero_to_one(name: str) -> None:
    for seed in range(2):
        matched = match_with_network(
            noise(64, 96, seed=seed), noise(64, 96, seed=9), network=build_network(name, seed=seed), window=(-16, 32)
        )
        assert matched.confidence.min() >= 0
        assert matched.confidence.max() <= 1
        assert matched.disparity_px.dtype == matched.confidence.dtype == np.float32
        assert matched.valid.dtype == np.bool_


@pytest.mark.parametrize("window", [(0, 32), (-32, 0)])
def test_what_falls_outside_src_is_not_valid(window: tuple[int, int]) -> None:
    pair = render_pair(random_scene(np.random.default_rng(0), hw=(64, 128), disparity_window_px=(6.0, 26.0)))
    ref, src = (pair.ref, pair.src) if window[0] == 0 else (pair.src, pair.ref)
    matched = match_with_network(ref, src, network=build_network("lite"), window=window)
    x_src_px = np.arange(128) - matched.disparity_px
    outside = (x_src_px < 0) | (x_src_px > 127)
    assert outside.any()
    assert not matched.valid[outside].any()


def test_untrained_lite_trusts_what_both_views_show_and_not_what_one_hides() -> None:
    """A square before a wall, both of rich texture: what it hides fails the left-right check more often."""
    blurred = [cv2.GaussianBlur(noise(128, 320, seed=seed), (0, 0), 1.5) for seed in (0, 1)]
    wall, square = (np.clip((b - 0.5) * 3 + 0.5, 0, 1).astype(np.float32) for b in blurred)
    ref, src = wall[:, 20:276].copy(), wall[:, 28:284].copy()  # the wall at 8 px
    ref[32:96, 120:184], src[32:96, 92:156] = square[:64, :64], square[:64, :64]  # the square at 28 px
    matched = match_with_network(ref, src, network=build_network("lite"), window=(0, 40))
    hidden = np.zeros(ref.shape[:2], np.bool_)
    hidden[36:92, 102:118] = True  # left of the square: 20 px that src does not see
    seen = np.zeros_like(hidden)
    seen[36:92, 60:90] = seen[36:92, 130:175] = True
    assert matched.confidence[seen].mean() > 5 * matched.confidence[hidden].mean()
    assert matched.valid[seen].mean() > matched.valid[hidden].mean()
    x_src_px = np.arange(256) - matched.disparity_px
    disagrees = (x_src_px >= 0) & (x_src_px <= 255) & ~matched.valid
    assert disagrees[hidden].any()
    assert matched.confidence[disagrees].max() == 0
    assert np.median(np.abs(matched.disparity_px[36:92, 130:175] - 28)) < 2
    assert np.median(np.abs(matched.disparity_px[36:92, 60:90] - 8)) < 2


def test_views_must_fit_each_other_and_the_window_the_volume() -> None:
    network = build_network("lite")
    with pytest.raises(ValueError, match="one size"):
        match_with_network(noise(64, 96), noise(64, 95), network=network, window=(0, 32))
    with pytest.raises(ValueError, match="multiples of 4"):
        match_with_network(noise(64, 96), noise(64, 96), network=network, window=(0, 30))


def test_matching_leaves_no_trace_in_the_network() -> None:
    network = build_network("psmnet-s").train()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    match_with_network(noise(64, 64), noise(64, 64, seed=1), network=network, window=(0, 16))
    assert not network.training
    assert all(torch.equal(before[name], tensor) for name, tensor in network.state_dict().items())
    assert all(parameter.requires_grad for parameter in network.parameters())


@pytest.mark.parametrize("name", ["lite", "psmnet-s"])
def test_an_image_off_the_grid_is_continued_by_its_border(name: str) -> None:
    """Standardised as it is, then continued to multiples of 64 px by repeating the border, which is cut off again."""
    ref, src = noise(GRID_PX - 20, 2 * GRID_PX - 37), noise(GRID_PX - 20, 2 * GRID_PX - 37, seed=1)
    network = build_network(name).eval()
    views = [torch.from_numpy(view.transpose(2, 0, 1).copy())[None] for view in (ref, src)]
    by_hand = [standardise(view).numpy() for view in views]
    by_hand = [np.pad(view, ((0, 0), (0, 0), (0, 20), (0, 37)), mode="edge") for view in by_hand]
    with full_precision(), torch.no_grad():
        matched = match_with_network(ref, src, network=network, window=(0, 32))
        output = network(*map(torch.from_numpy, by_hand), (0, 32))
    assert matched.disparity_px.shape == ref.shape[:2]
    np.testing.assert_allclose(matched.disparity_px, output.disparity_px[0, :-20, :-37].numpy(), atol=1e-3)


def test_brightness_and_tint_of_a_view_do_not_matter() -> None:
    ref, src = noise(64, 96), noise(64, 96, seed=1)
    network = build_network("lite")
    with full_precision():
        plain, tinted = (
            match_with_network(ref, (src * np.float32(gain)).astype(np.float32), network=network, window=(0, 32))
            for gain in (1.0, 0.9)
        )
    assert np.median(np.abs(plain.disparity_px - tinted.disparity_px)) < 0.2


def test_devices_are_chosen_by_name() -> None:
    assert choose_device("cpu").type == "cpu"
    if torch.cuda.is_available():
        assert choose_device("auto").type == choose_device("cuda").type == "cuda"
    else:
        assert choose_device("auto").type == "cpu"
        with pytest.raises(MissingPartError) as raised:
            choose_device("cuda")
        assert raised.value.exit_code == 5


def test_low_precision_can_be_switched_off() -> None:
    a = torch.rand(8, 8)
    with low_precision(CPU):
        assert (a @ a).dtype == (torch.bfloat16 if has_fast_bf16(CPU) else torch.float32)
    with full_precision(), low_precision(CPU):
        assert (a @ a).dtype == torch.float32


def test_the_choice_of_precision_is_made_on_one_thread_and_leaves_their_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads that wait for each other on busy cores take time of the processor, in one type as in the other."""
    seen: list[int] = []
    convolve = torch.nn.functional.conv2d

    def noted(*args: torch.Tensor, padding: int) -> torch.Tensor:
        seen.append(torch.get_num_threads())
        return convolve(*args, padding=padding)

    monkeypatch.setattr(inference.functional, "conv2d", noted)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        inference._seconds_to_convolve(torch.bfloat16, torch.float32)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert set(seen) == {1}


def test_a_gpu_gives_what_the_processor_gives(gpu: str) -> None:
    ref, src = noise(96, 160), noise(96, 160, seed=1)
    with full_precision():
        by_device = [
            match_with_network(ref, src, network=build_network("lite").to(device), window=(0, 32))
            for device in ("cpu", gpu)
        ]
    error_px = np.abs(by_device[0].disparity_px - by_device[1].disparity_px)
    assert (error_px < 0.1).mean() > 0.98


@pytest.mark.parametrize("window", [(0, 192), (-192, 0), (-96, 96), (132, 192)])
def test_the_left_right_check_of_a_tile_is_that_of_the_image(window: tuple[int, int]) -> None:
    """In a window wider than the network's context: what looks back from src stays within the tile."""
    ref, src = noise(64, 1400), noise(64, 1400, seed=1)
    network = StereoNetwork(_Blur(4), _Correlate(), context_px=64)
    with full_precision():
        whole = match_with_network(ref, src, network=network, window=window)
        tiled = match_with_network(ref, src, network=network, window=window, max_tile_pixels=80_000)
    assert np.abs(tiled.disparity_px - whole.disparity_px).max() < 0.1
    np.testing.assert_array_equal(tiled.valid, whole.valid)
    np.testing.assert_allclose(tiled.confidence, whole.confidence, atol=0.02)


@pytest.mark.parametrize(
    ("hw", "most_computed"), [((2048, 1536), 1.35), ((1536, 2048), 1.45), ((60, 50_000), 1.4), ((4000, 6000), 3.1)]
)
def test_an_image_is_cut_where_that_costs_least(hw: tuple[int, int], most_computed: float) -> None:
    """Into strips rather than squares, whose borders together are more; every pixel once."""
    most_pixels, times = 2_500_000, np.zeros(hw, np.uint8)
    network, computed = build_network("guided", seed=0), 0
    for tile in inference._tiles(hw, window=(0, 64), network=network, max_pixels=most_pixels):
        times[tile.inner] += 1
        size = np.empty((1, 1, *hw), np.bool_)[tile.outer_slices].size
        assert size <= most_pixels
        computed += size
    assert (times == 1).all()
    assert computed <= most_computed * times.size


def test_an_image_that_no_cut_makes_small_enough_is_cut_as_finely_as_can_be() -> None:
    """128 px and, on each side, the network's 320; along the rows where it looks and looks back, 64 px each."""
    network = build_network("guided", seed=0)
    tiles = inference._tiles((2048, 2048), window=(0, 64), network=network, max_pixels=1000)
    sizes = [np.empty((1, 1, 2048, 2048), np.bool_)[tile.outer_slices].shape[2:] for tile in tiles]
    assert max(sizes) == (128 + 2 * 320, 128 + 2 * 320 + 3 * 64)


class _Cells(_Blur):
    """Features less their means over cells of 256 px, as `psmnet` pools them."""

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor]:
        (quarter,) = super().forward(image)
        means = torch.nn.functional.avg_pool2d(quarter, 64, ceil_mode=True)
        spread = torch.nn.functional.interpolate(means, scale_factor=64.0)
        return (quarter - 3 * spread[..., : quarter.shape[-2], : quarter.shape[-1]],)


@pytest.mark.parametrize("cells_px", [256, 64])
def test_tiles_begin_where_the_cells_of_the_network_do(cells_px: int) -> None:
    ref, src = noise(300, 1400), noise(300, 1400, seed=1)
    network = StereoNetwork(_Cells(0), _Correlate(), context_px=64, cells_px=cells_px)
    with full_precision():
        whole, tiled = (
            match_with_network(ref, src, network=network, window=(0, 64), max_tile_pixels=n) for n in (10**6, 10**5)
        )
    assert (np.abs(tiled.disparity_px - whole.disparity_px).max() < 0.1) == (cells_px == 256)


class _Heads(_Correlate):
    """Finds the shift of the views and says: sure on the left half, hidden in the lower half."""

    def forward(
        self, ref: tuple[torch.Tensor], src: tuple[torch.Tensor], window: tuple[int, int]
    ) -> tuple[object, ...]:
        disparities, logits = super().forward(ref, src, window)
        heads = torch.full((len(logits), 2, *disparities[0].shape[-2:]), -4.0)
        heads[:, 0, :, : heads.shape[-1] // 2] = 4.0
        heads[:, 1, heads.shape[-2] // 2 :] = 4.0
        return disparities, logits, heads


def test_a_network_that_was_taught_to_says_where_it_is_sure_and_what_is_hidden() -> None:
    network = StereoNetwork(_Blur(0), _Heads())
    ref = noise(64, 128)
    matched = match_with_network(ref, np.roll(ref, -8, axis=1), network=network, window=(0, 16))
    assert (matched.confidence[:, :64] > 0.9).all()
    assert (matched.confidence[:, 64:] < 0.1).all()
    assert not matched.valid[32:].any()
    assert matched.valid[4:28, 24:].mean() > 0.9


def step_at(x_px: int, *, far_px: float, near_px: float) -> DisparityMap:
    disparity_px = np.full((96, 144), far_px, np.float32)
    disparity_px[:, x_px:] = near_px
    return DisparityMap(disparity_px, np.full((96, 144), 0.5, np.float32), disparity_px == near_px)


@pytest.mark.parametrize("x_px", range(60, 66))
def test_between_two_surfaces_no_third_appears_where_a_result_is_shrunken(
    x_px: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever the step lies in the enlarged views, it comes within a pixel of its place."""
    monkeypatch.setattr(inference, "_match_views", lambda *_, **__: step_at(x_px, far_px=3.0, near_px=30.0))
    monkeypatch.setattr(inference, "refine", lambda found, ref, src: found)
    found = match_with_network(noise(64, 96), noise(64, 96), network=build_network("guided", seed=1), window=(0, 32))
    assert set(np.unique(found.disparity_px)) == {np.float32(2.0), np.float32(20.0)}
    x_found_px = np.argmax(found.disparity_px[0] == 20.0)
    assert abs(x_found_px - x_px / 1.5) <= 1
    assert np.array_equal(found.valid, found.disparity_px == 20.0)


def test_small_views_are_matched_as_if_they_were_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    """By `guided`, up to a size; by networks that are rows of a published table as they are."""
    ref, src = (noise(64, 96, seed=seed) for seed in range(2))
    sizes, results = [], []
    whole = inference._match_views

    def seen(ref: NDArray[np.float32], src: NDArray[np.float32], **rest: object) -> DisparityMap:
        sizes.append((ref.shape[:2], rest["window"]))
        return whole(ref, src, **rest)

    monkeypatch.setattr(inference, "_match_views", seen)
    for name, most in (("guided", 1280 * 640), ("guided", 7_000), ("guided", 6_000), ("lite", 1280 * 640)):
        monkeypatch.setattr(other_view, "_ENLARGED_TO_PIXELS", most)
        results.append(match_with_network(ref, src, network=build_network(name, seed=1), window=(0, 32)))
    assert sizes == [((96, 144), (0, 48)), ((68, 102), (0, 36)), ((64, 96), (0, 32)), ((64, 96), (0, 32))]
    assert all(found.disparity_px.shape == (64, 96) for found in results)


@pytest.mark.parametrize(("name", "is_refined"), [("guided", True), ("lite", False)])
def test_a_match_is_refined_where_the_network_knows_how_sure_it_is(
    name: str, is_refined: bool, example: Views, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = load_weights(BOX_WEIGHTS, device=CPU)[0] if name == "guided" else build_network(name, seed=1)
    window = (0, 32)
    made = match_with_network(*example, network=network, window=window)
    with monkeypatch.context() as patch:
        patch.setattr(inference, "refine", lambda found, ref, src: found)
        matched = match_with_network(*example, network=network, window=window)
    expected = refine(matched, *example) if is_refined else matched
    np.testing.assert_array_equal(made.disparity_px, expected.disparity_px)
    assert np.array_equal(made.disparity_px, matched.disparity_px) is not is_refined


def test_beyond_a_photo_nothing_is_sure_before_a_match_is_refined_nor_after(
    example: Views, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So no wall is looked for there; and what moves to where src shows no photo is no longer measured."""
    hw = example[0].shape[:2]
    ref, src = np.ones(hw, np.bool_), np.ones(hw, np.bool_)
    ref[:, : hw[1] // 4] = False
    src[:, -hw[1] // 4 :] = False
    valid = ValidMasks(ref, src)
    handed = []

    def refined(found: DisparityMap, ref: NDArray[np.float32], src: NDArray[np.float32]) -> DisparityMap:
        handed.append(found)
        return DisparityMap(found.disparity_px - 8, np.ones(hw, np.float32), np.ones(hw, np.bool_))

    monkeypatch.setattr(inference, "refine", refined)
    made = match_with_network(*example, network=build_network("guided", seed=1), window=(0, 32), valid=valid)
    assert not handed[0].confidence[~ref].any()
    comparable = valid.comparable(made.disparity_px)
    assert not comparable.all()
    np.testing.assert_array_equal(made.valid, comparable)
    assert not made.confidence[~comparable].any()


def test_the_odds_of_an_error_below_a_pixel_grow_with_the_pixel() -> None:
    """A map computed half as large again: 1 px of it is two thirds of one here."""
    shares = np.array([0.0, 0.1, 0.5, 0.9, 1.0], np.float32)
    larger = np.repeat(shares, 6)[None].repeat(6, axis=0)
    (sure,) = inference._shrunken(DisparityMap(larger, larger, larger > 0), (4, 20)).confidence[:1, 1::4]
    np.testing.assert_array_equal(sure[[0, -1]], shares[[0, -1]])
    inner = shares[1:-1]
    np.testing.assert_allclose(sure[1:-1] / (1 - sure[1:-1]), 1.5 * inner / (1 - inner), rtol=1e-5)
