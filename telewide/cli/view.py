"""``telewide view``: the page of a run in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from telewide.cli.console import say
from telewide.errors import UsageError
from telewide.files import is_file
from telewide.text import command_line, first_few

VIEW_EPILOG = "Example: `telewide view run`"
PAGE_NAME = "report.html"
RUN_NAME = "run"


def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, where it lies, or a page.")] = Path(
        RUN_NAME
    ),
) -> None:
    """Open the page on which the captures of a run can be looked at: click to focus, compare, read distances."""
    page = run if run.suffix == ".html" else run / PAGE_NAME
    if not is_file(page) and is_file(run / RUN_NAME / PAGE_NAME):
        page = run / RUN_NAME / PAGE_NAME
    if not is_file(page):
        raise UsageError(f"{page} does not exist", hint=_where_pages_are(run))
    address = page.absolute().as_uri()
    say(str(page), is_answer=True)
    if not webbrowser.open(address):
        say(f"no browser could be started here; open {address} in one")


def _where_pages_are(folder: Path) -> str:
    """Name the folders in a folder that hold a page; where none does, the commands that write one."""
    inner = sorted(page.parent for page in folder.glob(f"*/{PAGE_NAME}")) if folder.is_dir() else []
    if not inner:
        return "`telewide depth` and `telewide run` write one"
    calls = [f"`{command_line('view', one)}`" for one in inner]
    return (
        f"a folder in it holds one: {calls[0]}" if len(calls) == 1 else f"folders in it hold some: {first_few(calls)}"
    )
