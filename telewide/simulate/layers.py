"""A world of textured surfaces, seen from any viewpoint exactly.

A layer is a surface whose disparity is ``d(x, y) = a + b x + c y + relief(x, y)`` in pixels of the reference view.
Moving the viewpoint by ``(s_x, s_y)`` moves the point at (x, y) to ``(x, y) + s (d(x, y) - pivot)``: ``s = (0, 0)`` is
the reference view, ``s = (-1, 0)`` the source view (``disparity_px = x_ref - x_src``), and the points of a disk are the
points of a lens focused at the pivot. With ``e = d - pivot`` the inverse is closed up to the relief:

    e(x', y') = (a - pivot + b x' + c y' + relief(x' - s_x e, y' - s_y e)) / (1 + b s_x + c s_y)

and a few fixed-point steps settle the relief, whose slopes are gentle. Where surfaces cross, the nearer one is seen.
Pixel (0, 0) is the centre of the reference view's top-left pixel. Images are float32 sRGB in [0, 1].
Letters: H W image, h w texture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap

_RELIEF_STEPS = 7
"""Fixed-point steps: with slopes up to 0.35 the rest is below 0.35**7 = 0.06 % of the relief."""

_FAR_AWAY = np.float32(-1e9)


@dataclass(frozen=True)
class Layer:
    """One surface.

    Attributes:
        texture: (h, w, 3) float32, sRGB in [0, 1], sampled at reference pixels.
        alpha: (h, w) float32 in [0, 1], what the surface covers; None covers everything, beyond the texture too.
        origin_xy: reference pixel of the texture's first sample.
        plane_px: (a, b, c) of the disparity ``a + b x + c y`` in reference pixels.
        relief_px: (h, w) float32 added to the plane, or None.
    """

    texture: FloatImage
    alpha: FloatMap | None
    origin_xy: tuple[int, int]
    plane_px: tuple[float, float, float]
    relief_px: FloatMap | None = None


@dataclass(frozen=True)
class LayeredScene:
    """Surfaces from far to near, and the size of the views.

    Attributes:
        layers: far to near; the first one should cover everything.
        hw: height and width of the views.
    """

    layers: tuple[Layer, ...]
    hw: tuple[int, int]


@dataclass(frozen=True)
class RenderedPair:
    """Two views and the truth.

    Attributes:
        ref: (H, W, 3) float32, sRGB.
        src: (H, W, 3) float32, sRGB.
        disparity_px: (H, W) float32, ``x_ref - x_src`` of the reference view, hard at the outlines.
        occluded: (H, W) bool, True where a reference pixel is hidden in the source view or outside it.
    """

    ref: FloatImage
    src: FloatImage
    disparity_px: FloatMap
    occluded: BoolMap


@dataclass(frozen=True)
class View:
    """A scene from one viewpoint.

    Attributes:
        image: (H, W, 3) float32, in the space of the textures.
        disparity_px: (H, W) float32, of the surface seen at each pixel.
        layer_index: (H, W) int16, which layer is seen; -1 none.
    """

    image: FloatImage
    disparity_px: FloatMap
    layer_index: NDArray[np.int16]


def render_pair(scene: LayeredScene) -> RenderedPair:
    """Render the reference view, the source view and the exact disparity between them.

    Args:
        scene: the world.

    Returns:
        The pair with its truth.
    """
    ref = render_view(scene)
    src = render_view(scene, parallax_xy=(-1.0, 0.0))
    return RenderedPair(ref.image, src.image, ref.disparity_px, _hidden_in_source(ref, src))


def render_view(scene: LayeredScene, *, parallax_xy: tuple[float, float] = (0.0, 0.0), pivot_px: float = 0.0) -> View:
    """Render the world from one viewpoint.

    Args:
        scene: the world.
        parallax_xy: px that a surface moves in x and y per px of disparity.
        pivot_px: disparity that does not move, px.

    Returns:
        The view; all its values belong to the surface seen at the pixel.
    """
    height, width = scene.hw
    image = np.zeros((height, width, 3), np.float32)
    nearest_px = np.full((height, width), _FAR_AWAY, np.float32)
    index = np.full((height, width), -1, np.int16)
    for number, layer in enumerate(scene.layers):
        box = _box_in_view(layer, scene.hw, parallax_xy=parallax_xy, pivot_px=pivot_px)
        if box is None:
            continue
        colour, alpha, disparity_px = _layer_in_view(layer, box, parallax_xy=parallax_xy, pivot_px=pivot_px)
        x0, y0, x1, y1 = box
        window = np.s_[y0:y1, x0:x1]
        solid = disparity_px >= nearest_px[window]
        if alpha is None:
            np.copyto(image[window], colour, where=solid[..., None])
        else:
            cover = alpha * solid
            image[window] += cv2.merge([cover, cover, cover]) * (colour - image[window])
            solid = cover > 0.5
        np.copyto(nearest_px[window], disparity_px, where=solid)
        np.copyto(index[window], np.int16(number), where=solid)
    nearest_px[index < 0] = np.nan
    return View(image, nearest_px, index)


def disparity_range_px(layer: Layer) -> tuple[float, float]:
    """Least and largest disparity of a layer over its texture.

    Args:
        layer: the surface.

    Returns:
        Bounds in px: exact for a plane, safe with a relief.
    """
    height, width = layer.texture.shape[:2]
    a, b, c = layer.plane_px
    x0, y0 = layer.origin_xy
    corners = [a + b * x + c * y for x in (x0, x0 + width - 1) for y in (y0, y0 + height - 1)]
    low, high = min(corners), max(corners)
    if layer.relief_px is None:
        return low, high
    return low + float(layer.relief_px.min()), high + float(layer.relief_px.max())


def _box_in_view(
    layer: Layer, hw: tuple[int, int], *, parallax_xy: tuple[float, float], pivot_px: float
) -> tuple[int, int, int, int] | None:
    """Window (x0, y0, x1, y1) of the view that the layer can touch, or None."""
    height, width = hw
    if layer.alpha is None:
        return 0, 0, width, height
    bounds: list[int] = []
    sizes = (layer.texture.shape[1], layer.texture.shape[0])
    for start, size, move, limit in zip(layer.origin_xy, sizes, parallax_xy, (width, height), strict=True):
        moves = [move * (d - pivot_px) for d in disparity_range_px(layer)]
        first = math.floor(start + min(moves))
        last = math.ceil(start + size - 1 + max(moves))
        bounds += [max(0, first), min(limit, last + 1)]
    x0, x1, y0, y1 = bounds
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _layer_in_view(
    layer: Layer, box: tuple[int, int, int, int], *, parallax_xy: tuple[float, float], pivot_px: float
) -> tuple[FloatImage, FloatMap | None, FloatMap]:
    """Colour, alpha and disparity of the layer at the pixels of a window of the view."""
    x0, y0, x1, y1 = box
    x = np.arange(x0, x1, dtype=np.float32)[None, :]
    y = np.arange(y0, y1, dtype=np.float32)[:, None]
    s_x, s_y = parallax_xy
    a, b, c = layer.plane_px
    x_origin, y_origin = layer.origin_xy
    if parallax_xy == (0.0, 0.0) and _is_inside_texture(layer, box):
        window = np.s_[y0 - y_origin : y1 - y_origin, x0 - x_origin : x1 - x_origin]
        disparity_px = np.float32(a) + np.float32(b) * x + np.float32(c) * y
        if layer.relief_px is not None:
            disparity_px = disparity_px + layer.relief_px[window]
        return layer.texture[window], None if layer.alpha is None else layer.alpha[window], disparity_px
    scale = 1.0 / (1.0 + b * s_x + c * s_y)
    plane_px: FloatMap = np.float32((a - pivot_px) * scale) + np.float32(b * scale) * x + np.float32(c * scale) * y
    moved_px = plane_px
    x_texture = x - np.float32(x_origin)
    y_texture = y - np.float32(y_origin)
    if layer.relief_px is not None:
        for _ in range(_RELIEF_STEPS):
            relief_px = _sample(
                layer.relief_px, x_texture - np.float32(s_x) * moved_px, y_texture - np.float32(s_y) * moved_px
            )
            moved_px = plane_px + np.float32(scale) * relief_px
    map_x = np.asarray(x_texture - np.float32(s_x) * moved_px, np.float32)
    map_y = np.asarray(y_texture - np.float32(s_y) * moved_px, np.float32)
    colour = cv2.remap(layer.texture, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    alpha = None
    if layer.alpha is not None:
        alpha = cv2.remap(layer.alpha, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return (
        np.asarray(colour, np.float32),
        None if alpha is None else np.asarray(alpha, np.float32),
        (moved_px + np.float32(pivot_px)),
    )


def _is_inside_texture(layer: Layer, box: tuple[int, int, int, int]) -> bool:
    x_origin, y_origin = layer.origin_xy
    height, width = layer.texture.shape[:2]
    return x_origin <= box[0] and y_origin <= box[1] and box[2] <= x_origin + width and box[3] <= y_origin + height


def _sample(values: FloatMap, map_x: FloatMap, map_y: FloatMap) -> FloatMap:
    sampled = cv2.remap(values, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32)


def _hidden_in_source(ref: View, src: View) -> BoolMap:
    """A reference pixel is hidden when the source pixel nearest to its image shows another layer."""
    height, width = ref.disparity_px.shape
    x_src = np.arange(width, dtype=np.float32)[None, :] - ref.disparity_px
    nearest = np.rint(np.nan_to_num(x_src, nan=-1.0)).astype(np.int32)
    outside = (nearest < 0) | (nearest >= width)
    rows = np.arange(height)[:, None]
    seen_layer = src.layer_index[rows, np.clip(nearest, 0, width - 1)]
    return np.asarray(outside | (seen_layer != ref.layer_index))
