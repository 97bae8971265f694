"""The small scene that these tests share, also as a pair."""

import pytest
from small_scene import wide_src, world

from telewide.capture.pair import RectifiedPair
from telewide.geometry.arrays import FloatImage
from telewide.simulate.layers import RenderedPair

__all__ = ["wide_src", "world"]


@pytest.fixture
def pair(world: RenderedPair, wide_src: FloatImage) -> RectifiedPair:
    return RectifiedPair("box", world.ref, wide_src)
