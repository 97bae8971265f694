"""How one view lies in the other when nothing is known: a free similarity from matches of any scale and angle.

Asked only where a pair that should be rectified has few matches along its rows, to say why.
Convention: ``p_src = scale * R(rotation) p_ref + shift``; a scale above 1 shows the scene larger in src.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import FloatImage
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
    sift = cv2.SIFT_create(nfeatures=_MAX_FEATURES, contrastThreshold=0.02)  # type: ignore[attr-defined]
    points, descriptors = zip(
        *(sift.detectAndCompute(np.round(np.clip(v, 0, 1) * 255).astype(np.uint8), None) for v in (ref_grey, src_grey)),
        strict=True,
    )
    if min(len(p) for p in points) < 3:
        return None
    tentative = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors[0], descriptors[1], k=2)
    chosen = [best for best, second in tentative if best.distance < _RATIO * second.distance]
    if len(chosen) < 3:
        return None
    ref_px = np.array([points[0][m.queryIdx].pt for m in chosen])
    src_px = np.array([points[1][m.trainIdx].pt for m in chosen])
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
