"""SIFT points of one view (Lowe 2004), and their descriptors square-rooted (Arandjelovic and Zisserman 2012).

Letters: M points, H W image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolArray, ByteImage, FloatArray, FloatImage


@dataclass(frozen=True)
class Features:
    """Feature points of one view.

    Attributes:
        xy_px: (M, 2) positions.
        size_px: (M,) diameters.
        angle_deg: (M,) orientations, in [0, 360).
        descriptor: (M, 128) float32.
    """

    xy_px: FloatArray
    size_px: FloatArray
    angle_deg: FloatArray
    descriptor: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.xy_px)

    def select(self, keep: BoolArray) -> Features:
        """Return the points a mask names."""
        return Features(self.xy_px[keep], self.size_px[keep], self.angle_deg[keep], self.descriptor[keep])

    def rooted(self) -> Features:
        """Return the points with unit descriptors whose products compare histograms (Hellinger kernel)."""
        total = np.maximum(self.descriptor.sum(axis=1, keepdims=True), 1e-9)
        return replace(self, descriptor=np.sqrt(self.descriptor / total).astype(np.float32))


def sift_features(
    image_u8: ByteImage, *, max_features: int, contrast_threshold: float, edge_threshold: float = 10.0
) -> Features:
    """Find the SIFT points of a picture.

    Args:
        image_u8: (H, W) grey.
        max_features: at most so many points, the strongest.
        contrast_threshold: weakest extremum to take, of the full range.
        edge_threshold: how much longer than wide a blob may be.

    Returns:
        The points with the descriptors as OpenCV gives them.
    """
    sift = cv2.SIFT_create(  # type: ignore[attr-defined]
        nfeatures=max_features, contrastThreshold=contrast_threshold, edgeThreshold=edge_threshold
    )
    points, descriptor = sift.detectAndCompute(image_u8, None)
    if not len(points):
        return Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.float32))
    # OpenCV keeps all that are as strong as the last: of a drawn pattern, tens of thousands.
    response = np.array([point.response for point in points])
    strongest = np.sort(np.argsort(-response, kind="stable")[:max_features])
    kept = [points[at] for at in strongest]
    return Features(
        np.array([point.pt for point in kept], dtype=np.float64),
        np.array([point.size for point in kept], dtype=np.float64),
        np.array([point.angle for point in kept], dtype=np.float64),
        np.asarray(descriptor, dtype=np.float32)[strongest],
    )


def stretched(image_HW: FloatImage) -> ByteImage:
    """Stretch a picture to the full range of 8 bits, half a per cent cut at either end: thresholds are absolute.

    Args:
        image_HW: (H, W) grey, in [0, 1].
    """
    low, high = np.percentile(image_HW, (0.5, 99.5))
    levels = np.clip((image_HW - low) * (255.0 / max(float(high - low), 1.0 / 255.0)), 0, 255)
    return np.asarray(np.round(levels), dtype=np.uint8)
