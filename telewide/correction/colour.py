"""Colour of one shot: a gain and an offset per channel that carry src's colours to ref's.

Two cameras expose and balance a scene each in its own way, differently in every shot. Colours are compared at matched
points, averaged over a neighbourhood wide enough that sharpness plays no part.
Values are sRGB-encoded in [0, 1]; ``ref = gain * src + offset`` per channel. Letters: N matches, S samples, H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.correction.matches import FloatImage, Matches

MIN_SAMPLES = 12
"""Fewer matched points than this leave the colours alone."""
EQUAL_DELTA = 0.004
"""Views whose colours differ less than this (one step of 8 bits) are equal."""
_BLUR_PER_HEIGHT = 0.006
_GAIN_RANGE = (0.3, 3.0)
_CLIPPED = (0.02, 0.98)
_HUBER = 0.02
_PRIOR_SPREAD = 0.02
_ITERATIONS = 15


@dataclass(frozen=True)
class ColourFit:
    """Gain and offset per channel, R G B.

    Attributes:
        gain: (3,) float64.
        offset: (3,) float64, in units of the [0, 1] image.
        delta_before: median absolute colour difference at the matches, in units of the image; NaN without matches.
        delta_after: what the fit leaves of it.
        n: number of matched points it was fitted to.
    """

    gain: NDArray[np.float64]
    offset: NDArray[np.float64]
    delta_before: float
    delta_after: float
    n: int

    @property
    def is_identity(self) -> bool:
        """Whether the colours are left alone."""
        return bool(np.all(self.gain == 1.0) and np.all(self.offset == 0.0))


def fit_colour(ref: FloatImage, src: FloatImage, matches: Matches) -> ColourFit:
    """Fit src's colours to ref's at matched points (iteratively reweighted, Huber at 0.02).

    Where the points span few shades a prior pulls the fit to a pure gain. A fit that does not lessen the difference by
    a tenth, or views that are equal already, give the identity.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: (H, W, 3), the same shape.
        matches: N matches of the two.

    Returns:
        The fit.
    """
    ref_colour, src_colour = sample_colours(ref, src, matches)
    before = colour_delta(ref_colour, src_colour)
    identity = ColourFit(np.ones(3), np.zeros(3), before, before, len(matches))
    if len(matches) < MIN_SAMPLES or before < EQUAL_DELTA:
        return identity
    laws = np.array([_fit_channel(ref_colour[:, c], src_colour[:, c]) for c in range(3)])
    gain, offset = laws[:, 0], laws[:, 1]
    after = colour_delta(ref_colour, src_colour * gain + offset)
    if after > 0.9 * before:
        return identity
    return ColourFit(gain, offset, before, after, len(matches))


def apply_colour(src: FloatImage, fit: ColourFit) -> FloatImage:
    """Carry src's colours to ref's.

    Args:
        src: (H, W, 3) RGB in [0, 1].
        fit: what :func:`fit_colour` found.

    Returns:
        The same shape, float32 in [0, 1]; src itself where the fit is the identity.
    """
    if fit.is_identity:
        return src
    fitted = src * fit.gain.astype(np.float32) + fit.offset.astype(np.float32)
    return np.asarray(np.clip(fitted, 0.0, 1.0), dtype=np.float32)


def sample_colours(
    ref: FloatImage, src: FloatImage, matches: Matches
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean colours of the neighbourhoods of matched points: (N, 3) of ref and (N, 3) of src."""
    sigma_px = max(2.0, _BLUR_PER_HEIGHT * ref.shape[0])
    sampled = []
    for image, points_px in ((ref, matches.ref_px), (src, matches.src_px)):
        blurred = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101)
        at = np.clip(np.round(points_px).astype(np.intp), 0, (image.shape[1] - 1, image.shape[0] - 1))
        sampled.append(blurred[at[:, 1], at[:, 0]].astype(np.float64).reshape(len(matches), 3))
    return sampled[0], sampled[1]


def colour_delta(ref_colour: NDArray[np.float64], src_colour: NDArray[np.float64]) -> float:
    """Median over the points of the mean absolute difference of the channels; NaN without points."""
    return float(np.median(np.abs(ref_colour - src_colour).mean(axis=1))) if len(ref_colour) else float("nan")


def colour_ratio(ref_colour: NDArray[np.float64], src_colour: NDArray[np.float64]) -> tuple[float, float, float]:
    """Ratio ref to src of the mean of each channel; NaN without points."""
    if len(ref_colour) == 0:
        return (float("nan"),) * 3
    red, green, blue = ref_colour.mean(axis=0) / np.maximum(src_colour.mean(axis=0), 1e-6)
    return float(red), float(green), float(blue)


def _fit_channel(ref: NDArray[np.float64], src: NDArray[np.float64]) -> tuple[float, float]:
    """Gain and offset of one channel from (S,) samples that neither view has clipped."""
    inside = (np.minimum(ref, src) > _CLIPPED[0]) & (np.maximum(ref, src) < _CLIPPED[1])
    if inside.sum() < MIN_SAMPLES:
        inside = np.ones(len(ref), dtype=bool)
    ref, src = ref[inside], src[inside]
    ratio = float(np.clip(np.median(ref) / max(float(np.median(src)), 1e-3), *_GAIN_RANGE))
    centre = float(src.mean())
    # parameters: value at the centre, and gain, the latter drawn to the ratio by a few samples' worth of prior
    design = np.column_stack([np.ones(len(src)), src - centre])
    prior = np.diag([0.0, len(src) * _PRIOR_SPREAD**2])
    law = np.array([ratio * centre, ratio])
    target = prior @ np.array([0.0, ratio])
    for _ in range(_ITERATIONS):
        weight = 1.0 / np.maximum(np.abs(ref - design @ law) / _HUBER, 1.0)
        law = np.linalg.solve(design.T @ (weight[:, None] * design) + prior, design.T @ (weight * ref) + target)
    gain = float(np.clip(law[1], *_GAIN_RANGE))
    return gain, float(law[0] - gain * centre)
