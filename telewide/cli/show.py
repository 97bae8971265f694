"""``telewide show``: a rig in words."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from telewide.cli.arguments import DEFAULT_RIG, JsonOption
from telewide.cli.console import print_json, say

SHOW_EPILOG = "Example: `telewide show rig.yaml`"


def show(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="A rig.yaml.")] = DEFAULT_RIG,
    *,
    as_json: JsonOption = False,
) -> None:
    """Print a rig for people: lenses, their distance, how sure each number is, and what the rig is worth."""
    from telewide.calibration.rig_file import read_rig
    from telewide.pages.rig_text import rig_lines
    from telewide.yaml_files import read_yaml

    stored = read_rig(rig)
    if as_json:
        print_json(cast(dict[str, object], read_yaml(rig)))
    else:
        say("\n".join(rig_lines(stored)), is_answer=True)
