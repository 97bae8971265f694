"""What is known of one capture once its disparity is: the map, the camera and, where the scale is known, metres.

``depth_m = f_px * baseline_m / (disparity_px + doffs_px)``, z along ref's optical axis, on the photo as it was given.
Nothing is invented: without a focal length there is no K, without a baseline no depth in metres.
Letters: H W image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from telewide.capture.facts import CaptureFacts
from telewide.geometry.stereo import DisparityMap, FloatMap, depth_from_disparity

FloatMatrix = NDArray[np.float64]


@dataclass(frozen=True)
class DepthResult:
    """The answer for one capture.

    Attributes:
        name: of the capture.
        disparity: px of the ref photo, with its confidence and what was measured.
        K: (3, 3) float64 intrinsics of the ref photo, px; None where the focal length is not known.
        baseline_m: distance of the two lenses, m; None where not known.
        depth_m: (H, W) float32, m, NaN where unknown; None where K or the baseline is not known.
        doffs_px: ``cx_src - cx_ref``, px.
        rotated_deg: how far the photos were turned counter-clockwise before they were given (multiple of 90).
            Files keep that orientation, pictures for people are shown upright.
    """

    name: str
    disparity: DisparityMap
    K: FloatMatrix | None = None
    baseline_m: float | None = None
    depth_m: FloatMap | None = None
    doffs_px: float = 0.0
    rotated_deg: int = 0


def depth_result(name: str, disparity: DisparityMap, *, facts: CaptureFacts | None = None) -> DepthResult:
    """Put a disparity map together with what is known of the cameras.

    The principal point is taken at the centre of the photo, ``((W - 1) / 2, (H - 1) / 2)``: the facts do not state it.

    Args:
        name: of the capture.
        disparity: (H, W) maps, px of the ref photo.
        facts: what ``captures.yaml`` states: focal length in px of the ref photo, baseline in m, doffs in px.

    Returns:
        The result; metric only where focal length and baseline are both known.
    """
    if facts is None:
        return DepthResult(name=name, disparity=disparity)
    doffs_px = facts.doffs_px or 0.0
    depth_m = None
    if facts.f_px is not None and facts.baseline_m is not None:
        depth_m = depth_from_disparity(
            disparity.disparity_px, f_px=facts.f_px, baseline_m=facts.baseline_m, doffs_px=doffs_px
        )
    return DepthResult(
        name=name,
        disparity=disparity,
        K=None if facts.f_px is None else _centred_intrinsics(facts.f_px, hw=disparity.disparity_px.shape),
        baseline_m=facts.baseline_m,
        depth_m=depth_m,
        doffs_px=doffs_px,
        rotated_deg=facts.rotated_deg,
    )


def _centred_intrinsics(f_px: float, *, hw: tuple[int, ...]) -> FloatMatrix:
    cx, cy = (hw[1] - 1) / 2, (hw[0] - 1) / 2
    return np.array([[f_px, 0.0, cx], [0.0, f_px, cy], [0.0, 0.0, 1.0]])
