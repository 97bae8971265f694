"""Pictures of a layered world through large apertures: the mean of exact views from many points of the lens.

Three planes of focus and three apertures. Light is averaged in linear light. Letters: H W image.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from telewide.capture.images import write_image
from telewide.files import write_text
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.simulate.layers import LayeredScene, render_view
from telewide.srgb import linear_from_srgb, srgb_from_linear
from telewide.text import json_text

FOCUSES = {"far": 10, "mid": 50, "near": 90}
"""Percentiles of the disparities: three distances."""
APERTURES = {"small": 0.01, "medium": 0.02, "large": 0.04}
"""Radius of the disk at the disparity farthest from the focus in the middle, as a share of the shorter side."""
LENS_POINTS = 96
_GOLDEN_RAD = math.pi * (3 - math.sqrt(5))


def write_lens_truths(
    folder: Path, world: LayeredScene, *, disparity_px: FloatMap, points: int = LENS_POINTS
) -> tuple[Path, ...]:
    """Write what apertures see, ``bokeh-<focus>-<aperture>.png``, each with a JSON of focus and blur.

    Args:
        folder: made when it is not there.
        world: at a whole multiple of the photo's size.
        disparity_px: (H, W) of the photo, px of the photo.
        points: of the lens.

    Returns:
        The pictures.
    """
    span_px = np.ptp(np.percentile(disparity_px, (0.5, 99.5))) / 2
    written = []
    for focus, percentile in FOCUSES.items():
        focus_px = float(np.percentile(disparity_px, percentile))
        for aperture, share in APERTURES.items():
            k = share * min(disparity_px.shape) / max(float(span_px), 1e-6)
            picture = through_lens(world, focus_px=focus_px, k=k, hw=disparity_px.shape, points=points)
            path = folder / f"bokeh-{focus}-{aperture}.png"
            write_image(path, picture)
            facts = {"focus_disparity_px": focus_px, "radius_per_px": k}
            write_text(path.with_suffix(".json"), json_text(facts, indent=2) + "\n")
            written.append(path)
    return tuple(written)


def through_lens(
    world: LayeredScene, *, focus_px: float, k: float, hw: tuple[int, ...], points: int = LENS_POINTS
) -> FloatImage:
    """Photograph a world through a disk of a lens.

    Args:
        world: at a whole multiple of the photo's size.
        focus_px: disparity that is sharp, px of the photo.
        k: radius of the disk per px of disparity.
        hw: height and width of the photo.
        points: of the lens, on a golden spiral; fewer than 50 show.

    Returns:
        (H, W, 3) sRGB.
    """
    fineness = world.hw[0] / hw[0]
    total = np.zeros((*world.hw, 3), np.float32)
    for number in range(points):
        radius, angle_rad = k * math.sqrt((number + 0.5) / points), number * _GOLDEN_RAD
        parallax_xy = radius * math.cos(angle_rad), radius * math.sin(angle_rad)
        total += linear_from_srgb(render_view(world, parallax_xy=parallax_xy, pivot_px=focus_px * fineness).image)
    light = cv2.resize(total / points, (hw[1], hw[0]), interpolation=cv2.INTER_AREA)
    return np.clip(srgb_from_linear(np.asarray(light, dtype=np.float32)), 0, 1)
