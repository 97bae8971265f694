"""Strands: twigs, rods and cables that a matcher has found in part, followed along their line through the photo.

A strand is a straight piece that is darker, or brighter, than both of its sides, and as wide as a few pixels. Where
part of it surely stands before its ground, and the disparities of that part lie on a line, the rest of its pixels, of
the same colour, take what that line says for their place. Wide sees strands a pixel wide, so most of one may be missed.
Letters: H W image, h w of a fraction of its size; N pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from telewide.depth.nearest import nearest_known
from telewide.geometry.arrays import BoolMap, ByteImage, FloatArray, FloatMap

WIDEST_PX = 9
"""Strands are less wide."""
CONTRAST = 0.05
"""Of a strand against both of its sides, sRGB."""
DIRECTIONS = 12
LEAST_LENGTH_PX = 11
GAP_PX = 9
"""Gaps that are passed over: berries, knots, noise."""
SURE = 0.5
"""Confidence of the part that is found."""
BEFORE_PX = 3.0
"""Disparity by which it stands before its ground, and"""
STILL_BEFORE_PX = 1.0
"""by which the rest of it has to."""
LEAST_FOUND = 15
LEAST_FOUND_SHARE = 0.1
LARGEST_WIDTH_PX, LEAST_ELONGATION = 2.5, 4.0
"""Standard deviation across a strand, and how many times that is the one along it."""
OFF_LINE_PX = 1.0
"""Disparity by which the found part may be off its line, of which"""
LEAST_ON_LINE = 0.5
"""at least this share has to lie on it."""
ALIKE = 0.1
"""Difference of colour within a strand, sRGB."""
FARTHEST = 3.0
"""Times the length of the found part, beyond its ends."""
LEVEL_PX = 20
"""Beyond the ends of the found part its line goes on for so long, and is then level."""


@dataclass(frozen=True)
class _Photo:
    """A map and its photo at the size at which strands are looked for.

    Attributes:
        disparity_px: (h, w).
        ground_px: (h, w) of what lies behind strands.
        colour: (h, w, 3).
        is_sure: (h, w) where something thin surely stands before its ground.
    """

    disparity_px: FloatMap
    ground_px: FloatMap
    colour: FloatMap
    is_sure: BoolMap


def with_strands(disparity_px: FloatMap, guide_rgb: FloatMap, *, trust: FloatMap, scale: int = 1) -> FloatMap:
    """Give strands that are found in part the disparity of that part.

    Args:
        disparity_px: (H, W) float32, px, finite.
        guide_rgb: (H, W, 3) float32 in [0, 1], the tele photo.
        trust: (H, W) float32 confidence, 0 where nothing was measured.
        scale: strands are looked for at this fraction of the size.

    Returns:
        (H, W) float32; nothing is farther than it was.
    """
    photo = _at_fraction(disparity_px, guide_rgb, trust, scale=scale)
    if not photo.is_sure.any():
        return disparity_px
    told_px, colour = np.full_like(photo.disparity_px, -np.inf), np.zeros_like(photo.colour)
    for mask in _straight_pieces(photo):
        _tell(photo, mask, told_px, colour)
    is_told = np.isfinite(told_px)
    if not is_told.any():
        return disparity_px
    # At the photo's own size the outline is where its colour ends, up to a pixel of the fraction away.
    distance, source = nearest_known(is_told)
    near = distance < (1.5 if scale > 1 else 0.5)
    wh = disparity_px.shape[1], disparity_px.shape[0]
    index = cv2.resize(np.where(near, source, -1).astype(np.int32), wh, interpolation=cv2.INTER_NEAREST_EXACT)
    y, x = np.nonzero(index >= 0)
    of = index[y, x]
    is_alike = np.abs(guide_rgb[y, x] - colour.reshape(-1, 3)[of]).max(axis=1) < ALIKE
    value_px = scale * told_px.ravel()[of]
    some = is_alike & (value_px > disparity_px[y, x])
    followed_px = disparity_px.copy()
    followed_px[y[some], x[some]] = value_px[some]
    return followed_px


def _at_fraction(disparity_px: FloatMap, guide_rgb: FloatMap, trust: FloatMap, *, scale: int) -> _Photo:
    wh = -(-disparity_px.shape[1] // scale), -(-disparity_px.shape[0] // scale)
    small_px, small_trust = (
        np.asarray(cv2.resize(plane, wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)
        for plane in (disparity_px, trust)
    )
    small_px /= scale
    colour = np.asarray(cv2.resize(guide_rgb, wh, interpolation=cv2.INTER_AREA), dtype=np.float32)
    ground_px = np.asarray(cv2.morphologyEx(small_px, cv2.MORPH_OPEN, _disk()), dtype=np.float32)
    return _Photo(small_px, ground_px, colour, (small_px - ground_px > BEFORE_PX) & (small_trust > SURE))


def _disk() -> ByteImage:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (WIDEST_PX, WIDEST_PX)), dtype=np.uint8)


def _straight_pieces(photo: _Photo) -> Iterator[tuple[tuple[slice, slice], BoolMap]]:
    """Boxes, and masks within them, of straight pieces of which enough is surely found."""
    light = np.asarray(photo.colour.mean(axis=2), dtype=np.float32)
    for sign in (1, -1):  # darker than both sides, then brighter
        own = np.asarray(sign * light, dtype=np.float32)
        is_thin = (cv2.morphologyEx(own, cv2.MORPH_CLOSE, _disk()) - own > CONTRAST).astype(np.uint8)
        if not (photo.is_sure & (is_thin > 0)).any():
            continue
        for step in range(DIRECTIONS):
            angle_rad = np.pi * step / DIRECTIONS
            straight = cv2.morphologyEx(is_thin, cv2.MORPH_OPEN, _segment(LEAST_LENGTH_PX, angle_rad))
            joined = cv2.morphologyEx(straight, cv2.MORPH_CLOSE, _segment(GAP_PX, angle_rad))
            count, label, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
            n_found = np.bincount(label[photo.is_sure & (straight > 0)], minlength=count)
            n_found[0] = 0  # the rest of the picture
            for piece in np.flatnonzero(n_found >= LEAST_FOUND):
                left, top, width, height = stats[piece, :4]
                box = slice(top, top + height), slice(left, left + width)
                yield box, label[box] == piece


def _segment(length_px: int, angle_rad: float) -> ByteImage:
    kernel = np.zeros((length_px, length_px), np.uint8)
    middle = (length_px - 1) / 2
    x, y = middle * np.cos(angle_rad), middle * np.sin(angle_rad)
    first, last = (round(middle - x), round(middle - y)), (round(middle + x), round(middle + y))
    return np.asarray(cv2.line(kernel, first, last, 1), dtype=np.uint8)


def _tell(photo: _Photo, piece: tuple[tuple[slice, slice], BoolMap], told_px: FloatMap, colour: FloatMap) -> None:
    """Write what the found part of a piece says of the rest of it, and its colour."""
    box, mask = piece
    is_found = mask & photo.is_sure[box]
    own = np.median(photo.colour[box][is_found], axis=0)
    is_alike = mask & (np.abs(photo.colour[box] - own).max(axis=2) < ALIKE)
    y, x = np.nonzero(is_found)
    found = np.column_stack([x, y]).astype(np.float64)
    middle = found.mean(axis=0)
    variance, axes = np.linalg.eigh(np.cov((found - middle).T))
    across_std, along_std = np.sqrt(np.maximum(variance, 1e-6))
    if across_std > LARGEST_WIDTH_PX or along_std < LEAST_ELONGATION * across_std:
        return
    along = (found - middle) @ axes[:, 1]
    line, on_line = _line_through(along, photo.disparity_px[box][is_found].astype(np.float64))
    if on_line.sum() < max(LEAST_FOUND, LEAST_FOUND_SHARE * is_alike.sum()):
        return
    y, x = np.nonzero(is_alike & ~is_found)
    rest = np.column_stack([x, y]) - middle
    first, last = along[on_line].min(), along[on_line].max()
    at = rest @ axes[:, 1]
    value_px = np.polyval(line, np.clip(at, first - LEVEL_PX, last + LEVEL_PX))
    is_strand = np.abs(rest @ axes[:, 0]) < 2 + 2 * across_std
    is_strand &= np.maximum(first - at, at - last) < FARTHEST * (last - first)
    is_strand &= value_px > photo.ground_px[box][y, x] + STILL_BEFORE_PX
    y, x, value_px = y[is_strand], x[is_strand], value_px[is_strand]
    is_nearer = value_px > told_px[box][y, x]
    told_px[box][y[is_nearer], x[is_nearer]] = value_px[is_nearer]
    colour[box][y[is_nearer], x[is_nearer]] = own


def _line_through(along: FloatArray, disparity_px: FloatArray) -> tuple[FloatArray, BoolMap]:
    """Coefficients of a line through most of N disparities, and which of them lie on it; none where few do."""
    on_line = np.abs(disparity_px - np.median(disparity_px)) < 2 * BEFORE_PX
    line = np.zeros(2)
    for _ in range(4):
        if on_line.sum() < LEAST_FOUND:
            return line, np.zeros_like(on_line)
        line = np.polyfit(along[on_line], disparity_px[on_line], 1)
        off_px = np.abs(np.polyval(line, along) - disparity_px)
        on_line = off_px < max(1.5 * float(np.median(off_px[on_line])), OFF_LINE_PX)
    is_line = on_line.mean() >= LEAST_ON_LINE and np.median(off_px[on_line]) <= OFF_LINE_PX
    return line, on_line & is_line
