"""The kernels that a blind restorer assumes, and their principal components.

Ranges are those of Luo et al., *Unfolding the alternating optimization for blind super resolution*, 2020: setting 1
isotropic, setting 2 turned ellipses, disturbed pixel by pixel. Letters: B kernels, H W kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage, FloatMap

KERNEL_SIDE = 21
"""Pixels of the large picture."""
KERNELS_OF_COMPONENTS = 3000
"""Enough for ten components to stand still in three digits."""


@dataclass(frozen=True)
class KernelRange:
    """Range of Gaussian blurs.

    Attributes:
        sigma_px: least and largest standard deviation, px of the large picture.
        is_isotropic: one deviation for both axes, else two and any direction.
        disturbance: every value grows by a share of up to so much.
    """

    sigma_px: tuple[float, float]
    is_isotropic: bool
    disturbance: float = 0.0


KERNEL_RANGES = {
    "isotropic": KernelRange((0.2, 4.0), is_isotropic=True),
    "anisotropic": KernelRange((0.6, 5.0), is_isotropic=False, disturbance=0.25),
}
"""Settings 1 and 2, for a factor of 4."""


def draw_kernels(kernels: KernelRange, *, count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw blurs.

    Args:
        kernels: which may come.
        count: how many.
        rng: source of the draws.

    Returns:
        (count, KERNEL_SIDE, KERNEL_SIDE) float32, each of sum 1.
    """
    along = rng.uniform(*kernels.sigma_px, size=(count, 1, 1))
    across = along if kernels.is_isotropic else rng.uniform(*kernels.sigma_px, size=(count, 1, 1))
    angle_rad = rng.uniform(-np.pi, np.pi, size=(count, 1, 1))
    y, x = np.mgrid[:KERNEL_SIDE, :KERNEL_SIDE] - KERNEL_SIDE // 2
    first = (x * np.cos(angle_rad) + y * np.sin(angle_rad)) / along
    second = (y * np.cos(angle_rad) - x * np.sin(angle_rad)) / across
    drawn = np.exp(-0.5 * (first**2 + second**2))
    drawn *= 1 + rng.uniform(0, kernels.disturbance, size=drawn.shape)
    return np.asarray(drawn / drawn.sum(axis=(1, 2), keepdims=True), np.float32)


def kernel_components(kernels: KernelRange, *, length: int, seed: int = 0) -> FloatMap:
    """Principal components of the kernels that may come: (KERNEL_SIDE^2, length) float32, of unit length."""
    drawn = draw_kernels(kernels, count=KERNELS_OF_COMPONENTS, rng=np.random.default_rng(seed))
    flat = drawn.reshape(len(drawn), -1).astype(np.float64)
    centred = flat - flat.mean(axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    return np.ascontiguousarray(vectors[:, ::-1][:, :length], np.float32)


def blur_with(image: FloatImage, kernel: NDArray[np.float32]) -> FloatImage:
    """Convolve a picture (H, W, 3) with a kernel, mirrored at its border."""
    # filter2D correlates.
    flipped = np.ascontiguousarray(kernel[::-1, ::-1])
    return np.asarray(cv2.filter2D(image, -1, flipped, borderType=cv2.BORDER_REFLECT_101), np.float32)
