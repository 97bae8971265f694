"""A picture of one capture: the photo with its marks, and beside it the disparity of every matcher at one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from telewide.benchmark.marks import CaptureMarks, DepthEdge, Point, ThinThing
from telewide.depth.preview import colourise, display_range_px
from telewide.drawing import image_from_page, new_page, paste_image, scaled_image, upright
from telewide.geometry.arrays import FloatMap
from telewide.pages.contact import strip, write_sheet

_PLANE, _THIN, _GROUND, _EDGE = (0, 160, 255), (255, 40, 40), (0, 230, 230), (40, 255, 40)
_NEAR_TICK_PX = 6.0
_LONGEST_PANEL_PX = 1280


def write_mark_sheet(
    path: Path, photo: FloatMap, marks: CaptureMarks, *, maps_px: Mapping[str, FloatMap], rotated_deg: int = 0
) -> None:
    """Write the picture of one capture as PNG.

    Args:
        path: ends in .png.
        photo: (H, W, 3) tele, RGB in [0, 1].
        marks: in px of the maps; none are drawn where there are none.
        maps_px: (H, W) disparities, px, by the names of the matchers, all of one size.
        rotated_deg: how far the photos were turned counter-clockwise; the picture shows them upright.
    """
    known_px = np.concatenate([map_px[np.isfinite(map_px)] for map_px in maps_px.values()])
    range_px = display_range_px(known_px[None])
    height, width = next(iter(maps_px.values())).shape
    panels = {"photo": drawn_marks(scaled_image(photo, wh=(width, height)), marks)}
    panels |= {name: colourise(map_px, range_px=range_px) for name, map_px in maps_px.items()}
    shown = [upright(panel, rotated_deg=rotated_deg) for panel in panels.values()]
    panel_h, panel_w = shown[0].shape[:2]
    width_px = round(panel_w * min(1.0, _LONGEST_PANEL_PX / max(panel_h, panel_w))) * len(shown)
    labels = [*panels]
    labels[1] = f"{labels[1]} ({range_px[0]:.1f} to {range_px[1]:.1f} px in all)"
    write_sheet(path, strip(shown, labels, width_px=width_px))


def drawn_marks(photo: FloatMap, marks: CaptureMarks) -> FloatMap:
    """Draw marks on a photo: planes blue, thin things red between their borders, their ground cyan, edges green.

    Args:
        photo: (H, W, 3) RGB in [0, 1].
        marks: in px of it; an edge has ticks towards its near side.

    Returns:
        (H, W, 3) RGB in [0, 1].
    """
    page = new_page(wh=(photo.shape[1], photo.shape[0]))
    paste_image(page, photo, at_xy=(0, 0))
    for polygon in marks.planes.values():
        _draw_line(page, [*polygon, polygon[0]], _PLANE)
    for thing in marks.thin.values():
        _draw_thing(page, thing)
    for edge in marks.edges.values():
        _draw_edge(page, edge)
    return image_from_page(page)


def _draw_thing(page: Image.Image, thing: ThinThing) -> None:
    _draw_line(page, thing.line, _THIN)
    for offset_px in (-thing.width_px / 2, thing.width_px / 2):
        _draw_line(page, _shifted(thing.line, offset_px), _THIN)
    for offset_px in thing.ground_px:
        _draw_line(page, _shifted(thing.line, offset_px), _GROUND)


def _draw_edge(page: Image.Image, edge: DepthEdge) -> None:
    _draw_line(page, edge.line, _EDGE)
    towards_near_px = _NEAR_TICK_PX if edge.near == "right" else -_NEAR_TICK_PX
    for start, end in zip(edge.line, _shifted(edge.line, towards_near_px), strict=True):
        _draw_line(page, [start, end], _EDGE)


def _draw_line(page: Image.Image, points: Sequence[Point], ink: tuple[int, int, int]) -> None:
    ImageDraw.Draw(page).line([(x, y) for x, y in points], fill=ink, width=1)


def _shifted(line: Sequence[Point], offset_px: float) -> list[Point]:
    """The line moved to the right of a walk along it, each corner along the mean of its normals."""
    corners = np.asarray(line, dtype=np.float64)
    ways = np.diff(corners, axis=0)
    normals = np.column_stack([-ways[:, 1], ways[:, 0]]) / np.hypot(ways[:, 0], ways[:, 1])[:, None]
    at_corners = np.vstack([normals[:1], (normals[:-1] + normals[1:]) / 2, normals[-1:]])
    moved = corners + offset_px * at_corners / np.linalg.norm(at_corners, axis=1, keepdims=True)
    return [(float(x), float(y)) for x, y in moved]
