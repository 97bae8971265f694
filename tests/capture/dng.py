"""Write small DNGs whose pixels and opcodes are known (DNG specification 1.6).

The sensor sees linear sRGB: ColorMatrix1 is XYZ to sRGB for D65, so that a developed photo equals the scene.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from telewide.simulate.dng import gain_map as gain_map
from telewide.simulate.dng import opcode_list as opcode_list

BLACK, WHITE = 64, 1023
_RGB_FROM_XYZ = (3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL = 1, 2, 3, 4, 5, 7, 10


def warp(*sets: Sequence[float], centre: tuple[float, float] = (0.5, 0.5)) -> tuple[int, bytes]:
    """WarpRectilinear of sets kr0 kr1 kr2 kr3 kt0 kt1."""
    numbers = [number for one in sets for number in one]
    return 1, struct.pack(f">I{len(numbers)}d2d", len(sets), *numbers, *centre)


def vignette(coefficients: Sequence[float], centre: tuple[float, float] = (0.5, 0.5)) -> tuple[int, bytes]:
    """FixVignetteRadial of k0 to k4."""
    return 3, struct.pack(">5d2d", *coefficients, *centre)


def mosaic_of(scene_linear: NDArray[np.float32], *, neutral: Sequence[float] = (1, 1, 1)) -> NDArray[np.float32]:
    """What an RGGB sensor sees of an (H, W, 3) scene, 1 at its white level."""
    seen = scene_linear * np.asarray(neutral, dtype=np.float32)
    mosaic = seen[..., 1].copy()
    mosaic[0::2, 0::2] = seen[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = seen[1::2, 1::2, 2]
    return mosaic


def write_dng(
    path: Path,
    mosaic: NDArray[np.float32],
    *,
    neutral: Sequence[float] = (1, 1, 1),
    orientation: int = 1,
    opcodes: dict[int, bytes] | None = None,
    exposure_ev: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    texts: dict[int, str] | None = None,
    rationals: dict[int, tuple[int, int]] | None = None,
) -> Path:
    """Write a Bayer DNG of 10 bits; `mosaic` (H, W) is 1 at the white level, `crop` top, left, height, width."""
    levels = np.clip(np.round(mosaic * (WHITE - BLACK) + BLACK), 0, WHITE).astype(np.uint16)
    ratios = [int(part) for number in _RGB_FROM_XYZ for part in (round(number * 10000), 10000)]
    tags: list[tuple[int, int, int, object, bool]] = [
        (274, _SHORT, 1, orientation, True),
        (33421, _SHORT, 2, (2, 2), True),
        (33422, _BYTE, 4, bytes([0, 1, 1, 2]), True),
        (50706, _BYTE, 4, bytes([1, 4, 0, 0]), True),
        (50708, _ASCII, 0, "Made Up", True),
        (50714, _SHORT, 1, BLACK, True),
        (50717, _SHORT, 1, WHITE, True),
        (50721, _SRATIONAL, 9, tuple(ratios), True),
        (50728, _RATIONAL, 3, tuple(int(part) for n in neutral for part in (round(n * 10000), 10000)), True),
        (50778, _SHORT, 1, 21, True),
    ]
    if exposure_ev is not None:
        tags.append((50730, _SRATIONAL, 1, (round(exposure_ev * 1000), 1000), True))
    if crop is not None:
        tags += [(50719, _LONG, 2, (crop[1], crop[0]), True), (50720, _LONG, 2, (crop[3], crop[2]), True)]
    for number, content in (opcodes or {}).items():
        tags.append(({1: 51008, 2: 51009, 3: 51022}[number], _UNDEFINED, len(content), content, True))
    tags += [(code, _ASCII, 0, text, True) for code, text in (texts or {}).items()]
    tags += [(code, _RATIONAL, 1, ratio, True) for code, ratio in (rationals or {}).items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(path, levels, photometric=32803, planarconfig=1, extratags=tags, metadata=None, software=False)
    return path
