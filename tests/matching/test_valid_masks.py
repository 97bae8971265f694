"""What no photo shows is not matched: nothing painted there moves the result, and no disparity is claimed of it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from training.small import rendered

from telewide.geometry.arrays import BoolMap, FloatImage
from telewide.geometry.stereo import ValidMasks
from telewide.matching.matcher import Match
from telewide.matching.semiglobal import match_semiglobal
from telewide.simulate.layers import RenderedPair

WINDOW = (0, 32)
REACH_PX = 8
"""Of the blur and the census before the costs; an edge of the unknown shows no farther among what was photographed."""


@pytest.fixture(scope="module")
def pair() -> RenderedPair:
    return rendered(3)


def masks_of(hw: tuple[int, int]) -> ValidMasks:
    """A corner of ref and a wedge of src that were not photographed, as of a turned photo."""
    rows, columns = np.mgrid[: hw[0], : hw[1]]
    return ValidMasks(ref=columns + rows > hw[0] // 2, src=columns < hw[1] - 20 - rows // 4)


def painted(view: FloatImage, valid: BoolMap, paint: FloatImage) -> FloatImage:
    return np.where(valid[..., None], view, paint).astype(np.float32)


def matchers() -> dict[str, Match]:
    from telewide.matching.inference import match_with_network
    from telewide.matching.networks import build_network

    network = build_network("lite", seed=1)
    return {"sgm": match_semiglobal, "network": partial(match_with_network, network=network)}


@pytest.mark.parametrize("name", ["sgm", "network"])
def test_no_disparity_is_claimed_where_one_of_the_photos_does_not_reach(name: str, pair: RenderedPair) -> None:
    valid = masks_of(pair.ref.shape[:2])
    found = matchers()[name](pair.ref, pair.src, window=WINDOW, valid=valid)
    x_src = np.round(np.arange(pair.ref.shape[1]) - found.disparity_px).astype(int)
    is_inside = (x_src >= 0) & (x_src < pair.ref.shape[1])
    partner = np.take_along_axis(valid.src, np.clip(x_src, 0, pair.ref.shape[1] - 1), axis=1)
    unknown = ~valid.ref | (is_inside & ~partner)
    assert 0.05 < unknown.mean() < 0.6
    assert not found.valid[unknown].any()
    assert not found.confidence[unknown].any()
    assert np.isfinite(found.disparity_px).all()
    whole = matchers()[name](pair.ref, pair.src, window=WINDOW)
    assert whole.confidence[unknown].any(), "nothing would have been claimed anyway"


def test_what_is_painted_there_moves_nothing(pair: RenderedPair) -> None:
    """A copy of what ref shows, at a wrong disparity, is the best match that paint can offer."""
    valid = masks_of(pair.ref.shape[:2])
    bait = np.roll(pair.ref, -28, axis=1)  # found at 28 px
    grey = np.full_like(pair.ref, 0.5)
    found = [
        match_semiglobal(pair.ref, painted(pair.src, valid.src, paint), window=WINDOW, valid=valid)
        for paint in (bait, grey)
    ]
    taken = match_semiglobal(pair.ref, painted(pair.src, valid.src, bait), window=WINDOW)
    off = [np.abs(each.disparity_px - pair.disparity_px) > 3 for each in (*found, taken)]
    assert off[2].mean() > 1.5 * off[0].mean(), "the bait is not taken without masks either"
    partner_px = np.arange(pair.ref.shape[1]) - pair.disparity_px
    edge_px = pair.ref.shape[1] - 20 - np.arange(pair.ref.shape[0])[:, None] // 4
    photographed = (partner_px < edge_px - REACH_PX) & ~pair.occluded
    moved = np.abs(found[0].disparity_px - found[1].disparity_px) > 0.25
    assert photographed.mean() > 0.4
    assert moved[photographed].mean() < 0.01
    assert (found[0].valid == found[1].valid)[photographed].mean() > 0.99


def test_masks_that_leave_nothing_out_change_nothing(pair: RenderedPair) -> None:
    whole = np.ones(pair.ref.shape[:2], np.bool_)
    with_masks = match_semiglobal(pair.ref, pair.src, window=WINDOW, valid=ValidMasks(whole, whole))
    without = match_semiglobal(pair.ref, pair.src, window=WINDOW)
    np.testing.assert_array_equal(with_masks.disparity_px, without.disparity_px)
    np.testing.assert_array_equal(with_masks.confidence, without.confidence)
    np.testing.assert_array_equal(with_masks.valid, without.valid)
