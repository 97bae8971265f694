"""Lens corrections that a DNG carries as opcode lists (DNG specification 1.6, chapter 7), which LibRaw leaves undone.

A list is big endian: its length, then for each opcode ID, DNG version, flags, number of bytes, parameters. List 2 works
on the linear mosaic, list 3 on the linear photo after demosaicing; coordinates are those of the active area.
Letters: H W image; C planes; V U rows and columns of a gain map; M planes of a gain map.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import FloatImage

_WARP_RECTILINEAR, _FIX_VIGNETTE_RADIAL, _GAIN_MAP = 1, 3, 9
_NAMES = {
    1: "WarpRectilinear",
    2: "WarpFisheye",
    3: "FixVignetteRadial",
    4: "FixBadPixelsConstant",
    5: "FixBadPixelsList",
    6: "TrimBounds",
    7: "MapTable",
    8: "MapPolynomial",
    9: "GainMap",
    10: "DeltaPerRow",
    11: "DeltaPerColumn",
    12: "ScalePerRow",
    13: "ScalePerColumn",
    14: "WarpRectilinear2",
}
# Far above what cameras write: a gain map of 17 x 13 for each of four colours, one or two warps.
_MAX_OPCODES, _MAX_WARPS, _MAX_GRID, _MAX_PLANES = 64, 3, 1024, 4
_STRIP_ROWS = 256
_HEADER = struct.Struct(">IIII")
_GAIN_HEAD = struct.Struct(">10I4dI")
_RADIAL_TERMS = 4


@dataclass(frozen=True)
class GainMap:
    """Lens shading: a coarse grid of gains over the image, interpolated bilinearly.

    Attributes:
        area: top, left, bottom, right, px: where it works.
        planes: first plane and number of planes.
        pitch: it works on every so many rows and columns: 2, 2 for one colour of a Bayer mosaic.
        spacing: of the grid's rows and columns, in heights and widths of the image.
        origin: of the grid, likewise.
        gains: (V, U, M) float32; a plane beyond M takes the last one.
    """

    area: tuple[int, int, int, int]
    planes: tuple[int, int]
    pitch: tuple[int, int]
    spacing: tuple[float, float]
    origin: tuple[float, float]
    gains: FloatImage


@dataclass(frozen=True)
class WarpRectilinear:
    """Lens distortion to be taken out: where in the stored photo each point of the corrected one lies.

    Attributes:
        coefficients: (1 or C, 6) kr0 kr1 kr2 kr3 kt0 kt1 of each plane.
        centre: x and y in widths and heights of the image.
    """

    coefficients: NDArray[np.float64]
    centre: tuple[float, float]


@dataclass(frozen=True)
class FixVignetteRadial:
    """Radial darkening to be taken out.

    Attributes:
        coefficients: (5,) of r^2, r^4 ... r^10.
        centre: x and y in widths and heights of the image.
    """

    coefficients: NDArray[np.float64]
    centre: tuple[float, float]


@dataclass(frozen=True)
class UnreadOpcode:
    """An opcode that is not carried out.

    Attributes:
        name: as the specification calls it.
        is_optional: the file says it may be left out.
    """

    name: str
    is_optional: bool


Opcode = GainMap | WarpRectilinear | FixVignetteRadial | UnreadOpcode


def parse_opcodes(data: bytes) -> tuple[Opcode, ...]:
    """Parse an opcode list.

    Args:
        data: content of the tag OpcodeList1, 2 or 3.

    Returns:
        The opcodes in the order in which they are to be carried out.

    Raises:
        ValueError: the list is cut off, contradicts itself, or asks for more than any camera does.
    """
    try:
        (count,) = struct.unpack_from(">I", data, 0)
        if count > _MAX_OPCODES:
            raise ValueError(f"a list of {count} opcodes")
        opcodes, offset = [], 4
        for _ in range(count):
            kind, _, flags, size = _HEADER.unpack_from(data, offset)
            offset += _HEADER.size
            if offset + size > len(data):
                raise ValueError(f"opcode {_NAMES.get(kind, kind)} ends {offset + size - len(data)} bytes too late")
            opcodes.append(_parse_one(kind, bool(flags & 1), data[offset : offset + size]))
            offset += size
    except struct.error as error:
        raise ValueError(f"the list ends too early: {error}") from error
    if sum(isinstance(opcode, WarpRectilinear) for opcode in opcodes) > _MAX_WARPS:
        raise ValueError(f"a list with more than {_MAX_WARPS} distortions")
    return tuple(opcodes)


def apply_gain_maps(linear: FloatImage, opcodes: Sequence[Opcode]) -> None:
    """Multiply an image by its gain maps, in place.

    Gain at a pixel: the grid read bilinearly at ``((row + 0.5) / H - origin) / spacing``, held at its borders.

    Args:
        linear: (H, W) mosaic or (H, W, C) photo, black 0.
        opcodes: those that are no gain map are passed over.
    """
    planes = linear[..., None] if linear.ndim == 2 else linear
    hw = (linear.shape[0], linear.shape[1])
    for opcode in opcodes:
        if not isinstance(opcode, GainMap):
            continue
        (top, left, bottom, right), (first, count) = opcode.area, opcode.planes
        rows, columns = slice(top, bottom, opcode.pitch[0]), slice(left, right, opcode.pitch[1])
        gains = _gains_at(opcode, np.arange(hw[0])[rows], np.arange(hw[1])[columns], hw)
        for plane in range(first, min(first + count, planes.shape[2])):
            planes[rows, columns, plane] *= gains[..., min(plane - first, gains.shape[2] - 1)]


def warp_rectilinear(image: FloatImage, warp: WarpRectilinear) -> FloatImage:
    """Take the lens distortion out, by bicubic resampling.

    With ``(dx, dy)`` the offset from the centre over the distance m of the farthest corner and ``r^2 = dx^2 + dy^2``::

        x_stored = x_centre + m (dx (kr0 + kr1 r^2 + kr2 r^4 + kr3 r^6) + 2 kt0 dx dy + kt1 (r^2 + 2 dx^2))

    and likewise for y with kt0 and kt1 exchanged. DNG specification 1.6, WarpRectilinear.

    Args:
        image: (H, W, C) float32.
        warp: what the file states.

    Returns:
        (H, W, C) float32; what lies outside of the stored photo repeats its border.
    """
    sets = warp.coefficients[: image.shape[2]]
    sources = [image] if len(sets) == 1 else [np.ascontiguousarray(image[..., k]) for k in range(image.shape[2])]
    warped = np.empty_like(image)
    for top in range(0, image.shape[0], _STRIP_ROWS):
        rows = np.arange(top, min(top + _STRIP_ROWS, image.shape[0]))
        parts = [
            cv2.remap(
                source,
                *_stored_xy(sets[min(k, len(sets) - 1)], warp.centre, (image.shape[0], image.shape[1]), rows=rows),
                cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            )
            for k, source in enumerate(sources)
        ]
        warped[rows[0] : rows[-1] + 1] = parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)
    return warped


def fix_vignette(image: FloatImage, vignette: FixVignetteRadial) -> FloatImage:
    """Brighten the corners: times ``1 + k0 r^2 + k1 r^4 + ... + k4 r^10``, r as in `warp_rectilinear`.

    Args:
        image: (H, W, C) float32, linear.
        vignette: what the file states.

    Returns:
        (H, W, C) float32.
    """
    dx, dy, _ = _offsets(vignette.centre, (image.shape[0], image.shape[1]), rows=np.arange(image.shape[0]))
    r2 = dx * dx + dy * dy
    gain = np.polyval([*vignette.coefficients[::-1], 1.0], r2).astype(np.float32)
    return np.asarray(image * gain[..., None], dtype=np.float32)


def _parse_one(kind: int, is_optional: bool, body: bytes) -> Opcode:
    if kind == _GAIN_MAP:
        return _parse_gain_map(body)
    if kind == _WARP_RECTILINEAR:
        (n_sets,) = struct.unpack_from(">I", body)
        values = _doubles(body, offset=4, count=6 * n_sets + 2)
        if n_sets < 1:
            raise ValueError("WarpRectilinear without coefficients")
        return WarpRectilinear(values[:-2].reshape(n_sets, 6), (float(values[-2]), float(values[-1])))
    if kind == _FIX_VIGNETTE_RADIAL:
        values = _doubles(body, offset=0, count=7)
        return FixVignetteRadial(values[:5], (float(values[5]), float(values[6])))
    return UnreadOpcode(_NAMES.get(kind, f"opcode {kind}"), is_optional)


def _parse_gain_map(body: bytes) -> GainMap:
    head = _GAIN_HEAD.unpack_from(body)
    area, planes, pitch, points = head[0:4], head[4:6], head[6:8], head[8:10]
    spacing, origin, n_planes = head[10:12], head[12:14], head[14]
    count = math.prod((*points, n_planes))
    if count < 1 or _GAIN_HEAD.size + 4 * count > len(body):
        raise ValueError(f"a GainMap of {points[0]} x {points[1]} x {n_planes} gains in {len(body)} bytes")
    if max(points) > _MAX_GRID or n_planes > _MAX_PLANES:
        raise ValueError(f"a GainMap of {points[0]} x {points[1]} x {n_planes} gains; {_MAX_GRID} a side are read")
    if min(pitch) < 1 or any(n > 1 and not step > 0 for n, step in zip(points, spacing, strict=True)):
        raise ValueError(f"a GainMap with pitch {pitch} and spacing {spacing}")
    gains = np.frombuffer(body, dtype=">f4", count=count, offset=_GAIN_HEAD.size).astype(np.float32)
    if not np.isfinite(gains).all() or gains.min() < 0:
        raise ValueError("a GainMap with gains that are no numbers of 0 or more")
    return GainMap(
        area=area, planes=planes, pitch=pitch, spacing=spacing, origin=origin, gains=gains.reshape(*points, n_planes)
    )


def _doubles(body: bytes, *, offset: int, count: int) -> NDArray[np.float64]:
    if count < 1 or offset + 8 * count > len(body):
        raise ValueError(f"{count} numbers were expected in {len(body) - offset} bytes")
    values = np.frombuffer(body, dtype=">f8", count=count, offset=offset).astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("coefficients that are no numbers")
    return values


def _gains_at(
    gain_map: GainMap, rows: NDArray[np.int64], columns: NDArray[np.int64], hw: tuple[int, int]
) -> FloatImage:
    """Interpolate a gain map to (len(rows), len(columns), M)."""
    gains = gain_map.gains
    for axis, pixels in enumerate((rows, columns)):
        last = gains.shape[axis] - 1
        spacing = gain_map.spacing[axis] if last else 1.0
        places = np.clip(((pixels + 0.5) / hw[axis] - gain_map.origin[axis]) / spacing, 0, last)
        before = np.minimum(places.astype(np.int64), max(last - 1, 0))
        weight = (places - before).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        after = np.minimum(before + 1, last)
        gains = gains.take(before, axis=axis) * (1 - weight) + gains.take(after, axis=axis) * weight
    return np.asarray(gains, dtype=np.float32)


def _stored_xy(
    coefficients: NDArray[np.float64], centre: tuple[float, float], hw: tuple[int, int], *, rows: NDArray[np.int64]
) -> tuple[FloatImage, FloatImage]:
    """Return x and y px, (len(rows), W) each, in the stored photo."""
    dx, dy, m_px = _offsets(centre, hw, rows=rows)
    kt0, kt1 = coefficients[_RADIAL_TERMS:]
    r2 = dx * dx + dy * dy
    radial = np.polyval(coefficients[:_RADIAL_TERMS][::-1], r2)
    x_px = centre[0] * (hw[1] - 1) + m_px * (dx * radial + kt0 * 2 * dx * dy + kt1 * (r2 + 2 * dx * dx))
    y_px = centre[1] * (hw[0] - 1) + m_px * (dy * radial + kt1 * 2 * dx * dy + kt0 * (r2 + 2 * dy * dy))
    return x_px.astype(np.float32), y_px.astype(np.float32)


def _offsets(
    centre: tuple[float, float], hw: tuple[int, int], *, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return (1, W) and (len(rows), 1) offsets from the centre in units of m, and m: to the farthest corner, px."""
    cx_px, cy_px = centre[0] * (hw[1] - 1), centre[1] * (hw[0] - 1)
    m_px = math.hypot(max(cx_px, hw[1] - 1 - cx_px), max(cy_px, hw[0] - 1 - cy_px))
    dx = (np.arange(hw[1], dtype=np.float64)[None] - cx_px) / m_px
    dy = (rows[:, None].astype(np.float64) - cy_px) / m_px
    return np.asarray(dx), np.asarray(dy), m_px
