"""A small textured scene with exact truth, shared by the tests of the correction."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from textures import textured

from telewide.simulate.degrade import Degradation, degrade
from telewide.simulate.layers import Layer, LayeredScene, RenderedPair, render_pair

HW = (240, 360)


@pytest.fixture(scope="session")
def world() -> RenderedPair:
    """A slanted wall (disparity 8 to 12 px) behind a box (24 px) and a ramp (14 to 20 px), both views sharp."""
    rng = np.random.default_rng(7)
    wall = Layer(textured(rng, hw=(HW[0], HW[1] + 80)), None, (-20, 0), (8.0, 0.0, 4.0 / HW[0]))
    box = Layer(textured(rng, hw=(90, 110)), np.ones((90, 110), dtype=np.float32), (60, 40), (24.0, 0.0, 0.0))
    ramp = Layer(textured(rng, hw=(100, 120)), np.ones((100, 120), dtype=np.float32), (210, 110), (0.0, 0.05, 0.03))
    return render_pair(LayeredScene((wall, ramp, box), HW))


@pytest.fixture(scope="session")
def wide_src(world: RenderedPair) -> NDArray[np.float32]:
    """The source view as a camera three times coarser takes it: blurred, noisy, another colour, rows moved."""
    damage = Degradation(
        factor=3.0, noise_std=0.004, gain=(0.85, 0.95, 1.05), vertical_offset_px=1.2, vertical_slope=0.006
    )
    return degrade(world.src, damage, rng=np.random.default_rng(1))
