"""Training samples: a crop of two views, and what is known of it.

Every sample is a function of (seed, index) alone: a training that is cut off continues with the very samples it would
have seen, and N processes draw the samples one process would.
Letters: H W crop.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from telewide.capture.pair import Capture, PairReader, RectifiedPair
from telewide.capture.pfm import read_pfm
from telewide.geometry.arrays import BoolMap, FloatImage, FloatMap
from telewide.geometry.stereo import ValidMasks
from telewide.matching.window import Window, scaled_window

_ZOOM = (0.75, 1.2)
"""Enlargement of a crop of a capture. Above 1 disparities spread, and the margin of the window has to hold them."""
_CROP_MULTIPLE_PX, _LEAST_CROP_PX = 16, 64
_LEAST_TEXTURE_PX = 32
_WHOLLY = 0.999  # of a resized mask


Value = TypeVar("Value", bound=np.generic)

DISPARITY_NAME = re.compile(r"disparity_-?\d+_-?\d+(_[0-9a-f]{8})?\.pfm")


@dataclass(frozen=True)
class Sample:
    """One crop of two views.

    Attributes:
        ref: (H, W, 3) float32 sRGB, the sharp view.
        src: (H, W, 3) float32 sRGB, the other view.
        truth_px: (H, W) float32 disparity, px, NaN where nothing is known.
        occluded: (H, W) bool, hidden from src; None where nobody knows.
        undamaged: both views before any damage, where they are known.
        valid: where both views were photographed, to the pixels beside; None where they are whole.
    """

    ref: FloatImage
    src: FloatImage
    truth_px: FloatMap
    occluded: BoolMap | None = None
    undamaged: tuple[FloatImage, FloatImage] | None = None
    valid: ValidMasks | None = None


@dataclass(frozen=True)
class CropArea:
    """The part of a capture that training may see, as fractions of its width.

    Attributes:
        first: left end.
        end: right end; what lies beyond is held out.
    """

    first: float = 0.0
    end: float = 1.0


@dataclass(frozen=True)
class SampleSource:
    """Where samples come from; travels to worker processes.

    Attributes:
        captures: corrected captures to draw from.
        disparities_folder: holds each capture's disparities, px, named by :func:`disparity_path`: matched ones to take
            its photo again by, or the truth of a data set to be taught; None for none.
        crop_hw: size of the crops.
        window_px: disparities of the captures.
        enlargement: how many times larger crops show the captures than they are, as the network will match them.
        asymmetry: range of the factor by which rehearsed views are damaged.
        area: the part of each capture that may be seen.
        surveyor: of the disparities, as of :func:`disparity_path`.
        undamaged: by the name of a capture, the same with a source view that was not damaged; for data sets that are
            damaged on purpose.
        reader: keeps the pictures last read.
    """

    captures: tuple[Capture, ...]
    crop_hw: tuple[int, int]
    window_px: Window
    enlargement: float = 1.0
    asymmetry: tuple[float, float] = (1.0, 6.0)
    area: CropArea = field(default_factory=CropArea)
    disparities_folder: Path | None = None
    surveyor: str = ""
    undamaged: Mapping[str, Capture] | None = None
    reader: PairReader = field(default_factory=lambda: PairReader(max_bytes=768 << 20), compare=False)

    @property
    def volume_px(self) -> Window:
        """Disparities of the crops, which the volume holds."""
        return scaled_window(self.window_px, self.enlargement)


def disparity_path(folder: Path, *, window_px: Window, surveyor: str = "") -> Path:
    """Where the disparities of a pair lie: a search of another window, or by another matcher, finds others.

    Args:
        folder: of the pair.
        window_px: searched.
        surveyor: eight digits that stand for the weights that matched; none for semi-global matching, or a truth.
    """
    return folder / f"disparity_{window_px[0]}_{window_px[1]}{surveyor and f'_{surveyor}'}.pfm"


def generator_for(seed: int, *salt: int) -> np.random.Generator:
    """Return a generator that depends on its arguments only."""
    return np.random.default_rng(np.random.SeedSequence([seed, *salt]))


@dataclass(frozen=True)
class SeenPhotos(Sequence[FloatImage]):
    """The sharp views that training may see, each read when it is asked for.

    Attributes:
        source: the captures.
    """

    source: SampleSource

    def __len__(self) -> int:
        return len(self.source.captures)

    def __getitem__(self, index: int) -> FloatImage:  # type: ignore[override]
        """(H, W, 3) float32 sRGB of capture ``index``, without what is held out and without continued borders."""
        pair = self.source.reader.read(self.source.captures[index])
        return pair.tele[seen_part(pair, self.source)]


def crop_capture(source: SampleSource, *, rng: np.random.Generator, may_swap: bool) -> Sample:
    """Cut a crop out of a real capture, zoomed and tinted alike in both views.

    Args:
        source: the captures and the sizes.
        rng: source of all draws.
        may_swap: exchange the views half of the time, mirrored, so that disparities keep their sign.

    Returns:
        A sample; its truth holds the disparities of the source where there are any.
    """
    capture = _choose(source.captures, rng)
    pair = source.reader.read(capture)
    known_px = None if source.disparities_folder is None else read_disparity(source, capture)
    box, shift_px = _random_box(pair.tele.shape[:2], source, rng)
    src_box = replace(box, x=box.x - shift_px)
    views = [_cut(pair.tele, box, source.crop_hw), _cut(pair.wide, src_box, source.crop_hw)]
    if source.undamaged is not None:
        views.append(_cut(source.reader.read(source.undamaged[capture.name]).wide, src_box, source.crop_hw))
    truth_px = _cut_disparity(known_px, box, source.crop_hw, shift_px=shift_px)
    valid = pair.valid and ValidMasks(
        _cut_mask(pair.valid.ref, box, source.crop_hw), _cut_mask(pair.valid.src, src_box, source.crop_hw)
    )
    ref, src, *rest = _jitter(views, rng)
    undamaged = (ref, rest[0]) if rest else None
    if may_swap and rng.random() < 0.5:
        ref, src = _exchanged((ref, src))
        undamaged = None if undamaged is None else _exchanged(undamaged)
        valid = valid and ValidMasks(_mirrored(valid.src), _mirrored(valid.ref))
        truth_px = np.full_like(truth_px, np.nan)
    return Sample(ref, src, truth_px, undamaged=undamaged, valid=valid)


def _exchanged(views: tuple[FloatImage, FloatImage]) -> tuple[FloatImage, FloatImage]:
    """One for the other, mirrored, so that disparities keep their sign."""
    ref, src = views
    return _mirrored(src), _mirrored(ref)


def _mirrored(values: NDArray[Value]) -> NDArray[Value]:
    return np.ascontiguousarray(values[:, ::-1])


def fitting_crop(
    crop_hw: tuple[int, int], sizes_hw: Iterable[tuple[int, int]], *, enlargement: float = 1.0
) -> tuple[int, int]:
    """The largest crop, up to the one asked for, that no picture has to be enlarged to fill.

    Args:
        crop_hw: asked for, multiples of 16 px.
        sizes_hw: of the parts of the pictures that training sees.
        enlargement: of the pictures, as of :class:`SampleSource`.

    Returns:
        Height and width, multiples of 16 px, at least 64.
    """
    heights, widths = zip(*sizes_hw, strict=True)
    height, width = (
        min(asked, max(_LEAST_CROP_PX, int(enlargement * least) // _CROP_MULTIPLE_PX * _CROP_MULTIPLE_PX))
        for asked, least in zip(crop_hw, (min(heights), min(widths)), strict=True)
    )
    return height, width


def _choose(captures: Sequence[Capture], rng: np.random.Generator) -> Capture:
    return captures[int(rng.integers(len(captures)))]


def seen_part(pair: RectifiedPair, source: SampleSource) -> tuple[slice, slice]:
    """Rows and columns of the tele view that training may see, without continued borders.

    Args:
        pair: a capture's.
        source: which part of each capture is held out.
    """
    first_x, end_x = _seen_columns(pair.tele.shape[1], source)
    rows, columns = slice(None), slice(None)
    if pair.valid is not None:
        rows, columns = inner_rectangle(pair.valid.ref[:, first_x:end_x])
    first, end, _ = columns.indices(end_x - first_x)
    return rows, slice(first_x + first, first_x + end)


def inner_rectangle(valid: BoolMap) -> tuple[slice, slice]:
    """A large rectangle of valid pixels: the sides where least is valid are given up first.

    Args:
        valid: (H, W) bool, of one piece, such as a turned photo's.

    Returns:
        Rows and columns; of all pixels where hardly any is valid.
    """
    top, bottom, left, right = 0, valid.shape[0], 0, valid.shape[1]
    while bottom - top > _LEAST_TEXTURE_PX and right - left > _LEAST_TEXTURE_PX:
        part = valid[top:bottom, left:right]
        if part.all():
            return slice(top, bottom), slice(left, right)
        shares = [side.mean() for side in (part[0], part[-1], part[:, 0], part[:, -1])]
        worst = int(np.argmin(shares))
        top, bottom, left, right = top + (worst == 0), bottom - (worst == 1), left + (worst == 2), right - (worst == 3)
    return slice(None), slice(None)


def _seen_columns(width: int, source: SampleSource) -> tuple[int, int]:
    return round(source.area.first * width), round(source.area.end * width)


def read_disparity(source: SampleSource, capture: Capture) -> FloatMap:
    """Read the disparities of a capture.

    Args:
        source: which knows where they lie.
        capture: one of its captures.

    Returns:
        (H, W) px; NaN where unknown.

    Raises:
        ValueError: the source has none.
    """
    if source.disparities_folder is None:
        raise ValueError("the source of the samples has no disparities")
    folder = source.disparities_folder / capture.name
    return _read_map(disparity_path(folder, window_px=source.window_px, surveyor=source.surveyor))


@lru_cache(maxsize=16)
def _read_map(path: Path) -> FloatMap:
    return read_pfm(path)


@dataclass(frozen=True)
class _Box:
    x: int
    y: int
    width: int
    height: int


def _random_box(hw: tuple[int, ...], source: SampleSource, rng: np.random.Generator) -> tuple[_Box, int]:
    """A box of the crop's shape in ref, and by how much it lies further left in src, px of the capture.

    The shift leaves the middle of the window where it is, whatever the zoom: disparities spread about it, and none that
    the window holds by its margin leaves it. Pictures smaller than the crop are enlarged to fill it.
    """
    zoom = float(rng.uniform(*_ZOOM)) * source.enlargement
    first_x, end_x = _seen_columns(hw[1], source)
    crop_h, crop_w = source.crop_hw
    zoom = max(zoom, crop_h / hw[0], crop_w / (end_x - first_x))
    box_h, box_w = max(8, int(crop_h / zoom)), max(8, int(crop_w / zoom))
    middle_px = sum(source.window_px) / 2
    shift_px = round(middle_px * (1 - source.enlargement * box_w / crop_w))
    if abs(shift_px) > end_x - first_x - box_w:  # no room in src: as it is, or as near to that as the picture allows
        box_h = min(int(crop_h / source.enlargement), hw[0])
        box_w, shift_px = min(int(crop_w / source.enlargement), end_x - first_x), 0
    low_x, high_x = first_x + max(0, shift_px), end_x - box_w + min(0, shift_px)
    x = low_x + int(rng.integers(0, high_x - low_x + 1))
    y = int(rng.integers(0, max(1, hw[0] - box_h + 1)))
    return _Box(x, y, box_w, min(box_h, hw[0] - y)), shift_px


def _cut(view: FloatImage, box: _Box, crop_hw: tuple[int, int]) -> FloatImage:
    part = view[box.y : box.y + box.height, box.x : box.x + box.width]
    interpolation = cv2.INTER_AREA if box.width > crop_hw[1] else cv2.INTER_CUBIC
    resized = cv2.resize(part, (crop_hw[1], crop_hw[0]), interpolation=interpolation)
    return np.clip(resized, 0, 1).astype(np.float32, copy=False)


def _cut_mask(valid: BoolMap, box: _Box, crop_hw: tuple[int, int]) -> BoolMap:
    """Cut as the views are cut; what is mixed with what no photo shows does not count."""
    whole = cv2.erode(valid.astype(np.float32), np.ones((3, 3)), borderType=cv2.BORDER_REPLICATE)
    part = whole[box.y : box.y + box.height, box.x : box.x + box.width]
    interpolation = cv2.INTER_AREA if box.width > crop_hw[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(part, (crop_hw[1], crop_hw[0]), interpolation=interpolation) > _WHOLLY)


def _cut_disparity(known_px: FloatMap | None, box: _Box, crop_hw: tuple[int, int], *, shift_px: int) -> FloatMap:
    if known_px is None:
        return np.full(crop_hw, np.nan, dtype=np.float32)
    part = known_px[box.y : box.y + box.height, box.x : box.x + box.width]
    resized = cv2.resize(part, (crop_hw[1], crop_hw[0]), interpolation=cv2.INTER_NEAREST_EXACT)
    return ((resized - shift_px) * np.float32(crop_hw[1] / box.width)).astype(np.float32)


def _jitter(views: Sequence[FloatImage], rng: np.random.Generator) -> Sequence[FloatImage]:
    """Gamma, brightness and colour drawn once and applied to all views, in the paper's ranges."""
    if rng.random() < 0.5:
        return views
    gamma = float(rng.uniform(0.8, 1.2))
    gain = (rng.uniform(0.8, 1.2) * rng.uniform(0.95, 1.05, size=3)).astype(np.float32)
    return [np.clip(np.power(view, np.float32(gamma)) * gain, 0, 1) for view in views]
