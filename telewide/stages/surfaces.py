"""Surfaces of the captures as they are matched before a training, which takes their photos again by them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path

from telewide.assets import BOX_WEIGHTS
from telewide.capture.exif import read_photo_facts
from telewide.capture.pair import RectifiedPair, read_pair
from telewide.capture.pfm import read_pfm, write_pfm
from telewide.cores import Device
from telewide.depth.edges import follow_edges
from telewide.errors import InputError, UsageError
from telewide.files import fingerprint
from telewide.geometry.arrays import FloatMap
from telewide.matching.matcher import Match
from telewide.matching.semiglobal import match_semiglobal
from telewide.matching.window import Window
from telewide.stages.kept_depth import FORMAT
from telewide.stages.match import read_matcher
from telewide.stages.pairs import PreparedSet
from telewide.training.options import TrainOptions
from telewide.training.samples import disparity_path


def surveyor_of(options: TrainOptions) -> str:
    """The matcher that surveys the captures before a training, as in `disparity_path`.

    It is the network that the training starts from, as depth is made of it today, and semi-global matching where the
    training starts from nothing.
    """
    if options.start != "box":
        return ""
    return hashlib.sha256(f"{fingerprint(BOX_WEIGHTS)} {FORMAT}".encode()).hexdigest()[:8]


def surveying_match(surveyor: str, *, device: Device) -> Match:
    """Read the matcher that a surveyor names, as of :func:`surveyor_of`."""
    return read_matcher(BOX_WEIGHTS, method="network" if surveyor else "sgm", device=device).match


def write_surfaces(
    prepared: PreparedSet,
    *,
    names: Iterable[str],
    window: Window,
    surveyor: str = "",
    device: Device = "auto",
    tick: Callable[[], None] | None = None,
) -> None:
    """Write the disparities of some pairs; whole ones that are there are kept.

    Args:
        prepared: the pairs.
        names: of the pairs to write, those that judge among them.
        window: disparities to search, px at the working size.
        surveyor: as of :func:`surveyor_of`.
        device: of a network.
        tick: called after each.
    """
    wanted = set(names)
    match: Match | None = None  # a training that goes on finds its surfaces, and reads no network for them
    for item in prepared.pairs:
        path = disparity_path(item.capture.tele_path.parent, window_px=window, surveyor=surveyor)
        if item.capture.name in wanted and not _is_whole(path, of=item.capture.tele_path):
            match = match or surveying_match(surveyor, device=device)
            write_pfm(path, matched_surface(read_pair(item.capture), window, match=match))
        if tick is not None:
            tick()


def _is_whole(disparity: Path, *, of: Path) -> bool:
    try:
        return read_pfm(disparity).shape == read_photo_facts(of).hw
    except (InputError, UsageError):  # not there, or cut off
        return False


def matched_surface(pair: RectifiedPair, window: Window, *, match: Match = match_semiglobal) -> FloatMap:
    """Match a pair, and move the edges to those of the sharp photo.

    Args:
        pair: two comparable views.
        window: disparities to search, px.
        match: how.

    Returns:
        (H, W) px, known everywhere.
    """
    matched = match(pair.tele, pair.wide, window=window, valid=pair.valid)
    return follow_edges(matched.disparity_px, pair.tele, confidence=matched.confidence, valid=matched.valid)
