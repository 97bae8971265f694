"""The other view before a network matches it, against the view that a lens and few pixels have not softened."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from textures import textured

from telewide.geometry.stereo import DisparityMap
from telewide.matching import inference, other_view
from telewide.matching.inference import match_with_network
from telewide.matching.networks import build_network
from telewide.matching.other_view import enlarged_size, sharpened
from telewide.simulate.degrade import shrink_and_enlarge

HW = (120, 160)
Image = NDArray[np.float32]


@pytest.fixture(scope="module")
def sharp() -> Image:
    return textured(np.random.default_rng(0), hw=HW)


def softened(view: Image, sigma_px: float) -> Image:
    return np.asarray(cv2.GaussianBlur(view, (0, 0), sigma_px), dtype=np.float32)


def detail(view: Image) -> float:
    """Of the grey view, what a blur by 1 px takes, in its deviations."""
    grey = cv2.cvtColor(view, cv2.COLOR_RGB2GRAY)
    return float(np.abs(grey - cv2.GaussianBlur(grey, (0, 0), 1.0)).mean() / grey.std())


@pytest.mark.parametrize("sigma_px", [2.0, 2.5, 3.0])
def test_what_a_lens_took_comes_back_in_part(sharp: Image, sigma_px: float) -> None:
    soft = softened(sharp, sigma_px)
    again = sharpened(soft, like=sharp)
    assert np.square(again - sharp).mean() < 0.95 * np.square(soft - sharp).mean()
    assert detail(soft) < detail(again) < 0.36 * detail(sharp)


def test_a_soft_view_gets_as_much_detail_as_it_is_to_have(sharp: Image) -> None:
    soft = softened(sharp, 1.8)
    assert detail(soft) < 0.3 * detail(sharp)
    assert detail(sharpened(soft, like=sharp)) == pytest.approx(0.35 * detail(sharp), rel=0.1)


@pytest.mark.parametrize("sigma_px", [0.3, 0.8])
def test_a_view_that_is_sharp_enough_stays_as_it_is(sharp: Image, sigma_px: float) -> None:
    soft = softened(sharp, sigma_px)
    assert detail(soft) > 0.4 * detail(sharp)
    assert sharpened(soft, like=sharp) is soft


def test_brightness_does_not_decide_how_soft_a_view_is(sharp: Image) -> None:
    soft = softened(sharp, 2.0)
    np.testing.assert_allclose(sharpened(soft / 2, like=sharp), sharpened(soft, like=sharp) / 2, atol=1e-4)


def test_nothing_leaves_the_range_of_a_picture() -> None:
    checks = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((10, 10)))[..., None].repeat(3, axis=2)
    checks = checks.astype(np.float32)
    again = sharpened(softened(checks, 3.0), like=checks)
    assert again.min() == 0
    assert again.max() == 1
    assert again.dtype == np.float32


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_views_that_show_nothing_are_no_softer_than_others(sharp: Image, value: float) -> None:
    plain = np.full((*HW, 3), value, np.float32)
    assert np.isfinite(sharpened(plain, like=sharp)).all()
    assert sharpened(plain, like=plain) is plain


@pytest.mark.parametrize(
    ("most_pixels", "expected"),
    [(1280 * 640, (180, 240)), (4 / 3 * 120 * 160, (139, 185)), (120 * 160, HW), (1000, HW)],
)
def test_small_views_are_enlarged_up_to_a_size(
    sharp: Image, most_pixels: float, expected: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(other_view, "_ENLARGED_TO_PIXELS", most_pixels)
    assert enlarged_size(sharp) == expected


@pytest.mark.parametrize(("factor", "is_enlarged"), [(1, True), (4, True), (8, False), (12, False)])
@pytest.mark.parametrize("contrast", [1.0, 0.3])
def test_coarse_views_are_not(sharp: Image, factor: int, is_enlarged: bool, contrast: float) -> None:
    view = shrink_and_enlarge(sharp, factor=factor) * np.float32(contrast)
    assert (enlarged_size(view) != HW) is is_enlarged


@pytest.mark.parametrize(("name", "is_sharpened"), [("guided", True), ("lite", False)])
def test_a_network_that_knows_how_sure_it_is_sees_the_sharpened_view(
    name: str, is_sharpened: bool, sharp: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And refinement, which compares colours, the view as it came."""
    monkeypatch.setattr(other_view, "_ENLARGED_TO_PIXELS", 0)
    seen, refined = [], []

    def matched(ref: Image, src: Image, **_: object) -> DisparityMap:
        seen.append(src)
        return DisparityMap(ref[..., 0], ref[..., 1], ref[..., 2] > 0)

    def followed(found: DisparityMap, _: Image, src: Image) -> DisparityMap:
        refined.append(src)
        return found

    monkeypatch.setattr(inference, "_match_views", matched)
    monkeypatch.setattr(inference, "refine", followed)
    soft = softened(sharp, 3.0)
    match_with_network(sharp, soft, network=build_network(name, seed=1), window=(0, 32))
    np.testing.assert_array_equal(seen[0], sharpened(soft, like=sharp) if is_sharpened else soft)
    assert all(src is soft for src in refined)
    assert len(refined) == is_sharpened
