"""The command line: parse, call one function, say what was written. Heavy imports wait until a command runs.

Answers go to standard output, everything else to standard error. Exit codes: see `telewide.errors`.
"""

from __future__ import annotations

import dataclasses
import logging
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn, TextIO

import typer

from telewide.cli.benchmark import benchmark_app
from telewide.cli.board import board
from telewide.cli.calibrate import CALIBRATE_EPILOG, SHOW_EPILOG, calibrate, show
from telewide.cli.console import (
    DeviceOption,
    JsonOption,
    QuietOption,
    RigOption,
    check_device,
    console_observer,
    print_json,
)
from telewide.cli.import_roll import IMPORT_EPILOG, import_photos
from telewide.cli.simulate import SIMULATE_EPILOG, simulate
from telewide.cli.stopping import INTERRUPTED, UNREAD, terminable
from telewide.errors import TelewideError, UsageError
from telewide.text import command_line, counted
from telewide.training.processes import this_process

if TYPE_CHECKING:
    from telewide.bokeh.picture import BokehOptions
    from telewide.cli.progress import ConsoleObserver
    from telewide.pipeline import DepthOptions, DepthRun

_ISSUES_HINT = "the command and the lines above"

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
app.add_typer(benchmark_app, name="benchmark")

CapturesArgument = Annotated[Path, typer.Argument(help="Folder of the captures.")]
RecipeOption = Annotated[str, typer.Option(help="Recipe: quick, default, paper, or a YAML file.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the recipe; may be repeated.")
]
DistanceOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,M|exif",
        help="A point of the tele photo and its distance, metres; exif: its middle, at the focus EXIF states.",
    ),
]
SeedOption = Annotated[int | None, typer.Option(help="Seed of weights and samples.")]
METHOD_HELP = "joint: network and semi-global matching; network: alone, faster; sgm: alone, needs no training."
FocusOption = Annotated[str, typer.Option(metavar="X,Y|near|far|auto", help="What is sharp in the bokeh.")]
FNumberOption = Annotated[
    float | None, typer.Option(help="Aperture of the 50 mm lens to imitate; needs the lenses' distance.")
]
StrengthOption = Annotated[
    float | None, typer.Option(metavar="PX", help="Radius of the strongest blur, px. [default: 1.2 % of the width]")
]


