"""Words and numbers as telewide writes them: counts, JSON, commands to type."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping


def counted(number: int, noun: str) -> str:
    """Say how many there are: ``1 capture``, ``2 captures``.

    Args:
        number: how many.
        noun: of one of them; its plural is made with an s.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


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


def command_line(*words: object, **options: object) -> str:
    """Write a command of telewide, quoted for a shell.

    Args:
        words: subcommand and arguments.
        options: ``run=folder`` gives ``--run folder``, ``bokeh=True`` gives ``--bokeh``; None and False give nothing.

    Returns:
        One line.
    """
    said = ["telewide", *(str(word) for word in words)]
    for name, value in options.items():
        if value is not None and value is not False:
            flag = f"--{name.replace('_', '-')}"
            said += [flag] if value is True else [flag, str(value)]
    return shlex.join(said)
