"""``telewide depth``: disparity, metres and bokeh of every capture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.cli.arguments import (
    CapturesArgument,
    DeviceOption,
    DistanceOption,
    FormatOption,
    JsonOption,
    MethodOption,
    OnlyOption,
    QuietOption,
    RigOption,
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
from telewide.cores import Device
from telewide.errors import QualityError, UsageError
from telewide.files import is_there
from telewide.matching.methods import Method
from telewide.text import command_line, counted

if TYPE_CHECKING:
    from telewide.bokeh.picture import BokehOptions
    from telewide.cli.progress import ConsoleObserver
    from telewide.stages.depth import DepthOptions, DepthRun

DEPTH_EPILOG = (
    "Example: `telewide depth --bokeh --preview --focus near`, and without `--preview` once it pleases; without a "
    "network: `telewide depth --method sgm`"
)


def depth(
    context: typer.Context,
    captures: CapturesArgument = Path("captures"),
    *,
    # torchrun takes what begins like its own --run-path for itself: hence a second name.
    run: Annotated[
        Path | None, typer.Option("--run", "--run-folder", help="Run folder of a training. [default: as train has it]")
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="Weights file instead of a run's newest.")] = None,
    method: MethodOption = "network",
    bokeh: Annotated[bool, typer.Option("--bokeh", help="Make bokeh.jpg as well.")] = False,
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
    only: OnlyOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. [default: RUN/depth]")] = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute disparity, depth where the scale is known, and bokeh."""
    options = depth_options(
        method=method,
        weights=weights,
        bokeh=BokehWords.of_call(context).options_if(is_asked=bokeh),
        out=out,
        device=device,
        rig=rig,
        distance=distance,
        formats=formats or (),
        only=tuple(only or ()),
        is_stripped=strip,
    )
    from telewide.pipeline import depth_captures
    from telewide.stages.depth import recipe_of_depth

    with console_observer(is_quiet=quiet, shows_table=False, invocation=typed(context)) as observer:
        recipe = recipe_of_depth(run, captures, weights=weights)
        done = depth_captures(captures, run=run, recipe=recipe, options=options, observer=observer)
        say_depth(done, observer, has_previews=preview, formats=formats or ())
    hand_over(depth_as_json(done, observer), failure=why_not_good(done), as_json=as_json)


def refuse_beside_sgm(method: Method, weights: Path | None, device: Device) -> None:
    """Refuse what belongs to a network where none is used."""
    if method != "sgm":
        return
    if weights is not None:
        raise UsageError(
            "--method sgm matches without a network, and --weights names one", hint="leave one of them out"
        )
    if device == "cuda":
        raise UsageError("--method sgm runs on the processor, not on a GPU", hint="leave --device out")


def depth_options(
    *,
    method: Method,
    weights: Path | None,
    bokeh: BokehOptions | None,
    out: Path | None,
    device: Device,
    rig: Path | None,
    distance: str | None,
    only: tuple[str, ...] = (),
    formats: Sequence[str] = (),
    is_stripped: bool = False,
) -> DepthOptions:
    """Turn words of the command line into the options of depth.

    Args:
        method: as given to ``--method``.
        weights: a file, or None for the run's newest.
        bokeh: None for no bokeh picture.
        out: folder for the results, or None for the run's.
        device: as given to ``--device``.
        rig: a file, or None for the one by the captures.
        distance: as given to ``--distance``.
        only: as given to ``--only``.
        formats: as given to ``--format``.
        is_stripped: whether ``--strip`` was given.

    Raises:
        UsageError: a word that is none of the known ones, or that has no effect, or a file that is not there.
        MissingPartError: a format whose extra is not installed.
    """
    from telewide.depth.pin import parse_known_distance
    from telewide.stages.depth import DepthOptions

    refuse_beside_sgm(method, weights, device)
    if weights is not None and not is_there(weights):
        raise UsageError(f"{weights} does not exist; a weights file was expected")
    return DepthOptions(
        method=method,
        weights=weights,
        bokeh=bokeh,
        out=out,
        device=device,
        rig=rig,
        known=parse_known_distance(distance) if distance is not None and distance != "exif" else None,
        trusts_focus=distance == "exif",
        only=only,
        formats=_formats(formats, is_stripped_alone=is_stripped and bokeh is None),
        is_stripped=is_stripped,
    )


def _formats(words: Sequence[str], *, is_stripped_alone: bool) -> tuple[str, ...] | None:
    """Choose the depth files, some with facts where these alone are to be left out; None for those that lie there."""
    from telewide.depth.export import WITH_FACTS, chosen_formats

    chosen = chosen_formats(words)
    if is_stripped_alone and not WITH_FACTS.intersection(chosen):
        raise UsageError(
            "--strip leaves facts of the photo out of files that hold any, and none of these does",
            hint=f"add --bokeh, or a --format of {', '.join(sorted(WITH_FACTS))}",
        )
    return chosen if words else None


def say_depth(
    done: DepthRun, observer: ConsoleObserver, *, has_previews: bool = False, formats: Sequence[str] = ()
) -> None:
    """Say where depth was written, which files each capture has, and what to look at.

    Args:
        done: what was written.
        observer: says it.
        has_previews: whether previews of the bokeh were asked for.
        formats: as given to ``--format``.
    """
    from telewide.depth.export import missing_formats
    from telewide.stages.kept_depth import PREVIEW_BOKEH_NAME

    observer.said(f"depth of {counted(len(done.outcomes), 'capture')} in {done.folder}")
    if done.outcomes:
        names = sorted(set.intersection(*({path.name for path in outcome.paths} for outcome in done.outcomes)))
        observer.said(f"each with: {', '.join(names)}")
    for missing in missing_formats(formats):
        observer.warned(f"warning: {missing}")
    previews = [path for outcome in done.outcomes for path in outcome.paths if path.name == PREVIEW_BOKEH_NAME]
    if has_previews and previews:
        more = f" and {len(previews) - 1} more" if len(previews) > 1 else ""
        observer.said(f"to look at: {previews[0]}{more}")
    if done.report is not None:
        observer.said(f"to look at: {done.report}; `{command_line('view', done.report.parent)}` opens it")


def why_not_good(done: DepthRun) -> QualityError | None:
    """Tell what is wrong with results of which none has what its rig promises; None where one has."""
    withheld = [outcome.withheld for outcome in done.outcomes if outcome.withheld is not None]
    if not withheld or len(withheld) < len(done.outcomes):
        return None
    return QualityError(
        f"disparity was written to {done.folder}, but no capture has depth in metres; {withheld[0]}",
        hint="measure the distance of one point in each photo and name it with --distance X,Y,M; or calibrate from "
        "photos of a board"
        if done.has_rig
        else "correct what captures.yaml states, and run the command again",
    )


def depth_as_json(done: DepthRun, observer: ConsoleObserver) -> dict[str, object]:
    """Return what was written as plain data, for ``--json``."""
    return {
        "folder": str(done.folder),
        "report": None if done.report is None else str(done.report),
        "captures": [
            {
                "name": outcome.name,
                "files": [str(path) for path in outcome.paths],
                "notes": list(outcome.notes),
                "numbers": dict(outcome.numbers),
                "withheld": outcome.withheld,
            }
            for outcome in done.outcomes
        ],
        "warnings": list(observer.warnings),
        "problems": [{"name": problem.name, "message": problem.message} for problem in done.problems],
    }
