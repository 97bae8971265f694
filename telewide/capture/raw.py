"""RAW photos to linear light.

Exposure: the sensor's white level, in the channel the white balance enlarges least, is 1; no automatic brightening.
White balance as shot; linear sRGB primaries; upright. `encoded` adds the file's own BaselineExposure (0 where it states
none) and the sRGB curve, no other tone curve. Of a DNG, lens shading (GainMap), vignetting and distortion
(WarpRectilinear) that the file states are corrected here, since LibRaw leaves them; then its DefaultCrop is taken.
Letters: H W photo.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from telewide.capture.formats import TAG_DNG_VERSION, TAG_OPCODES, open_tiff, read_bytes, tiff_pages
from telewide.capture.opcodes import (
    FixVignetteRadial,
    GainMap,
    Opcode,
    UnreadOpcode,
    WarpRectilinear,
    apply_gain_maps,
    fix_vignette,
    parse_opcodes,
    warp_rectilinear,
)
from telewide.capture.sizes import check_size, is_read_halved, read_hw, say_halved
from telewide.capture.tiff_tags import numbers_at
from telewide.errors import InputError
from telewide.geometry.arrays import FloatImage
from telewide.srgb import srgb_from_linear

if TYPE_CHECKING:
    import rawpy
    import tifffile


_TAG_CROP_ORIGIN, _TAG_CROP_SIZE, _TAG_BASELINE_EXPOSURE = 50719, 50720, 50730
_TAG_SUBFILE, _TAG_PHOTOMETRIC = 254, 262
_CFA, _LINEAR_RAW = 32803, 34892
_FULL_SCALE = 65535
# LibRaw's turns, as bits: rows exchanged with columns, rows from below, columns from the right.
_TRANSPOSED, _BOTTOM_UP, _RIGHT_TO_LEFT = 4, 2, 1
_MAX_EXPOSURE_EV = 8.0
_BYTES = {1, 7}  # types of a TIFF
_MOST_OPCODE_BYTES = 1 << 26
_log = logging.getLogger("telewide")


@dataclass(frozen=True)
class RawPhoto:
    """A developed RAW photo.

    Attributes:
        linear: (H, W, 3) linear sRGB float32 in [0, 1], 1 at the sensor's white level, upright.
        baseline_exposure_ev: how much brighter the file wants to be shown.
        corrections: what the file asked for and what was done, by the names of the DNG specification.
    """

    linear: FloatImage
    baseline_exposure_ev: float
    corrections: tuple[str, ...]


@dataclass(frozen=True)
class _DngFacts:
    """Facts of a DNG that LibRaw does not carry out: opcodes by list, crop (top, left, height, width), exposure."""

    opcodes: dict[int, tuple[Opcode, ...]]
    crop: tuple[int, int, int, int] | None
    exposure_ev: float


def read_raw(path: Path, *, is_half_size: bool = False) -> RawPhoto:
    """Develop a RAW photo to linear light.

    Args:
        path: a DNG or another RAW that LibRaw knows.
        is_half_size: one pixel for each 2 x 2 of the mosaic, four times faster; nothing is interpolated.

    Returns:
        The photo.

    Raises:
        UsageError: there is no such file.
        InputError: the file is corrupt or no RAW that is known.
    """
    return develop(path, read_bytes(path), is_half_size=is_half_size)


def show_as_srgb(raw: RawPhoto) -> FloatImage:
    """Show a RAW photo as sRGB: ``srgb(min(1, linear 2^BaselineExposure))``.

    Args:
        raw: developed.

    Returns:
        (H, W, 3) sRGB float32 in [0, 1].
    """
    exposed: FloatImage = raw.linear * np.float32(2.0**raw.baseline_exposure_ev)
    return srgb_from_linear(np.minimum(exposed, np.float32(1), out=exposed))


def develop(path: Path, data: bytes, *, is_half_size: bool = False) -> RawPhoto:
    """Develop the content of a RAW file; see `read_raw`.

    Args:
        path: to be named in messages.
        data: content of the file.
        is_half_size: one pixel for each 2 x 2 of the mosaic.
    """
    import rawpy

    facts = _read_dng(path, data)
    try:
        with rawpy.imread(BytesIO(data)) as raw:
            mosaic_hw = (int(raw.sizes.raw_height), int(raw.sizes.raw_width))
            check_size(path, mosaic_hw)
            if is_read_halved(mosaic_hw) and not is_half_size:
                is_half_size = True
                say_halved(path, mosaic_hw)
            flip = raw.sizes.flip  # as stored: developing overwrites it
            white = _scaled_mosaic(path, raw, facts.opcodes[2])
            linear = _demosaiced(raw, facts, white=white, is_half_size=is_half_size)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # LibRaw fails on corrupt files in a dozen ways
        raise InputError(
            f"{path} cannot be developed as a RAW photo: {_reason(error)}",
            hint="copy the file again from the phone, or export it as an uncompressed DNG or a TIFF",
        ) from error
    linear = _cropped(linear, facts.crop, is_half_size=is_half_size)
    _warn_of_unread(path, facts)
    done = tuple(_name(opcode) for opcodes in facts.opcodes.values() for opcode in opcodes)
    return RawPhoto(np.ascontiguousarray(_turned(linear, flip)), facts.exposure_ev, done)


def _scaled_mosaic(path: Path, raw: rawpy.RawPy, opcodes: Sequence[Opcode]) -> int | None:
    """Apply the gain maps to the mosaic in place, and return its new white above black; None where it did not change.

    The mosaic is stretched to 16 bits: gains on ten bits would leave steps.
    """
    if not any(isinstance(opcode, GainMap) for opcode in opcodes):
        return _FULL_SCALE if _is_expanded(raw) else None
    if raw.raw_image is None:
        _log.warning("%s: its lens shading map cannot be applied to this kind of RAW; the corners stay dark", path)
        return None
    mosaic = raw.raw_image_visible
    black = np.asarray(raw.black_level_per_channel, dtype=np.float32)
    black_of_pixel = black[raw.raw_colors_visible] if mosaic.ndim == 2 else black[: mosaic.shape[2]]
    linear = (mosaic - black_of_pixel) / (np.float32(raw.white_level) - black_of_pixel)
    apply_gain_maps(linear, opcodes)
    span = _FULL_SCALE - int(black.max())
    np.clip(linear * span + black_of_pixel + 0.5, 0, black_of_pixel + span, out=linear)
    mosaic[...] = linear.astype(np.uint16)
    return span


def _is_expanded(raw: rawpy.RawPy) -> bool:
    """Tell whether LibRaw made 16 bits of a scan of 8 bits, whose white level it still states for 8."""
    import rawpy

    is_scan = raw.raw_type == rawpy.RawType.Stack and raw.raw_image is not None
    return bool(is_scan and raw.raw_image.max() > 2 * raw.white_level)


def _demosaiced(raw: rawpy.RawPy, facts: _DngFacts, *, white: int | None, is_half_size: bool) -> FloatImage:
    """Return (H, W, 3) linear sRGB of the active area, as stored on the sensor, corrections of list 3 included."""
    import rawpy

    late = [opcode for opcode in facts.opcodes[3] if not isinstance(opcode, UnreadOpcode)]
    # Planes are warped as the sensor saw them, each with its own coefficients: before colours are mixed.
    matrix = np.asarray(raw.color_matrix, dtype=np.float32)[:3, :3]
    is_mixed_here = bool(late) and raw.num_colors == 3 and bool(matrix.any())
    levels = raw.postprocess(
        half_size=is_half_size,
        use_camera_wb=True,
        no_auto_bright=True,
        adjust_maximum_thr=0.0,
        user_sat=white,
        user_flip=0,
        gamma=(1, 1),
        output_bps=16,
        output_color=rawpy.ColorSpace.raw if is_mixed_here else rawpy.ColorSpace.sRGB,
    )
    linear: FloatImage = levels.astype(np.float32)
    linear /= _FULL_SCALE
    if linear.ndim == 2 or linear.shape[2] == 1:
        linear = np.repeat(linear.reshape(*linear.shape[:2], 1), 3, axis=2)
    linear = _late_corrections(linear, late)
    if is_mixed_here:
        linear = linear @ matrix.T
    return np.clip(linear, 0, 1, out=linear)


def _late_corrections(linear: FloatImage, opcodes: Sequence[Opcode]) -> FloatImage:
    for opcode in opcodes:
        if isinstance(opcode, WarpRectilinear):
            linear = warp_rectilinear(linear, opcode)
        elif isinstance(opcode, FixVignetteRadial):
            linear = fix_vignette(linear, opcode)
        elif isinstance(opcode, GainMap):
            apply_gain_maps(linear, [opcode])
    return linear


def _cropped(linear: FloatImage, crop: tuple[int, int, int, int] | None, *, is_half_size: bool) -> FloatImage:
    if crop is None:
        return linear
    top, left, height, width = (value // 2 for value in crop) if is_half_size else crop
    if min(top, left) < 0 or min(height, width) < 1 or top + height > len(linear) or left + width > linear.shape[1]:
        return linear
    return linear[top : top + height, left : left + width]


def _turned(linear: FloatImage, flip: int) -> FloatImage:
    if flip & _BOTTOM_UP:
        linear = linear[::-1]
    if flip & _RIGHT_TO_LEFT:
        linear = linear[:, ::-1]
    return linear.swapaxes(0, 1) if flip & _TRANSPOSED else linear


def _read_dng(path: Path, data: bytes) -> _DngFacts:
    """Read the tags of a DNG that are ours to carry out; of another RAW, nothing."""
    opcodes: dict[int, tuple[Opcode, ...]] = dict.fromkeys(TAG_OPCODES, ())
    crop, exposure_ev = None, 0.0
    with suppress(InputError), open_tiff(BytesIO(data)) as tiff:
        page = raw_page(tiff)
        if page is not None and TAG_DNG_VERSION in tiff.pages.first.tags:
            stated = numbers_at(BytesIO(data), page.offset) & set(TAG_OPCODES.values())
            opcodes = {
                number: _opcodes(path, page.tags.get(code), number=number) if code in stated else ()
                for number, code in TAG_OPCODES.items()
            }
            exposure_ev = _ratio(tiff.pages.first.tags.valueof(_TAG_BASELINE_EXPOSURE, default=0))
            crop = _crop_of(page)
    if not math.isfinite(exposure_ev):
        exposure_ev = 0.0
    return _DngFacts(opcodes, crop, float(np.clip(exposure_ev, -_MAX_EXPOSURE_EV, _MAX_EXPOSURE_EV)))


def stored_hw(tiff: tifffile.TiffFile) -> tuple[int, int] | None:
    """Return height and width in which a DNG is developed, as it lies on the sensor, or None for another RAW.

    Args:
        tiff: open.
    """
    page = raw_page(tiff)
    if page is None:
        return None
    crop, mosaic_hw = _crop_of(page), (int(page.shape[0]), int(page.shape[1]))
    if not is_read_halved(mosaic_hw):
        return (crop[2], crop[3]) if crop else mosaic_hw
    return (crop[2] // 2, crop[3] // 2) if crop else read_hw(mosaic_hw)


def raw_page(tiff: tifffile.TiffFile) -> tifffile.TiffPage | None:
    """Return the page of a DNG that holds the full mosaic, or None.

    Args:
        tiff: open; previews come first in many DNGs, the mosaic below them.
    """
    for page in tiff_pages(tiff):
        is_full = page.tags.valueof(_TAG_SUBFILE, default=0) == 0
        if is_full and page.tags.valueof(_TAG_PHOTOMETRIC) in (_CFA, _LINEAR_RAW):
            return page
    return None


def _opcodes(path: Path, tag: tifffile.TiffTag | None, *, number: int) -> tuple[Opcode, ...]:
    try:
        if tag is None:  # tifffile passes over what it cannot reach
            raise ValueError("it lies beyond the file's end")
        if tag.dtype not in _BYTES:
            raise ValueError(f"it holds {tag.count} numbers, bytes were expected")
        if tag.valuebytecount > _MOST_OPCODE_BYTES:
            raise ValueError(f"it has {tag.valuebytecount} bytes")
        content = tag.value
        return parse_opcodes(content) if content else ()
    except ValueError as error:
        _log.warning("%s: its OpcodeList%d cannot be read (%s) and is left out", path, number, error)
        return ()


def _crop_of(page: tifffile.TiffPage) -> tuple[int, int, int, int] | None:
    origin, size = page.tags.valueof(_TAG_CROP_ORIGIN), page.tags.valueof(_TAG_CROP_SIZE)
    if origin is None or size is None:
        return None
    (left, top), (width, height) = _two(origin), _two(size)
    return top, left, height, width


def _two(values: Sequence[int]) -> tuple[int, int]:
    """Return two whole numbers, stored as such or as fractions."""
    if len(values) == 4:
        return round(values[0] / values[1]), round(values[2] / values[3])
    return int(values[0]), int(values[1])


def _ratio(value: Sequence[int] | float) -> float:
    return float(value) if isinstance(value, int | float) else value[0] / value[1]


def _warn_of_unread(path: Path, facts: _DngFacts) -> None:
    for number, opcodes in facts.opcodes.items():
        unread = {opcode.name for opcode in opcodes if isinstance(opcode, UnreadOpcode) and not opcode.is_optional}
        if number == 1:  # on stored values, before LibRaw: none is carried out
            unread |= {_name(opcode) for opcode in opcodes if not isinstance(opcode, UnreadOpcode)}
        if unread:
            _log.warning("%s asks for %s, which is not carried out", path, ", ".join(sorted(unread)))


def _name(opcode: Opcode) -> str:
    return opcode.name if isinstance(opcode, UnreadOpcode) else type(opcode).__name__


def _reason(error: Exception) -> str:
    first = error.args[0] if error.args else error
    return first.decode(errors="replace") if isinstance(first, bytes) else str(first)
