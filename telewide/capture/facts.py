"""Facts that the owner of a capture folder states about all its captures: the file ``captures.yaml`` (or ``.yml``).

Example::

    format: 1
    rectified: true
    asymmetry: 3.0     # f_tele_px / f_wide_px of the photos as captured
    reference: tele

Units: metres, degrees, pixels of the reference view.
"""

from __future__ import annotations

import difflib
import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from telewide.errors import InputError
from telewide.files import read_yaml
from telewide.ranges import MAX_ASYMMETRY, MAX_BASELINE_M, MAX_CENTRE_SIDES, MAX_FOCAL_SIDES, MAX_SIDE_PX

if TYPE_CHECKING:
    from pydantic import ValidationError

FACTS_FILE = "captures.yaml"


@dataclass(frozen=True)
class CaptureFacts:
    """Facts that hold for every capture of a folder; None where the owner says nothing.

    Attributes:
        format: version of the file format.
        rectified: whether corresponding points lie on the same row.
        asymmetry: focal length of tele over that of wide, in pixels of the photos as captured, >= 1.
        reference: the view the depth is for; always tele so far.
        rotated_deg: how far the photos were turned counter-clockwise to make the baseline horizontal.
        baseline_m: distance of the two lenses, m.
        f_px: focal length of the rectified reference view, px.
        doffs_px: ``cx_src - cx_ref`` of the rectified views, px.
        notes: free text.
    """

    format: Literal[1] = 1
    rectified: bool | None = None
    asymmetry: float | None = None
    reference: Literal["tele"] = "tele"
    rotated_deg: Literal[0, 90, 180, 270] = 0
    baseline_m: float | None = None
    f_px: float | None = None
    doffs_px: float | None = None
    notes: str | None = None

    def __post_init__(self) -> None:
        """Refuse numbers no camera has."""
        for name in ("asymmetry", "baseline_m", "f_px", "doffs_px"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name} is {value}; a finite number was expected")
        if self.asymmetry is not None and not 1 <= self.asymmetry <= MAX_ASYMMETRY:
            raise ValueError(f"asymmetry is {self.asymmetry}; it is f_tele / f_wide, 1 to {MAX_ASYMMETRY:g}")
        if self.f_px is not None and not 0 < self.f_px <= MAX_FOCAL_SIDES * MAX_SIDE_PX:
            raise ValueError(f"f_px is {self.f_px}; a positive number of pixels was expected")
        if self.doffs_px is not None and abs(self.doffs_px) > MAX_CENTRE_SIDES * MAX_SIDE_PX:
            raise ValueError(f"doffs_px is {self.doffs_px}; a difference of two pixel columns was expected")
        if self.baseline_m is not None and not 0 < self.baseline_m <= MAX_BASELINE_M:
            raise ValueError(
                f"baseline_m is {self.baseline_m}; metres were expected, more than 0 and at most {MAX_BASELINE_M}"
            )


def read_facts(path: Path) -> CaptureFacts:
    """Read a ``captures.yaml``.

    Args:
        path: the file; one that does not exist or is empty states nothing.

    Returns:
        The facts.

    Raises:
        InputError: not YAML, not a mapping, an unknown key or a value of the wrong type.
    """
    if not path.exists():
        return CaptureFacts()
    data = read_yaml(path)
    if data is None:
        return CaptureFacts()
    if not isinstance(data, dict):
        raise InputError(f"{path} holds a {type(data).__name__}; lines of the form 'key: value' were expected")
    _refuse_unknown_keys(path, data)
    return _validated(path, data)


def _refuse_unknown_keys(path: Path, data: dict[object, object]) -> None:
    known = [field.name for field in fields(CaptureFacts)]
    for key in data:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.4)
            meant = f"did you mean '{near[0]}'? " if near else ""
            raise InputError(f"{path} has an unknown key '{key}'", hint=f"{meant}known keys: {', '.join(known)}")


def _validated(path: Path, data: dict[object, object]) -> CaptureFacts:
    import pydantic  # slow to import: only where a file is read

    try:
        # JSON mode: types are taken strictly, yet a mapping may become a dataclass.
        text = json.dumps(data, default=str)
        return pydantic.TypeAdapter(CaptureFacts).validate_json(text, strict=True)
    except pydantic.ValidationError as error:
        raise InputError(f"{path}: {_first_complaint(error)}") from error


def _first_complaint(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    if not first["loc"]:  # a ValueError of CaptureFacts itself, which names its key
        return first["msg"].removeprefix("Value error, ")
    expected = first["msg"].removeprefix("Input should be ")
    return f"{first['loc'][0]} is {first['input']!r}; expected {expected}"
