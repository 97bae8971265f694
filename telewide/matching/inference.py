"""A trained network as a matcher: any image size, confidence, occlusion, tiles where memory asks for them.

Letters: B batch, C channels, H W image.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from telewide.errors import MissingPartError
from telewide.geometry.arrays import FloatImage
from telewide.geometry.stereo import DisparityMap, ValidMasks, without_unphotographed
from telewide.matching.networks import SIZE_MULTIPLE_PX, StereoNetwork, prepare_view
from telewide.matching.other_view import enlarged_size, sharpened
from telewide.matching.readout import AGREEMENT_PX, learned_confidence, left_right_gap_px, measured_confidence
from telewide.matching.refinement import refine
from telewide.matching.sampling import pad_to_multiple
from telewide.matching.window import Window, check_window, scaled_window

GRID_PX = 4 * SIZE_MULTIPLE_PX
"""Images are padded to multiples of this, and tiles begin at them: psmnet-s pools over cells of this size."""
MAX_TILE_PIXELS = 2_500_000
SAME_SURFACE_PX = 0.5
LEAST_BF16_GAIN = 1.2
_may_use_bf16: ContextVar[bool] = ContextVar("may_use_bf16", default=True)


def choose_device(name: str) -> torch.device:
    """Resolve ``auto``, ``cpu`` or ``cuda``.

    Raises:
        MissingPartError: cuda was asked for and is not there.
    """
    has_cuda = torch.cuda.is_available()
    if name == "cuda" and not has_cuda:
        raise MissingPartError("no CUDA device was found", hint="use `device` cpu, or auto")
    return torch.device("cuda" if has_cuda and name != "cpu" else "cpu")


@contextmanager
def full_precision() -> Iterator[None]:
    """Compute in float32 within the block, also where bf16 is faster."""
    token = _may_use_bf16.set(False)
    try:
        yield
    finally:
        _may_use_bf16.reset(token)


def low_precision(device: torch.device) -> AbstractContextManager[object]:
    """Autocast to bf16 where the device computes in it, and do nothing elsewhere or within :func:`full_precision`."""
    return torch.autocast(device.type, dtype=torch.bfloat16, enabled=_may_use_bf16.get() and has_fast_bf16(device))


@lru_cache
def has_fast_bf16(device: torch.device) -> bool:
    """Whether convolutions in bf16 are faster than in float32 on this device.

    Processors with AVX-512 bf16 and without AMX differ by a factor of four: some take twice the time of float32. They
    are asked to convolve, once a process; what a machine gains or loses lies far from the limit.
    """
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    capability = torch.cpu.get_capabilities() if hasattr(torch.cpu, "get_capabilities") else {}
    if capability.get("amx_bf16"):
        return True
    if not (capability.get("avx512_bf16") or capability.get("arm_bf16")):
        return False
    bf16_s, float32_s = _seconds_to_convolve(torch.bfloat16, torch.float32)
    return bf16_s * LEAST_BF16_GAIN < float32_s


@torch.inference_mode()
def _seconds_to_convolve(*dtypes: torch.dtype) -> list[float]:
    """The least of some trials in each type, in turns, with a layer as the networks have them; the first warms up.

    Time of the processor, not of the clock, and of one thread, as two of them wait for each other where cores are busy:
    what else the machine does must not decide how a result is rounded.
    """
    layers = []
    threads = torch.get_num_threads()
    for dtype in dtypes:
        x, weight = (torch.ones(shape, dtype=dtype) for shape in ((1, 48, 96, 96), (48, 48, 3, 3)))
        layers.append(tuple(tensor.contiguous(memory_format=torch.channels_last) for tensor in (x, weight)))
    seconds: list[list[float]] = [[] for _ in dtypes]
    try:
        torch.set_num_threads(1)
        for _ in range(8):
            for (x, weight), trials in zip(layers, seconds, strict=True):
                begun_s = time.process_time()
                functional.conv2d(x, weight, padding=1)
                trials.append(time.process_time() - begun_s)
    finally:
        torch.set_num_threads(threads)
    return [min(trials[1:]) for trials in seconds]


@torch.inference_mode()
def match_with_network(
    ref: FloatImage,
    src: FloatImage,
    *,
    network: StereoNetwork,
    window: Window,
    valid: ValidMasks | None = None,
    max_tile_pixels: int = MAX_TILE_PIXELS,
) -> DisparityMap:
    """Match two views with a trained network, on the device its weights are on.

    Args:
        ref: (H, W, 3) sharp view, [0, 1].
        src: (H, W, 3) other view of the same size.
        network: trained; put into eval mode.
        window: disparities ``[d_min, d_max)``, px.
        valid: where the photos reach, of (H, W); None where they fill the views. The network knows it no better beyond,
            so nothing there counts as measured.
        max_tile_pixels: larger images are computed in overlapping tiles of at most this size.

    Returns:
        Disparity everywhere (continued into what src does not see), confidence, and where both views agree.

    Raises:
        ValueError: the views differ in size, or the window does not fit the volume.
    """
    if ref.shape != src.shape or ref.ndim != 3:
        raise ValueError(f"ref {ref.shape} and src {src.shape} must be (H, W, 3) of one size")
    check_window(window)
    network.eval()
    if not network.has_confidence:
        found = _match_views(ref, src, network=network, window=window, max_tile_pixels=max_tile_pixels)
        return without_unphotographed(found, valid)
    hw, enlarged_hw = ref.shape[:2], enlarged_size(src)
    views, scale = (ref, sharpened(src, like=ref)), enlarged_hw[1] / hw[1]
    if enlarged_hw == hw:
        found = _match_views(*views, network=network, window=window, max_tile_pixels=max_tile_pixels)
    else:
        larger = _match_views(
            *(_enlarged(view, enlarged_hw) for view in views),
            network=network,
            window=scaled_window(window, scale),
            max_tile_pixels=max_tile_pixels,
        )
        found = _shrunken(larger, hw)
    found = without_unphotographed(found, valid)  # before, so that no wall is looked for beyond a photo
    return without_unphotographed(refine(found, ref, src), valid)


def _enlarged(view: FloatImage, hw: tuple[int, ...]) -> FloatImage:
    larger = cv2.resize(view, (hw[1], hw[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(larger.clip(0, 1), dtype=np.float32)


def _shrunken(larger: DisparityMap, hw: tuple[int, ...]) -> DisparityMap:
    """The map at the size that was asked for; no disparity is the mean of two surfaces.

    A pixel of the larger map is less than one here, so that more errors are below 1 px: the odds of that grow as the
    limit does (measured, docs/decisions.md).
    """
    scale = np.float32(larger.disparity_px.shape[1] / hw[1])

    def resized(values: FloatImage, interpolation: int) -> FloatImage:
        return np.asarray(cv2.resize(values, (hw[1], hw[0]), interpolation=interpolation), dtype=np.float32)

    mean_px, nearest_px = (resized(larger.disparity_px, kind) for kind in (cv2.INTER_AREA, cv2.INTER_NEAREST_EXACT))
    is_surface = np.abs(mean_px - nearest_px) < SAME_SURFACE_PX
    valid = resized(larger.valid.astype(np.float32), cv2.INTER_NEAREST_EXACT) > 0
    disparity_px = np.asarray(np.where(is_surface, mean_px, nearest_px) / scale, dtype=np.float32)
    sure = resized(larger.confidence, cv2.INTER_AREA)
    return DisparityMap(disparity_px, sure * scale / (1 + sure * (scale - 1)), valid)


def _match_views(
    ref: FloatImage, src: FloatImage, *, network: StereoNetwork, window: Window, max_tile_pixels: int
) -> DisparityMap:
    """Match at the size of the views, in tiles where they are large."""
    device = next(network.parameters()).device
    # Over the whole image, so that a tile is seen with the brightness the image has.
    ref_BCHW, src_BCHW = (prepare_view(network.features, _tensor_from_image(view).to(device)) for view in (ref, src))
    disparity_px = np.empty(ref.shape[:2], np.float32)
    confidence, agrees = np.empty_like(disparity_px), np.empty(ref.shape[:2], np.bool_)
    for tile in _tiles(ref.shape[:2], window=window, network=network, max_pixels=max_tile_pixels):
        maps = _match_tile(ref_BCHW[tile.outer_slices], src_BCHW[tile.outer_slices], network, window)
        for whole, part in zip((disparity_px, confidence, agrees), maps, strict=True):
            whole[tile.inner] = part[tile.inner_of_outer].cpu().numpy()
    return DisparityMap(disparity_px, confidence, agrees & _falls_inside(disparity_px))


def _match_tile(ref: Tensor, src: Tensor, network: StereoNetwork, window: Window) -> tuple[Tensor, ...]:
    """(H, W) disparity, confidence and agreement of one tile."""
    height, width = ref.shape[-2:]
    ref, src = (pad_to_multiple(view, multiple=GRID_PX) for view in (ref, src))
    with low_precision(ref.device):
        output = network.match_in_scales(ref, src, window)
    gap_px = left_right_gap_px(output, window)
    heads = output.heads_BCHW
    confidence, hidden = measured_confidence(output, gap_px) if heads is None else learned_confidence(heads)
    is_seen = (gap_px < AGREEMENT_PX) & (hidden < 0.5)
    cut = (0, slice(height), slice(width))
    return output.disparity_px.float()[cut], confidence[cut], is_seen[cut]


def _falls_inside(disparity_px: FloatImage) -> NDArray[np.bool_]:
    width = disparity_px.shape[1]
    x_src_px = np.arange(width, dtype=np.float32) - disparity_px
    return np.asarray((x_src_px >= 0) & (x_src_px <= width - 1))


def _tensor_from_image(image: FloatImage) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


_Spans = list[tuple[tuple[int, int], tuple[int, int]]]


@dataclass(frozen=True)
class _Tile:
    """Where a tile's result goes, and the larger part of the image it is computed from."""

    y: tuple[int, int]
    x: tuple[int, int]
    outer_y: tuple[int, int]
    outer_x: tuple[int, int]

    @property
    def inner(self) -> tuple[slice, slice]:
        return slice(*self.y), slice(*self.x)

    @property
    def outer_slices(self) -> tuple[slice, slice, slice, slice]:
        return slice(None), slice(None), slice(*self.outer_y), slice(*self.outer_x)

    @property
    def inner_of_outer(self) -> tuple[slice, slice]:
        (y, x), (top, left) = (self.y, self.x), (self.outer_y[0], self.outer_x[0])
        return slice(y[0] - top, y[1] - top), slice(x[0] - left, x[1] - left)


