"""Drawing on pictures: words, lines and colour bars on a dark neutral ground.

Arrays are (H, W, 3) float32 RGB in [0, 1]; a page is a Pillow image. Sizes are ``wh``, corners ``at_xy``, both in px of
the page.
The typeface is the one Pillow carries, so a page looks the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from telewide.geometry.arrays import BoolMap, FloatMap

GROUND = (22, 22, 24)
INK = (236, 236, 236)
FAINT_INK = (158, 158, 162)
UNKNOWN = 0.35
"""Grey level of a pixel of which nothing is known."""

_TABLES = {"turbo": cv2.COLORMAP_TURBO, "inferno": cv2.COLORMAP_INFERNO}
_TURBO_ENDS = (0.06, 0.96)  # its ends are so dark that nearest and farthest would look alike
_HATCH_PERIOD_PX = 9
_STRIP_ROWS = 128


@dataclass(frozen=True)
class Tick:
    """A mark on a colour bar: where (0 left to 1 right) and what it says."""

    position: float
    label: str


def new_page(*, wh: tuple[int, int]) -> Image.Image:
    """Make an empty page of the given width and height."""
    return Image.new("RGB", wh, GROUND)


def image_from_page(page: Image.Image) -> FloatMap:
    """Turn a page into an (H, W, 3) float32 RGB image in [0, 1]."""
    return np.asarray(page, dtype=np.float32) / np.float32(255)


def paste_image(page: Image.Image, image: FloatMap, *, at_xy: tuple[int, int]) -> None:
    """Put an (H, W, 3) RGB image in [0, 1] on a page, its top left corner at ``at_xy``."""
    levels = np.round(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    page.paste(Image.fromarray(levels), at_xy)


def paste_centred(page: Image.Image, image: FloatMap, *, at_xy: tuple[int, int], box_wh: tuple[int, int]) -> None:
    """Put an image in the middle of a box that is at least as large."""
    x = at_xy[0] + (box_wh[0] - image.shape[1]) // 2
    y = at_xy[1] + (box_wh[1] - image.shape[0]) // 2
    paste_image(page, image, at_xy=(x, y))


def write_text(
    page: Image.Image,
    text: str,
    *,
    at_xy: tuple[float, float],
    size_px: int,
    anchor: str = "lm",
    is_faint: bool = False,
) -> None:
    """Write one line.

    Args:
        page: to write on.
        text: the line.
        at_xy: the anchor's place, px.
        size_px: height of the letters.
        anchor: Pillow's two letters: l m r across, a m s down.
        is_faint: in grey, for what is not the message.
    """
    ink = FAINT_INK if is_faint else INK
    ImageDraw.Draw(page).text(at_xy, text, font=_font(size_px), fill=ink, anchor=anchor)


def text_width_px(text: str, *, size_px: int) -> float:
    """Measure one line."""
    return float(_font(size_px).getlength(text))


def fitted_text(text: str, *, width_px: float, size_px: int) -> str:
    """Shorten a line in its middle until it fits, so that both ends of a long name stay readable."""
    if text_width_px(text, size_px=size_px) <= width_px:
        return text
    for n_kept in range(len(text) - 1, 1, -1):
        shortened = f"{text[: (n_kept + 1) // 2]}…{text[len(text) - n_kept // 2 :]}"
        if text_width_px(shortened, size_px=size_px) <= width_px:
            return shortened
    return "…"


def fitted_wh(wh: tuple[int, int], *, box_wh: tuple[float, float]) -> tuple[int, int]:
    """Find the largest size of the same shape that fits a box, at least 1 px."""
    scale = min(box_wh[0] / wh[0], box_wh[1] / wh[1])
    return max(1, round(wh[0] * scale)), max(1, round(wh[1] * scale))


def scaled_image(image: FloatMap, *, wh: tuple[int, int]) -> FloatMap:
    """Scale an image for looking at: by area when it shrinks, bilinearly when it grows."""
    if wh == (image.shape[1], image.shape[0]):
        return image
    shrinks = wh[0] < image.shape[1]
    scaled = cv2.resize(image, wh, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return np.asarray(np.clip(scaled, 0, 1), dtype=np.float32)


def scaled_mask(mask: BoolMap, *, wh: tuple[int, int]) -> BoolMap:
    """Scale a mask; a pixel is set where at least half of it was."""
    shares = scaled_image(mask.astype(np.float32), wh=wh)
    return np.asarray(shares >= 0.5)


def upright(image: FloatMap, *, rotated_deg: int) -> FloatMap:
    """Turn an image or map back that had been turned counter-clockwise by a multiple of 90 degrees."""
    return np.ascontiguousarray(np.rot90(image, k=-round(rotated_deg / 90)))


def upright_mask(mask: BoolMap, *, rotated_deg: int) -> BoolMap:
    """Do as :func:`upright` to a mask."""
    return np.ascontiguousarray(np.rot90(mask, k=-round(rotated_deg / 90)))


def painted(values: FloatMap, *, value_range: tuple[float, float], table: str = "turbo") -> FloatMap:
    """Paint a map by a colour table.

    Args:
        values: (H, W); NaN becomes a neutral grey.
        value_range: what the first and the last colour stand for; values outside take the end's colour.
        table: turbo, inferno or grey.

    Returns:
        (H, W, 3) float32 RGB in [0, 1].
    """
    low, high = value_range
    colours, colour_table = np.empty((*values.shape, 3), np.float32), _colour_table(table)
    for top in range(0, len(values), _STRIP_ROWS):  # between its steps the formula leaves a few times the map
        strip = values[top : top + _STRIP_ROWS]
        position = np.clip((strip - low) / max(high - low, 1e-12), 0, 1)
        is_known = np.isfinite(strip)
        indices = np.round(np.where(is_known, position, 0) * 255).astype(np.uint8)
        painted_strip = colours[top : top + _STRIP_ROWS]
        painted_strip[:] = colour_table[indices]
        painted_strip[~is_known] = UNKNOWN
    return colours


def hatched(image: FloatMap, mask: BoolMap) -> FloatMap:
    """Draw thin light diagonals over the masked part of an (H, W, 3) image; what lies under them stays readable."""
    rows, columns = np.indices(mask.shape, dtype=np.int32)
    is_line = mask & ((rows + columns) % _HATCH_PERIOD_PX < 2)
    result = image.copy()
    result[is_line] = 0.55 * result[is_line] + 0.45
    return np.asarray(result, dtype=np.float32)


def rounded_ticks(low: float, high: float, *, n_wanted: int = 6) -> list[float]:
    """Choose about ``n_wanted`` values in [low, high] that are multiples of 1, 2 or 5 times a power of ten."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return []
    rough = (high - low) / max(n_wanted, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * min((1, 2, 5, 10), key=lambda factor: abs(math.log(factor * power / rough)))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(n * step, 12) + 0.0 for n in range(first, last + 1)]


