"""``telewide train``: weights from captures without labels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.assets import Start
from telewide.cli.arguments import (
    CapturesArgument,
    DeviceOption,
    JsonOption,
    QuietOption,
    RecipeOption,
    RigOption,
    RunFolderOption,
    SeedOption,
    SetOption,
)
from telewide.cli.console import console_observer, print_json, typed

if TYPE_CHECKING:
    from telewide.stages.train import TrainOutcome

TRAIN_EPILOG = (
    "Example: `telewide train captures/ --recipe quick --minutes 20` trains for twenty minutes at most; the same call "
    "goes on."
)


def train(
    context: typer.Context,
    captures: CapturesArgument = Path("captures"),
    *,
    recipe: RecipeOption = "default",
    out: RunFolderOption = None,
    settings: SetOption = None,
    start: Annotated[
        Start | None,
        typer.Option(
            "--from", help="Begin with the network that comes with telewide, or from scratch. [default: recipe]"
        ),
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start over where a training lies in the run folder.")] = False,
    minutes: Annotated[
        float | None, typer.Option(metavar="N", help="Stop after so many minutes; run again to go on. [default: never]")
    ] = None,
    rig: RigOption = None,
    device: DeviceOption = "auto",
    seed: SeedOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Adapt the network to your own captures, without labels, where that is judged better; run again to continue."""
    from telewide.api import train as train_network

    with console_observer(is_quiet=quiet, invocation=typed(context)) as observer:
        outcome = train_network(
            captures,
            run=out,
            recipe=recipe,
            settings=[*(settings or ()), *([f"train.start={start}"] if start else [])],
            seed=seed,
            rig=rig,
            device=device,
            fresh=fresh,
            minutes=minutes,
            observer=observer,
        )
        observer.said(f"weights: {outcome.weights}")
        if outcome.is_finished:
            observer.said(f"next: {typed(context).instead('depth', bokeh=True)}")
        else:
            observer.said(f"stopped after {minutes:g} min; to continue: {typed(context).again(fresh=None)}")
    if as_json:
        print_json({**_answer(outcome), "warnings": list(observer.warnings)})


def _answer(outcome: TrainOutcome) -> dict[str, object]:
    return {
        "weights": str(outcome.weights),
        "is_new": outcome.is_new,
        "is_finished": outcome.is_finished,
        "best_stage": outcome.best_stage,
        "best_step": outcome.best_step,
        "clipped_px": dict(outcome.stages),
    }