def _tiles(hw: tuple[int, ...], *, window: Window, network: StereoNetwork, max_pixels: int) -> Iterator[_Tile]:
    """Cut an image so that every tile, border included, has at most ``max_pixels``; one tile if it fits.

    The border is the network's context on each side, in x beyond where src is looked up and where the left-right check
    looks back from; its result is thrown away. Of all such cuts the one that computes the fewest pixels is taken, and
    where there is none, the one with the smallest tiles.
    """
    context_px, grid = network.context_px, max(GRID_PX, network.cells_px)
    if hw[0] * hw[1] <= max_pixels:
        yield _Tile((0, hw[0]), (0, hw[1]), (0, hw[0]), (0, hw[1]))
        return
    looks_back_px = window[1] - window[0]
    borders_x = [context_px + looks_back_px + max(reach_px, 0) for reach_px in (window[1], -window[0])]

    def cost(cut: tuple[_Spans, _Spans]) -> tuple[int, int]:
        lengths = [[end - start for _, (start, end) in spans] for spans in cut]
        largest, computed = (math.prod(of(side) for side in lengths) for of in (max, sum))
        return max(0, largest - max_pixels), computed

    cuts_y = _cuts(hw[0], before=context_px, after=context_px, grid=grid)
    rows, columns = min(product(cuts_y, _cuts(hw[1], before=borders_x[0], after=borders_x[1], grid=grid)), key=cost)
    for (y, outer_y), (x, outer_x) in product(rows, columns):
        yield _Tile(y, x, outer_y, outer_x)


def _cuts(length: int, *, before: int, after: int, grid: int) -> list[_Spans]:
    """All cuts of one side into spans of equal length, a multiple of the grid, but for the last."""
    least = max(2 * GRID_PX, grid)
    steps = range(least, max(least, length) + grid, grid)
    return [_spans(length, step, before=before, after=after, grid=grid) for step in steps]


def _spans(length: int, step: int, *, before: int, after: int, grid: int) -> _Spans:
    """(inner, outer) spans along one side; outer ends lie on the grid, so that a tile is padded as the image is."""
    spans = []
    for start in range(0, length, step):
        end = min(start + step, length)
        outer = (max(0, (start - before) // grid * grid), min(length, -(-(end + after) // grid) * grid))
        spans.append(((start, end), outer))
    return spans
