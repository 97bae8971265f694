"""Protocols: which scenes of which data sets are taken, and what of their pictures counts.

Without a protocol a set's own pair is read whole and all its known truth counts; those of ``protocols.yaml`` are named
explicitly, a user's own file of the same form too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from telewide.benchmark.datasets.catalogue import DATA_SETS, DataSet, Views, find_data_set, locate, missing_note
from telewide.benchmark.datasets.truth import StereoTruth
from telewide.errors import InputError, UsageError, unknown_name
from telewide.files import once_a_file
from telewide.matching.window import Window
from telewide.options import Options, parse_options
from telewide.yaml_files import read_yaml

PROTOCOLS_FILE = Path(__file__).with_name("protocols.yaml")
_WINDOW_STEP_PX = 16

Count = Annotated[int, Field(ge=1)]


class Protocol(Options):
    """Part of the data that one experiment takes."""

    description: str = ""
    """One line for people."""
    data_sets: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the catalogue; their scenes are taken together."""
    splits: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    """Names of scenes by split, with ``*`` and ``?`` for any letters; without splits every scene is taken."""
    views: Views | None = None
    """Numbers of the left and the right view; None for the set's own pair."""
    window_px: Window | None = None
    """Disparities [d_min, d_max) to search; None measures them on the truth."""
    crop_wh: tuple[Count, Count] | None = None
    """Width and height cut from the middle; a smaller picture is kept as it is."""
    last_rows: Count | None = None
    """Rows kept, counted from the bottom."""
    left_out_columns: Annotated[int, Field(ge=0)] = 0
    """First columns of what is left whose truth does not count."""


class _ProtocolFile(Options):
    format: Literal[1]
    protocols: dict[str, Protocol]


@dataclass(frozen=True)
class Scene:
    """One pair that can be read.

    Attributes:
        data_set: it belongs to.
        root: folder of the set.
        name: of the scene.
        protocol: how it is read.
    """

    data_set: DataSet
    root: Path
    name: str
    protocol: Protocol

    def read(self) -> StereoTruth:
        """Read the pair and leave of it what the protocol takes.

        Raises:
            UsageError: a file does not exist.
            InputError: a file cannot be read, or nothing of the truth is left.
        """
        views = self.protocol.views or self.data_set.views or (0, 1)
        return taken_by(self.protocol, self.data_set.read(self.root, self.name, views))


@dataclass(frozen=True)
class Selection:
    """The scenes of a protocol that are there.

    Attributes:
        scenes: in the order of the protocol.
        notes: what is not there, and where to get it.
    """

    scenes: tuple[Scene, ...]
    notes: tuple[str, ...]


def load_protocols(*, path: Path = PROTOCOLS_FILE) -> dict[str, Protocol]:
    """Read the protocols of a file by their names.

    Args:
        path: YAML of the form of ``protocols.yaml``.

    Raises:
        UsageError: there is no such file.
        InputError: no YAML, an unknown key, or a wrong value.
    """
    return {**_read_protocols(path)}


@once_a_file
def _read_protocols(path: Path) -> dict[str, Protocol]:
    return parse_options(_ProtocolFile, read_yaml(path) or {}, source=str(path), error=InputError).protocols


def find_protocol(name: str) -> Protocol:
    """Find a protocol of ``protocols.yaml``, or make that of a data set taken whole.

    Args:
        name: of a protocol or of a data set.

    Raises:
        UsageError: neither is called so; the nearest name is told.
    """
    protocols = load_protocols()
    if name in protocols:
        return protocols[name]
    if name in DATA_SETS:
        return Protocol(data_sets=(name,))
    known = f"{', '.join(protocols)}, and every data set by its name"
    raise unknown_name("protocol", name, [*protocols, *DATA_SETS], listed=known)


def select_scenes(protocol: Protocol, data_root: Path, *, split: str | None = None) -> Selection:
    """Find the scenes of a protocol below the data folder.

    Args:
        protocol: which scenes.
        data_root: holds the data sets.
        split: one of the protocol's; None for all scenes.

    Returns:
        The scenes that are there. A set or a named scene that is not is told in the notes.

    Raises:
        UsageError: there is no data folder, no such split or no such data set.
        InputError: what is in a set cannot be read.
    """
    names = _names_of(protocol, split)
    scenes: list[Scene] = []
    notes = []
    for data_set in map(find_data_set, protocol.data_sets):
        root = locate(data_set, data_root)
        if root is None:
            notes.append(missing_note(data_set, data_root))
            continue
        scenes += [Scene(data_set, root, name, protocol) for name in data_set.scenes(root)]
    if names is None:
        return Selection(tuple(scenes), tuple(notes))
    chosen = {(scene.root, scene.name): scene for name in names for scene in scenes if fnmatchcase(scene.name, name)}
    absent = [name for name in names if not any(fnmatchcase(scene.name, name) for scene in scenes)]
    if scenes and absent:
        notes.append(f"left out, because {data_root} does not have them: {', '.join(absent)}")
    return Selection(tuple(chosen.values()), tuple(notes))


def taken_by(protocol: Protocol, truth: StereoTruth) -> StereoTruth:
    """Cut a pair as a protocol says; the truth of left-out columns becomes unknown.

    Args:
        protocol: what is taken.
        truth: the whole pair.
    """
    height, width = truth.disparity_px.shape
    wanted_w, wanted_h = protocol.crop_wh or (width, height)
    top, left = max(0, (height - wanted_h) // 2), max(0, (width - wanted_w) // 2)
    rows, columns = slice(top, top + wanted_h), slice(left, left + wanted_w)
    if protocol.last_rows is not None:
        rows = slice(max(rows.start, min(rows.stop, height) - protocol.last_rows), rows.stop)
    disparity_px = truth.disparity_px[rows, columns].copy()
    disparity_px[:, : protocol.left_out_columns] = np.nan
    occluded = None if truth.occluded is None else truth.occluded[rows, columns]
    return StereoTruth(truth.left[rows, columns], truth.right[rows, columns], disparity_px, occluded)


def search_window(protocol: Protocol, truth: StereoTruth) -> Window:
    """Return the disparities to search, px: those stated, or else the truth's range in steps of 16 px.

    Args:
        protocol: may state them.
        truth: of the scene.

    Raises:
        InputError: none is stated and nothing of the truth is known.
    """
    if protocol.window_px is not None:
        return protocol.window_px
    known_px = truth.disparity_px[np.isfinite(truth.disparity_px)]
    if known_px.size == 0:
        raise InputError("no disparity of the scene is known, so what is to be searched cannot be told")
    lowest, highest = float(known_px.min()), float(known_px.max())
    start = min(0, math.floor(lowest / _WINDOW_STEP_PX) * _WINDOW_STEP_PX)
    return start, (math.floor(highest / _WINDOW_STEP_PX) + 1) * _WINDOW_STEP_PX


def _names_of(protocol: Protocol, split: str | None) -> Sequence[str] | None:
    if split is None:
        return None
    if split not in protocol.splits:
        known = ", ".join(protocol.splits) or "none"
        raise UsageError(f"unknown split {split!r}; the splits of the protocol: {known}")
    return protocol.splits[split]
