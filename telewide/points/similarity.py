"""Similarity of two views when nothing is known: a free similarity from matches of any scale and angle.

Asked only where a pair that should be rectified has few matches along its rows, to say why.
Convention: ``p_src = scale * R(rotation) p_ref + shift``; a scale above 1 shows the scene larger in src.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage
from telewide.points.features import sift_features
from telewide.srgb import grey

_MAX_FEATURES = 2000
_LONGEST_SIDE_PX = 800
_RATIO = 0.8
_TOLERANCE_SHARE = 0.02


@dataclass(frozen=True)
class Overlap:
    """A similarity from ref to src.

    Attributes:
        n: matches that agree with it.
        scale: size of the scene in src over that in ref.
        rotation_deg: turn of src against ref, clockwise on the screen.
        vertical_px: ``y_ref - y_src`` at ref's centre, px.
    """

    n: int
    scale: float
    rotation_deg: float
    vertical_px: float


def find_overlap(ref: FloatImage, src: FloatImage) -> Overlap | None:
    """Find the similarity most SIFT matches of two views agree with, within 2 % of the image's longer side.

    Args:
        ref: (H, W, 3) RGB in [0, 1].
        src: (H', W', 3) RGB in [0, 1].

    Returns:
        The similarity; None where there are too few matches for one.
    """
    shrink = min(1.0, _LONGEST_SIDE_PX / max(ref.shape[:2]))
    ref_grey, src_grey = _shrunk(grey(ref), shrink), _shrunk(grey(src), shrink)
    views = (np.round(np.clip(view, 0, 1) * 255).astype(np.uint8) for view in (ref_grey, src_grey))
    of_ref, of_src = (sift_features(view, max_features=_MAX_FEATURES, contrast_threshold=0.02) for view in views)
    if min(len(of_ref), len(of_src)) < 3:
        return None
    tentative = cv2.BFMatcher(cv2.NORM_L2).knnMatch(of_ref.descriptor, of_src.descriptor, k=2)
    chosen = [best for best, second in tentative if best.distance < _RATIO * second.distance]
    if len(chosen) < 3:
        return None
    ref_px = of_ref.xy_px[[match.queryIdx for match in chosen]]
    src_px = of_src.xy_px[[match.trainIdx for match in chosen]]
    tolerance_px = _TOLERANCE_SHARE * max(ref_grey.shape)
    similarity, inlier = cv2.estimateAffinePartial2D(ref_px, src_px, ransacReprojThreshold=tolerance_px)
    if similarity is None:
        return None
    n = len(np.unique(np.round(src_px[inlier.ravel() > 0] / 3), axis=0))  # many points on one spot are one witness
    centre = (np.array(ref_grey.shape[::-1]) - 1) / 2
    return Overlap(
        n=n,
        scale=float(np.hypot(similarity[0, 0], similarity[1, 0])),
        rotation_deg=float(np.degrees(np.arctan2(similarity[1, 0], similarity[0, 0]))),
        vertical_px=float(centre[1] - (similarity[1] @ np.array([*centre, 1.0]))) / shrink,
    )


def _shrunk(image_HW: FloatImage, shrink: float) -> FloatImage:
    if shrink == 1.0:
        return image_HW
    return np.asarray(cv2.resize(image_HW, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), dtype=np.float32)
