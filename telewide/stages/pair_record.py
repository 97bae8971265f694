"""The record of a corrected pair in the run folder, ``pair.json``: what it was made from, and what was measured."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, JsonValue

from telewide.capture.facts import WideSide
from telewide.correction.blur import BlurEstimate
from telewide.correction.verdict import PairReport
from telewide.records import Figure, Record

RECORD_NAME = "pair.json"
MIN_SCALE, MAX_SCALE = 1 / 1024, 16.0
"""The largest photo at the smallest working width is 1 / 512 of its size; no pair is much larger than its photo."""


class ColourFigures(Record):
    """Parts of the colour correction, and the differences at the matches before and after it, CIEDE2000."""

    parts: tuple[str, ...]
    delta_e_before: Figure
    delta_e_after: Figure


class PairRecord(Record):
    """Content of the file.

    Attributes:
        key: everything the pair depends on.
        scale: px of the pair for one px of the photo.
        wide_side: where wide stands, seen from tele.
        report: what was measured, and a verdict.
        colour: what was corrected.
        blur: kernel between the two views; None where it cannot be told.
        files_sha256: of the files beside it, by their names.
    """

    key: dict[str, JsonValue]
    scale: Annotated[float, Field(ge=MIN_SCALE, le=MAX_SCALE)]
    wide_side: WideSide
    report: PairReport
    colour: ColourFigures
    blur: BlurEstimate | None
    files_sha256: dict[str, str]
