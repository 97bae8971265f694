"""Find what ships with telewide: recipes (``pipelines``) and boards or device profiles (``calib``).

A name is the path below its folder without ``.yaml``: ``quick``, ``boards/chessboard_9x6``. Looked up in this order:
an explicit path, the user's folder (``./pipelines``, ``./calib``), the copy inside the installed package, the checkout.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Literal

from telewide.errors import UsageError

AssetKind = Literal["pipelines", "calib"]

_SUFFIXES = (".yaml", ".yml")
_PACKAGE = Path(__file__).resolve().parent


def find_asset(kind: AssetKind, name: str) -> Path:
    """Find a recipe or a calibration file by its name or path.

    Args:
        kind: which folder to look in.
        name: a name as :func:`list_assets` gives it, or the path of a YAML file.

    Returns:
        Path of an existing file.

    Raises:
        UsageError: there is no such file; the message lists the known names and the nearest one.
    """
    explicit = Path(name).expanduser()
    if explicit.suffix in _SUFFIXES and explicit.is_file():
        return explicit
    for folder in _folders(kind):
        for candidate in (folder / name, *(folder / f"{name}{suffix}" for suffix in _SUFFIXES)):
            if candidate.suffix in _SUFFIXES and candidate.is_file():
                return candidate
    known = list_assets(kind)
    nearest = difflib.get_close_matches(name, known, n=1)
    raise UsageError(
        f"{name}: no such file, and no such name in {kind}; known: {', '.join(known) or 'none'}",
        hint=f"did you mean {nearest[0]}?" if nearest else "give one of the known names or the path of a YAML file",
    )


def list_assets(kind: AssetKind) -> tuple[str, ...]:
    """Names that :func:`find_asset` knows, sorted.

    Args:
        kind: which folder to look in.

    Returns:
        Names with forward slashes and without ``.yaml``.
    """
    names = {
        path.relative_to(folder).with_suffix("").as_posix()
        for folder in _folders(kind)
        for path in folder.rglob("*")
        if path.suffix in _SUFFIXES and path.is_file()
    }
    return tuple(sorted(names))


def _folders(kind: AssetKind) -> tuple[Path, ...]:
    # An editable install has no shipped copy beside the sources, hence the checkout.
    candidates = (Path.cwd() / kind, _PACKAGE / "_shipped" / kind, _PACKAGE.parent / kind)
    return tuple(folder for folder in dict.fromkeys(candidates) if folder.is_dir())
