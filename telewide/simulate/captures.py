"""Capture folders of worlds whose disparity is known: what a phone with two cameras would have written.

Each capture is a still life photographed by a sharp camera (tele) and by a worse one beside it (wide: fewer pixels, a
little blur and noise, another tint, content a little lower). ``truth.pfm`` holds the exact disparity of tele.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from telewide.capture.facts import FACTS_FILE
from telewide.capture.images import write_image
from telewide.capture.pfm import write_pfm
from telewide.errors import UsageError
from telewide.files import write_text
from telewide.geometry.arrays import FloatImage, FloatMap
from telewide.simulate.apertures import write_lens_truths
from telewide.simulate.degrade import Degradation, degrade_small
from telewide.simulate.layers import LayeredScene, render_pair
from telewide.simulate.scene import random_scene
from telewide.simulate.still_life import still_life

SCENES = ("still-life", "random")
"""Kinds of scenes: arranged pictures, or strewn shapes as the networks are taught on."""

_SUPERSAMPLING = 2
_LARGEST_STEP_PX = 1.0
"""Samples of one surface differ by less than this within a block of 2x2."""

_MAX_FACTOR = 16.0
_MIN_WIDE_PX = 32
"""The shortest side of a picture that readers of captures accept."""


def write_captures(
    folder: Path,
    *,
    count: int,
    seed: int = 0,
    hw: tuple[int, int] = (256, 384),
    factor: float = 3.0,
    disparity_window_px: tuple[float, float] | None = None,
    scene: str = "still-life",
    image_format: str = "png",
    truth_count: int | None = None,
    has_bokeh: bool = False,
) -> tuple[Path, ...]:
    """Write simulated captures with their truth.

    Args:
        folder: made when it is not there; captures of the same names are replaced.
        count: number of captures, >= 1.
        seed: the same seed writes the same pictures.
        hw: height and width of tele.
        factor: how many times fewer pixels wide has along each axis, >= 1.
        disparity_window_px: bounds of the disparity; None takes 1 to 12 % of the width.
        scene: one of `SCENES`.
        image_format: "png" or "jpg".
        truth_count: how many of the captures get a ``truth.pfm``, the first ones; None means all.
        has_bokeh: whether to write what large apertures see into ``../truth/<name>/``, by `write_lens_truths`.

    Returns:
        The capture folders.

    Raises:
        UsageError: a number out of range or an unknown name, with what was expected.
        TelewideError: the folder cannot be written.
    """
    window_px = disparity_window_px or (0.01 * hw[1], 0.12 * hw[1])
    _check(count=count, hw=hw, factor=factor, scene=scene, image_format=image_format, window_px=window_px)
    written: list[Path] = []
    for number, child in enumerate(np.random.SeedSequence(seed).spawn(count)):
        rng = np.random.default_rng(child)
        world = _world(rng, hw=hw, window_px=window_px, scene=scene)
        capture = folder / f"{number:03d}"
        disparity_px = _write_views(capture, world, rng, hw=hw, factor=factor, image_format=image_format)
        if truth_count is None or number < truth_count:
            write_pfm(capture / "truth.pfm", disparity_px)
        if has_bokeh:
            write_lens_truths(folder.parent / "truth" / capture.name, world, disparity_px=disparity_px)
        written.append(capture)
    facts = f"format: 1\nrectified: true\nasymmetry: {float(factor)}\nreference: tele\nnotes: simulated, seed {seed}\n"
    write_text(folder / FACTS_FILE, facts)
    return tuple(written)


def _write_views(
    capture: Path,
    world: LayeredScene,
    rng: np.random.Generator,
    *,
    hw: tuple[int, int],
    factor: float,
    image_format: str,
) -> FloatMap:
    """Photograph and damage a world; the disparity of tele."""
    ref, src, disparity_px = _photographed(world, hw=hw)
    wide = degrade_small(src, _phone_damage(rng, hw=hw, factor=factor), rng=rng)
    write_image(capture / f"tele.{image_format}", ref, quality=95)
    write_image(capture / f"wide.{image_format}", wide, quality=95)
    return disparity_px


def _check(
    *,
    count: int,
    hw: tuple[int, int],
    factor: float,
    scene: str,
    image_format: str,
    window_px: tuple[float, float],
) -> None:
    if count < 1:
        raise UsageError(f"the number of captures is {count}; 1 or more was expected")
    if not 1.0 <= factor <= _MAX_FACTOR:
        raise UsageError(f"the factor is {factor}; a number from 1 to {_MAX_FACTOR:g} was expected")
    least = math.ceil(_MIN_WIDE_PX * factor)
    if min(hw) < least:
        raise UsageError(f"the size is {hw[1]}x{hw[0]}; with a factor of {factor:g} both must be {least} or more")
    if scene not in SCENES:
        raise UsageError(f"no scene is called {scene!r}", hint=f"known scenes: {', '.join(SCENES)}")
    if image_format not in ("png", "jpg"):
        raise UsageError(f"pictures cannot be written as {image_format!r}", hint="png or jpg")
    if not window_px[0] < window_px[1]:
        raise UsageError(f"the disparity window is {window_px}; a lower and a higher bound were expected")


def _world(
    rng: np.random.Generator, *, hw: tuple[int, int], window_px: tuple[float, float], scene: str
) -> LayeredScene:
    """Draw a world at twice the size of its photo."""
    fine_hw = (hw[0] * _SUPERSAMPLING, hw[1] * _SUPERSAMPLING)
    fine_window = (window_px[0] * _SUPERSAMPLING, window_px[1] * _SUPERSAMPLING)
    draw = still_life if scene == "still-life" else random_scene
    return draw(rng, hw=fine_hw, disparity_window_px=fine_window)


def _photographed(world: LayeredScene, *, hw: tuple[int, int]) -> tuple[FloatImage, FloatImage, FloatMap]:
    """Average fine pixels, as those of a sensor do: ref, src and the disparity of ref."""
    fine = render_pair(world)
    wh = (hw[1], hw[0])
    ref = np.asarray(cv2.resize(fine.ref, wh, interpolation=cv2.INTER_AREA), np.float32)
    src = np.asarray(cv2.resize(fine.src, wh, interpolation=cv2.INTER_AREA), np.float32)
    return ref, src, _of_one_surface(fine.disparity_px)


def _of_one_surface(fine_px: FloatMap) -> FloatMap:
    """Disparity of each block of 2x2 samples: their mean on one surface, else the surface that covers half of it."""
    height, width = fine_px.shape
    blocks = fine_px.reshape(height // 2, 2, width // 2, 2).transpose(0, 2, 1, 3).reshape(height // 2, width // 2, 4)
    ordered = np.sort(blocks, axis=2)
    is_one = ordered[..., 3] - ordered[..., 0] < _LARGEST_STEP_PX
    return np.asarray(np.where(is_one, blocks.mean(axis=2), ordered[..., 2]) / _SUPERSAMPLING, np.float32)


def _phone_damage(rng: np.random.Generator, *, hw: tuple[int, int], factor: float) -> Degradation:
    """Draw what was measured to remain in rectified pairs of a phone: tint, rows, a soft and noisy wide lens."""
    gain = np.exp(rng.normal(0.0, 0.04) + rng.normal(0.0, 0.05, 3))
    return Degradation(
        factor=factor,
        blur_sigma_px=(0.25 * factor, 0.2 * factor),
        blur_angle_rad=float(rng.uniform(0.0, math.pi)),
        jpeg_quality=None,
        noise_std=0.006,
        gain=(float(gain[0]), float(gain[1]), float(gain[2])),
        vertical_offset_px=float(rng.uniform(-0.0025, 0.0025)) * hw[0],
        vertical_slope=float(rng.normal(0.0, 0.0015)),
    )
