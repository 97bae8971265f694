"""``telewide board``: a calibration board to print. Registered by `telewide.cli`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from telewide.cli.arguments import JsonOption, QuietOption
from telewide.cli.console import print_json, say
from telewide.errors import UsageError
from telewide.text import command_line

PAPERS = ("A4", "A3")


def board(
    *,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="A known board or a YAML file; without it, the known ones.")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option("--square-m", metavar="M", help="Side of a square, m. [default: the board's own]")
    ] = None,
    paper: Annotated[
        str | None, typer.Option(metavar="|".join(PAPERS), help="Sheet. [default: the board's own]")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="PDF to write. [default: NAME.pdf]")] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a calibration board as a PDF to print at 100 %, with a ruler to check the print by."""
    from telewide.boards.board import list_boards, load_board, on_paper, resized_board
    from telewide.boards.printing import write_board

    if name is None:
        known = {name: load_board(name).description for name in list_boards()}
        if as_json:
            print_json({"boards": known})
        else:
            say("\n".join(f"{name:24}{description}".rstrip() for name, description in known.items()), is_answer=True)
        return
    chosen = load_board(name)
    if square_m is not None:
        chosen = resized_board(chosen, square_m=square_m)
    if paper is not None:
        chosen = on_paper(chosen, paper=paper)
    path = out or Path(f"{Path(name).stem}.pdf")
    if path.suffix.lower() != ".pdf":
        raise UsageError(f"--out {path}: a board is written as .pdf")
    write_board(path, chosen, name=Path(name).stem)
    if not quiet:
        say(f"wrote {path}; print it at 100 % on {chosen.paper} and check its ruler")
        told = command_line("calibrate", board=name, square_m="MEASURED")
        say(f"next: measure a square, photograph the board, {told}")
    if as_json:
        print_json({"pdf": str(path), "board": name, "square_m": chosen.square_m, "paper": chosen.paper})
