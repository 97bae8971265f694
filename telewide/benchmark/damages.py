"""Damages of the second view by name, from ``damages.yaml`` or a file of the user's own of the same form.

Each shrinks the view by a factor and enlarges it again; what else it does, the file says. What is drawn is drawn anew
for each scene and is the same whenever the seed is.
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from telewide.capture.images import resize_bicubic
from telewide.errors import InputError, unknown_name
from telewide.geometry.arrays import FloatImage
from telewide.options import Options, parse_options
from telewide.simulate.degrade import Degradation, degrade_small
from telewide.yaml_files import read_yaml

DAMAGES_FILE = Path(__file__).with_name("damages.yaml")


def _in_order(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"{ends[0]} to {ends[1]}: the lower end comes first")
    return ends


NotNegative = Annotated[float, Field(ge=0)]
Ends = Annotated[tuple[float, float], AfterValidator(_in_order)]
Factor = Annotated[float, Field(gt=0)]
Factors = Annotated[tuple[Factor, Factor], AfterValidator(_in_order)]
Share = Annotated[float, Field(ge=0, lt=1)]
Shares = Annotated[tuple[Share, Share], AfterValidator(_in_order)]
_NO_CHANGE = (1.0, 1.0)
_NOTHING = (0.0, 0.0)


class Damage(Options):
    """Damage a view suffers besides having fewer pixels."""

    description: str = ""
    """A few words for people."""
    blur_sigma_px_per_factor: tuple[NotNegative, NotNegative] = _NOTHING
    """Standard deviations of a Gaussian along its major and minor axis, px before shrinking, divided by the factor."""
    blur_angle_deg: float = 0.0
    """Direction of the major axis, from x towards y."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Of JPEG compression at the shrunken size."""
    noise_std: Shares = _NOTHING
    """Ends of the standard deviation of white noise at the shrunken size."""
    vignetting: Shares = _NOTHING
    """Ends of the share of light that the corners lose."""
    gain: Factors = _NO_CHANGE
    """Ends of a factor of all channels."""
    white_balance: Factors = _NO_CHANGE
    """Ends of a factor of each channel by itself."""
    gamma: Factors = _NO_CHANGE
    """Ends of an exponent of all channels."""
    vertical_offset_px: Ends = _NOTHING
    """Ends of how far the content moves down, px before shrinking."""
    vertical_slope: Ends = _NOTHING
    """Ends of how much farther per px of height below the centre."""


class Damages(Options):
    """A file of damages."""

    format: Literal[1]
    damages: dict[str, Damage]


def load_damages(*, path: Path = DAMAGES_FILE) -> Damages:
    """Read a file of damages.

    Args:
        path: YAML of the form of ``damages.yaml``.

    Raises:
        UsageError: there is no such file.
        InputError: no YAML, an unknown key, or a wrong value.
    """
    return parse_options(Damages, read_yaml(path) or {}, source=str(path), error=InputError)


def find_damage(name: str, damages: Damages) -> Damage:
    """Find a damage by its name, in any letter case.

    Args:
        name: of the damage.
        damages: those there are.

    Raises:
        UsageError: there is no such damage; the nearest name is told.
    """
    for known, damage in damages.damages.items():
        if known.casefold() == name.casefold():
            return damage
    raise unknown_name("damage", name, damages.damages)


def damaged_view(view: FloatImage, damage: Damage, *, factor: float, scene: str, seed: int) -> FloatImage:
    """Damage a view and enlarge it back to its own size.

    Args:
        view: (H, W, 3) RGB float32 in [0, 1].
        damage: what happens to it.
        factor: how many times fewer pixels it has along each side, >= 1.
        scene: its name; with the seed it decides what is drawn.
        seed: of the run.

    Returns:
        (H, W, 3) RGB float32 in [0, 1].
    """
    small = damaged_small_view(view, damage, factor=factor, scene=scene, seed=seed)
    return resize_bicubic(small, wh=(view.shape[1], view.shape[0]))


def damaged_small_view(view: FloatImage, damage: Damage, *, factor: float, scene: str, seed: int) -> FloatImage:
    """Damage a view and leave it at the worse camera's own size.

    Arguments as of :func:`damaged_view`.

    Returns:
        (round(H / factor), round(W / factor), 3) RGB float32 in [0, 1].
    """
    rng = np.random.default_rng([seed, zlib.crc32(scene.encode())])
    return degrade_small(view, drawn_degradation(damage, factor=factor, rng=rng), rng=rng)


def drawn_degradation(damage: Damage, *, factor: float, rng: np.random.Generator) -> Degradation:
    """Draw what a damage leaves open: factors and exponents evenly by their logarithm, all else evenly.

    Args:
        damage: what is fixed, and between which ends the rest is drawn.
        factor: how many times fewer pixels along each side, >= 1.
        rng: source of the draw.
    """
    major, minor = damage.blur_sigma_px_per_factor
    gain = _drawn_factor(damage.gain, rng)
    red, green, blue = (gain * _drawn_factor(damage.white_balance, rng) for _ in range(3))
    return Degradation(
        factor=factor,
        blur_sigma_px=(major * factor, minor * factor),
        blur_angle_rad=math.radians(damage.blur_angle_deg),
        vignetting=float(rng.uniform(*damage.vignetting)),
        jpeg_quality=damage.jpeg_quality,
        noise_std=float(rng.uniform(*damage.noise_std)),
        gain=(red, green, blue),
        gamma=_drawn_factor(damage.gamma, rng),
        vertical_offset_px=float(rng.uniform(*damage.vertical_offset_px)),
        vertical_slope=float(rng.uniform(*damage.vertical_slope)),
    )


def _drawn_factor(ends: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(math.log(ends[0]), math.log(ends[1]))))
