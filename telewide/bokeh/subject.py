"""The subject of a photo, which "auto" focuses on: a large surface in the middle, or a thing that stands before it.

The surface is the nearest slab of disparity that fills an eighth of the middle, or else the fullest one. A thing is a
connected piece of a nearer slab, in a wider middle, large, filled and upright: neither a rod nor a strip of the ground.
Letters: H W image, h w thinned out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.geometry.arrays import BoolMap, FloatArray, FloatMap

OUTLIER_PERCENT = 0.5  # of the pixels at either end, whose disparity is taken for a mistake
SLAB_SHARE, SLAB_MIN_PX = 0.1, 1.0
"""Thickness of a surface or thing: a share of the scene's disparities, and at least so many px."""
SURFACE_SHARE, THING_SHARE = 0.12, 0.08
"""Of the weight of the middle that a surface fills at least, and a thing of that of the wider middle."""
THING_FILLED, THING_TALL, THING_WIDE = 0.4, 0.6, 0.7
"""Of its box at least; height over width at least; of the photo's width at most."""
SUBJECT_ENDS = 0.02
"""Of the subject, at either end of its depth, that may be blurred: mistakes."""
_MIDDLE, _WIDER_MIDDLE = 12, 4
"""The middle fades out from the centre as ``exp(-12 r^2)``, r from 0 to 1 at the sides: about their inner half."""
_SLAB_STEPS = 8  # slabs begin an eighth of their thickness apart
_SAMPLED_PX = 1 << 20
_LONGEST_PX = 192  # of the map in which things are looked for


@dataclass(frozen=True)
class Subject:
    """Depth of the subject, and where it is.

    Attributes:
        farthest_px: disparity of its far end.
        middle_px: median of its disparities.
        nearest_px: disparity of its near end.
        trusted: (H, W) trusted pixels among which it lies.
    """

    farthest_px: float
    middle_px: float
    nearest_px: float
    trusted: BoolMap


