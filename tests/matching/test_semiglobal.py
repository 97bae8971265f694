"""Semi-global matching against rendered truth, photographed truth and the laws of disparity."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from telewide.geometry.arrays import FloatImage
from telewide.matching.semiglobal import match_semiglobal
from telewide.metrics import end_point_error_px, three_pixel_error
from telewide.simulate.degrade import shrink_and_enlarge
from telewide.simulate.layers import Layer, LayeredScene, RenderedPair, render_pair


def texture(rng: np.random.Generator, hw: tuple[int, int]) -> FloatImage:
    """Structure at several scales, so that some of it survives the loss of resolution."""
    layers = [cv2.GaussianBlur(rng.random((*hw, 3)), (0, 0), sigma) * sigma for sigma in (0.7, 2.0, 5.0)]
    mixed = np.sum(layers, axis=0)
    return np.asarray((mixed - mixed.min()) / np.ptp(mixed), dtype=np.float32)


def object_before_wall(rng: np.random.Generator, *, shift_px: float = 0.0) -> RenderedPair:
    """A slanted wall and, in front of it, a square with a hole."""
    wall = Layer(texture(rng, (120, 260)), None, (-40, 0), (6.0 + shift_px, 0.02, 0.01))
    outline = np.ones((70, 70), dtype=np.float32)
    outline[25:45, 25:45] = 0
    square = Layer(texture(rng, (70, 70)), outline, (70, 25), (22.0 + shift_px, 0.0, 0.0))
    return render_pair(LayeredScene(layers=(wall, square), hw=(120, 180)))


@pytest.mark.parametrize(("shift_px", "window"), [(0.0, (0, 32)), (-16.0, (-16, 16)), (-40.0, (-40, -8))])
def test_recovers_a_rendered_scene(shift_px: float, window: tuple[int, int], rng: np.random.Generator) -> None:
    pair = object_before_wall(rng, shift_px=shift_px)
    found = match_semiglobal(pair.ref, pair.src, window=window)
    error_px = np.abs(found.disparity_px - pair.disparity_px)
    seen = ~pair.occluded
    assert (error_px[seen] > 1).mean() < 0.03
    assert np.median(error_px[seen]) < 0.2
    assert (error_px > 3).mean() < 0.06
    assert (error_px[found.valid] > 3).mean() < 0.03


def test_blind_side_is_not_measured(rng: np.random.Generator) -> None:
    pair = object_before_wall(rng)
    found = match_semiglobal(pair.ref, pair.src, window=(0, 32))
    assert found.valid[~pair.occluded].mean() > 0.85
    assert found.confidence[pair.occluded].mean() < 0.4 * found.confidence[~pair.occluded].mean()


def test_result_is_complete_and_within_the_window(rng: np.random.Generator) -> None:
    ref, src = rng.random((2, 40, 56, 3), dtype=np.float32)  # nothing in common
    found = match_semiglobal(ref, src, window=(-5, 90))  # wider than the view
    assert found.disparity_px.shape == found.confidence.shape == found.valid.shape == (40, 56)
    assert found.disparity_px.dtype == found.confidence.dtype == np.float32
    assert found.valid.dtype == np.bool_
    assert np.isfinite(found.disparity_px).all()
    assert found.disparity_px.min() >= -5.5
    assert found.disparity_px.max() <= 90
    assert 0 <= found.confidence.min() <= found.confidence.max() <= 1
    assert found.confidence.mean() < 0.1


def test_mirrored_and_exchanged_views_agree(rng: np.random.Generator) -> None:
    # Mirroring both views and exchanging their roles leaves x_ref - x_src of a point as it was.
    pair = object_before_wall(rng)
    of_ref = match_semiglobal(pair.ref, pair.src, window=(0, 32)).disparity_px
    of_src = match_semiglobal(pair.src[:, ::-1], pair.ref[:, ::-1], window=(0, 32)).disparity_px[:, ::-1]
    x_src = np.clip(np.round(np.arange(180) - of_ref).astype(int), 0, 179)
    apart_px = np.abs(np.take_along_axis(of_src, x_src, axis=1) - of_ref)
    assert (apart_px[~pair.occluded] < 1).mean() > 0.93


def test_same_input_same_output(rng: np.random.Generator) -> None:
    pair = object_before_wall(rng)
    first, second = (match_semiglobal(pair.ref, pair.src, window=(0, 32)) for _ in range(2))
    np.testing.assert_array_equal(first.disparity_px, second.disparity_px)
    np.testing.assert_array_equal(first.confidence, second.confidence)


def test_stands_loss_of_resolution_and_of_light(rng: np.random.Generator) -> None:
    pair = object_before_wall(rng)
    src = shrink_and_enlarge(pair.src, factor=3) * np.float32(0.8)
    found = match_semiglobal(pair.ref, src, window=(0, 32))
    assert three_pixel_error(found.disparity_px, pair.disparity_px) < 0.1


@pytest.mark.parametrize(
    ("ref_shape", "src_shape", "window", "words"),
    [
        ((32, 40, 3), (32, 41, 3), (0, 16), "one shape"),
        ((32, 40), (32, 40), (0, 16), "one shape"),
        ((32, 40, 3), (32, 40, 3), (16, 16), "at least 4 px"),
        ((32, 40, 3), (32, 40, 3), (16, 0), "at least 4 px"),
    ],
)
def test_refuses_what_cannot_be_matched(
    ref_shape: tuple[int, ...], src_shape: tuple[int, ...], window: tuple[int, int], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        match_semiglobal(np.zeros(ref_shape, np.float32), np.zeros(src_shape, np.float32), window=window)


@pytest.mark.parametrize("name", ["Baby3", "Wood2"])
def test_photographed_truth(name: str, data_root: Path) -> None:
    from telewide.benchmark.datasets.middlebury import read_middlebury_2006

    truth = read_middlebury_2006(data_root / "middlebury_2006_third" / name, scale_denominator=3)
    src = shrink_and_enlarge(truth.right, factor=4)
    found = match_semiglobal(truth.left, src, window=(0, 80))
    counted = np.arange(truth.left.shape[1]) >= 53
    mask = np.broadcast_to(counted, found.valid.shape)
    assert three_pixel_error(found.disparity_px, truth.disparity_px, mask=mask) < 0.12
    assert end_point_error_px(found.disparity_px, truth.disparity_px, mask=mask) < 2.5
    measured = mask & found.valid
    assert three_pixel_error(found.disparity_px, truth.disparity_px, mask=measured) < 0.06
