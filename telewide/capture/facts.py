"""Facts that the owner of a capture folder states about all its captures: the file ``captures.yaml`` (or ``.yml``).

Example::

    format: 1
    rectified: true
    asymmetry: 3.0     # f_tele_px / f_wide_px of the photos as captured
    reference: tele

Units: metres, degrees, pixels of the reference view.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import ConfigDict, field_validator

from telewide.errors import InputError
from telewide.files import is_there
from telewide.options import Options, parse_options
from telewide.ranges import MAX_ASYMMETRY, MAX_BASELINE_M, MAX_CENTRE_SIDES, MAX_FOCAL_SIDES, MAX_SIDE_PX
from telewide.yaml_files import read_yaml

FACTS_FILE = "captures.yaml"
WideSide = Literal["right", "left"]


class CaptureFacts(Options):
    """Facts that hold for every capture of a folder; None where the owner says nothing."""

    model_config = ConfigDict(strict=True)  # 'rectified: 1' is a slip, not a yes

    format: Literal[1] = 1
    """Version of the file format."""
    rectified: bool | None = None
    """Whether corresponding points lie on the same row."""
    asymmetry: float | None = None
    """Focal length of tele over that of wide, in pixels of the photos as captured, >= 1."""
    reference: Literal["tele"] = "tele"
    """The view the depth is for; always tele so far."""
    wide_side: WideSide | None = None
    """The side of tele on which wide stands in the rectified photos as they are given; None for right, unless a stated
    `doffs_px` contradicts."""
    rotated_deg: Literal[0, 90, 180, 270] = 0
    """Counter-clockwise turn of the photos to make the baseline horizontal."""
    baseline_m: float | None = None
    """Distance of the two lenses, m."""
    f_px: float | None = None
    """Focal length of the rectified reference view, px."""
    doffs_px: float | None = None
    """``cx_src - cx_ref`` of the rectified views, px."""
    notes: str | None = None
    """Free text."""

    @field_validator("asymmetry")
    @classmethod
    def _is_a_ratio(cls, value: float | None) -> float | None:
        if value is not None and not 1 <= value <= MAX_ASYMMETRY:
            raise ValueError(f"f_tele / f_wide, 1 to {MAX_ASYMMETRY:g}")
        return value

    @field_validator("baseline_m")
    @classmethod
    def _is_in_metres(cls, value: float | None) -> float | None:
        if value is not None and not 0 < value <= MAX_BASELINE_M:
            raise ValueError(f"metres, more than 0 and at most {MAX_BASELINE_M:g}")
        return value

    @field_validator("f_px")
    @classmethod
    def _is_a_focal_length(cls, value: float | None) -> float | None:
        if value is not None and not 0 < value <= MAX_FOCAL_SIDES * MAX_SIDE_PX:
            raise ValueError("a positive number of pixels")
        return value

    @field_validator("doffs_px")
    @classmethod
    def _lies_near_a_photo(cls, value: float | None) -> float | None:
        if value is not None and abs(value) > MAX_CENTRE_SIDES * MAX_SIDE_PX:
            raise ValueError("a difference of two pixel columns")
        return value


def read_facts(path: Path) -> CaptureFacts:
    """Read a ``captures.yaml``.

    Args:
        path: the file; one that does not exist or is empty states nothing.

    Returns:
        The facts.

    Raises:
        InputError: not YAML, not a mapping, an unknown key or a value of the wrong type.
    """
    data = read_yaml(path) if is_there(path) else None
    return parse_options(CaptureFacts, {} if data is None else data, source=str(path), error=InputError)