def find_subject(disparity_px: FloatMap, trusted: BoolMap, confidence: FloatMap) -> Subject:
    """Find the subject of a photo.

    Args:
        disparity_px: (H, W) float32, px.
        trusted: (H, W) pixels to find it from, at least one.
        confidence: (H, W) float32 in [0, 1].
    """
    step = max(round(math.sqrt(disparity_px.size / _SAMPLED_PX)), 1)
    if not trusted[step // 2 :: step, step // 2 :: step].any():
        step, confidence = 1, np.ones(disparity_px.shape, np.float32)
    sampled = (slice(step // 2, None, step), slice(step // 2, None, step))
    some_px = disparity_px[sampled]
    weight = np.where(trusted[sampled], np.maximum(confidence[sampled], 1e-3), 0)
    surface, slab_px = _nearest_surface(some_px, weight)
    nearest_px = surface[2]
    thing = _nearest_thing(some_px, weight, before_px=nearest_px, slab_px=slab_px)
    if thing is None:
        return Subject(*surface, trusted=trusted)
    beyond = trusted[sampled][thing] & (some_px[thing] > nearest_px)
    rows, columns = (slice(side.start * step, side.stop * step) for side in thing)
    there = np.zeros_like(trusted)
    there[rows, columns] = trusted[rows, columns]
    return Subject(*_depth_of_thing(some_px[thing][beyond].astype(np.float64), slab_px=slab_px), trusted=there)


def _nearest_surface(disparity_px: FloatMap, weight: FloatMap) -> tuple[tuple[float, float, float], float]:
    """Farthest, middle and nearest disparity of the surface in the middle, and the thickness of a slab."""
    height, width = disparity_px.shape
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)[None]
    central = weight * np.exp(-_MIDDLE * (x**2 + y**2))
    value_px, share = disparity_px[weight > 0].astype(np.float64), central[weight > 0].astype(np.float64)
    far_px, near_px = np.percentile(value_px, (OUTLIER_PERCENT, 100 - OUTLIER_PERCENT))
    inside = (value_px >= far_px) & (value_px <= near_px)
    value_px, share = value_px[inside], share[inside]
    slab_px = max(SLAB_SHARE * (near_px - far_px), SLAB_MIN_PX)
    start_px = _nearest_slab(value_px - far_px, share / share.sum(), slab_px=slab_px) + far_px
    in_slab = (value_px >= start_px) & (value_px <= start_px + slab_px)
    return _depth_of(value_px[in_slab], share[in_slab]), slab_px


def _nearest_slab(value_px: FloatArray, share: FloatArray, *, slab_px: float) -> float:
    """Far side of the nearest slab that holds enough, or of the fullest."""
    step_px = slab_px / _SLAB_STEPS
    histogram = np.bincount((value_px / step_px).astype(np.int64), weights=share)
    held = np.convolve(histogram, np.ones(_SLAB_STEPS))[_SLAB_STEPS - 1 :]  # by slab, named by its farthest step
    large = np.flatnonzero(held >= SURFACE_SHARE)
    first = int(large[-1]) if len(large) else int(held.argmax())
    nearest = first
    while len(large) and first > max(nearest - _SLAB_STEPS, 0) and held[first - 1] > held[first]:
        first -= 1  # the whole surface, not its near side alone; but no other one, at the far end of the ground
    return first * step_px


def _nearest_thing(
    disparity_px: FloatMap, weight: FloatMap, *, before_px: float, slab_px: float
) -> tuple[slice, slice] | None:
    """Rows and columns of the box around the nearest thing all of which has a larger disparity; None without."""
    step = -(-max(disparity_px.shape) // _LONGEST_PX)
    thinned_px, inner = (each[step // 2 :: step, step // 2 :: step] for each in (disparity_px, weight))
    if not (inner > 0).any():
        return None
    y, x = (np.linspace(-1, 1, size) for size in inner.shape)
    inner = inner * np.exp(-_WIDER_MIDDLE * (x[None] ** 2 + y[:, None] ** 2))
    inner /= inner.sum()
    nearest_px = float(np.percentile(thinned_px[inner > 0], 99.5))
    for start_px in np.arange(nearest_px - slab_px, before_px, -slab_px / _SLAB_STEPS):
        here = (inner > 0) & (thinned_px >= start_px) & (thinned_px <= start_px + slab_px)
        box = _largest_piece(here, inner)
        if box is not None:
            return slice(box[0].start * step, box[0].stop * step), slice(box[1].start * step, box[1].stop * step)
    return None


def _largest_piece(here: BoolMap, weight: FloatMap) -> tuple[slice, slice] | None:
    """Box of the piece that weighs most and is a thing; None where none is."""
    n, label, facts, _ = cv2.connectedComponentsWithStats(here.astype(np.uint8), connectivity=4)
    held = np.bincount(label.ravel(), weights=(weight * here).ravel(), minlength=n)
    for piece in np.argsort(held)[::-1]:
        if held[piece] < THING_SHARE:
            break
        left, top, width, height, area = (int(fact) for fact in facts[piece])
        if (
            area >= THING_FILLED * width * height
            and height >= THING_TALL * width
            and width <= THING_WIDE * here.shape[1]
        ):
            return slice(top, top + height), slice(left, left + width)
    return None


def _depth_of_thing(value_px: FloatArray, *, slab_px: float) -> tuple[float, float, float]:
    """Farthest, middle and nearest disparity of a thing, by the fullest slab of its box."""
    ordered_px = np.sort(value_px)
    held = np.searchsorted(ordered_px, ordered_px + slab_px, side="right") - np.arange(len(ordered_px))
    first = int(held.argmax())
    own_px = ordered_px[first : first + int(held[first])]
    return _depth_of(own_px, np.ones(len(own_px)))


def _depth_of(values_px: FloatArray, weights: FloatArray) -> tuple[float, float, float]:
    """Farthest, middle and nearest of some disparities, without the ends."""
    order = np.argsort(values_px)
    passed = np.cumsum(weights[order])
    farthest_px, middle_px, nearest_px = (
        float(values_px[order][np.searchsorted(passed, share * passed[-1])])
        for share in (SUBJECT_ENDS, 0.5, 1 - SUBJECT_ENDS)
    )
    return farthest_px, middle_px, nearest_px
