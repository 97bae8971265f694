"""``telewide run``: everything that is still to do, and a page about it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from telewide.cli.arguments import (
    CapturesArgument,
    DeviceOption,
    DistanceOption,
    FormatOption,
    JsonOption,
    MethodOption,
    QuietOption,
    RecipeOption,
    RigOption,
    RunFolderOption,
    SeedOption,
    SetOption,
)
from telewide.cli.bokeh import (
    BladesOption,
    BokehWords,
    EquivFocalOption,
    FNumberOption,
    FocusOption,
    HighlightsOption,
    PictureOption,
    PreviewOption,
    StrengthOption,
    StripOption,
)
from telewide.cli.console import console_observer, hand_over, typed
from telewide.cli.depth import depth_as_json, depth_options, say_depth, why_not_good
from telewide.errors import UsageError

if TYPE_CHECKING:
    from telewide.recipe import Recipe

RUN_EPILOG = "Example: `telewide run captures/ --recipe quick`"


def run_everything(
    context: typer.Context,
    captures: CapturesArgument = Path("captures"),
    *,
    recipe: RecipeOption = "default",
    method: MethodOption = "network",
    out: RunFolderOption = None,
    settings: SetOption = None,
    focus: FocusOption = "auto",
    f_number: FNumberOption = None,
    f35_mm: EquivFocalOption = None,
    strength: StrengthOption = None,
    blades: BladesOption = None,
    highlights: HighlightsOption = None,
    picture: PictureOption = None,
    strip: StripOption = False,
    preview: PreviewOption = False,
    rig: RigOption = None,
    distance: DistanceOption = None,
    formats: FormatOption = None,
    device: DeviceOption = "auto",
    seed: SeedOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Do everything that is still to do: train, depth, bokeh, and a report page."""
    from telewide.pipeline import run_captures

    words = BokehWords.of_call(context)
    options = depth_options(
        method=method,
        weights=None,
        bokeh=words.options(),
        out=None,
        device=device,
        rig=rig,
        distance=distance,
        formats=formats or (),
        is_stripped=strip,
    )
    resolved = _recipe_of_captures(recipe, settings=settings or (), seed=seed)
    with console_observer(is_quiet=quiet, invocation=typed(context)) as observer:
        done = run_captures(captures, run=out, recipe=resolved, options=options, observer=observer)
        say_depth(done, observer, has_previews=preview, formats=formats or ())
    hand_over(depth_as_json(done, observer), failure=why_not_good(done), as_json=as_json)


def _recipe_of_captures(name: str, *, settings: Sequence[str], seed: int | None) -> Recipe:
    from telewide.recipe import load_recipe

    recipe = load_recipe(name, settings=settings, seed=seed)
    if recipe.train.worlds:
        raise UsageError(
            f"recipe {name} trains on worlds alone, for hours, and looks at no capture",
            hint=f"`telewide train --recipe {shlex.quote(name)}` does that; for captures take another, such as default",
        )
    return recipe
