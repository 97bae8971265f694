"""The origin of a result: the state of the source that made it."""

from __future__ import annotations

import functools
import os
import subprocess
from importlib import metadata
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_LONGEST_S = 10


@functools.cache
def source_state(*, root: Path = _PACKAGE.parent) -> str:
    """Name the commit of a source tree, with ``-dirty`` where tracked files differ from it; else the version.

    Args:
        root: of the tree; a folder inside another tree is none.
    """
    return _commit(root) or f"version {metadata.version('telewide')}"


def _commit(root: Path) -> str | None:
    if not (root / ".git").exists():
        return None
    commit, changes = _git(root, "rev-parse", "HEAD"), _git(root, "status", "-s", "-uno")
    return f"{commit}-dirty" if commit and changes else commit


def _git(root: Path, *words: str) -> str | None:
    """Ask git about a tree; None where it cannot say."""
    # A hook of git names its own repository to all it calls.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"
    command = ["git", "-C", str(root), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_LONGEST_S, env=environment)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