def number_labels(values: Sequence[float]) -> list[str]:
    """Write numbers with the decimals that tell them apart, all with as many."""
    decimals = next((n for n in range(6) if all(abs(v - round(v, n)) < 1e-9 * max(1, abs(v)) for v in values)), 6)
    return [f"{value:.{decimals}f}" for value in values]


def draw_colour_bar(
    page: Image.Image, *, at_xy: tuple[int, int], wh: tuple[int, int], table: str, ticks: Sequence[Tick], size_px: int
) -> None:
    """Draw a horizontal colour bar with its ticks and their labels under it; labels never overlap or leave the bar."""
    ramp = np.tile(np.linspace(0, 1, wh[0], dtype=np.float32), (wh[1], 1))
    paste_image(page, painted(ramp, value_range=(0, 1), table=table), at_xy=at_xy)
    pen = ImageDraw.Draw(page)
    free_from_x = float(at_xy[0])
    for tick in sorted(ticks, key=lambda tick: tick.position):
        x = at_xy[0] + tick.position * (wh[0] - 1)
        half_width = text_width_px(tick.label, size_px=size_px) / 2
        text_x = min(max(x, at_xy[0] + half_width), at_xy[0] + wh[0] - half_width)
        if text_x - half_width < free_from_x:
            continue
        pen.line([(x, at_xy[1] + wh[1]), (x, at_xy[1] + wh[1] + 4)], fill=FAINT_INK)
        write_text(page, tick.label, at_xy=(text_x, at_xy[1] + wh[1] + 6), size_px=size_px, anchor="ma")
        free_from_x = text_x + half_width + size_px * 0.6


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size_px)


@cache
def _colour_table(name: str) -> FloatMap:
    start, end = _TURBO_ENDS if name == "turbo" else (0.0, 1.0)
    levels = np.round(np.linspace(start, end, 256) * 255).astype(np.uint8)
    if name == "grey":
        return np.repeat(levels[:, None].astype(np.float32) / 255, 3, axis=1)
    bgr = cv2.applyColorMap(levels[:, None], _TABLES[name])
    return np.asarray(bgr[:, 0, ::-1], dtype=np.float32) / np.float32(255)
