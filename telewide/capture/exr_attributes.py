"""Facts of a photo by the names that OpenEXR gives them: its standard attributes (ImfStandardAttributes.h)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import datetime, timedelta

from telewide.capture.carried import CarriedFacts

_DESCRIPTION, _ARTIST, _COPYRIGHT = 270, 315, 33432
_TEXTS = {"cameraMake": 271, "cameraModel": 272}
_TEXTS_OF_EXIF = {"cameraSerialNumber": 42033, "lensMake": 42035, "lensModel": 42036, "lensSerialNumber": 42037}
_NUMBERS_OF_EXIF = {"expTime": 33434, "aperture": 33437, "focus": 37382, "nominalFocalLength": 37386}  # s, 1, m, mm
_ISO, _DATE, _OFFSET = 34855, 36867, 36881
_BEYOND = {"isoSpeed": 65535.0, "focus": 1e4}
"""Values that stand for more than can be told: of a tag of 16 bits, and infinity."""
_DATE_FORM = "%Y:%m:%d %H:%M:%S"


def exr_attributes(facts: CarriedFacts, *, done: str) -> dict[str, str | float]:
    """Tell what a photo states of itself, as far as OpenEXR has a name for it.

    Args:
        facts: of the photo; its GPS is told as well.
        done: what was done to it, which the comments say too.

    Returns:
        Values by the names of attributes, those that are known.
    """
    texts = {name: _text(facts.lasting.get(tag)) for name, tag in _TEXTS.items()}
    texts |= {name: _text(facts.exif.get(tag)) for name, tag in _TEXTS_OF_EXIF.items()}
    texts["owner"] = _text(facts.lasting.get(_COPYRIGHT)) or _text(facts.lasting.get(_ARTIST))
    texts["comments"] = "; ".join(filter(None, (_text(facts.lasting.get(_DESCRIPTION)), done)))
    numbers = {name: _positive(facts.exif.get(tag)) for name, tag in _NUMBERS_OF_EXIF.items()}
    numbers["isoSpeed"] = _positive(facts.exif.get(_ISO))
    for name, beyond in _BEYOND.items():
        if (numbers[name] or 0.0) >= beyond:
            numbers[name] = None
    told = {**texts, **numbers, **_moment(facts.exif), **_place(facts.gps)}
    return {name: value for name, value in told.items() if value is not None and value != ""}


def _moment(exif: Mapping[int, object]) -> dict[str, str | float]:
    """Local time, and what has to be added to it for UTC, s."""
    date = _text(exif.get(_DATE))
    try:
        if datetime.strptime(date, _DATE_FORM).strftime(_DATE_FORM) != date:
            return {}
    except ValueError:
        return {}
    offset = re.fullmatch(r"([+-])(\d\d):(\d\d)", _text(exif.get(_OFFSET)))
    if offset is None:
        return {"capDate": date}
    ahead = timedelta(hours=int(offset[2]), minutes=int(offset[3])).total_seconds()
    return {"capDate": date, "utcOffset": -ahead if offset[1] == "+" else ahead}


def _place(gps: Mapping[int, object]) -> dict[str, float]:
    """Degrees north and east, metres above the sea."""
    north, east = _degrees(gps, 2, signs="NS", most=90), _degrees(gps, 4, signs="EW", most=180)
    if north is None or east is None:
        return {}
    height_m = _number(gps.get(6))
    if height_m is None:
        return {"latitude": north, "longitude": east}
    return {"latitude": north, "longitude": east, "altitude": -height_m if gps.get(5) in {1, b"\1"} else height_m}


def _degrees(gps: Mapping[int, object], tag: int, *, signs: str, most: float) -> float | None:
    """An angle of degrees, minutes and seconds, whose side the tag before it names."""
    parts, side = gps.get(tag), _text(gps.get(tag - 1)).upper()
    if not isinstance(parts, tuple | list) or len(parts) != 3 or side not in set(signs):
        return None
    numbers = [_number(part) for part in parts]
    known = [number for number in numbers if number is not None and number >= 0]
    if len(known) < 3:
        return None
    angle = known[0] + known[1] / 60 + known[2] / 3600
    return None if angle > most else -angle if side == signs[1] else angle


def _positive(value: object) -> float | None:
    number = _number(value[0] if isinstance(value, tuple | list) and value else value)
    return number if number is not None and number > 0 else None


def _number(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]  # Pillow's fractions and numbers; what is none of them raises
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _text(value: object) -> str:
    """A text that a header can hold; empty for anything else."""
    text = value.strip(" \0\r\n\t") if isinstance(value, str) else ""
    return text if text.isprintable() else ""
