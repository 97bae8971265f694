"""Refinement of a match by a network that knows how sure it is: the sharp view decides what the network leaves open."""

from __future__ import annotations

from telewide.geometry.arrays import FloatImage
from telewide.geometry.stereo import DisparityMap
from telewide.matching.backdrops import with_backdrops
from telewide.matching.even_surfaces import even_surfaces
from telewide.matching.lookalikes import follow_lookalikes


def refine(found: DisparityMap, ref: FloatImage, src: FloatImage) -> DisparityMap:
    """Bring unsure pixels to what looks like them, walls that stuck to things back, and surfaces to evenness.

    Args:
        found: its confidence is the probability of an error below 1 px.
        ref: (H, W, 3) the view of the map, [0, 1].
        src: (H, W, 3) the other view.

    Returns:
        The map with other disparities; confidence and what counts as measured are the same.
    """
    return even_surfaces(with_backdrops(follow_lookalikes(found, ref), ref, src), ref)
