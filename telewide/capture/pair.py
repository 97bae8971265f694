"""Captures and the pairs of pictures read from them.

`find_captures` looks into a folder, `read_pair` brings the two views of one capture to one size, `PairReader` keeps
what was read. tele is the sharp view; wide, when it is smaller, is enlarged to tele's size.
Letters: H W image.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from telewide.capture.exif import read_photo_facts
from telewide.capture.facts import CaptureFacts, read_facts
from telewide.capture.images import read_image, resize_bicubic
from telewide.capture.layout import Capture, CaptureSet, Problem, find_captures
from telewide.capture.pfm import read_pfm
from telewide.errors import InputError
from telewide.geometry.arrays import BoolMap, FloatImage
from telewide.geometry.stereo import ValidMasks

__all__ = [
    "Capture",
    "CaptureFacts",
    "CaptureSet",
    "PairReader",
    "PhotoPair",
    "Problem",
    "RectifiedPair",
    "find_captures",
    "pair_from_photos",
    "read_facts",
    "read_pair",
    "read_photos",
    "read_truth",
]

MIN_SIDE_PX = 32
# A stated asymmetry this far from the measured ratio of sizes is worth a word.
_FACTOR_TOLERANCE = 0.1
_CROP = "crop wide to what tele shows"
_KEEP_WHOLE = "photos as a phone took them are not cropped, but need a rig"
_log = logging.getLogger("telewide")


class UnlikeSizesError(InputError):
    """Sizes of two photos that are not those of one view: they are not rectified."""


@dataclass(frozen=True)
class PhotoPair:
    """Two photos as they were taken, each of its own size.

    Attributes:
        name: of the capture.
        tele: (h, w, 3) RGB float32 in [0, 1].
        wide: likewise.
        orientations: EXIF orientations of the two, in which a phone says how it was held; None where unknown.
    """

    name: str
    tele: FloatImage
    wide: FloatImage
    orientations: tuple[int, int] | None = None


@dataclass(frozen=True)
class RectifiedPair:
    """Two views of one size whose corresponding points lie on (nearly) the same row.

    What is nearer has the larger disparity: photos whose wide lens stands to the left of tele's are mirrored.

    Attributes:
        name: of the capture.
        tele: (H, W, 3) RGB float32 in [0, 1].
        wide: (H, W, 3) RGB float32 in [0, 1], enlarged to tele's size.
        valid: where the photos reach, ref is tele; None where they fill the views.
    """

    name: str
    tele: FloatImage
    wide: FloatImage
    valid: ValidMasks | None = None

    @property
    def mirrored(self) -> RectifiedPair:
        """The pair with its left and right exchanged, and so the sign of its disparities."""
        tele, wide = (np.ascontiguousarray(view[:, ::-1]) for view in (self.tele, self.wide))
        valid = self.valid and ValidMasks(self.valid.ref[:, ::-1], self.valid.src[:, ::-1])
        return RectifiedPair(self.name, tele, wide, valid=valid)


def read_photos(capture: Capture, *, read: Callable[[Path], FloatImage] = read_image) -> PhotoPair:
    """Read the two photos of a capture as they were taken.

    Args:
        capture: what to read.
        read: decodes a photo, or has it already.

    Returns:
        The photos.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, is too small, or both are the same picture.
    """
    tele, wide = read(capture.tele_path), read(capture.wide_path)
    _refuse_tiny(capture.tele_path, tele)
    _refuse_tiny(capture.wide_path, wide)
    if np.array_equal(tele, wide):
        raise InputError(
            f"{capture.tele_path} and {capture.wide_path} are the same picture; two different photos were expected"
        )
    held = tuple(read_photo_facts(path).orientation for path in (capture.tele_path, capture.wide_path))
    return PhotoPair(capture.name, tele, wide, orientations=(held[0], held[1]))


def read_pair(capture: Capture, *, facts: CaptureFacts | None = None) -> RectifiedPair:
    """Read the two views of a capture and bring wide to tele's size.

    Args:
        capture: what to read.
        facts: what its owner states: of a wide lens on the left the pair is mirrored, and a stated asymmetry that
            contradicts the sizes is warned of.

    Returns:
        The pair.

    Raises:
        UsageError: a file does not exist.
        InputError: a file cannot be read, is too small, both views are the same picture, or no common factor explains
            the two sizes.
    """
    photos = read_photos(capture)
    pair = pair_from_photos(photos, labels=(str(capture.tele_path), str(capture.wide_path)), facts=facts)
    return pair if capture.valid_paths is None else replace(pair, valid=_read_masks(capture.valid_paths, pair))


def pair_from_photos(
    photos: PhotoPair, *, labels: tuple[str, str] = ("tele", "wide"), facts: CaptureFacts | None = None
) -> RectifiedPair:
    """Bring wide to tele's size; the photos are taken for rectified.

    Args:
        photos: tele, and wide of its size or shrunk by one factor.
        labels: what messages call the two photos.
        facts: what their owner states: of a wide lens on the left the pair is mirrored, and a stated asymmetry that
            contradicts the sizes is warned of.

    Returns:
        The pair.

    Raises:
        InputError: no common factor explains the two sizes.
    """
    tele, wide = photos.tele, photos.wide
    if tele.shape != wide.shape:
        _check_factor(labels, tele, wide, facts)
        wide = resize_bicubic(wide, wh=(tele.shape[1], tele.shape[0]))
    pair = RectifiedPair(photos.name, tele, wide)
    return pair.mirrored if facts is not None and facts.wide_side == "left" else pair


def read_truth(capture: Capture, *, hw: tuple[int, int] | None = None) -> FloatImage | None:
    """Read the true disparity of a capture.

    Args:
        capture: what to read.
        hw: height and width the map must have, those of the pair; None asks for none.

    Returns:
        (H, W) float32, px, NaN where unknown; None where the capture has no truth.

    Raises:
        InputError: the file cannot be read or has another size.
    """
    if capture.truth_path is None:
        return None
    disparity_px = read_pfm(capture.truth_path)
    if hw is not None and disparity_px.shape != hw:
        found, expected = _size(disparity_px.shape), _size(hw)
        raise InputError(f"{capture.truth_path} is {found}; the size of the pair, {expected}, was expected")
    return disparity_px


class PairReader:
    """Reads pairs and keeps the last ones, within a budget of memory.

    Args:
        max_bytes: of all kept pictures together; a single larger pair is read each time.
    """

    def __init__(self, *, max_bytes: int = 1 << 30) -> None:
        self._max_bytes = max_bytes
        self._kept: OrderedDict[Capture, RectifiedPair] = OrderedDict()

    def __reduce__(self) -> tuple[object, ...]:
        """Another process reads for itself: what is kept here does not travel."""
        return partial(PairReader, max_bytes=self._max_bytes), ()

    @property
    def kept_bytes(self) -> int:
        """Memory of all kept pictures."""
        return sum(_bytes_of(pair) for pair in self._kept.values())

    def read(self, capture: Capture) -> RectifiedPair:
        """Return the pair of a capture; read it if it is not kept.

        Args:
            capture: what to read.

        Returns:
            The pair; its arrays are shared with later calls and must not be changed.

        Raises:
            InputError: see `read_pair`.
        """
        pair = self._kept.pop(capture, None)
        if pair is None:
            pair = read_pair(capture)
        self._kept[capture] = pair
        while self._kept and self.kept_bytes > self._max_bytes:
            self._kept.popitem(last=False)
        return pair


def _bytes_of(pair: RectifiedPair) -> int:
    masks = 0 if pair.valid is None else pair.valid.ref.nbytes + pair.valid.src.nbytes
    return pair.tele.nbytes + pair.wide.nbytes + masks


def _read_masks(paths: tuple[Path, Path], pair: RectifiedPair) -> ValidMasks:
    return ValidMasks(*(_read_mask(path, hw=pair.tele.shape[:2]) for path in paths))


def _read_mask(path: Path, *, hw: tuple[int, ...]) -> BoolMap:
    mask = read_image(path)[..., 0] > 0.5
    if mask.shape != hw:
        raise InputError(f"{path} is {_size(mask.shape)}; the size of the pair, {_size(hw)}, was expected")
    return mask


def _refuse_tiny(path: Path, image: FloatImage) -> None:
    if min(image.shape[:2]) < MIN_SIDE_PX:
        raise InputError(f"{path} is {_size(image.shape)} px; both sides of a photo must have {MIN_SIDE_PX} or more")


def _check_factor(labels: tuple[str, str], tele: FloatImage, wide: FloatImage, facts: CaptureFacts | None) -> None:
    """Refuse sizes that are not one picture size and the same shrunk by a factor, in whole pixels."""
    tele_hw, wide_hw = tele.shape[:2], wide.shape[:2]
    lowest, highest = _factor_range(tele_hw, wide_hw)
    sizes = f"{labels[0]} is {_size(tele_hw)} px and {labels[1]} is {_size(wide_hw)} px"
    if lowest >= highest:
        turned_lowest, turned_highest = _factor_range(tele_hw, wide_hw[::-1])
        hint = _CROP if facts is not None and facts.rectified else f"{_KEEP_WHOLE}; if these are rectified, {_CROP}"
        if turned_lowest < turned_highest:
            hint = "turn one of them by 90 degrees"
        raise UnlikeSizesError(f"{sizes}; no common factor explains the two sizes", hint=hint)
    if highest <= 1:
        raise InputError(f"{sizes}; tele must not be the smaller one", hint="are the two views swapped?")
    factor = float(np.sqrt(tele.size / wide.size))
    if facts is not None and facts.asymmetry and abs(factor / facts.asymmetry - 1) > _FACTOR_TOLERANCE:
        _log.warning("%s: a factor of %.2f, but the stated asymmetry is %.2f", sizes, factor, facts.asymmetry)


def _factor_range(tele_hw: tuple[int, ...], wide_hw: tuple[int, ...]) -> tuple[float, float]:
    """Return the open range of the factors k with ``|wide k - tele| < k`` on both sides; empty where none fits."""
    lowest = max(tele / (wide + 1) for tele, wide in zip(tele_hw, wide_hw, strict=True))
    highest = min(tele / (wide - 1) for tele, wide in zip(tele_hw, wide_hw, strict=True))
    return lowest, highest


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
