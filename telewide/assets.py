"""Find what ships with telewide: recipes (``pipelines``) and boards or device profiles (``calib``).

A name is the path below its folder without ``.yaml``: ``quick``, ``boards/chessboard_9x6``. Looked up in this order:
an explicit path, the user's folder (``./pipelines``, ``./calib``), the copy inside the installed package, the checkout.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Literal

from telewide.errors import InputError, UsageError
from telewide.files import is_file, is_folder

AssetKind = Literal["pipelines", "calib"]

YAML_SUFFIXES = (".yaml", ".yml")
"""In any letter case."""
_PACKAGE = Path(__file__).resolve().parent
BOX_WEIGHTS = _PACKAGE / "weights" / "box.safetensors"
"""The network that comes with telewide, made by the recipe `box`."""
Start = Literal["box", "scratch"]
"""Beginning of a training: the network that comes with telewide, or random weights."""


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
    if is_yaml(explicit) and is_file(explicit):
        return explicit
    for folder in _folders(kind):
        if is_yaml(folder / name) and is_file(folder / name):
            return folder / name
        if found := find_yaml((folder / name).parent, (folder / name).name):
            return found
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
        if is_yaml(path) and is_file(path)
    }
    return tuple(sorted(names))


def is_yaml(path: Path | str) -> bool:
    """Tell whether a path is named like a YAML file, in any letter case."""
    return Path(path).suffix.lower() in YAML_SUFFIXES


def find_yaml(folder: Path, stem: str) -> Path | None:
    """Find the YAML file of a name, whatever its suffix and letter case: captures.yaml, Captures.YML.

    Args:
        folder: where it may lie; need not exist.
        stem: its name without suffix.

    Returns:
        The file; None where there is none.

    Raises:
        InputError: there are several, which may contradict each other.
    """
    try:
        entries = sorted(folder.iterdir())
    except OSError:  # not there; or a folder that may be entered, not listed
        entries = [folder / f"{stem}.yaml"]
    found = [
        path for path in entries if is_yaml(path) and path.stem.casefold() == stem.casefold() and not is_folder(path)
    ]
    if len(found) > 1:
        names = " and ".join(path.name for path in found)
        raise InputError(f"{folder} holds {names}; one of them was expected", hint="keep the one that is right")
    return found[0] if found else None


def _folders(kind: AssetKind) -> tuple[Path, ...]:
    # An editable install has no shipped copy beside the sources, hence the checkout.
    candidates = (Path.cwd() / kind, _PACKAGE / "_shipped" / kind, _PACKAGE.parent / kind)
    return tuple(folder for folder in dict.fromkeys(candidates) if is_folder(folder))
