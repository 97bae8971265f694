"""``telewide calibrate``: a rig from photos of a board, or from ordinary captures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.cli.arguments import DEFAULT_RIG, JsonOption, QuietOption
from telewide.cli.console import console_observer, hand_over
from telewide.errors import QualityError, UsageError
from telewide.files import is_folder, refuse_unwritable
from telewide.ranges import MAX_SEED
from telewide.text import command_line

if TYPE_CHECKING:
    from telewide.cli.progress import ConsoleObserver
    from telewide.stages.calibrate_scenes import SceneOptions
    from telewide.stages.rig_run import CalibrationRun

PhotosArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="BOARDS|CAPTURES", help="Folder of the photos. [default: boards/, or captures/ with --from-scenes]"
    ),
]
BoardOption = Annotated[str | None, typer.Option(metavar="NAME|FILE", help="Board. [default: found in the photos]")]
SquareOption = Annotated[
    float | None, typer.Option(metavar="M", help="Measured side of a square, metres. [default: the board's]")
]
ScenesOption = Annotated[
    bool, typer.Option("--from-scenes", help="No board: find a rig from EXIF and the matches of captures.")
]
BaselineOption = Annotated[
    float | None, typer.Option(metavar="M", help="Distance of the lenses, metres, by a ruler; with --from-scenes.")
]
SideOption = Annotated[
    str | None,
    typer.Option(
        metavar="left|right|above|below",
        help="Where the wide lens stands, seen from tele and from behind the phone, photos upright; with "
        "--from-scenes. [default: guessed]",
    ),
]
F35Option = Annotated[
    str | None,
    typer.Option(metavar="TELE,WIDE", help="35 mm equivalents where EXIF has none, such as 80,27; with --from-scenes."),
]
CALIBRATE_EPILOG = (
    "Example: `telewide calibrate --square-m 0.0243`, with the photos in boards/; "
    "without a board: `telewide calibrate captures/ --from-scenes`"
)


def calibrate(
    photos: PhotosArgument = None,
    *,
    board: BoardOption = None,
    square_m: SquareOption = None,
    from_scenes: ScenesOption = False,
    baseline_m: BaselineOption = None,
    wide_side: SideOption = None,
    f35: F35Option = None,
    out: Annotated[Path, typer.Option("--out", help="File to write; the report lies beside it.")] = DEFAULT_RIG,
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of the choice of photos held out.")] = 0,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Turn photos of a board, taken with both lenses, into rig.yaml and a report that says how good it is."""
    _check_out(out)
    if from_scenes:
        if board is not None or square_m is not None:
            raise UsageError("--board and --square-m describe a board; --from-scenes goes without one")
        stated = _scene_options(out, baseline_m=baseline_m, wide_side=wide_side, f35=f35, seed=seed)
        _calibrate_scenes(photos, stated, as_json=as_json, quiet=quiet)
        return
    _refuse_options_of_scenes({"--baseline-m": baseline_m, "--wide-side": wide_side, "--f35": f35})
    from telewide.stages.calibrate import CalibrateOptions, calibrate_boards, calibrate_call, captures_beside
    from telewide.stages.rig_run import BOARDS_FOLDER, calls_with_rig

    options, boards = CalibrateOptions(board=board, square_m=square_m, out=out, seed=seed), photos or BOARDS_FOLDER
    with console_observer(is_quiet=quiet) as observer:
        done = calibrate_boards(boards, options=options, observer=observer)
        _say(done, observer, next_steps=calls_with_rig(captures_beside(boards), out))
    _hand_over(done, again=f"Then again: {calibrate_call(boards, options).again()}", as_json=as_json)


def _check_out(out: Path) -> None:
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: a file that ends in .yaml was expected")
    if is_folder(out):
        raise UsageError(f"--out {out} is a folder; a file was expected")
    refuse_unwritable(out)


def _refuse_options_of_scenes(stated: Mapping[str, object]) -> None:
    named = [flag for flag, value in stated.items() if value is not None]
    if named:
        raise UsageError(
            f"{' and '.join(named)} {'goes' if len(named) == 1 else 'go'} with --from-scenes only",
            hint="photos of a board show focal lengths, distance and places of the lenses by themselves: leave it out",
        )


