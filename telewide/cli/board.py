"""``telewide board``: a calibration board to print. Registered by `telewide.cli`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from telewide.errors import UsageError

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
) -> None:
    """Write a calibration board as a PDF to print at 100 %, with a ruler to check the print by."""
    from telewide.boards.board import list_boards, load_board, on_paper, resized_board
    from telewide.boards.printing import write_board

    if name is None:
        for known in list_boards():
            typer.echo(f"{known:24}{load_board(known).description}".rstrip())
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
    typer.echo(f"wrote {path}; print it at 100 % on {chosen.paper} and check its ruler", err=True)
    typer.echo(
        f"next: measure a square, photograph the board, telewide calibrate --board {name} --square-m MEASURED", err=True
    )
