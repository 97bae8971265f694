"""Console output of the commands: the progress of a pipeline, bars, and answers in JSON."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from telewide.errors import QualityError
from telewide.text import MOST_LINES, Invocation, is_worth_a_line, json_text, printable, with_options
from telewide.training.processes import this_process

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from telewide.cli.progress import ConsoleObserver


@dataclass
class Bar:
    """A bar that shows how far some work is, lines that say it, or nothing; see :func:`bar`."""

    _shown: tuple[Progress, TaskID] | None = None
    _label: str = ""
    _total: int = 0
    _done: int = 0

    def advance(self) -> None:
        """One more is done."""
        self._done += 1
        if self._shown is not None:
            self._shown[0].advance(self._shown[1])
        elif self._label and is_worth_a_line(self._done, self._total):
            say(f"{self._label} {self._done}/{self._total}")

    def reach(self, done: int, total: int) -> None:
        """So many of so many are done; of a few, which take an instant, no line is said."""
        if self._shown is not None:
            self._shown[0].update(self._shown[1], completed=done, total=total)
        elif self._label and total > MOST_LINES and is_worth_a_line(done, total):
            say(f"{self._label} {done}/{total}")


def typed(context: typer.Context) -> Invocation:
    """Tell what was typed: the arguments, default ones too, and the options that were given.

    Args:
        context: of the running command.
    """
    words: list[object] = []
    options: dict[str, object] = {}
    for parameter in context.command.params:
        name = str(parameter.name)
        value = context.params.get(name)
        source = context.get_parameter_source(name)
        if parameter.param_type_name == "argument":
            words.append(value)
        elif source is not None and source.name == "COMMANDLINE" and name not in ("as_json", "quiet"):
            options[parameter.opts[0].lstrip("-").replace("-", "_")] = value
    return Invocation(str(context.info_name), tuple(words), options)


@contextmanager
def console_observer(
    *, is_quiet: bool = False, shows_table: bool = True, invocation: Invocation | None = None
) -> Iterator[ConsoleObserver]:
    """Report on standard error what a pipeline does; one of several processes reports.

    Args:
        is_quiet: say nothing but problems.
        shows_table: print the table of the captures.
        invocation: the command that was typed, as `typed` tells.

    Yields:
        The observer.
    """
    from telewide.cli.progress import ConsoleObserver
    from telewide.cli.terminal import TerminalConsole

    if is_quiet:
        logging.getLogger("telewide").setLevel(logging.WARNING)
    console = TerminalConsole(stderr=True, quiet=not this_process().is_writer)
    observer = ConsoleObserver(console, is_quiet=is_quiet, shows_table=shows_table, invocation=invocation)
    try:
        yield observer
    finally:
        observer.close()


@contextmanager
def bar(label: str, *, total: int | None = None, is_quiet: bool = False) -> Iterator[Bar]:
    """Show a bar on a terminal; elsewhere print a line now and then.

    Args:
        label: what is done.
        total: how many there are; None where the work says so itself.
        is_quiet: show nothing there either.

    Yields:
        The bar.
    """
    from rich.progress import Progress

    from telewide.cli.terminal import TerminalConsole

    console = TerminalConsole(stderr=True)
    if is_quiet or not console.is_terminal:  # a bar of rich that is switched off leaves an empty line all the same
        yield Bar(_label="" if is_quiet else label, _total=total or 0)
        return
    with Progress(console=console, transient=True) as progress:
        yield Bar((progress, progress.add_task(label, total=total)), _total=total or 0)


def hand_over(answer: dict[str, object], *, failure: QualityError | None, as_json: bool) -> None:
    """Answer in JSON where asked, and leave with the code of a result that is not good enough.

    Args:
        answer: plain data.
        failure: what is wrong with the result, which was written; None where nothing is.
        as_json: whether the answer is printed.

    Raises:
        QualityError: the failure, where no JSON was asked for.
        typer.Exit: likewise, where the JSON says it.
    """
    if failure is None:
        if as_json:
            print_json(answer)
        return
    if not as_json:
        raise failure
    say(f"error: {failure.message}\n  {failure.hint}")
    print_json({**answer, "error": failure.message, "hint": failure.hint, "exit_code": failure.exit_code})
    raise typer.Exit(failure.exit_code)


def say(text: str, *, is_answer: bool = False) -> None:
    """Print a text for a person; what a terminal would obey is shown instead.

    Args:
        text: may hold names and notes of other people.
        is_answer: to standard output; else to standard error.
    """
    typer.echo(printable(with_options(text)), err=not is_answer)


class VisibleFormatter(logging.Formatter):
    """Formats lines of the log, notes and warnings; what a terminal would obey is shown instead."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        kind = "warning" if record.levelno >= logging.WARNING else "note"
        return printable(with_options(f"{kind}: {super().format(record)}"))


def print_json(content: dict[str, object]) -> None:
    """Print the one object of a command, however many processes worked on it.

    Args:
        content: plain data; see :func:`telewide.text.json_text`.
    """
    if this_process().is_writer:
        typer.echo(with_options(json_text(content)))