def _scene_options(
    out: Path, *, baseline_m: float | None, wide_side: str | None, f35: str | None, seed: int
) -> SceneOptions:
    from telewide.calibration.scene_rig import SIDES
    from telewide.ranges import MAX_BASELINE_M
    from telewide.stages.calibrate_scenes import SceneOptions

    if baseline_m is not None and not 0 < baseline_m <= MAX_BASELINE_M:
        raise UsageError(f"--baseline-m {baseline_m:g}: metres were expected, above 0 and at most {MAX_BASELINE_M:g}")
    side = next((side for side in SIDES if side == wide_side), None)
    if wide_side is not None and side is None:
        raise UsageError(f"--wide-side {wide_side}: one of {', '.join(SIDES)} was expected")
    return SceneOptions(baseline_m=baseline_m, wide_side=side, f35_mm=_parsed_f35(f35), out=out, seed=seed)


def _calibrate_scenes(photos: Path | None, options: SceneOptions, *, as_json: bool, quiet: bool) -> None:
    from telewide.stages.calibrate_scenes import calibrate_scenes, scenes_call
    from telewide.stages.rig_run import BOARDS_FOLDER, CAPTURES_FOLDER, calls_with_rig, stated_rig

    captures, rig = photos or CAPTURES_FOLDER, stated_rig(options.out)
    with console_observer(is_quiet=quiet) as observer:
        done = calibrate_scenes(captures, options=options, observer=observer)
        _say(done, observer, next_steps=calls_with_rig(captures, options.out))
    again = (
        f"After more captures: {scenes_call(captures, options).again()}\n"
        f"  After photos of a board: {command_line('calibrate', BOARDS_FOLDER, out=rig)}"
    )
    _hand_over(done, again=again, as_json=as_json)


def _parsed_f35(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        tele_mm, wide_mm = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--f35 {text}: two numbers were expected, tele first, such as 80,27") from None
    if not 0 < wide_mm < tele_mm < math.inf:
        raise UsageError(f"--f35 {text}: tele's focal length comes first, and is the longer one")
    return tele_mm, wide_mm


def _say(done: CalibrationRun, observer: ConsoleObserver, *, next_steps: tuple[str, str]) -> None:
    from telewide.pages.rig_text import summary_line

    observer.close()
    stored = done.stored
    for note in done.notes:
        observer.warned(f"warning: {note}")
    for check in stored.quality.checks:
        if check.status != "pass":
            observer.warned(f"{check.status}: {check.name}: {check.advice}")
    std_m = stored.transform_std.baseline_m if stored.transform_std is not None else None
    observer.said(summary_line(stored.rig, stored.quality, baseline_std_m=std_m))
    observer.said(f"rig: {done.rig}")
    observer.said(f"report: {done.report}")
    if stored.quality.verdict != "insufficient":
        depth, train = next_steps
        observer.said(f"next: {depth}")
        observer.said(f"then, to adapt the network to your captures: {train}")


def _hand_over(done: CalibrationRun, *, again: str, as_json: bool) -> None:
    """Answer in JSON where asked, and leave with code 4 where the rig is not good enough."""
    failure: QualityError | None = None
    quality = done.stored.quality
    if quality.verdict == "insufficient":
        advice = " ".join(check.advice for check in quality.checks if check.status == "fail")
        failure = QualityError(
            f"{done.rig} was written, and marked as not good enough to compute depth with", hint=f"{advice} {again}"
        )
    hand_over(_json_of(done), failure=failure, as_json=as_json)


def _json_of(done: CalibrationRun) -> dict[str, object]:
    rig, quality, std = done.stored.rig, done.stored.quality, done.stored.transform_std
    figures = {
        field.name: getattr(quality, field.name)
        for field in dataclasses.fields(quality)
        if field.name not in ("checks", "verdict")
    }
    return {
        "rig": str(done.rig),
        "report": str(done.report),
        "verdict": quality.verdict,
        "source": done.stored.facts.source,
        "board": done.stored.facts.board,
        "scale_verified": done.stored.facts.scale_verified,
        "baseline_m": rig.baseline_m if rig.is_scale_known else None,
        "baseline_std_m": std.baseline_m if std is not None and rig.is_scale_known else None,
        "asymmetry": rig.asymmetry,
        **figures,
        "checks": [dataclasses.asdict(check) for check in quality.checks],
        "left_out": list(done.stored.left_out),
        "notes": list(done.notes),
    }
