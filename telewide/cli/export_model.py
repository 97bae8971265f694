"""``telewide export-model``: a trained network for apps."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from telewide.cli.arguments import JsonOption, QuietOption
from telewide.cli.console import print_json, say
from telewide.errors import UsageError

EXPORT_EPILOG = "Example: `telewide export-model run/ --window 0,64 --size 1280x640 --out depth.onnx`"
_ANY = "any"


def export_model(
    weights: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of a training, or a weights file.")] = Path(
        "run"
    ),
    *,
    window: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST,END", help="Disparities to search, px, multiples of 4. [default: those it was trained for]"
        ),
    ] = None,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT|any", help="Size of the views, px; any: all multiples of 64.")
    ] = _ANY,
    out: Annotated[Path, typer.Option("--out", help="Model to write.")] = Path("telewide.onnx"),
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a trained network as an ONNX model, checked with onnxruntime; needs the extra `onnx`."""
    from telewide.stages.export_model import export_model as export

    if out.suffix.lower() != ".onnx":
        raise UsageError(f"--out {out}: a model is written as .onnx")
    wh = None if size == _ANY else _numbers(size, "x", f"--size {size}: 1280x640, say, or {_ANY} was expected")
    done = export(
        weights,
        out,
        window=None if window is None else _numbers(window, ",", f"--window {window}: 0,64, say, was expected"),
        hw=None if wh is None else (wh[1], wh[0]),
        tell=(lambda text: None) if quiet else say,
    )
    if not quiet:
        fixed = "views of any size" if done.hw is None else f"views of {done.hw[1]}x{done.hw[0]}"
        megabytes = done.path.stat().st_size / 1e6
        say(f"wrote {done.path}: {done.network}, {done.window[0]} to {done.window[1]} px, {fixed}, {megabytes:.1f} MB")
        for c in done.comparisons:
            say(
                f"at {c.hw[1]}x{c.hw[0]} it differs from torch at {100 * c.differing:.2g} % of the pixels; "
                f"onnxruntime {c.onnxruntime_s:.2f} s, torch {c.torch_s:.2f} s on {c.threads} threads"
            )
    if as_json:
        plain = {name: value for name, value in asdict(done).items() if name != "path"}
        print_json({"model": str(done.path), **plain})


def _numbers(text: str, separator: str, message: str) -> tuple[int, int]:
    found = re.fullmatch(rf"(-?\d{{1,6}}){separator}(-?\d{{1,6}})", text.strip())
    if found is None:
        raise UsageError(message)
    return int(found[1]), int(found[2])
