"""Results of a calibration, from photos of a board and from scenes alike: the rig's file, a page beside it, notes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from telewide.calibration.rig_file import RIG_FILE, StoredRig
from telewide.capture.pair import PhotoPair
from telewide.correction.rectify import rectify_pair
from telewide.errors import TelewideError
from telewide.geometry.arrays import FloatMap
from telewide.geometry.rig import StereoRig
from telewide.pages.report import NextStep
from telewide.text import command_line

BOARDS_FOLDER = Path("boards")
CAPTURES_FOLDER = Path("captures")
_PREVIEW_WIDTH_PX = 1000

RectifiedPreview = tuple[str, FloatMap, FloatMap]
"""Name of a shot, and its two views (H, W, 3)."""


@dataclass(frozen=True)
class CalibrationRun:
    """A rig and where it was written.

    Attributes:
        stored: the rig, how sure it is, what it is worth and how it was made.
        rig: path of ``rig.yaml``.
        report: path of the page about it.
        notes: what a person should know, one sentence each.
    """

    stored: StoredRig
    rig: Path
    report: Path
    notes: tuple[str, ...]


def report_path(rig: Path) -> Path:
    """Where the page about a rig lies: beside its file."""
    return rig.with_name(f"{rig.stem}_report.html")


def report_facts(rig: Path, told: Mapping[str, str]) -> dict[str, str]:
    """The table of facts of a page: what is told of the photos, then the rig's file and the version."""
    return {**told, "rig": rig.name, "telewide": metadata.version("telewide")}


def stated_rig(rig: Path) -> Path | None:
    """The rig as an option has to name it: None where it is found without."""
    return None if rig == RIG_FILE else rig


def calls_with_rig(captures: Path, rig: Path) -> tuple[str, str]:
    """Name the commands that a new rig is for: depth and bokeh, which need no training, and training."""
    stated = stated_rig(rig)
    return command_line("depth", captures, rig=stated, bokeh=True), command_line("train", captures, rig=stated)


def steps_with_rig(captures: Path, rig: Path) -> tuple[NextStep, NextStep]:
    """Say what to do with a new rig, for its page; as :func:`calls_with_rig`."""
    depth, train = calls_with_rig(captures, rig)
    return (
        NextStep("Depth and bokeh of captures taken with the same lenses:", depth),
        NextStep("Adapt the network to them:", train),
    )


def rectified_preview(photos: PhotoPair, *, rig: StereoRig) -> RectifiedPreview | None:
    """Rectify one shot for the page; None where the rig cannot, whose page is then needed all the more.

    Args:
        photos: as taken.
        rig: the rig, with this shot's own correction where there is one.
    """
    try:
        made = rectify_pair(photos.tele, photos.wide, rig=rig, name=photos.name, working_width_px=_PREVIEW_WIDTH_PX)
    except TelewideError:
        return None
    return photos.name, made.pair.tele, made.pair.wide
