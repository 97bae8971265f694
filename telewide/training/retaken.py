"""Crops of the user's sharp photos with what a lens beside would see of them: real scenes with an exact truth.

Where the matched disparity of a photo is wrong, its scene is another one than that of the user; the truth is exact all
the same. Letters: H W crop.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import torch
from torch import Tensor

from telewide.geometry.arrays import FloatMap
from telewide.matching.window import Window
from telewide.simulate.beside import seen_from_beside
from telewide.training.samples import SampleSource, read_disparity, seen_part
from telewide.training.world_samples import WorldCrop, recoloured, shift_into

ZOOM = (0.75, 1.25)
DEEPER = (0.6, 1.25)
"""Range by which disparities are stretched: other baselines, other truths for the same photo."""
TILT = 0.05
"""Largest slope, px a px along each axis, that is added to the scene: its looks then say less of its disparity."""


def retaken_crop(source: SampleSource, *, rng: np.random.Generator, scale: float = 1.0) -> WorldCrop:
    """Cut a crop out of a sharp photo and render its second view; both as sharp as the photo.

    Args:
        source: the captures, their disparities and the sizes.
        rng: source of all draws.
        scale: size of the crop, in whole ones, at most 1.
    """
    capture = source.captures[int(rng.integers(len(source.captures)))]
    pair = source.reader.read(capture)
    rows, columns = seen_part(pair, source)
    photo, surface_px = pair.tele[rows, columns], read_disparity(source, capture)[rows, columns]
    height, width = (round(scale * side) for side in source.crop_hw)
    window = (math.floor(scale * source.volume_px[0]), math.ceil(scale * source.volume_px[1]))
    zoom = max(float(rng.uniform(*ZOOM)), (height + 1) / photo.shape[0], (width + 1) / photo.shape[1])
    # Room for what src sees beyond the crop.
    room = min(window[1] - window[0], int(photo.shape[1] * zoom) - width)
    box_h, box_w = int(height / zoom), int((width + room) / zoom)
    y, x = (int(rng.integers(side - part + 1)) for side, part in zip(photo.shape, (box_h, box_w), strict=False))
    box, size = np.s_[y : y + box_h, x : x + box_w], (width + room, height)
    enlarging = cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC
    ref = cv2.resize(photo[box], size, interpolation=enlarging).clip(0, 1).astype(np.float32, copy=False)
    disparity_px = cv2.resize(surface_px[box], size, interpolation=cv2.INTER_NEAREST_EXACT)
    stretch = zoom * math.exp(rng.uniform(math.log(DEEPER[0]), math.log(DEEPER[1])))
    disparity_px = _moved(stretch * disparity_px + _tilt(disparity_px.shape, rng), window, rng)
    seen = seen_from_beside(ref, disparity_px)
    first = int(rng.integers(room + 1))
    here = np.s_[:, first : first + width]
    x_src = np.arange(width) - disparity_px[here]
    occluded = seen.occluded[here] | (x_src < 0) | (x_src > width - 1)
    ref_CHW, src_CHW = (_tensor(view[here]).permute(2, 0, 1) for view in (ref, seen.src))
    return recoloured(WorldCrop(ref_CHW, src_CHW, _tensor(disparity_px[here]), _tensor(occluded)), rng)


def _tilt(hw: tuple[int, ...], rng: np.random.Generator) -> FloatMap:
    along_x, along_y = rng.uniform(-TILT, TILT, 2)
    plane_px = along_x * np.arange(hw[1])[None, :] + along_y * np.arange(hw[0])[:, None]
    return np.asarray(plane_px, np.float32)


def _moved(disparity_px: FloatMap, window: Window, rng: np.random.Generator) -> FloatMap:
    """Moved as a whole, so that the window holds it somewhere."""
    low_px, high_px = np.quantile(disparity_px, (0.01, 0.99)).tolist()
    return np.asarray(disparity_px - shift_into(window, (low_px, high_px), rng=rng), np.float32)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values))
