"""``telewide view``: the page of a run in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from telewide.cli.console import say
from telewide.errors import UsageError
from telewide.files import is_file

VIEW_EPILOG = "Example: `telewide view run`"
PAGE_NAME = "report.html"


def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, or a page.")] = Path("run"),
) -> None:
    """Open the page on which the captures of a run can be looked at: click to focus, compare, read distances."""
    page = run if run.suffix == ".html" else run / PAGE_NAME
    if not is_file(page):
        raise UsageError(f"{page} does not exist", hint="`telewide depth` and `telewide run` write one")
    address = page.absolute().as_uri()
    say(str(page), is_answer=True)
    if not webbrowser.open(address):
        say(f"no browser could be started here; open {address} in one")
