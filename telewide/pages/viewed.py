"""One capture as the page shows it: pictures and maps inside the page, small enough to be mailed.

Maps are PNGs of 8-bit channels, which browsers decode exactly. Letters: H W image.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from telewide.bokeh.aperture import DISK, Aperture
from telewide.bokeh.focus import Focus, find_focus
from telewide.bokeh.hidden import COUNT, JUMP, sort_by_level
from telewide.bokeh.highlights import MAX_TIMES, light_share
from telewide.bokeh.picture import BokehOptions, blur_per_px
from telewide.bokeh.render import LARGEST_RADIUS_SHARE, radius_per_px_from_f_number
from telewide.depth.preview import disparity_panel
from telewide.depth.result import FARTHEST_M, DepthResult
from telewide.drawing import fitted_wh, scaled_image
from telewide.geometry.arrays import ByteImage, FloatArray, FloatImage, FloatMap
from telewide.geometry.stereo import DisparityMap, resize_disparity

LONGEST_PX = 1200
STEPS, FEWEST_PARTS, MOST_STEPS = 4095, 3, 65535
"""Disparity is shown to so many parts of its range: what lies below is noise, and takes half of the file. A tenth of a
px has a few parts, however wide the range, as long as 16 bits hold them."""
MOST_BYTES = 5_800_000
"""Of one capture in the page, base64 included."""
DEFAULT_F_NUMBER, DEFAULT_LIGHTS = 1.8, 4.0
_QUALITIES = (88, 75, 60, 40)
_CONFIDENCE_STEPS = 50


@dataclass(frozen=True)
class Metric:
    """Where the scale is known: ``depth_m = scale_px_m / (disparity_px + doffs_px)``, px of the photo.

    Attributes:
        scale_px_m: focal length times distance of the lenses.
        doffs_px: disparity of what is infinitely far, negated.
        baseline_m: distance of the lenses.
    """

    scale_px_m: float
    doffs_px: float
    baseline_m: float


@dataclass(frozen=True)
class Opening:
    """Bokeh that the page opens with.

    Attributes:
        focus: what is sharp, px of the photo.
        blur_per_px: radius of the blur per px of disparity.
        f_number: that was asked for; None where the blur was given in another way.
        aperture: shape of the opening.
        lights: how many times as bright as white small clipped lights were.
    """

    focus: Focus
    blur_per_px: float
    f_number: float | None = None
    aperture: Aperture = DISK
    lights: float = 1.0


def viewed_capture(
    photo: FloatImage,
    disparity: DisparityMap,
    *,
    others: Mapping[str, FloatImage],
    metric: Metric | None,
    name: str,
    opening: Opening | None = None,
) -> dict[str, object]:
    """Gather what the page needs of a capture, as plain data.

    Args:
        photo: (h, w, 3) the tele photo, upright, sRGB in [0, 1]; of any size, as it is shown smaller.
        disparity: (H, W) on it, at its full size.
        others: further pictures to compare it with, by their labels, of any size.
        metric: how disparity becomes metres; None where that is not known.
        name: of the capture.
        opening: what it opens with; None for the nearest large surface in the middle at f/1.8.

    Raises:
        InputError: no disparity is known.
    """
    height, width = disparity.disparity_px.shape
    wh = shown_wh((width, height))
    small, maps = framed(photo, wh=wh), _resized(disparity, wh=wh)
    levels = sort_by_level(small, maps.disparity_px)
    in_photo_px = maps.disparity_px.astype(np.float64) * (width / wh[0])
    lowest_px, step_px = _steps_of(in_photo_px)
    opens = _default_opening(maps, metric) if opening is None else _made_smaller(opening, wh[0] / width)
    result = DepthResult(name=name, disparity=maps)
    pictures = {"tele": small, **{label: framed(other, wh=wh) for label, other in others.items()}}
    pictures["disparity"] = disparity_panel(result, wh=wh)
    lights = np.round(255 * light_share(small)).astype(np.uint8)
    by_level = np.dstack([levels.level, levels.hidden_level, lights])
    maps_png = {"levels": _png(by_level), "map": _png(_packed(maps, (in_photo_px - lowest_px) / step_px))}
    return {
        "name": name,
        "wh": list(wh),
        "photoPx": width / wh[0],
        **_encoded(pictures, hidden=levels.hidden, most_bytes=MOST_BYTES - sum(len(png) for png in maps_png.values())),
        **maps_png,
        "levelEnds": list(levels.ends_px),
        "levelCount": COUNT,
        "jump": JUMP,
        "mapSteps": [lowest_px, step_px],
        "opensAt": None if opening is None else _place(opening.focus, disparity),
        **_told_of(opens, metric),
        "capPx": LARGEST_RADIUS_SHARE * min(small.shape[:2]),
        "metric": None if metric is None else [metric.scale_px_m, metric.doffs_px, metric.baseline_m, FARTHEST_M],
    }


def _told_of(opens: Opening, metric: Metric | None) -> dict[str, object]:
    focus = opens.focus
    return {
        "focus": [focus.x_px, focus.y_px],
        "focusPx": focus.disparity_px,
        "sharpPx": list(focus.sharp_px or (focus.disparity_px, focus.disparity_px)),
        "radiusPerPx": opens.blur_per_px,
        "fNumber": opens.f_number or _like_f_number(opens.blur_per_px, metric),
        "blades": opens.aperture.blades or 0,
        "curvature": opens.aperture.curvature,
        "turnRad": math.radians(opens.aperture.rotation_deg),
        "lights": opens.lights,
        "mostLights": MAX_TIMES,
    }


def _default_opening(maps: DisparityMap, metric: Metric | None) -> Opening:
    """Choose what the page opens with where no bokeh was asked for."""
    focus = find_focus(maps.disparity_px, maps.confidence, focus="auto")
    options = BokehOptions(f_number=None if metric is None else DEFAULT_F_NUMBER)
    baseline_m = None if metric is None else metric.baseline_m
    blur = blur_per_px(maps.disparity_px, focus, options=options, baseline_m=baseline_m)
    return Opening(focus, blur, f_number=options.f_number, lights=DEFAULT_LIGHTS)


def _made_smaller(opening: Opening, scale: float) -> Opening:
    focus = opening.focus
    x, y = (math.floor((at + 0.5) * scale) for at in (focus.x_px, focus.y_px))
    sharp_px = None if focus.sharp_px is None else (scale * focus.sharp_px[0], scale * focus.sharp_px[1])
    small = replace(focus, disparity_px=scale * focus.disparity_px, x_px=x, y_px=y, sharp_px=sharp_px)
    return replace(opening, focus=small)


def _like_f_number(blur: float, metric: Metric | None) -> float:
    """F-number of a 50 mm lens that blurs so; where metres are not known, the default stands for any blur."""
    if metric is None or not blur > 0:
        return DEFAULT_F_NUMBER
    return radius_per_px_from_f_number(f_number=1.0, baseline_m=metric.baseline_m) / blur


def shown_wh(wh: tuple[int, int]) -> tuple[int, int]:
    """Tell the size at which a photo of a size is shown: that of the frame of all its pictures."""
    fitted = fitted_wh(wh, box_wh=(LONGEST_PX, LONGEST_PX))
    return fitted if fitted[0] < wh[0] else wh


def framed(picture: FloatImage, *, wh: tuple[int, int]) -> FloatImage:
    """Make a picture as large as a frame allows, on grey where its sides are of another proportion.

    Args:
        picture: (H, W, 3) RGB in [0, 1].
        wh: width and height of the frame.
    """
    if (picture.shape[1], picture.shape[0]) == wh:
        return picture
    inner = fitted_wh((picture.shape[1], picture.shape[0]), box_wh=wh)
    fitted = np.clip(scaled_image(picture, wh=inner), 0, 1)
    framed = np.full((wh[1], wh[0], 3), 0.5, np.float32)
    top, left = (wh[1] - inner[1]) // 2, (wh[0] - inner[0]) // 2
    framed[top : top + inner[1], left : left + inner[0]] = fitted
    return framed


def _resized(disparity: DisparityMap, *, wh: tuple[int, int]) -> DisparityMap:
    def nearest(values: FloatMap) -> FloatMap:
        return np.asarray(cv2.resize(values, wh, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)

    if (disparity.disparity_px.shape[1], disparity.disparity_px.shape[0]) == wh:
        return disparity
    return DisparityMap(
        resize_disparity(disparity.disparity_px, wh=wh),
        nearest(disparity.confidence),
        nearest(disparity.valid.astype(np.float32)) > 0,
    )


def _place(focus: Focus, disparity: DisparityMap) -> list[float] | None:
    """Point of a focus and its disparity, px of the photo; None where nothing is known of it."""
    height, width = disparity.disparity_px.shape
    if not (0 <= focus.x_px < width and 0 <= focus.y_px < height):
        return None
    there_px = float(disparity.disparity_px[focus.y_px, focus.x_px])
    return [focus.x_px, focus.y_px, there_px] if math.isfinite(there_px) else None


def _steps_of(disparity_px: FloatArray) -> tuple[float, float]:
    """Tell the lowest disparity that the page can show and its step, px.

    An odd number of steps makes a tenth, and one lies on each tenth: rounded to steps first, a disparity is the same in
    tenths as rounded at once, so that the page says what the command says.
    """
    lowest, highest = math.floor(10 * np.nanmin(disparity_px)), math.ceil(10 * np.nanmax(disparity_px))
    tenths = max(highest - lowest, 1)
    parts = max(STEPS // tenths, FEWEST_PARTS)
    if parts * tenths > MOST_STEPS:
        return lowest / 10, tenths / 10 / MOST_STEPS
    return lowest / 10, 1 / (10 * (parts - 1 + parts % 2))


def _packed(maps: DisparityMap, steps: FloatArray) -> ByteImage:
    """Disparity in red (upper) and green (lower bits), confidence in blue; blue 0 was not measured, 255 unknown."""
    number = np.round(np.nan_to_num(steps, nan=0.0)).astype(np.uint16)
    known = np.clip(np.nan_to_num(maps.confidence), 0, 1)
    confidence = np.round(np.round(known * _CONFIDENCE_STEPS) / _CONFIDENCE_STEPS * 253) + 1
    confidence = np.where(maps.valid, confidence, 0)
    confidence = np.where(np.isfinite(maps.disparity_px), confidence, 255)
    return np.dstack([number >> 8, number & 255, confidence]).astype(np.uint8)


def _encoded(pictures: Mapping[str, FloatImage], *, hidden: FloatImage, most_bytes: int) -> dict[str, object]:
    """Pictures as JPEGs, of as good a quality as their bytes allow."""
    for quality in _QUALITIES:
        encoded = {label: _jpeg(picture, quality=quality) for label, picture in pictures.items()}
        behind = _jpeg(hidden, quality=quality)
        if len(behind) + sum(len(jpeg) for jpeg in encoded.values()) <= most_bytes:
            break
    return {"pictures": encoded, "hidden": behind}


def _jpeg(picture: FloatImage, *, quality: int) -> str:
    levels = np.round(np.clip(np.nan_to_num(picture), 0, 1) * 255).astype(np.uint8)
    return _uri("jpeg", levels, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality])


def _png(levels: ByteImage) -> str:
    return _uri("png", levels, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _uri(kind: str, levels: ByteImage, suffix: str, parameters: list[int]) -> str:
    _, encoded = cv2.imencode(suffix, np.ascontiguousarray(levels[..., ::-1]), parameters)
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode('ascii')}"
