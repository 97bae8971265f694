"""What was made of one capture, remembered beside its files, so that the same is not computed twice: ``depth.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from telewide.errors import TelewideError
from telewide.files import read_json, write_text

FORMAT = 4
KEPT_NAME = "depth.json"


@dataclass(frozen=True)
class KeptDepth:
    """What was made of one capture.

    Attributes:
        files: names of the files in its folder.
        notes: what was left out, and why.
        numbers: what was measured; NaN where it could not be.
        withheld: what is not among the files because it would mean nothing, and why; None where all is there.
    """

    files: tuple[str, ...]
    notes: tuple[str, ...]
    numbers: Mapping[str, float]
    withheld: str | None = None


def read_kept(folder: Path, key: Mapping[str, object]) -> KeptDepth | None:
    """Read what lies in a folder, if it was made from the same and is still whole.

    Args:
        folder: of one capture.
        key: everything the files depend on, as plain data.

    Returns:
        What was made, or None where it has to be made (again).
    """
    path = folder / KEPT_NAME
    try:
        content = cast(dict[str, Any], read_json(path))
        if content["format"] != FORMAT or content["key"] != json.loads(json.dumps(key)):
            return None
        numbers = {name: math.nan if value is None else float(value) for name, value in content["numbers"].items()}
        sizes = {str(name): int(n_bytes) for name, n_bytes in content["files_bytes"].items()}
        are_whole = all(_is_file_of(folder, name, n_bytes) for name, n_bytes in sizes.items())
        withheld = None if content["withheld"] is None else str(content["withheld"])
        kept = KeptDepth(tuple(sizes), tuple(map(str, content["notes"])), numbers, withheld)
        return kept if are_whole else None
    except (TelewideError, ValueError, KeyError, TypeError, AttributeError):  # damaged: it is made again
        return None


def _is_file_of(folder: Path, name: str, n_bytes: int) -> bool:
    path = folder / name
    return Path(name).name == name and path.is_file() and path.stat().st_size == n_bytes


def write_kept(folder: Path, kept: KeptDepth, *, key: Mapping[str, object]) -> None:
    """Remember what was made; called when all its files are written.

    Args:
        folder: of one capture.
        kept: what was made.
        key: everything the files depend on, as plain data.
    """
    numbers = {name: value if math.isfinite(value) else None for name, value in kept.numbers.items()}
    sizes = {name: (folder / name).stat().st_size for name in kept.files}
    content = {
        "format": FORMAT,
        "key": key,
        "files_bytes": sizes,
        "notes": kept.notes,
        "numbers": numbers,
        "withheld": kept.withheld,
    }
    write_text(folder / KEPT_NAME, json.dumps(content, indent=2) + "\n")
