"""Contact sheets: one look tells whether a matcher or a training run is sound.

A line per capture: tele, wide, disparity, confidence, and what is left between tele and the wide view warped to it.
ref is tele, src is wide. Images are (H, W, 3) float32 RGB in [0, 1]. Letters: H W image.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from telewide.depth.preview import disparity_panel, scale_ticks
from telewide.depth.result import DepthResult
from telewide.drawing import (
    Tick,
    draw_colour_bar,
    fitted_text,
    fitted_wh,
    hatched,
    image_from_page,
    new_page,
    painted,
    paste_centred,
    paste_image,
    scaled_image,
    scaled_mask,
    text_width_px,
    upright,
    write_text,
)
from telewide.files import replacing
from telewide.geometry.arrays import FloatMap
from telewide.geometry.stereo import DisparityMap, resize_disparity

SHEET_WIDTH_PX = 2000
DIFFERENCE_SHOWN = 0.15
"""Difference (of values in [0, 1]) that is drawn in the brightest colour, the same on every sheet."""

_COLUMNS = ("tele", "wide", "disparity", "confidence", "warped difference")
_TALLEST_CELL_PX = 420
_PAD, _TEXT_PX, _TITLE_PX = 12, 17, 26
_FOOT_PX = 46  # below the pictures of a row: colour bars and numbers
_DIFFERENCE_WIDTH_PX = 1600  # larger views are compared at this width
_DIFFERENCE_SIGMA_PX = 2.0  # both views blurred so: the wide one has no finer detail to be compared


@dataclass(frozen=True)
class ContactRow:
    """One capture on a contact sheet.

    Attributes:
        name: of the capture.
        tele: (H, W, 3) ref.
        wide: (H, W, 3) src, of tele's size.
        disparity: (H, W) maps of tele.
        rotated_deg: how far the photos were turned counter-clockwise; they are shown upright.
    """

    name: str
    tele: FloatMap
    wide: FloatMap
    disparity: DisparityMap
    rotated_deg: int = 0


def fetch_to_ref(src: FloatMap, disparity_px: FloatMap) -> FloatMap:
    """Fetch src into ref's frame: ``warped(x, y) = src(x - d(x, y), y)``, linear along the row.

    Args:
        src: (H, W, C).
        disparity_px: (H, W) ``x_ref - x_src``, px.

    Returns:
        (H, W, C) float32; NaN where the disparity is unknown or points outside src.
    """
    height, width = disparity_px.shape
    src_x = np.arange(width, dtype=np.float32) - disparity_px
    is_inside = np.isfinite(src_x) & (src_x >= 0) & (src_x <= width - 1)
    src_x = np.where(is_inside, src_x, 0)
    first = np.minimum(src_x.astype(np.intp), max(width - 2, 0))
    second = np.minimum(first + 1, width - 1)
    weight = (src_x - first)[..., None].astype(np.float32)
    rows = np.arange(height)[:, None]
    warped = src[rows, first] * (1 - weight) + src[rows, second] * weight
    warped[~is_inside] = np.nan
    return np.asarray(warped, dtype=np.float32)


def warped_difference(tele: FloatMap, wide: FloatMap, disparity_px: FloatMap) -> FloatMap:
    """Measure what the disparity leaves unexplained, exposure and colour balance aside.

    Both views are blurred to the bandwidth they share, wide is warped to tele and its channels take tele's mean and
    spread.

    Args:
        tele: (H, W, 3) ref.
        wide: (H, W, 3) src.
        disparity_px: (H, W), px.

    Returns:
        (H, W) mean absolute difference over the channels, in [0, 1]; NaN where wide does not reach.
    """
    warped = fetch_to_ref(_shared_band(wide), disparity_px)
    tele_blurred = _shared_band(tele)
    is_seen = np.isfinite(warped[..., 0])
    if not is_seen.any():
        return np.full(disparity_px.shape, np.nan, dtype=np.float32)
    tele_seen, wide_seen = tele_blurred[is_seen], warped[is_seen]
    gain = tele_seen.std(axis=0) / np.maximum(wide_seen.std(axis=0), 1e-6)
    matched = (warped - wide_seen.mean(axis=0)) * gain + tele_seen.mean(axis=0)
    return np.asarray(np.abs(matched - tele_blurred).mean(axis=2), dtype=np.float32)


def contact_sheet(rows: Iterable[ContactRow], *, title: str) -> FloatMap:
    """Lay captures out on one sheet at most 2000 px wide; upright ones stand side by side.

    Args:
        rows: the captures; taken one by one, so a generator keeps memory small.
        title: the sheet's heading.

    Returns:
        The sheet, float32 RGB in [0, 1].

    Raises:
        ValueError: if there are no rows.
    """
    strips: list[Image.Image] = []
    cell_wh = (0, 0)
    for row in rows:
        if not strips:
            cell_wh = _cell_wh(row)
        strips.append(_row_page(row, cell_wh=cell_wh))
    if not strips:
        message = "a contact sheet needs at least one capture, there are none"
        raise ValueError(message)
    return image_from_page(_assembled(strips, cell_wh=cell_wh, title=title))


def write_sheet(path: Path, sheet: FloatMap) -> None:
    """Write a sheet as a PNG of 256 colours: a quarter of the size, and as good to judge by.

    Args:
        path: ends in .png.
        sheet: (H, W, 3) RGB in [0, 1].
    """
    page = new_page(wh=(sheet.shape[1], sheet.shape[0]))
    paste_image(page, sheet, at_xy=(0, 0))
    colours = page.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    with replacing(path) as temporary:
        colours.save(temporary)


def strip(images: Sequence[FloatMap], labels: Sequence[str], *, width_px: int = 1600, columns: int = 0) -> FloatMap:
    """Put labelled images of one shape side by side.

    Args:
        images: (H, W, 3) each; all are fitted to the shape of the first.
        labels: one each, written under the image.
        width_px: of the whole strip.
        columns: images beside each other; 0 puts all on one line.

    Returns:
        The strip, float32 RGB in [0, 1].

    Raises:
        ValueError: if there are no images, or not one label each.
    """
    if not images or len(images) != len(labels):
        message = f"a strip needs images and one label each, got {len(images)} images and {len(labels)} labels"
        raise ValueError(message)
    columns = columns or len(images)
    gap, text_px = max(4, width_px // 200), max(14, width_px // 80)
    cell_w = (width_px - gap * (columns - 1)) // columns
    cell_wh = (cell_w, max(1, round(cell_w * images[0].shape[0] / images[0].shape[1])))
    pitch_y = cell_wh[1] + 2 * text_px
    page = new_page(wh=(width_px, pitch_y * -(-len(images) // columns)))
    for n, (image, label) in enumerate(zip(images, labels, strict=True)):
        corner_xy = (n % columns * (cell_w + gap), n // columns * pitch_y)
        _paste_fitted(page, image, at_xy=corner_xy, box_wh=cell_wh)
        label_xy = (corner_xy[0] + cell_w / 2, corner_xy[1] + cell_wh[1] + text_px)
        write_text(page, label, at_xy=label_xy, size_px=text_px, anchor="mm")
    return image_from_page(page)


def _shared_band(image: FloatMap) -> FloatMap:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), _DIFFERENCE_SIGMA_PX), dtype=np.float32)


def _cell_wh(row: ContactRow) -> tuple[int, int]:
    tele = upright(row.tele, rotated_deg=row.rotated_deg)
    widest = (SHEET_WIDTH_PX - _PAD * (len(_COLUMNS) + 1)) // len(_COLUMNS)
    return fitted_wh((tele.shape[1], tele.shape[0]), box_wh=(widest, _TALLEST_CELL_PX))


def _row_page(row: ContactRow, *, cell_wh: tuple[int, int]) -> Image.Image:
    """Draw one capture: five pictures in a line, and under them their scales."""
    page = new_page(wh=(_line_width(cell_wh), cell_wh[1] + _FOOT_PX))
    difference = _difference_at_most(row)
    result = DepthResult(name=row.name, disparity=row.disparity, rotated_deg=row.rotated_deg)
    tele = upright(row.tele, rotated_deg=row.rotated_deg)
    picture_wh = fitted_wh((tele.shape[1], tele.shape[0]), box_wh=cell_wh)
    confidence = upright(row.disparity.confidence, rotated_deg=row.rotated_deg)
    pictures = (
        tele,
        upright(row.wide, rotated_deg=row.rotated_deg),
        disparity_panel(result, wh=picture_wh),
        painted(confidence, value_range=(0, 1), table="grey"),
        _difference_panel(difference, wh=picture_wh, rotated_deg=row.rotated_deg),
    )
    for column, picture in enumerate(pictures):
        _paste_fitted(page, picture, at_xy=(_column_x(column, cell_wh), 0), box_wh=cell_wh)
    _write_foot(page, row, result=result, difference=difference, cell_wh=cell_wh)
    return page


def _write_foot(
    page: Image.Image, row: ContactRow, *, result: DepthResult, difference: FloatMap, cell_wh: tuple[int, int]
) -> None:
    text_y = cell_wh[1] + 16
    name = fitted_text(row.name, width_px=cell_wh[0], size_px=_TEXT_PX)
    write_text(page, name, at_xy=(_column_x(0, cell_wh), text_y), size_px=_TEXT_PX)
    unit, disparity_ticks = scale_ticks(result, n_wanted=max(2, cell_wh[0] // 90))
    measured_share = float(row.disparity.valid.mean())
    left_out = np.isnan(difference).all()
    texts = (unit, f"{measured_share:.0%} measured", "none" if left_out else f"mean {np.nanmean(difference):.3f}")
    tables = ("turbo", "grey", "inferno")
    ticks = (
        disparity_ticks,
        [Tick(0, "0"), Tick(0.5, "0.5"), Tick(1, "1")],
        [Tick(0, "0"), Tick(1 / 3, "0.05"), Tick(2 / 3, "0.1"), Tick(1, "0.15")],
    )
    for n, (text, table, marks) in enumerate(zip(texts, tables, ticks, strict=True)):
        x = _column_x(n + 2, cell_wh)
        write_text(page, text, at_xy=(x + cell_wh[0], text_y), size_px=_TEXT_PX, anchor="rm")
        bar_width = cell_wh[0] - round(text_width_px(text, size_px=_TEXT_PX)) - 12
        if bar_width >= 40:
            bar_xy = (x, cell_wh[1] + 8)
            draw_colour_bar(page, at_xy=bar_xy, wh=(bar_width, 9), table=table, ticks=marks, size_px=_TEXT_PX - 4)


def _difference_at_most(row: ContactRow) -> FloatMap:
    height, width = row.disparity.disparity_px.shape
    if width <= _DIFFERENCE_WIDTH_PX:
        return warped_difference(row.tele, row.wide, row.disparity.disparity_px)
    wh = (_DIFFERENCE_WIDTH_PX, max(1, round(height * _DIFFERENCE_WIDTH_PX / width)))
    disparity_px = resize_disparity(row.disparity.disparity_px, wh=wh)
    return warped_difference(scaled_image(row.tele, wh=wh), scaled_image(row.wide, wh=wh), disparity_px)


def _difference_panel(difference: FloatMap, *, wh: tuple[int, int], rotated_deg: int) -> FloatMap:
    standing = upright(difference, rotated_deg=rotated_deg)
    colours = painted(standing, value_range=(0, DIFFERENCE_SHOWN), table="inferno")
    return hatched(scaled_image(colours, wh=wh), scaled_mask(np.isnan(standing), wh=wh))


def _paste_fitted(page: Image.Image, image: FloatMap, *, at_xy: tuple[int, int], box_wh: tuple[int, int]) -> None:
    wh = fitted_wh((image.shape[1], image.shape[0]), box_wh=box_wh)
    paste_centred(page, scaled_image(image, wh=wh), at_xy=at_xy, box_wh=box_wh)


def _column_x(column: int, cell_wh: tuple[int, int]) -> int:
    return column * (cell_wh[0] + _PAD)


def _line_width(cell_wh: tuple[int, int]) -> int:
    return _column_x(len(_COLUMNS), cell_wh) - _PAD


def _assembled(strips: Sequence[Image.Image], *, cell_wh: tuple[int, int], title: str) -> Image.Image:
    """Stack the lines below a title and the columns' names; narrow lines stand beside each other."""
    pitch_x = _line_width(cell_wh) + 3 * _PAD
    per_line = max(1, min(len(strips), (SHEET_WIDTH_PX - 2 * _PAD + 3 * _PAD) // pitch_x))
    pitch_y = strips[0].height + _PAD
    top = _PAD + 2 * _TITLE_PX + 2 * _TEXT_PX
    width = 2 * _PAD + per_line * pitch_x - 3 * _PAD
    page = new_page(wh=(width, top + -(-len(strips) // per_line) * pitch_y))
    heading = fitted_text(title, width_px=width - 2 * _PAD, size_px=_TITLE_PX)
    write_text(page, heading, at_xy=(_PAD, _PAD + _TITLE_PX), size_px=_TITLE_PX)
    for n in range(per_line):
        for column, label in enumerate(_COLUMNS):
            label_xy = (_PAD + n * pitch_x + _column_x(column, cell_wh), top - _TEXT_PX)
            shown = fitted_text(label, width_px=cell_wh[0], size_px=_TEXT_PX)
            write_text(page, shown, at_xy=label_xy, size_px=_TEXT_PX, is_faint=True)
    for n, line in enumerate(strips):
        page.paste(line, (_PAD + n % per_line * pitch_x, top + n // per_line * pitch_y))
    return page
