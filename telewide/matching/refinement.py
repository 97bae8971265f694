"""Refinement of a match by a network that knows how sure it is: the sharp view decides what the network leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap
from telewide.matching.backdrops import with_backdrops
from telewide.matching.even_surfaces import even_surfaces
from telewide.matching.lookalikes import follow_lookalikes

_MOVED_PX = 0.02
"""Distance from which on a pixel counts as moved."""
_BORNE_OUT = (0.28, 0.62)
"""Confidence of a pixel that lies on a surface, by its own: a base, and the share of its own. Fitted, as the next, to
how many of such pixels are right within 1 px in 22 scenes at three factors (``docs/decisions.md``, "Three sizes")."""
_AT_MOST = ((0.5, 0.75, 1.0, 1.5, 2.0), (1.0, 0.9, 0.75, 0.55, 0.42))
"""Distance moved, px, and the most that a pixel is then sure."""


def refine(found: DisparityMap, ref: FloatImage, src: FloatImage) -> DisparityMap:
    """Bring unsure pixels to what looks like them, walls that stuck to things back, and surfaces to evenness.

    Args:
        found: its confidence is the probability of an error below 1 px.
        ref: (H, W, 3) the view of the map, [0, 1].
        src: (H, W, 3) the other view.

    Returns:
        The map with other disparities, and with the confidence of these; what counts as measured is the same.
    """
    refined = even_surfaces(with_backdrops(follow_lookalikes(found, ref), ref, src), ref)
    moved_px = np.abs(refined.disparity_px - found.disparity_px)
    return replace(refined, confidence=_confidence_of_moved(found.confidence, moved_px))


def _confidence_of_moved(confidence: FloatMap, moved_px: FloatMap) -> FloatMap:
    """Take in that a pixel was brought to a surface, which bears it out, and how far, which speaks against it."""
    base, share = _BORNE_OUT
    borne_out = np.maximum(confidence, base + share * confidence)
    moved = np.minimum(borne_out, np.interp(moved_px, *_AT_MOST))
    return np.where(moved_px > _MOVED_PX, moved, confidence).astype(np.float32)
