"""JSON as telewide writes it: numbers that do not exist become null, for JSON has no word for them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping


def json_text(value: object, *, indent: int | None = None) -> str:
    """Write plain data as JSON.

    Args:
        value: mappings, sequences, texts and numbers; NaN and infinity become null, anything else its text.
        indent: columns a level is indented by; None for one line.
    """
    return json.dumps(_with_finite_numbers(value), indent=indent, ensure_ascii=False, allow_nan=False, default=str)


def _with_finite_numbers(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _with_finite_numbers(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_with_finite_numbers(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
