"""``telewide calibrate`` and ``telewide show``: a rig from photos of a board, and a rig in words."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telewide.errors import QualityError, UsageError

if TYPE_CHECKING:
    from telewide.calibrate import CalibrationRun
    from telewide.progress import ConsoleObserver

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output.")]
CALIBRATE_EPILOG = (
    "Example: `telewide calibrate --square-m 0.0243`, with the photos in boards/; "
    "without a board: `telewide calibrate captures/ --from-scenes`"
)
SHOW_EPILOG = "Example: `telewide show rig.yaml`"


def calibrate(
    photos: Annotated[
        Path | None,
        typer.Argument(metavar="BOARDS", help="Folder of the board photos. [default: boards/]", show_default=False),
    ] = None,
    *,
    board: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="Board. [default: found in the photos]")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option(metavar="M", help="Measured side of a square, metres. [default: the board's]")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="File to write; a report lies beside it.")] = Path("rig.yaml"),
    seed: Annotated[int, typer.Option(help="Seed of the choice of photos held out.")] = 0,
    as_json: JsonOption = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but problems.")] = False,
) -> None:
    """Turn photos of a board, taken with both lenses, into rig.yaml and a report that says how good it is."""
    from telewide.calibrate import BOARDS_FOLDER, CalibrateOptions, calibrate_boards

    _check_out(out)
    options = CalibrateOptions(board=board, square_m=square_m, out=out, seed=seed)
    with _observer(is_quiet=quiet) as observer:
        done = calibrate_boards(photos or BOARDS_FOLDER, options=options, observer=observer)
        observer.close()
        _say(done, observer)
    _hand_over(done, as_json=as_json)


def show(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="A rig.yaml.")] = Path("rig.yaml"),
    *,
    as_json: JsonOption = False,
) -> None:
    """Print a rig for people: lenses, their distance, how sure each number is, and what the rig is worth."""
    import yaml

    from telewide.calibration.rig_file import read_rig
    from telewide.output.rig_text import rig_lines

    stored = read_rig(rig)
    if as_json:
        typer.echo(json.dumps(_plain(yaml.safe_load(rig.read_text(encoding="utf-8"))), ensure_ascii=False))
    else:
        typer.echo("\n".join(rig_lines(stored)))


def _check_out(out: Path) -> None:
    if out.suffix.lower() not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: a file that ends in .yaml was expected")
    if out.is_dir():
        raise UsageError(f"--out {out} is a folder; a file was expected")


@contextmanager
def _observer(*, is_quiet: bool) -> Iterator[ConsoleObserver]:
    from rich.console import Console

    from telewide.progress import ConsoleObserver

    observer = ConsoleObserver(Console(stderr=True), is_quiet=is_quiet)
    try:
        yield observer
    finally:
        observer.close()


def _say(done: CalibrationRun, observer: ConsoleObserver) -> None:
    from telewide.output.rig_text import summary_line

    calibration = done.calibration
    for note in done.notes:
        observer.warned(f"note: {note}")
    for check in calibration.quality.checks:
        if check.status != "pass":
            observer.warned(f"{check.status}: {check.name}: {check.advice}")
    std_m = calibration.transform_std.baseline_m
    observer.said(summary_line(calibration.rig, calibration.quality, baseline_std_m=std_m))
    observer.said(f"rig: {done.rig}")
    observer.said(f"report: {done.report}")
    if calibration.quality.verdict != "insufficient":
        observer.said("next: telewide train captures/")


def _hand_over(done: CalibrationRun, *, as_json: bool) -> None:
    """Answer in JSON where asked, and leave with code 4 where the rig is not good enough."""
    failed = [check for check in done.calibration.quality.checks if check.status == "fail"]
    failure: QualityError | None = None
    if done.calibration.quality.verdict == "insufficient":
        failure = QualityError(
            f"{done.rig} was written, and marked as not good enough to compute depth with",
            hint=f"{' '.join(check.advice for check in failed)} {done.report} shows more".strip(),
        )
    if not as_json:
        if failure is not None:
            raise failure
        return
    answer = _json_of(done)
    if failure is not None:
        answer |= {"error": failure.message, "hint": failure.hint, "exit_code": failure.exit_code}
        typer.echo(f"error: {failure.message}\n  {failure.hint}", err=True)
    typer.echo(json.dumps(_plain(answer), ensure_ascii=False))
    if failure is not None:
        raise typer.Exit(failure.exit_code)


def _json_of(done: CalibrationRun) -> dict[str, object]:
    calibration = done.calibration
    rig, quality = calibration.rig, calibration.quality
    figures = {
        field.name: getattr(quality, field.name)
        for field in dataclasses.fields(quality)
        if field.name not in ("checks", "verdict")
    }
    return {
        "rig": str(done.rig),
        "report": str(done.report),
        "verdict": quality.verdict,
        "board": done.facts.board,
        "scale_verified": done.facts.scale_verified,
        "baseline_m": rig.baseline_m if rig.is_scale_known else None,
        "baseline_std_m": calibration.transform_std.baseline_m,
        "asymmetry": rig.asymmetry,
        **figures,
        "checks": [dataclasses.asdict(check) for check in quality.checks],
        "left_out": [
            {"shot": view.shot, "camera": view.camera, "rms_px": view.rms_px, "reason": view.reason}
            for view in calibration.views
            if not view.is_used
        ],
        "notes": list(done.notes),
    }


def _plain(value: object) -> object:
    """Numbers that do not exist become null; JSON has none of them."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
