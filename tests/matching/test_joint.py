"""Network and semi-global matching together: rendered truth, and the limits in which one of them knows nothing."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage
from telewide.geometry.stereo import DisparityMap
from telewide.matching import joint
from telewide.matching.inference import full_precision, match_with_volume
from telewide.matching.joint import match_jointly
from telewide.matching.networks import build_network
from telewide.matching.semiglobal import match_semiglobal, match_to_levels
from telewide.simulate.layers import RenderedPair, render_pair
from telewide.simulate.scene import random_scene

WINDOW = (0, 40)


@pytest.fixture
def rendered(rng: np.random.Generator) -> RenderedPair:
    """Slanted and curved layers of rich texture, of a size that no cell divides."""
    photo = cv2.GaussianBlur(rng.random((300, 400, 3)), (0, 0), 1.2).astype(np.float32)
    scene = random_scene(rng, hw=(150, 230), disparity_window_px=WINDOW, photos=[(photo - 0.5) * 2.5 + 0.5])
    return render_pair(scene)


def test_the_volume_holds_probabilities_of_every_cell(rendered: RenderedPair) -> None:
    matched, surprise = match_with_volume(rendered.ref, rendered.src, network=build_network("lite"), window=WINDOW)
    assert surprise.shape == (10, 38, 58)
    np.testing.assert_allclose(np.exp(-surprise).sum(axis=0), 1, atol=1e-4)
    likeliest_px = 4.0 * surprise.argmin(axis=0).repeat(4, axis=0).repeat(4, axis=1)[:150, :230]
    assert np.median(np.abs(likeliest_px - matched.disparity_px)) < 4


def test_tiles_have_the_volume_of_the_whole_image(rendered: RenderedPair) -> None:
    ref, src = (np.tile(view, (2, 3, 1)) for view in (rendered.ref, rendered.src))
    network = build_network("lite")
    with full_precision():
        whole, tiled = (
            match_with_volume(ref, src, network=network, window=WINDOW, max_tile_pixels=pixels)[1]
            for pixels in (10**9, 100_000)
        )
    assert whole.shape == tiled.shape
    assert (np.abs(whole - tiled) < 0.1).mean() > 0.98


def test_both_together_recover_a_rendered_scene(rendered: RenderedPair) -> None:
    found = match_jointly(rendered.ref, rendered.src, network=build_network("lite"), window=WINDOW)
    error_px = np.abs(found.disparity_px - rendered.disparity_px)
    seen = ~rendered.occluded
    assert np.median(error_px[seen]) < 0.3
    assert (error_px[seen] > 3).mean() < 0.06


def test_a_network_that_knows_nothing_changes_nothing(rendered: RenderedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    def clueless(ref: FloatImage, src: FloatImage, **_: object) -> tuple[DisparityMap, FloatImage]:
        far_off = np.full(ref.shape[:2], 1000, np.float32)
        surprise = np.full((10, -(-ref.shape[0] // 4), -(-ref.shape[1] // 4)), np.log(10), np.float32)
        return DisparityMap(far_off, np.zeros_like(far_off), np.zeros(far_off.shape, np.bool_)), surprise

    monkeypatch.setattr("telewide.matching.inference.match_with_volume", clueless)
    alone = match_semiglobal(rendered.ref, rendered.src, window=WINDOW)
    both = match_jointly(rendered.ref, rendered.src, network=build_network("lite"), window=WINDOW)
    assert (np.abs(both.disparity_px - alone.disparity_px) < 0.05).mean() > 0.97


def test_what_photos_do_not_tell_is_taken_from_the_doubt() -> None:
    """A plain wall, which matches everywhere alike."""
    wall = np.full((48, 96, 3), 0.5, np.float32)

    def doubt(disparity_px: int) -> NDArray[np.uint16]:
        cost = np.full((48, 96), min(40, 8 * abs(disparity_px - 11)), np.uint16)
        cost[:, 60:] = min(40, 8 * abs(disparity_px - 21))
        return cost

    found = match_to_levels(wall, wall, window=(0, 32), doubt=doubt)
    assert np.median(np.abs(found.disparity_px[:, 36:56] - 11)) < 0.5
    assert np.median(np.abs(found.disparity_px[:, 70:90] - 21)) < 0.5


def test_no_doubt_is_a_doubt_of_zero(rendered: RenderedPair) -> None:
    zero = np.zeros(rendered.ref.shape[:2], np.uint16)
    alone = match_to_levels(rendered.ref, rendered.src, window=WINDOW)
    doubted = match_to_levels(rendered.ref, rendered.src, window=WINDOW, doubt=lambda disparity_px: zero)
    np.testing.assert_array_equal(alone.disparity_px, doubted.disparity_px)


def test_doubt_passes_through_the_planes_and_is_even_between_them(rng: np.random.Generator) -> None:
    surprise = np.broadcast_to(rng.uniform(0, 6, (8, 1, 1)), (8, 10, 12)).astype(np.float32)
    doubt = joint._doubt(surprise, hw=(38, 46), window=(-8, 24))
    for plane in range(8):
        assert doubt(4 * plane - 8).shape == (38, 46)
        np.testing.assert_allclose(doubt(4 * plane - 8), 5 * surprise[plane, 0, 0], atol=0.51)
    for below, above in pairwise(range(8)):
        middle = 2.5 * (surprise[below, 0, 0] + surprise[above, 0, 0])
        np.testing.assert_allclose(doubt(4 * below - 6), middle, atol=0.51)
    np.testing.assert_allclose(doubt(23), doubt(20))  # beyond the last plane nothing is known to be different


def test_surprise_has_its_limit() -> None:
    surprise = np.full((8, 4, 4), 1e4, np.float32)
    assert joint._doubt(surprise, hw=(16, 16), window=(0, 32))(7).max() == 40
