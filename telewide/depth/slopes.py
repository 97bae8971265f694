"""Slopes between two surfaces made steps, and their outlines smooth.

A network draws an edge of depth as a slope of several pixels: values that belong to neither surface, and that no median
takes away, for they are many. In a bokeh they are a ragged fringe.
Letters: H W image.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from telewide.geometry.arrays import FloatMap

SLOPE_PX = 9
"""Width of what may be a slope."""
STEP_PX = 3.0
"""Rise of a slope that is a step between two surfaces."""
RAMP = 1.9
"""A surface that leans rises twice as much over twice the width; a step rises no more."""
SAME_PX = 0.5
LEAST_COMPANY = 16
"""Of the 25 pixels around one, itself among them: on a straight edge of a surface 15 have its value."""
OUTLINE_PX = 3
LEAST_OUTLINE_COMPANY = 5
"""Of the 3 x 3 pixels around one on an outline, itself among them: the greater part."""


def steepened(disparity_px: FloatMap) -> FloatMap:
    """Give each pixel on the slope of an edge the value of the nearer of its two surfaces.

    Source: toggle mapping, H. Kramer and J. Bruckner, "Iterations of a non-linear transformation for enhancement of
    digital images", Pattern Recognition 7, 1975; here where the slope is a step and no leaning surface.

    Args:
        disparity_px: (H, W) float32, px, finite.

    Returns:
        (H, W) float32; every value is one of the window around its pixel.
    """
    near_px, far_px = _extremes(disparity_px, SLOPE_PX)
    beyond_near_px, beyond_far_px = _extremes(disparity_px, 2 * SLOPE_PX - 1)
    rise_px = near_px - far_px
    is_step = (rise_px > STEP_PX) & (beyond_near_px - beyond_far_px < RAMP * rise_px)
    is_near = near_px - disparity_px < disparity_px - far_px
    is_slope = is_step & (_company(disparity_px) < LEAST_COMPANY)
    return np.where(is_slope, np.where(is_near, near_px, far_px), disparity_px)


def _company(disparity_px: FloatMap) -> FloatMap:
    """Count the pixels of the 5 x 5 around each that have its value, itself among them: few on a slope."""
    height, width = disparity_px.shape
    around_px = cv2.copyMakeBorder(disparity_px, 2, 2, 2, 2, cv2.BORDER_REPLICATE)
    count = np.zeros(disparity_px.shape, np.float32)
    for y, x in itertools.product(range(5), repeat=2):
        count += np.abs(around_px[y : y + height, x : x + width] - disparity_px) <= SAME_PX
    return count


def with_smooth_outlines(disparity_px: FloatMap, *, jump_px: float) -> FloatMap:
    """Take the median of 3 x 3 pixels along edges, and once more where a pixel still stands out of its outline.

    Args:
        disparity_px: (H, W) float32, px, finite.
        jump_px: a difference between neighbours that is an edge.
    """
    near_px, far_px = _extremes(disparity_px, 3)
    square = np.ones((3, 3), np.uint8)
    at_edge = cv2.dilate((near_px - far_px > jump_px).astype(np.uint8), square) > 0
    smooth_px = np.where(at_edge, cv2.medianBlur(disparity_px, OUTLINE_PX), disparity_px).astype(np.float32)
    y, x = np.nonzero(at_edge)
    around_px = cv2.copyMakeBorder(smooth_px, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    company = np.zeros(len(y), np.uint8)
    for step_y, step_x in itertools.product(range(3), repeat=2):
        company += np.abs(around_px[y + step_y, x + step_x] - smooth_px[y, x]) <= jump_px
    y, x = y[company < LEAST_OUTLINE_COMPANY], x[company < LEAST_OUTLINE_COMPANY]
    smooth_px[y, x] = cv2.medianBlur(smooth_px, OUTLINE_PX)[y, x]
    return smooth_px


def _extremes(disparity_px: FloatMap, size: int) -> tuple[FloatMap, FloatMap]:
    """Largest and least value of the square around each pixel."""
    square = np.ones((size, size), np.uint8)
    largest, least = cv2.dilate(disparity_px, square), cv2.erode(disparity_px, square)
    return np.asarray(largest, dtype=np.float32), np.asarray(least, dtype=np.float32)
