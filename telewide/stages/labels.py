"""Labels to begin a training with: the confident semi-global disparities of the pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from telewide.capture.exif import read_photo_facts
from telewide.capture.pair import RectifiedPair, read_pair
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.errors import InputError, UsageError
from telewide.geometry.arrays import FloatMap
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.stages.pairs import PreparedSet
from telewide.training.samples import labels_path

LABEL_CONFIDENCE = 0.5


def write_labels(
    prepared: PreparedSet, *, names: Iterable[str], window: Window, tick: Callable[[], None] | None = None
) -> None:
    """Write the confident semi-global disparities of some pairs, to teach by; whole ones that are there are kept.

    Args:
        prepared: the pairs.
        names: of the pairs that training will see.
        window: disparities to search, px at the working size.
        tick: called after each.
    """
    wanted = set(names)
    for item in prepared.pairs:
        path = labels_path(item.capture.tele_path.parent, window_px=window)
        if item.capture.name in wanted and not _is_each_whole(path, of=item.capture.tele_path):
            pair = read_pair(item.capture)
            write_pfm(path, confident_disparity(pair, window))
        if tick is not None:
            tick()


def _is_each_whole(labels: Path, *, of: Path) -> bool:
    try:
        return read_pfm(labels).shape == read_photo_facts(of).hw
    except (InputError, UsageError):  # not there, or cut off
        return False


def confident_disparity(pair: RectifiedPair, window: Window) -> FloatMap:
    """Match a pair semi-globally and keep what is confident.

    Args:
        pair: two comparable views.
        window: disparities to search, px.

    Returns:
        (H, W) px, NaN where it is not.
    """
    matched = match_semiglobal(pair.tele, pair.wide, window=window, valid=pair.valid)
    is_sure = matched.valid & (matched.confidence >= LABEL_CONFIDENCE)
    return np.where(is_sure, matched.disparity_px, np.nan).astype(np.float32)
