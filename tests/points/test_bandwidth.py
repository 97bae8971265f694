"""Detail of two views, against pictures shrunk or blurred by a known factor."""

from __future__ import annotations

import numpy as np
import pytest

from telewide.points.bandwidth import blur_to_bandwidth, estimate_asymmetry
from telewide.simulate.degrade import shrink_and_enlarge
from telewide.simulate.layers import RenderedPair


@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0, 4.0, 6.0])
def test_asymmetry_is_the_factor_of_the_shrinking(world: RenderedPair, factor: float) -> None:
    coarse = shrink_and_enlarge(world.src, factor=factor)
    assert estimate_asymmetry(world.ref, coarse) == pytest.approx(factor, rel=0.25)


def test_swapped_views_give_the_inverse(world: RenderedPair) -> None:
    coarse = shrink_and_enlarge(world.src, factor=3.0)
    forth, back = estimate_asymmetry(world.ref, coarse), estimate_asymmetry(coarse, world.ref)
    assert forth is not None
    assert back is not None
    assert forth * back == pytest.approx(1.0, rel=1e-6)


def test_equal_views_have_no_asymmetry(world: RenderedPair) -> None:
    assert estimate_asymmetry(world.ref, world.src) == 1.0


def test_gain_and_offset_do_not_matter(world: RenderedPair) -> None:
    coarse = shrink_and_enlarge(world.src, factor=3.0)
    paler = (0.6 * coarse + 0.2).astype(np.float32)
    assert estimate_asymmetry(world.ref, paler) == pytest.approx(estimate_asymmetry(world.ref, coarse), rel=0.02)


def test_a_view_without_texture_tells_nothing(world: RenderedPair) -> None:
    assert estimate_asymmetry(world.ref, np.full_like(world.src, 0.5)) is None


@pytest.mark.parametrize("factor", [2.0, 4.0])
def test_blurring_by_a_factor_reads_as_that_factor(world: RenderedPair, factor: float) -> None:
    blurred = blur_to_bandwidth(world.ref, factor=factor)
    assert estimate_asymmetry(world.ref, blurred) == pytest.approx(factor, rel=0.2)


def test_a_factor_of_one_changes_nothing(world: RenderedPair) -> None:
    assert blur_to_bandwidth(world.ref, factor=1.0) is world.ref
