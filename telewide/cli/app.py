"""The command line: parse, call one function, say what was written. Heavy imports wait until a command runs.

Answers go to standard output, everything else to standard error. Exit codes: see `telewide.errors`.
"""

from __future__ import annotations

import dataclasses
import difflib
import logging
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from typing import Annotated, NoReturn, TextIO

import typer

from telewide.cli.benchmark import benchmark_app
from telewide.cli.board import board
from telewide.cli.calibrate import CALIBRATE_EPILOG, calibrate
from telewide.cli.console import VisibleFormatter, print_json, say
from telewide.cli.depth import DEPTH_EPILOG, depth
from telewide.cli.export_model import EXPORT_EPILOG, export_model
from telewide.cli.import_roll import IMPORT_EPILOG, import_photos
from telewide.cli.run import RUN_EPILOG, run_everything
from telewide.cli.show import SHOW_EPILOG, show
from telewide.cli.simulate import SIMULATE_EPILOG, simulate
from telewide.cli.stopping import INTERRUPTED, UNREAD, terminable
from telewide.cli.train import TRAIN_EPILOG, train
from telewide.cli.view import VIEW_EPILOG, view
from telewide.errors import TelewideError, UsageError
from telewide.text import printable
from telewide.training.processes import this_process

_ISSUES_HINT = "the command and the lines above"
_UNKNOWN_CHOICE = re.compile(r"'(?P<given>[^']*)' is not one of (?P<known>.*)\.$")
_QUOTED = re.compile("'([^']*)'")
_ALSO_CALLED = {"gpu": "cuda"}

app = typer.Typer(
    name="telewide",
    help="Depth and bokeh from the wide and tele lenses of a phone.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Example: `telewide train captures/`, then `telewide depth --bokeh`.",
)

app.command("import", epilog=IMPORT_EPILOG)(import_photos)
app.command(epilog="Example: `telewide board chessboard_9x6 --square-m 0.024 --out board.pdf`")(board)
app.command(epilog=CALIBRATE_EPILOG)(calibrate)
app.command(epilog=SHOW_EPILOG)(show)
app.command(epilog=TRAIN_EPILOG)(train)
app.command(epilog=DEPTH_EPILOG)(depth)
app.command("run", epilog=RUN_EPILOG)(run_everything)
app.command(epilog=VIEW_EPILOG)(view)
app.command("export-model", epilog=EXPORT_EPILOG)(export_model)
app.command(epilog=SIMULATE_EPILOG)(simulate)
app.add_typer(benchmark_app, name="benchmark")


def _print_version(is_asked: bool) -> None:
    if is_asked:
        say(metadata.version("telewide"), is_answer=True)
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code.

    Args:
        arguments: the words after ``telewide``; None takes them from the process.
    """
    notes = logging.StreamHandler(sys.stderr)
    notes.setFormatter(VisibleFormatter())
    notes.addFilter(logging.Filter("telewide"))  # remarks of the decoders on odd files are no help to anybody
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    logging.basicConfig(level=logging.WARNING, handlers=[notes])
    logging.getLogger("telewide").setLevel(logging.INFO)  # notes; quiet commands leave them out
    if this_process().world > 1:  # torchrun ends its processes together, and waits for none
        sys.exit(_exit_code(arguments))
    with terminable() as interrupted:
        sys.exit(_exit_code(arguments, interrupted))


def _exit_code(arguments: Sequence[str] | None, interrupted: Callable[[], int] = lambda: INTERRUPTED) -> int:
    words = list(arguments) if arguments is not None else sys.argv[1:]
    try:
        code = app(words, prog_name="telewide", standalone_mode=False)
        if code == INTERRUPTED:  # how the parser hands Ctrl-C over
            raise KeyboardInterrupt
    except SystemExit as left:
        if not isinstance(left.__context__, BrokenPipeError):  # the parser and rich leave so where nobody reads on
            raise
        return UNREAD
    except (Exception, KeyboardInterrupt) as error:
        failure = _told(error, interrupted)
        if "--json" in words:
            with _perhaps_unread(sys.stdout):
                print_json(dataclasses.asdict(failure))
        return failure.exit_code
    return code if isinstance(code, int) else 0


@contextmanager
def _perhaps_unread(stream: TextIO) -> Iterator[None]:
    """Write what changes no exit code where nobody reads it."""
    try:
        yield
    except BrokenPipeError:
        # What is left in its buffer would be one more error at the end of the program.
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@dataclass(frozen=True)
class _Failure:
    """Reason why a command did not do what it was asked for; what ``--json`` prints instead of an answer."""

    error: str
    hint: str | None
    exit_code: int


def _sentence_of_parser(message: str) -> str:
    """Say what the parser found wrong, with what was probably meant."""
    message = message.removeprefix("Value error, ")
    if choice := _UNKNOWN_CHOICE.search(message):
        known = _QUOTED.findall(choice["known"])
        given = choice["given"].casefold()
        nearest = difflib.get_close_matches(_ALSO_CALLED.get(given, given), known, n=1)
        return f"{message} Did you mean {nearest[0]}?" if nearest else message
    if message.startswith("Got unexpected extra argument"):
        return f"{message}; an option takes one word, without spaces; of a folder, --only NAME takes some captures"
    return message


def _told(error: BaseException, interrupted: Callable[[], int]) -> _Failure:
    """Say on standard error what went wrong."""
    if isinstance(error, OSError) and error.filename is not None:  # of a place that no command looks at more closely
        error = UsageError(f"{error.filename} cannot be used: {error.strerror or error}")
    show = getattr(error, "show", None)  # the parser's own errors know how to show themselves
    with _perhaps_unread(sys.stderr):
        if isinstance(error, TelewideError):
            failure = _Failure(error.message, error.hint, error.exit_code)
            say(f"error: {error.message}" + (f"\n  {error.hint}" if error.hint else ""))
        elif isinstance(error, KeyboardInterrupt | typer.Abort):
            failure = _Failure("stopped; what was finished is kept", "run the same command to continue", interrupted())
            say(f"{failure.error}, {failure.hint}")
        elif callable(show):
            vars(error)["message"] = _sentence_of_parser(printable(str(getattr(error, "message", error))))
            failure = _Failure(str(error), None, int(getattr(error, "exit_code", 2)))
            show()
        else:
            failure = _Failure(f"{type(error).__name__}: {error}", f"please report this: {_ISSUES_HINT}", 1)
            say("".join(traceback.format_exception(error)))
            say(f"this is a fault in telewide, not in your files; please report {_ISSUES_HINT}")
    return failure