def _print_version(is_asked: bool) -> None:
    if is_asked:
        typer.echo(metadata.version("telewide"))
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: `telewide train captures/ --recipe quick --set train.rehearsal.steps=300`")
def train(
    captures: CapturesArgument = Path("captures"),
    *,
    recipe: RecipeOption = "default",
    out: Annotated[Path | None, typer.Option("--out", help="Run folder. [default: run/]")] = None,
    settings: SetOption = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start over where a training lies in the run folder.")] = False,
    rig: RigOption = None,
    device: DeviceOption = "auto",
    seed: SeedOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Train a stereo network on your own captures, without labels; run again to continue."""
    from telewide.pipeline import train_captures
    from telewide.recipe import load_recipe

    check_device(device)
    resolved = load_recipe(recipe, settings=settings or (), seed=seed)
    with console_observer(is_quiet=quiet) as observer:
        outcome = train_captures(
            captures, run=out, recipe=resolved, fresh=fresh, device=device, observer=observer, rig=rig
        )
        named = () if captures == Path("captures") else (captures,)
        observer.said(f"weights: {outcome.weights}")
        observer.said(f"next: {command_line('depth', *named, run=out, rig=rig, bokeh=True)}")
    if as_json:
        print_json(
            {
                "weights": str(outcome.weights),
                "is_new": outcome.is_new,
                "best_stage": outcome.best_stage,
                "clipped_px": dict(outcome.stages),
            }
        )


@app.command(
    epilog="Example: `telewide depth --bokeh --focus near`; without a trained run: `telewide depth --method sgm`"
)
def depth(
    captures: CapturesArgument = Path("captures"),
    *,
    # torchrun takes what begins like its own --run-path for itself: hence a second name.
    run: Annotated[
        Path | None, typer.Option("--run", "--run-folder", help="Run folder of a training. [default: run/]")
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="Weights file instead of a run's newest.")] = None,
    method: Annotated[str, typer.Option(metavar="joint|network|sgm", help=METHOD_HELP)] = "joint",
    bokeh: Annotated[bool, typer.Option("--bokeh", help="Make bokeh.jpg as well.")] = False,
    focus: FocusOption = "auto",
    f_number: FNumberOption = None,
    strength: StrengthOption = None,
    rig: RigOption = None,
    distance: DistanceOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. [default: RUN/depth]")] = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute disparity, depth where the scale is known, and bokeh."""
    if not bokeh and (focus != "auto" or f_number is not None or strength is not None):
        raise UsageError("--focus, --f-number and --strength shape the bokeh picture", hint="add --bokeh")
    if method == "sgm" and weights is not None:
        raise UsageError(
            "--method sgm matches without a network, and --weights names one", hint="leave one of them out"
        )
    if method == "sgm" and device == "cuda":
        raise UsageError("--method sgm runs on the processor, not on a GPU", hint="leave --device out")
    options = _depth_options(
        method=method,
        weights=weights,
        bokeh=_bokeh_options(focus=focus, f_number=f_number, strength=strength) if bokeh else None,
        out=out,
        device=device,
        rig=rig,
        distance=distance,
    )
    from telewide.pipeline import depth_captures, recipe_of_depth

    with console_observer(is_quiet=quiet, shows_table=False) as observer:
        recipe = recipe_of_depth(run, captures, weights=weights)
        done = depth_captures(captures, run=run, recipe=recipe, options=options, observer=observer)
        _say_depth(done, observer)
    if as_json:
        print_json(_json_of_depth(done))


@app.command("run", epilog="Example: `telewide run examples/captures --recipe quick`")
def run_everything(
    captures: CapturesArgument = Path("captures"),
    *,
    recipe: RecipeOption = "default",
    out: Annotated[Path | None, typer.Option("--out", help="Run folder. [default: run/]")] = None,
    settings: SetOption = None,
    focus: FocusOption = "auto",
    f_number: FNumberOption = None,
    strength: StrengthOption = None,
    rig: RigOption = None,
    distance: DistanceOption = None,
    device: DeviceOption = "auto",
    seed: SeedOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Do everything that is still to do: train, depth, bokeh, and a report page."""
    from telewide.pipeline import run_captures
    from telewide.recipe import load_recipe

    options = _depth_options(
        method="joint",
        weights=None,
        bokeh=_bokeh_options(focus=focus, f_number=f_number, strength=strength),
        out=None,
        device=device,
        rig=rig,
        distance=distance,
    )
    resolved = load_recipe(recipe, settings=settings or (), seed=seed)
    with console_observer(is_quiet=quiet) as observer:
        done = run_captures(captures, run=out, recipe=resolved, options=options, observer=observer)
        _say_depth(done, observer)
        observer.said(f"report: {done.report}")
    if as_json:
        print_json({**_json_of_depth(done), "report": str(done.report)})


app.command(epilog=SIMULATE_EPILOG)(simulate)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code.

    Args:
        arguments: the words after ``telewide``; None takes them from the process.
    """
    logging.basicConfig(level=logging.WARNING, format="note: %(message)s", stream=sys.stderr)
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
    """Why a command did not do what it was asked for; what ``--json`` prints instead of an answer."""

    error: str
    hint: str | None
    exit_code: int


def _told(error: BaseException, interrupted: Callable[[], int]) -> _Failure:
    """Say on standard error what went wrong."""
    show = getattr(error, "show", None)  # the parser's own errors know how to show themselves
    with _perhaps_unread(sys.stderr):
        if isinstance(error, TelewideError):
            failure = _Failure(error.message, error.hint, error.exit_code)
            typer.echo(f"error: {error.message}" + (f"\n  {error.hint}" if error.hint else ""), err=True)
        elif isinstance(error, KeyboardInterrupt | typer.Abort):
            failure = _Failure("stopped; what was finished is kept", "run the same command to continue", interrupted())
            typer.echo(f"{failure.error}, {failure.hint}", err=True)
        elif callable(show):
            failure = _Failure(str(error), None, int(getattr(error, "exit_code", 2)))
            show()
        else:
            failure = _Failure(f"{type(error).__name__}: {error}", f"please report this: {_ISSUES_HINT}", 1)
            traceback.print_exception(error)
            typer.echo(f"this is a fault in telewide, not in your files; please report {_ISSUES_HINT}", err=True)
    return failure


def _depth_options(
    *,
    method: str,
    weights: Path | None,
    bokeh: BokehOptions | None,
    out: Path | None,
    device: str,
    rig: Path | None,
    distance: str | None,
) -> DepthOptions:
    from telewide.depth.pin import parse_known_distance
    from telewide.pipeline import DepthOptions
    from telewide.stages.match import METHODS

    check_device(device)
    if method not in METHODS:
        raise UsageError(f"--method {method}: expected {', '.join(METHODS)}")
    if weights is not None and not weights.is_file():
        raise UsageError(f"{weights} does not exist; a weights file was expected")
    trusts_focus = distance == "exif"
    return DepthOptions(
        method=method,
        weights=weights,
        bokeh=bokeh,
        out=out,
        device=device,
        rig=rig,
        known=None if distance is None or trusts_focus else parse_known_distance(distance),
        trusts_focus=trusts_focus,
    )


def _bokeh_options(*, focus: str, f_number: float | None, strength: float | None) -> BokehOptions:
    from telewide.bokeh.picture import BokehOptions

    if f_number is not None and strength is not None:
        raise UsageError("--f-number and --strength both say how strong the blur is; give one of them")
    for name, value in (("--f-number", f_number), ("--strength", strength)):
        if value is not None and not value > 0:
            raise UsageError(f"{name} {value}: a number above 0 was expected")
    return BokehOptions(focus=focus, strength_px=strength, f_number=f_number)


def _say_depth(done: DepthRun, observer: ConsoleObserver) -> None:
    observer.said(f"depth of {counted(len(done.outcomes), 'capture')} in {done.folder}")
    if done.outcomes:
        names = sorted(set.intersection(*({path.name for path in outcome.paths} for outcome in done.outcomes)))
        observer.said(f"each with: {', '.join(names)}")


def _json_of_depth(done: DepthRun) -> dict[str, object]:
    return {
        "folder": str(done.folder),
        "captures": [
            {
                "name": outcome.name,
                "files": [str(path) for path in outcome.paths],
                "notes": list(outcome.notes),
                "numbers": dict(outcome.numbers),
            }
            for outcome in done.outcomes
        ],
        "problems": [{"name": problem.name, "message": problem.message} for problem in done.problems],
    }
